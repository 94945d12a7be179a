//! Effects that all axes have alike, and one of them hardly shows.
//!
//! Amplifiers, preloads and platforms of a stage are built alike. What a current limit does to an axis that seldom asks for so much is no gap, and a
//! swinging part may ring on one axis in a single recording that is not among those that are fitted. So where all other axes have an effect alike,
//! and the recordings agree better with one of about the same size on the last axis than with none, by what a place has to be worth, it is
//! there as well ([`crate::search::hidden`]: or as well, where other effects there hide it). The other way round a place where an effect has another size than elsewhere may be none.

use host_sim::effects::{Parameter, Place, Role};

use crate::Error;
use crate::fitting::fit::{Effort, cost, fit};
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::{Model, Term, knobs_from, start_terms};
use crate::search::hidden::Hidden;
use crate::search::prune::WORTH_OF_PLACE;
use crate::search::select::Search;
use crate::session::scene::Wanted;

/// Other axes that have to show it at least: of a single one nobody knows.
const LEAST_SEEN: usize = 2;
/// Largest ratio of sizes that are alike,
pub(super) const ALIKE: f64 = 1.6;
/// ... and of sizes that are the same: what trims something else on one of two axes seldom comes that near to the other.
const SAME: f64 = 1.05;
/// Multiple of its typical value from which the zero of a size is that of a threshold.
const FAR: f64 = 5.0;
/// Share of its typical value below which a further size of an effect is next to nothing.
const LITTLE: f64 = 0.3;
/// Iterations of a fit on that axis, and of the whole model with it.
const ITERATIONS: [usize; 2] = [6, 3];

impl Search<'_> {
    /// `model`, with effects that all axes but one have alike on that one as well, if the recordings agree better with it, or as well where others hide
    /// it; beside it those that are hidden and the axis (from 0) where they are.
    pub(crate) fn also_on_last_axis(&self, model: Model) -> Result<(Model, Hidden), Error> {
        let mut best = model;
        let mut hidden = Hidden::new();
        for t in 0..best.terms.len() {
            // One that is hidden may take the place of another.
            let Some(term) = best.terms.get(t) else { break };
            let Some(axis) = self.only_other_axis(term) else { continue };
            let name = term.name();
            let most = self.left_everywhere(&best)? - WORTH_OF_PLACE;
            match self.also_on(&best, t, axis)? {
                Some(other) if self.left_everywhere(&other)? < most => best = other,
                _ => {
                    if let Some(other) = self.hidden_on(&best, t, axis)? {
                        hidden.push((name, axis));
                        best = other;
                    }
                }
            }
        }
        Ok((best, hidden))
    }

    /// `model` with term `t` on an axis more, fitted, if it comes to about the same size there as elsewhere.
    fn also_on(&self, model: &Model, t: usize, axis: usize) -> Result<Option<Model>, Error> {
        let term = &model.terms[t];
        let mut sets = sets_of(model, t);
        let Some(mean) = mean_of_alike(term.effect, &sets, ALIKE) else { return Ok(None) };
        let there = Term { effect: term.effect, places: vec![Place::Axis(axis)] };
        let knobs = knobs_from(&[there], &mean, &model.ranges);
        let effort = Effort { iterations: ITERATIONS[0], ..self.effort() };
        let with = fit(self.scene, &model.fit.rig, knobs, mean, effort, None, self.include)?;
        sets.push(with.values.clone());
        if mean_of_alike(term.effect, &sets, ALIKE).is_none() {
            return Ok(None);
        }
        let mut terms = start_terms(model);
        terms[t].0.places.push(Place::Axis(axis));
        terms[t].1.extend(with.values);
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
        let iterations = if self.is_spent() { 0 } else { ITERATIONS[1] };
        let effort = Effort { iterations, ..self.effort() };
        let other = self.fit_model(terms, start.concat(), effort)?;
        Ok(mean_of_alike(term.effect, &sets_of(&other, t), ALIKE).is_some().then_some(other))
    }

    /// Cost of all recordings: those that are fitted may hardly show what others do.
    pub(super) fn left_everywhere(&self, model: &Model) -> Result<f64, Error> {
        Ok(cost(&self.scene.residuals_at(&model.fit.rig, Wanted::ALL, |_| true)?))
    }

    /// The one axis, of those that were measured, on which an effect is not, if it is on enough others.
    fn only_other_axis(&self, term: &Term) -> Option<usize> {
        let is_on = |axis: &usize| term.places.contains(&Place::Axis(*axis));
        let axes = 0..self.nominal.axes.len();
        let measured = axes.filter(|&axis| self.scene.position_noise[axis].is_some());
        let (on, off): (Vec<usize>, Vec<usize>) = measured.partition(is_on);
        let [axis] = off[..] else { return None };
        (on.len() >= LEAST_SEEN).then_some(axis)
    }
}

/// Whether a term has about the same sizes on an axis as on all its others, of which enough speak for it by `speaks`.
pub(crate) fn is_as_elsewhere(
    model: &Model,
    t: usize,
    place: Place,
    speaks: impl Fn(usize) -> bool,
) -> bool {
    let term = &model.terms[t];
    let axis_of = |place: &Place| match *place {
        Place::Axis(axis) => Some(axis),
        Place::Pair { .. } => None,
    };
    let Some(axes) = term.places.iter().map(axis_of).collect::<Option<Vec<usize>>>() else {
        return false;
    };
    let others = axes.iter().filter(|&&axis| Place::Axis(axis) != place && speaks(axis));
    others.count() >= LEAST_SEEN && mean_of_alike(term.effect, &sets_of(model, t), ALIKE).is_some()
}

/// Values of a term, one set a place.
pub(super) fn sets_of(model: &Model, t: usize) -> Vec<Vec<f64>> {
    (0..model.terms[t].places.len()).map(|place| model.values(t, place).to_vec()).collect()
}

/// Whether a term has the same sizes at a place as at another one.
pub(crate) fn is_same_elsewhere(model: &Model, t: usize, place: Place) -> bool {
    let term = &model.terms[t];
    let sets = sets_of(model, t);
    let Some(here) = term.places.iter().position(|known| *known == place) else { return false };
    let is_same = |p: usize| {
        let two = [sets[here].clone(), sets[p].clone()];
        p != here && mean_of_alike(term.effect, &two, SAME).is_some()
    };
    (0..sets.len()).any(is_same)
}

/// Mean of sets of values of an effect whose sizes, from where it has none, are within a ratio of `most` in all of them, but those after the first that are next to
/// nothing in each. What is stepped by ratios has a geometric mean.
pub(super) fn mean_of_alike(effect: EffectRef, sets: &[Vec<f64>], most: f64) -> Option<Vec<f64>> {
    let parameters = effect.info().parameters;
    let first = parameters.iter().position(|p| p.role == Role::Size);
    let mean = |(k, parameter): (usize, &Parameter)| {
        let values = || sets.iter().map(|values| values[k]);
        // Sizes of thresholds, which are none at a thousand volts, are no distances from there.
        let typical = parameter.typical.abs();
        let zero = if parameter.zero.abs() > FAR * typical { 0.0 } else { parameter.zero };
        let sizes = || values().map(|value| value - zero);
        let low = sizes().fold(f64::INFINITY, f64::min);
        let high = sizes().fold(f64::NEG_INFINITY, f64::max);
        let is_little = first != Some(k)
            && low.abs().max(high.abs()) < LITTLE * (parameter.typical - zero).abs();
        let is_alike =
            low == high || is_little || (low * high > 0.0 && (high / low).max(low / high) < most);
        let count = sets.len() as f64;
        let mean = if parameter.log && values().all(|value| value > 0.0) {
            (values().map(f64::ln).sum::<f64>() / count).exp()
        } else {
            values().sum::<f64>() / count
        };
        (parameter.role != Role::Size || is_alike).then_some(mean)
    };
    parameters.iter().enumerate().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::effects::catalogue;

    fn mean(effect: &str, sets: &[&[(&str, f64)]]) -> Option<Vec<f64>> {
        let effect = *catalogue().iter().find(|e| e.info().name == effect).expect("in it");
        let set = |named: &&[(&str, f64)]| -> Vec<f64> {
            let value = |p: &Parameter| {
                named.iter().find(|(name, _)| *name == p.name).map_or(p.zero, |(_, value)| *value)
            };
            effect.info().parameters.iter().map(value).collect()
        };
        mean_of_alike(effect, &sets.iter().map(set).collect::<Vec<_>>(), ALIKE)
    }

    #[test]
    fn sizes_are_alike_from_where_they_are_none() {
        // 0.6 and 0.8 % of gain; -0.6 % is another one.
        assert!(mean("sensor-gain", &[&[("ratio", 1.006)], &[("ratio", 1.008)]]).is_some());
        assert!(mean("sensor-gain", &[&[("ratio", 1.006)], &[("ratio", 0.994)]]).is_none());
        assert!(mean("sensor-gain", &[&[("ratio", 1.006)], &[("ratio", 1.02)]]).is_none());
    }

    #[test]
    fn sizes_within_five_per_cent_are_the_same() {
        let gain = *catalogue().iter().find(|e| e.info().name == "sensor-gain").expect("in it");
        let two = |a: f64, b: f64| mean_of_alike(gain, &[vec![a], vec![b]], SAME).is_some();
        assert!(two(1.0200, 1.0209) && !two(1.0200, 1.0212) && !two(1.02, 0.98));
    }

    #[test]
    fn a_limit_that_is_none_is_not_alike_to_one_that_is() {
        let limits = [0.08, 0.1].map(|current_a| [("current_a", current_a)]);
        let found = mean("amplifier-current-limit", &[&limits[0], &limits[1]]).expect("alike");
        assert!((found[0] - 0.0894).abs() < 1.0e-4, "{found:?}");
        assert!(mean("amplifier-current-limit", &[&limits[0], &[]]).is_none());
    }

    #[test]
    fn what_is_next_to_nothing_tells_nothing() {
        let stacks = [0.01, -0.01].map(|tilt| [("per_decade", 0.006), ("tilt", tilt)]);
        assert!(mean("creep", &[&stacks[0], &stacks[1]]).is_some());
    }
}
