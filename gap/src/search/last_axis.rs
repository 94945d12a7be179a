//! Effects that all axes have alike, and one of them hardly shows.
//!
//! Amplifiers, preloads and platforms of a stage are built alike. What a current limit does to an axis that seldom asks for so much is no gap, and a
//! swinging part may ring on one axis in a single recording that is not among those that are fitted. So where all other axes have an effect alike,
//! and the recordings agree better with one of about the same size on the last axis than with none, by more than their noise, it is there as
//! well. The other way round a place where an effect has another size than elsewhere may be none.

use host_sim::effects::{Parameter, Place, Role};

use crate::Error;
use crate::fitting::fit::{Effort, cost, fit};
use crate::fitting::model::{Model, Term, knobs_from, start_terms};
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::select::Search;
use crate::session::scene::{Channel, Wanted};

/// Other axes that have to show it at least: of a single one nobody knows.
const LEAST_SEEN: usize = 2;
/// Largest ratio of sizes that are alike.
const ALIKE: f64 = 1.6;
/// Multiple of its typical value from which the zero of a size is that of a threshold.
const FAR: f64 = 5.0;
/// Iterations of a fit on that axis, and of the whole model with it.
const ITERATIONS: [usize; 2] = [6, 3];

impl Search<'_> {
    /// `model`, with effects that all axes but one have alike on that one as well, if the recordings agree better with it.
    pub(crate) fn also_on_last_axis(&self, model: Model) -> Result<Model, Error> {
        let everything = |_: &Channel| true;
        let mut best = model;
        for t in 0..best.terms.len() {
            let term = best.terms[t].clone();
            let Some(axis) = self.only_other_axis(&term) else { continue };
            let mut sets = sets_of(&best, t);
            let Some(mean) = mean_of_alike(&term, &sets) else { continue };
            let there = Term { effect: term.effect, places: vec![Place::Axis(axis)] };
            let knobs = knobs_from(&[there], &mean, &best.ranges);
            let effort = Effort { iterations: ITERATIONS[0], ..self.effort() };
            let rig = &best.fit.rig;
            let with = fit(self.scene, rig, knobs, mean, effort, None, self.include)?;
            let rigs = [(rig, Wanted::ALL), (&with.rig, Wanted::ALL)];
            let costs: Vec<f64> =
                self.scene.residuals(&rigs, everything)?.iter().map(cost).collect();
            sets.push(with.values.clone());
            if costs[1] > costs[0] - NOISE_MARGIN || mean_of_alike(&term, &sets).is_none() {
                continue;
            }
            let mut terms = start_terms(&best);
            terms[t].0.places.push(Place::Axis(axis));
            terms[t].1.extend(with.values);
            let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
            let effort = Effort { iterations: ITERATIONS[1], ..self.effort() };
            best = self.fit_model(terms, start.concat(), effort)?;
        }
        Ok(best)
    }

    /// The one axis, among those that were measured, on which an effect is not, if it is on enough others.
    fn only_other_axis(&self, term: &Term) -> Option<usize> {
        let is_on = |axis: &usize| term.places.contains(&Place::Axis(*axis));
        let (on, off): (Vec<usize>, Vec<usize>) = (0..self.nominal.axes.len()).partition(is_on);
        let [axis] = off[..] else { return None };
        (on.len() >= LEAST_SEEN && self.scene.position_noise[axis].is_some()).then_some(axis)
    }
}

/// Whether a term has sizes at one of its places that are alike to those at all its others, of which there are enough.
pub(crate) fn is_as_elsewhere(model: &Model, t: usize, place: Place) -> bool {
    let term = &model.terms[t];
    let sets = sets_of(model, t);
    term.places.contains(&place)
        && term.places.len() > LEAST_SEEN
        && mean_of_alike(term, &sets).is_some()
}

/// Values of a term, one set a place.
fn sets_of(model: &Model, t: usize) -> Vec<Vec<f64>> {
    (0..model.terms[t].places.len()).map(|place| model.values(t, place).to_vec()).collect()
}

/// Mean of sets of values of an effect whose sizes, from where it has none, are alike in all of them.
fn mean_of_alike(term: &Term, sets: &[Vec<f64>]) -> Option<Vec<f64>> {
    let mean = |(k, parameter): (usize, &Parameter)| {
        let values = || sets.iter().map(|values| values[k]);
        // Sizes of thresholds, which are none at a thousand volts, are no distances from there.
        let zero =
            if parameter.zero.abs() > FAR * parameter.typical.abs() { 0.0 } else { parameter.zero };
        let sizes = || values().map(|value| value - zero);
        let low = sizes().fold(f64::INFINITY, f64::min);
        let high = sizes().fold(f64::NEG_INFINITY, f64::max);
        let is_alike = low == high || (low * high > 0.0 && (high / low).max(low / high) < ALIKE);
        (parameter.role != Role::Size || is_alike)
            .then(|| values().sum::<f64>() / sets.len() as f64)
    };
    term.effect.info().parameters.iter().enumerate().map(mean).collect()
}
