//! What a search found, checked on the recordings that were not fitted before it is an answer. Which of two answers is given may hang on these, the
//! numbers in it never do: what is promised of them is then no longer blind, and `flexstage blind` measures it on further ones.

use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::cost;
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::{Model, Term, start_terms};
use crate::search::found::wandering;
use crate::search::screen::Gain;
use crate::search::select::Search;
use crate::search::worth::WORTH_OF_GAP;
use crate::session::energy::Energies;
use crate::session::scene::{Channel, Wanted};

fn held(channel: &Channel) -> bool {
    channel.held_out
}

/// Effects of slow strain, each of which nearly accounts for the other.
const SLOW: [&str; 2] = ["creep", "viscoelasticity"];

/// Energy beyond the noise that is open in the recordings held out, as a share of that of the noise,
const OPEN: f64 = 0.5;
/// and what another model may leave of it at most.
const FAR_LESS: f64 = 0.3;
/// Most models that are looked at.
const MOST: usize = 8;

/// `model`, or what leaves far less of the recordings held out, of those models that have no more effects and are about as good where they were
/// fitted. Slow motion hardly weighs in a fit, as gauges wander; relaxation and creep that nearly account for each other differ by nothing else, so
/// that the other one is tried where none was that carries over.
pub(super) fn carries_over(search: &mut Search, model: Model) -> Result<Model, Error> {
    let before = search.scene.raw(search.nominal, held)?;
    let open = |search: &Search, model: &Model| -> Result<f64, Error> {
        let after = search.scene.raw(&model.fit.rig, held)?;
        let gap =
            Energies::new(search.scene, &before, &after, &held).gap(search.nominal.axes.len());
        Ok((gap.after_nm / gap.floor_nm).powi(2) - 1.0)
    };
    let left = open(search, &model)?;
    if left < OPEN || !wandering(&model).is_empty() {
        return Ok(model);
    }
    let mut best = best_elsewhere(search, &model, |other| {
        Ok(Some(open(search, other)?).filter(|by_it| *by_it < FAR_LESS * left))
    })?;
    if best.is_none() && !search.is_spent() {
        for other in slow_instead(search, &model)? {
            let other = search.prune(other)?;
            if is_as_good(search, &other, &model) && open(search, &other)? < FAR_LESS * left {
                best = Some(other);
                break;
            }
        }
    }
    let Some(best) = best else { return Ok(model) };
    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(&best).into_iter().unzip();
    search.fit_model(terms, start.concat(), search.effort())
}

/// Whether a model is about as good as another one where both were fitted.
fn is_as_good(search: &Search, other: &Model, model: &Model) -> bool {
    other.fit.cost < model.fit.cost + WORTH_OF_GAP * search.gap
}

/// Of the models that were tried, are about as good as `model` and have no more effects: the one of fewest, and among these the one that leaves
/// least elsewhere, of those that leave little enough.
fn best_elsewhere(
    search: &Search,
    model: &Model,
    leaves_little: impl Fn(&Model) -> Result<Option<f64>, Error>,
) -> Result<Option<Model>, Error> {
    let mut known = vec![model.key()];
    let mut best: Option<((usize, f64), &Model)> = None;
    for other in &search.tried {
        let key = other.key();
        if !is_as_good(search, other, model) || known.len() > MOST {
            break;
        }
        if key.len() > model.terms.len() || known.contains(&key) || !wandering(other).is_empty() {
            continue;
        }
        let size = key.len();
        known.push(key);
        let Some(left) = leaves_little(other)? else { continue };
        if best.is_none_or(|(least, _)| (size, left) < least) {
            best = Some(((size, left), other));
        }
    }
    Ok(best.map(|(_, model)| model.clone()))
}

/// `model` with creep in the place of relaxation, or the other way round.
fn slow_instead(search: &mut Search, model: &Model) -> Result<Vec<Model>, Error> {
    let mut models = Vec::new();
    for t in 0..model.terms.len() {
        let name = model.terms[t].name();
        let Some(instead) = SLOW.into_iter().find(|other| SLOW.contains(&name) && *other != name)
        else {
            continue;
        };
        let others = model.part(|term, _| term.name() != name && term.name() != instead);
        let (stack, gains) = search.offered_beside(&others)?;
        let offers = search.shortlist(&gains, &[], usize::MAX);
        let is_it = |(effect, _): &&(EffectRef, Vec<Gain>)| effect.info().name == instead;
        let Some((effect, gains)) = offers.iter().find(is_it) else { continue };
        let fitted = search.fit_terms((&others, &stack), *effect, gains)?;
        search.remember(fitted.clone());
        models.push(fitted);
    }
    Ok(models)
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
