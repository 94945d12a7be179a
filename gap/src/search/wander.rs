//! Drift without a period.
//!
//! A gauge may drift to an end, to and fro, or as chance has it. The last takes as many numbers as there are turns in it, with which a drift makes up for much
//! that is none. So it is tried only where a plain drift is most of the answer by itself and leaves something, and has to leave far less.

use host_sim::effects::Parameter;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::knobs::{WANDER_S, WANDERS};
use crate::fitting::model::{Model, Term};
use crate::search::select::{CLOSED, Search};

/// The effect that this is about.
const DRIFT: &str = "sensor-drift";
/// Share of the gap that a plain drift leaves at most.
const MOST: f64 = 0.9;
/// Share of what the plain drift leaves that one without a period may leave at most.
const MUCH_LESS: f64 = 0.3;
/// Iterations of the fit: the drift is linear in its sizes.
const ITERATIONS: usize = 3;

/// Whether the effect of this name, with these values at its places, goes without a period anywhere.
pub(crate) fn wanders(term: &Term, values: &[f64]) -> bool {
    let parameters = term.effect.info().parameters;
    let is_part = |(parameter, value): (&Parameter, &f64)| {
        WANDERS.contains(&parameter.name) && *value != parameter.zero
    };
    term.name() == DRIFT
        && values.chunks(parameters.len()).any(|here| parameters.iter().zip(here).any(is_part))
}

impl Search<'_> {
    /// `model` of a drift alone, or the same without a period, if that leaves much less.
    pub(crate) fn wandering(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let [term] = model.terms.as_slice() else { return Ok(model) };
        // Other axes may lack something else.
        let mask = term.axes().iter().fold(0, |mask, axis| mask | 1 << axis);
        let gap = self.left_on(&self.base, mask);
        let left = self.left_on(&model.fit.stack, mask);
        if term.name() != DRIFT || left < CLOSED * gap || left > MOST * gap {
            return Ok(model);
        }
        let value = |parameter: &Parameter| match parameter.name {
            WANDER_S => self.ranges.session_s,
            // Any size but none: a law that does nothing is frozen.
            name if WANDERS.contains(&name) => 1.0e-3 * parameter.typical,
            _ => parameter.zero,
        };
        let rests: Vec<f64> = term.effect.info().parameters.iter().map(value).collect();
        let line = model.fit.cost - (1.0 - MUCH_LESS) * left;
        let effort = Effort { iterations: ITERATIONS, hopeless: line, ..effort };
        let other = self.fit_model(model.terms.clone(), rests.repeat(term.places.len()), effort)?;
        Ok(if other.fit.cost < line { other } else { model })
    }
}
