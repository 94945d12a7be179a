//! Varieties of an effect that a fit does not get to by itself.
//!
//! A current limit has a corner, or a knee that bends ever sooner. What a small knee changes goes with more than its square, so that a fit
//! which starts from a corner stays there, and the screen, which tries both, may like the corner at one size better than the knee at a wrong
//! one. So where the plain variety leaves something the other one is fitted as well.

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::model::Model;
use crate::search::select::{CLOSED, Search, WORTH_OF_FIRST};

/// Effect, the parameter that is zero in the plain variety, where the other one starts, and by how much the effect's first size grows there.
const VARIETIES: [(&str, &str, f64, f64); 1] = [("amplifier-current-limit", "knee", 0.35, 1.25)];

impl Search<'_> {
    /// `model`, or the same with the other variety of its last effect, whichever leaves less.
    pub(crate) fn other_variety(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let last = model.terms.len() - 1;
        let info = model.terms[last].effect.info();
        let left = model.fit.cost - self.noise;
        let variety = VARIETIES.iter().find(|(name, ..)| *name == info.name);
        let Some(&(_, parameter, start, growth)) = variety else { return Ok(model) };
        // Where the plain one does nothing at all, there is nothing that a knee could round off.
        let does_nothing = model.terms.len() == 1 && left > (1.0 - WORTH_OF_FIRST) * self.gap;
        if left < CLOSED * self.gap || model.fit.cost > effort.hopeless || does_nothing {
            return Ok(model);
        }
        let Some(index) = info.parameters.iter().position(|p| p.name == parameter) else {
            return Ok(model);
        };
        let width = info.parameters.len();
        let range = model.knob_range(last);
        let mut values = model.fit.values.clone();
        for place in range.step_by(width) {
            if values[place + index] == info.parameters[index].zero {
                values[place + index] = start;
                values[place] *= growth;
            }
        }
        if values == model.fit.values {
            return Ok(model);
        }
        let other = self.fit_model(model.terms.clone(), values, effort)?;
        Ok(if other.fit.cost < model.fit.cost { other } else { model })
    }
}
