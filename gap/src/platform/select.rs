//! Which effects the data asks for, and what else it could be.
//!
//! Forward steps: every effect of the catalogue is fitted on top of those accepted, the best by BIC is taken, and it stays
//! only if it also shrinks the gap on held-out samples. Then every accepted effect is exchanged for every rival: rivals that
//! do as well within three standard deviations are named with it.

use host_sim::platform::PlatformRig;
use rand::{RngExt, SeedableRng, rngs::SmallRng};

use super::{
    catalogue::Effect,
    data::Split,
    fit::{Data, Fit, fit},
    identify,
    model::{Knob, Model},
    tell,
};

/// Growth of chi-squared within which two models cannot be told apart: three standard deviations.
const INDISTINGUISHABLE: f64 = 9.0;
/// BIC must fall by this much ("very strong" in the usual scale of Kass and Raftery).
const STRONG: f64 = 10.0;
/// An effect must close this share of the gap on held-out samples.
const WORTH_NAMING: f64 = 0.01;
/// At most this many effects.
const MOST: usize = 4;
/// Resamplings of the bootstrap.
const RESAMPLINGS: usize = 1000;
/// Samples in a bootstrap block, at least.
const BLOCK: usize = 20;

/// An accepted effect.
#[derive(Debug, Clone)]
pub struct Accepted {
    /// The effect.
    pub effect: Effect,
    /// Share of the explainable gap that it closes, on held-out samples.
    pub closes: f64,
    /// Its probability among the rivals.
    pub confidence: f64,
    /// Rivals that do as well.
    pub indistinguishable: Vec<(Effect, Fit)>,
}

/// How a single effect did on top of the nominal rig: the table of alternatives.
#[derive(Debug, Clone)]
pub struct Tried {
    /// The effect.
    pub effect: Effect,
    /// Its fit.
    pub fit: Fit,
    /// Gap on held-out samples, m.
    pub held_out_m: f64,
}

/// The chosen effects.
#[derive(Debug, Clone)]
pub struct Selection {
    /// Accepted effects in the order in which they were taken.
    pub accepted: Vec<Accepted>,
    /// Fit of all of them together.
    pub fit: Fit,
    /// Every single effect on the nominal rig.
    pub tried: Vec<Tried>,
}

/// What a decision needs.
#[derive(Debug, Clone, Copy)]
pub struct Question<'a> {
    /// Returns and noise.
    pub data: Data<'a>,
    /// Fitted and held-out samples.
    pub split: &'a Split,
    /// Noise over the held-out samples, m.
    pub floor_m: f64,
    /// Effects that may be named, in the order of the catalogue.
    pub catalogue: &'a [Effect],
}

impl Question<'_> {
    fn held_out_m(&self, rig: &PlatformRig) -> f64 {
        identify::rms_m(self.data, rig, &self.split.held_out).unwrap_or(f64::INFINITY)
    }

    /// Fit `effect` on top of a fit; `None` if it does not apply or cannot be simulated.
    fn add(&self, from: &Fit, effect: Effect) -> Option<Fit> {
        if !effect.applies(&from.model.rig) {
            return None;
        }
        let (model, starts) = effect.extend(from);
        let found = fit(self.data, &model, &self.split.fit, &starts)?;
        if !matches!(effect, Effect::SecondMass | Effect::ThirdMass) {
            return Some(found);
        }
        // Where the order of the springs makes no difference the slow ones go next to the ground.
        let Some(sorted) = tell::slow_springs_inside(&found.model.rig) else { return Some(found) };
        let model = Model { rig: sorted, knobs: found.model.knobs.clone() };
        let start = model.values();
        let again = fit(self.data, &model, &self.split.fit, &[start]);
        Some(again.filter(|again| again.chi2 < found.chi2 + 1.0).unwrap_or(found))
    }

    /// Whether a fit leaves nothing but noise.
    fn at_the_noise(&self, fit: &Fit) -> bool {
        let samples = fit.samples as f64;
        fit.chi2 < samples + 4.0 * (2.0 * samples).sqrt()
    }

    /// Fit several effects, one after the other.
    fn build(&self, nominal: &Fit, effects: &[Effect]) -> Option<Fit> {
        let mut now = nominal.clone();
        for effect in effects {
            now = self.add(&now, *effect)?;
        }
        Some(now)
    }

    /// Evidence of a fit: BIC where it was fitted and chi-squared where it was not; smaller is better.
    fn evidence(&self, fit: &Fit) -> f64 {
        fit.bic() + self.data.chi2(&fit.model.rig, &self.split.held_out)
    }

    /// Whether the gap on held-out samples shrinks from one rig to another, surely (bootstrap over blocks).
    fn shrinks(&self, from: &PlatformRig, to: &PlatformRig) -> bool {
        let part = &self.split.held_out;
        let (Ok(from), Ok(to)) =
            (self.data.residuals_m(from, part), self.data.residuals_m(to, part))
        else {
            return false;
        };
        let gains: Vec<f64> =
            blocks(&from).zip(blocks(&to)).map(|(a, b)| energy(a) - energy(b)).collect();
        let mut sums = resample(&gains, |sample| sample.iter().sum::<f64>());
        sums.sort_by(f64::total_cmp);
        sums.get(sums.len() / 40).is_some_and(|low| *low > 0.0)
    }
}

/// Choose effects.
pub fn select(question: Question, nominal: &PlatformRig) -> Option<Selection> {
    let data = question.data;
    let start = fit(data, &Model::fixed(nominal), &question.split.fit, &[])?;
    let explainable =
        (question.held_out_m(nominal).powi(2) - question.floor_m.powi(2)).max(f64::MIN_POSITIVE);
    let mut tried = Vec::new();
    let mut chain: Vec<(Effect, Fit)> = Vec::new();
    while chain.len() < MOST {
        let now = chain.last().map_or(&start, |(_, fit)| fit).clone();
        let at_the_noise = !chain.is_empty() && question.at_the_noise(&now);
        let candidates: Vec<(Effect, Fit)> = question
            .catalogue
            .iter()
            .copied()
            .filter(|effect| !chain.iter().any(|(own, _)| own == effect))
            // Where only noise is left, the two that are integrated step by step have nothing to find worth their time.
            .filter(|effect| !at_the_noise || !effect.is_stepped())
            .filter_map(|effect| question.add(&now, effect).map(|fit| (effect, fit)))
            .collect();
        if chain.is_empty() {
            tried = candidates
                .iter()
                .map(|(effect, fit)| Tried {
                    effect: *effect,
                    held_out_m: question.held_out_m(&fit.model.rig),
                    fit: fit.clone(),
                })
                .collect();
        }
        let least = candidates.iter().map(|(_, fit)| fit.bic()).fold(f64::INFINITY, f64::min);
        // Of those that do as well, the first of the catalogue.
        let as_well = |(_, fit): &(Effect, Fit)| fit.bic() <= least + INDISTINGUISHABLE;
        let Some((effect, better)) = candidates.into_iter().find(as_well) else { break };
        let gain = question.held_out_m(&now.model.rig).powi(2)
            - question.held_out_m(&better.model.rig).powi(2);
        if now.bic() - better.bic() < STRONG
            || gain < WORTH_NAMING * explainable
            || !question.shrinks(&now.model.rig, &better.model.rig)
        {
            break;
        }
        chain.push((effect, better));
    }
    let (chain, fit) = settle_damping(question, nominal, &start, chain, explainable);
    let names: Vec<Effect> = chain.iter().map(|(effect, _)| *effect).collect();
    let accepted = chain
        .iter()
        .map(|(effect, closes)| {
            let (confidence, indistinguishable) =
                rivals(question, &start, &tried, &names, *effect, &fit);
            Accepted { effect: *effect, closes: *closes, confidence, indistinguishable }
        })
        .collect();
    Some(Selection { accepted, fit, tried })
}

/// Every effect was fitted with the dampers free. Where the chain's own dampers are kept by the effects chosen, say whether
/// they were really wrong: keep them free (and name `damping`) only if the data asks for it.
fn settle_damping(
    question: Question,
    nominal: &PlatformRig,
    start: &Fit,
    chain: Vec<(Effect, Fit)>,
    explainable: f64,
) -> (Vec<(Effect, f64)>, Fit) {
    let held = |fit: &Fit| question.held_out_m(&fit.model.rig).powi(2);
    let mut before = held(start);
    let mut shares: Vec<(Effect, f64)> = Vec::new();
    for (effect, fit) in &chain {
        let now = held(fit);
        shares.push((*effect, (before - now) / explainable));
        before = now;
    }
    let Some((_, full)) = chain.last() else { return (shares, start.clone()) };
    let takes_dampers = |effect: &Effect| {
        matches!(
            effect,
            Effect::Damping | Effect::SecondMass | Effect::ThirdMass | Effect::Viscoelasticity
        )
    };
    if chain.iter().any(|(effect, _)| takes_dampers(effect)) {
        return (shares, full.clone());
    }
    let mut kept = full.model.clone();
    kept.knobs.retain(|knob| !matches!(knob, Knob::Rate(_) | Knob::Share(_)));
    for (i, mass) in kept.rig.masses.iter_mut().enumerate() {
        mass.damping_n_s_per_m = nominal.masses[i].damping_n_s_per_m;
        mass.stiffness_n_per_m = nominal.masses[i].stiffness_n_per_m;
        mass.flexure = nominal.masses[i].flexure;
    }
    let values = kept.values();
    let Some(without) = fit(question.data, &kept, &question.split.fit, &[values]) else {
        return (shares, full.clone());
    };
    let gain = (held(&without) - held(full)) / explainable;
    let may_name = question.catalogue.contains(&Effect::Damping);
    if !may_name || without.bic() - full.bic() < STRONG || gain < WORTH_NAMING {
        return (shares, without);
    }
    if let Some(first) = shares.first_mut() {
        first.1 -= gain;
    }
    shares.push((Effect::Damping, gain));
    shares.sort_by(|a, b| b.1.total_cmp(&a.1));
    (shares, full.clone())
}

/// Exchange one effect for every other one.
fn rivals(
    question: Question,
    start: &Fit,
    tried: &[Tried],
    chosen: &[Effect],
    effect: Effect,
    fit: &Fit,
) -> (f64, Vec<(Effect, Fit)>) {
    if effect == Effect::Damping && chosen.len() > 1 {
        return (1.0, Vec::new()); // asked for by BIC on top of the others; nothing to exchange it for
    }
    let held = |fit: &Fit| question.data.chi2(&fit.model.rig, &question.split.held_out);
    let own = question.evidence(fit);
    let mut weights = 1.0;
    let mut alike = Vec::new();
    for &rival in question.catalogue {
        if chosen.contains(&rival) {
            continue;
        }
        let set: Vec<Effect> =
            chosen.iter().map(|own| if *own == effect { rival } else { *own }).collect();
        let known = tried.iter().find(|tried| set == [tried.effect]).map(|tried| tried.fit.clone());
        let Some(other) = known.or_else(|| question.build(start, &set)) else { continue };
        weights += (-(question.evidence(&other) - own) / 2.0).clamp(-700.0, 50.0).exp();
        if (other.chi2 - fit.chi2) < INDISTINGUISHABLE
            && (held(&other) - held(fit)) < INDISTINGUISHABLE
            && other.values.len() <= fit.values.len()
        {
            alike.push((rival, other));
        }
    }
    let without: Vec<Effect> = chosen.iter().copied().filter(|own| *own != effect).collect();
    if let Some(other) = question.build(start, &without) {
        weights += (-(question.evidence(&other) - own) / 2.0).clamp(-700.0, 50.0).exp();
    }
    (1.0 / weights, alike)
}

/// Residuals in blocks, recording by recording.
pub fn blocks(residuals: &[Vec<f64>]) -> impl Iterator<Item = &[f64]> {
    residuals.iter().flat_map(|recording| recording.chunks(BLOCK))
}

/// Sum of squares.
pub fn energy(residuals: &[f64]) -> f64 {
    residuals.iter().map(|r| r * r).sum()
}

/// A statistic of blocks drawn with replacement, again and again; the same every time that it is run.
pub fn resample<T: Copy>(blocks: &[T], statistic: impl Fn(&[T]) -> f64) -> Vec<f64> {
    if blocks.is_empty() {
        return Vec::new();
    }
    let mut rng = SmallRng::seed_from_u64(1);
    let mut sample = blocks.to_vec();
    (0..RESAMPLINGS)
        .map(|_| {
            for place in &mut sample {
                *place = blocks[rng.random_range(0..blocks.len())];
            }
            statistic(&sample)
        })
        .collect()
}
