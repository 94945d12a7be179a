//! What a search found, checked on the recordings that were not fitted before it is an answer.

use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::cost;
use crate::fitting::model::{Model, Term, start_terms};
use crate::search::found::wandering;
use crate::search::select::Search;
use crate::search::worth::WORTH_OF_GAP;
use crate::session::energy::Energies;
use crate::session::scene::{Channel, Wanted};

fn held(channel: &Channel) -> bool {
    channel.held_out
}

/// `model`, or what leaves far less of the recordings held out, of those models that have no more effects and are about as good where they were
/// fitted. Slow motion hardly weighs in a fit, as gauges wander; relaxation and creep that nearly account for each other differ by nothing else.
pub(super) fn carries_over(search: &Search, model: Model) -> Result<Model, Error> {
    /// Energy beyond the noise that is open in the recordings held out, as a share of that of the noise,
    const OPEN: f64 = 0.5;
    /// and what another model may leave of it at most.
    const FAR_LESS: f64 = 0.3;
    /// Most models that are looked at.
    const MOST: usize = 8;
    let before = search.scene.raw(search.nominal, held)?;
    let open = |model: &Model| -> Result<f64, Error> {
        let after = search.scene.raw(&model.fit.rig, held)?;
        let gap =
            Energies::new(search.scene, &before, &after, &held).gap(search.nominal.axes.len());
        Ok((gap.after_nm / gap.floor_nm).powi(2) - 1.0)
    };
    let left = open(&model)?;
    if left < OPEN || !wandering(&model).is_empty() {
        return Ok(model);
    }
    let mut known = vec![model.key()];
    let mut best: Option<((usize, f64), &Model)> = None;
    for other in &search.tried {
        let key = other.key();
        let as_good = other.fit.cost < model.fit.cost + WORTH_OF_GAP * search.gap;
        if !as_good || known.len() > MOST {
            break;
        }
        if key.len() > model.terms.len() || known.contains(&key) || !wandering(other).is_empty() {
            continue;
        }
        // One effect that carries over comes before two.
        let rank = (key.len(), open(other)?);
        known.push(key);
        if rank.1 < FAR_LESS * left && best.is_none_or(|(least, _)| rank < least) {
            best = Some((rank, other));
        }
    }
    match best {
        Some((_, other)) => {
            let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(other).into_iter().unzip();
            search.fit_model(terms, start.concat(), search.effort())
        }
        None => Ok(model),
    }
}

/// Take out effects that make the held-out recordings worse: they only mended the form of another one where it was fitted.
pub(super) fn stands_elsewhere(search: &Search, model: Model) -> Result<Model, Error> {
    /// Rise of the held-out cost that is no accident, in noise variances,
    const WORSE: f64 = 30.0;
    /// and as a share of what the effect takes off where it was fitted. A limit that one recording of steps reaches by far does next to
    /// nothing in others, and its form shows there.
    const WORSE_OF_TAKEN: f64 = 0.02;
    let mut model = model;
    while model.terms.len() > 1 {
        let mut rigs = vec![model.fit.rig.clone()];
        for t in 0..model.terms.len() {
            rigs.push(model.without(search.nominal, t, |_| true)?);
        }
        let jobs: Vec<(&Rig, Wanted)> = rigs.iter().map(|r| (r, Wanted::ALL)).collect();
        let costs: Vec<f64> = search.scene.residuals(&jobs, held)?.iter().map(cost).collect();
        let mut worst: Option<usize> = None;
        for t in (0..model.terms.len()).filter(|t| costs[t + 1] < costs[0] - WORSE) {
            let without = search.scene.residuals_at(&rigs[t + 1], Wanted::ALL, search.include)?;
            let taken = cost(&without) - model.fit.cost;
            let is_worst = worst.is_none_or(|worst| costs[t + 1] < costs[worst + 1]);
            if is_worst && costs[0] - costs[t + 1] > WORSE_OF_TAKEN * taken {
                worst = Some(t);
            }
        }
        let Some(t) = worst else { break };
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(&model)
            .into_iter()
            .enumerate()
            .filter(|(k, _)| *k != t)
            .map(|(_, term)| term)
            .unzip();
        model = search.fit_model(terms, start.concat(), search.effort())?;
    }
    Ok(model)
}
