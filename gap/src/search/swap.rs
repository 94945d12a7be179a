//! Others in the place of each effect, and the plainest of those that do as well.

use crate::Error;
use crate::fitting::fit::{Sensitivities, cost, rig_with};
use crate::fitting::knobs::{EffectRef, is_plain};
use crate::fitting::model::{Model, Term, knobs_from, start_terms};
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::screen::Gain;
use crate::search::select::Search;
use crate::search::widen::PROMISE;
use crate::session::scene::{Stack, Wanted};

/// A plainer model may leave this much more than the best one, of what that leaves, or of what it saves.
pub(super) const AS_LITTLE: f64 = 0.1;

/// What a model that is behind leaves at most, as a multiple of what the one before it does.
const NEAR: f64 = 4.0;

/// Models about which effects are swapped: the plainest of them may be another one than what was swapped about.
const ROUNDS: usize = 2;

impl Search<'_> {
    /// Try others in the place of each effect of a model of several. An effect that was fitted alone, or beside a wrong one, made
    /// up for what it lacked: what suits best beside it may only show once it has found its own size.
    pub(crate) fn swap(&mut self, model: Model) -> Result<Model, Error> {
        let size = model.terms.len();
        if size < 2 {
            return Ok(self.plainest(model));
        }
        let mut at = model;
        for _ in 0..ROUNDS {
            self.swap_each(&at)?;
            // What leaves least may not be worth it where what keeps to axes of its own is.
            let Some(best) = self.chosen_of(size).or_else(|| self.best_of(size)) else { break };
            let best = self.plainest(best);
            let has_moved = best.key() != at.key();
            at = best;
            if !has_moved {
                break;
            }
        }
        Ok(at)
    }

    /// Try others in the place of each effect of `model`, and remember them.
    fn swap_each(&mut self, model: &Model) -> Result<(), Error> {
        let names = model.key();
        for t in 0..model.terms.len() {
            if self.is_spent() {
                break;
            }
            let mut others = start_terms(model);
            others.remove(t);
            let (stack, gains) = self.offered_beside(&others)?;
            let needed = cost(&stack) - model.fit.cost;
            let mut offers = self.shortlist(&gains, &names, usize::MAX);
            let rest = offers.split_off(offers.len().min(self.breadth.swaps));
            // What it is known to be confused with is asked for, however many others promise more.
            let alike = model.terms[t].effect.info().confused_with;
            let is_alike = |effect: &EffectRef| alike.contains(&effect.info().name);
            let (known, plain): (Vec<_>, Vec<_>) =
                rest.into_iter().partition(|(effect, _)| is_alike(effect));
            offers.extend(known);
            let plain = plain.into_iter();
            // An effect of many forms promises more than the plain one whose form it takes on here.
            let plain = plain.filter(|(effect, _)| is_plain(*effect));
            offers.extend(plain.take(self.breadth.plain));
            for (effect, gains) in offers {
                if gains.iter().map(|g| g.gain).sum::<f64>() < PROMISE * needed || self.is_spent() {
                    continue;
                }
                let mut key: Vec<&str> = others.iter().map(|(term, _)| term.name()).collect();
                key.push(effect.info().name);
                key.sort_unstable();
                if !self.is_tried(&key) || (is_alike(&effect) && self.is_behind(model, &key, t)) {
                    let model = self.fit_terms((&others, &stack), effect, &gains)?;
                    self.remember(model);
                }
            }
        }
        Ok(())
    }

    /// What known terms leave where they stand, and what each effect promises to take off that, the terms giving way.
    pub(super) fn offered_beside(
        &self,
        known: &[(Term, Vec<f64>)],
    ) -> Result<(Stack, Vec<Vec<Gain>>), Error> {
        let (terms, values): (Vec<Term>, Vec<Vec<f64>>) = known.iter().cloned().unzip();
        let values = values.concat();
        let knobs = knobs_from(&terms, &values, &self.ranges);
        let rig = rig_with(self.nominal, &knobs, &values)?;
        let stack = self.scene.residuals_at(&rig, Wanted::ALL, self.include)?;
        let beside =
            Sensitivities::at(self.scene, self.nominal, &knobs, &values, &stack, self.include)?;
        let gains = self.screen.test(self.scene, &stack, Some(&beside).filter(|b| !b.is_empty()));
        Ok((stack, gains))
    }

    /// Whether the best model of these effects is not far behind `model` and may be where its fit got stuck: beside what has a form of its own, other
    /// than in term `t`, an effect that is confused with that one is worth a fit from where those stand now.
    fn is_behind(&self, model: &Model, key: &[&str], t: usize) -> bool {
        let left = |m: &Model| m.fit.cost - self.noise;
        let mut others = model.terms.iter().enumerate().filter(|(other, _)| *other != t);
        let best = self.tried.iter().find(|m| m.key() == key);
        others.any(|(_, term)| !is_plain(term.effect))
            && best.is_some_and(|best| {
                let behind = best.fit.cost - model.fit.cost;
                behind > NOISE_MARGIN && left(best) < NEAR * left(model)
            })
    }

    /// The model of fewest numbers among those that leave about as little as the best one, of as many effects.
    pub(crate) fn plainest(&self, best: Model) -> Model {
        let left = (best.fit.cost - self.noise).max(0.0);
        let saved = (self.gap - left).max(0.0);
        let most = best.fit.cost + NOISE_MARGIN + AS_LITTLE * left.min(saved);
        let is_rival = |m: &&Model| m.terms.len() == best.terms.len() && m.fit.cost < most;
        let plainest = self.tried.iter().filter(is_rival).min_by_key(|m| m.numbers());
        match plainest {
            Some(plain) if plain.numbers() < best.numbers() => plain.clone(),
            _ => best,
        }
    }
}
