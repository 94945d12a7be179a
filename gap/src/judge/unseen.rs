//! Thresholds on an axis that hardly reaches them.
//!
//! What a current limit does to an axis that seldom asks for so much is no gap, and no cause is looked for where there is none. But amplifiers,
//! preloads and supplies of a stage are built alike: where all other axes have a threshold alike, and the recordings agree better with one
//! of about the same size on the last axis than with none, by more than their noise, it is named there too, and a note says why.

use host_sim::effects::{Parameter, Place, Role};
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::{Effort, cost, fit};
use crate::fitting::model::{Model, Term, knobs_from};
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::session::scene::{Channel, Scene, Wanted};

/// Axes that have to show it at least: of a single one nobody knows.
const LEAST_SEEN: usize = 2;
/// Largest ratio of sizes that are alike.
const ALIKE: f64 = 1.6;
/// Iterations of the fit on that axis.
const ITERATIONS: usize = 6;

/// A threshold that is named on an axis without a gap of its own.
pub(crate) struct Unseen {
    /// Which effect.
    pub effect: &'static str,
    /// On which axis.
    pub axis: usize,
}

impl Unseen {
    /// What a person is told.
    pub(crate) fn note(&self) -> String {
        format!(
            "Axis {}: {} is named there because the other axes have it alike. What these recordings show of it on this axis is more than noise, \
             but less than what counts as a gap.",
            self.axis + 1,
            self.effect
        )
    }
}

/// Thresholds of `model` that are likely on one axis more, written into `fitted`, the rig with its causes.
pub(crate) fn name(
    scene: &Scene,
    model: &Model,
    nominal: &Rig,
    fitted: &mut Rig,
) -> Result<Vec<Unseen>, Error> {
    let mut named = Vec::new();
    for (t, term) in model.terms.iter().enumerate().filter(|(_, t)| t.effect.info().threshold) {
        let Some(axis) = only_other_axis(scene, nominal, term) else { continue };
        let mut sets: Vec<Vec<f64>> =
            (0..term.places.len()).map(|place| model.values(t, place).to_vec()).collect();
        let Some(mean) = alike(term, &sets) else { continue };
        let there = Term { effect: term.effect, places: vec![Place::Axis(axis)] };
        let knobs = knobs_from(&[there], &mean, &model.ranges);
        let everything = |_: &Channel| true;
        let effort = Effort { iterations: ITERATIONS, ..Effort::default() };
        let with = fit(scene, fitted, knobs, mean, effort, None, &everything)?;
        let without = cost(&scene.residuals_at(fitted, Wanted::ALL, everything)?);
        sets.push(with.values.clone());
        if with.cost < without - NOISE_MARGIN && alike(term, &sets).is_some() {
            *fitted = with.rig;
            named.push(Unseen { effect: term.name(), axis });
        }
    }
    Ok(named)
}

/// The one axis, among those that were measured, on which an effect is not, if it is on enough others.
fn only_other_axis(scene: &Scene, nominal: &Rig, term: &Term) -> Option<usize> {
    let is_on = |axis: &usize| term.places.contains(&Place::Axis(*axis));
    let (on, off): (Vec<usize>, Vec<usize>) = (0..nominal.axes.len()).partition(is_on);
    let [axis] = off[..] else { return None };
    (on.len() >= LEAST_SEEN && scene.position_noise[axis].is_some()).then_some(axis)
}

/// Mean of sets of values of an effect whose sizes are alike in all of them.
fn alike(term: &Term, sets: &[Vec<f64>]) -> Option<Vec<f64>> {
    let mean = |(k, parameter): (usize, &Parameter)| {
        let values = || sets.iter().map(|values| values[k]);
        let (low, high) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        let is_alike = low == high || (low * high > 0.0 && (high / low).max(low / high) < ALIKE);
        (parameter.role != Role::Size || is_alike)
            .then(|| values().sum::<f64>() / sets.len() as f64)
    };
    term.effect.info().parameters.iter().enumerate().map(mean).collect()
}
