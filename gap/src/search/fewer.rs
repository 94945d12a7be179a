//! As few effects as do.
//!
//! Which effects a search adds depends on those it began with. Three that began with a wrong one may leave no more than two right
//! ones that were never tried: a stack of another gain with the loops that it ought not to have is a gauge of another gain. So of the best
//! models of a size, which a swap has brought up, each effect is taken out and the rest fitted again: as it is, and with another effect, that
//! is on other axes alone, in its place. A stack of another gain on two axes and a stiff mechanism on the third may be three stacks of
//! another gain, where nothing tells the two apart.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::{Effort, cost};
use crate::fitting::model::{Model, Term};
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::select::Search;
use crate::search::worth::{WORTH_OF_GAP, WORTH_OF_LEFTOVER};
use crate::session::scene::Wanted;

/// What a model may leave beyond the best one of its size to be looked at, as a share of what that leaves.
const AS_GOOD: f64 = 0.5;
/// Share of the gap that an effect has to carry to be left alone.
const MUCH: f64 = 0.5;
/// Effects that a variety of another one takes in, the parameter that tells the variety, and where fits of it begin, as multiples: of the
/// parameter itself, or of the farthest travel. A spring that runs from axis to axis, or is that of a base under both, is a stiffness as well; a
/// bridge that is right in the middle of the travel, or at its beginning alone, is a gain as well.
const TAKEN_IN: [(&str, (&str, &str), &[f64]); 2] = [
    ("stiffness", ("stiffness-coupling", "own"), &[-1.0, 1.0]),
    ("sensor-gain", ("sensor-nonlinearity", "zero_m"), &[0.5, 0.0]),
];
/// Most models that are looked at.
const MOST_LOOKED_AT: usize = 3;

impl Search<'_> {
    /// `model`, or one of fewer effects that leaves no more than what the last effect has to be worth.
    pub(crate) fn fewer(&mut self, model: Model) -> Result<Model, Error> {
        let size = model.terms.len();
        if size < 2 {
            return Ok(model);
        }
        let left = (model.fit.cost - self.noise).max(0.0);
        let most = model.fit.cost + NOISE_MARGIN + AS_GOOD * left;
        let as_good = |m: &&Model| m.terms.len() == size && m.fit.cost < most;
        let rivals: Vec<Model> =
            self.tried.iter().filter(as_good).take(MOST_LOOKED_AT).cloned().collect();
        // What a smaller model may leave for the larger one not to be worth an effect more.
        let open =
            self.noise + (left / (1.0 - WORTH_OF_LEFTOVER)).max(left + WORTH_OF_GAP * self.gap);
        for rival in rivals {
            for t in 0..size {
                if self.is_spent() {
                    break;
                }
                let name = rival.terms[t].name();
                let effort =
                    Effort { iterations: 8, tolerance: 2.0e-2, hopeless: open, ..self.effort() };
                let key: Vec<&str> = rival.key().into_iter().filter(|n| *n != name).collect();
                let is_known = self.is_tried(&key) || self.carries_much(&rival, t)?;
                for terms in in_place_of(&rival, t) {
                    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
                    let wider = self.fit_model(terms, start.concat(), effort)?;
                    self.remember(wider);
                }
                for (terms, start) in self.taken_in(&rival, t) {
                    let model = self.fit_model(terms, start, effort)?;
                    self.remember(model);
                }
                if is_known {
                    continue;
                }
                let (terms, start): (Vec<Term>, Vec<Vec<f64>>) =
                    rival.part(|term, _| term.name() != name).into_iter().unzip();
                let rest = self.fit_model(terms, start.concat(), effort)?;
                self.remember(rest);
            }
        }
        let smaller = self.chosen_of(size - 1).or_else(|| self.best_of(size - 1));
        let Some(smaller) = smaller else { return Ok(model) };
        if self.is_worth_more(&smaller, &model) { Ok(model) } else { self.fewer(smaller) }
    }

    /// A model without a term, with varieties of another one that take it in: terms and where their fits begin.
    fn taken_in(&self, model: &Model, term: usize) -> Vec<(Vec<Term>, Vec<f64>)> {
        let name = model.terms[term].name();
        let Some((_, (by, parameter), starts)) = TAKEN_IN.iter().find(|(taken, ..)| *taken == name)
        else {
            return Vec::new();
        };
        let rest = model.part(|other, _| other.name() != name);
        let Some((other, _)) = rest.iter().find(|(other, _)| other.name() == *by) else {
            return Vec::new();
        };
        let info = other.effect.info();
        let Some(index) = info.parameters.iter().position(|p| p.name == *parameter) else {
            return Vec::new();
        };
        let unit = if info.parameters[index].unit == "m" { self.ranges.travel_m.1 } else { 1.0 };
        let begun_at = |start: &f64| {
            let set = |(term, values): &(Term, Vec<f64>)| {
                let mut values = values.clone();
                if term.name() == *by {
                    values
                        .chunks_mut(info.parameters.len())
                        .for_each(|at| at[index] = start * unit);
                }
                (term.clone(), values)
            };
            let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = rest.iter().map(set).unzip();
            (terms, start.concat())
        };
        starts.iter().map(begun_at).collect()
    }

    /// Whether most of the gap comes back without a term, the others as they are: they will not make up for it.
    fn carries_much(&self, model: &Model, term: usize) -> Result<bool, Error> {
        let rig = model.without(self.nominal, term, |_| true)?;
        let left = cost(&self.scene.residuals_at(&rig, Wanted::ALL, self.include)?);
        Ok(left - self.noise > MUCH * self.gap)
    }
}

/// The terms of a model but one, for each of the others that is on other axes alone and can take its place there.
fn in_place_of(model: &Model, term: usize) -> Vec<Vec<(Term, Vec<f64>)>> {
    let taken = &model.terms[term];
    let is_on_axes = |term: &Term| term.places.iter().all(|p| matches!(p, Place::Axis(_)));
    let stands_in = |other: &&Term| {
        other.name() != taken.name()
            && is_on_axes(other)
            && is_on_axes(taken)
            && taken.places.iter().all(|place| !other.places.contains(place))
    };
    let others = model.terms.iter().filter(stands_in);
    let wider = |other: &Term| {
        let mut terms = model.part(|term, _| term.name() != taken.name());
        for (term, values) in terms.iter_mut().filter(|(term, _)| term.name() == other.name()) {
            let there = values[..values.len() / term.places.len()].to_vec();
            term.places.extend(&taken.places);
            taken.places.iter().for_each(|_| values.extend(&there));
        }
        terms
    };
    others.map(wider).collect()
}
