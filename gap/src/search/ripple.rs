//! The periodic error of a gauge beside its bend.
//!
//! A fit of a gauge's bend does not get to a ripple on top of it: it has no sizes to start from, and of its period only what is close by. So where
//! a bend leaves something, ripples of several periods are begun beside it. No simulation is needed for that: the axes move as they did.

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::guess::RIPPLES;
use crate::fitting::model::Model;
use crate::search::select::{CLOSED, Search};

/// The effect that this is about, and its parameters.
const BEND: &str = "sensor-nonlinearity";
const SIZES: [&str; 2] = ["ripple_sine_m", "ripple_cosine_m"];
const PERIOD: &str = "ripple_period_m";
/// Further periods that are tried, as shares of the travel: beside a bend they may be short.
const SHORT: [f64; 3] = [0.09, 0.13, 0.2];
/// Share of the gap that a bend by itself leaves at most.
const MOST: f64 = 0.4;
/// Share of what it leaves that both leave at most: what is missing besides is nibbled at by a ripple.
const MUCH_LESS: f64 = 0.3;

impl Search<'_> {
    /// `model`, or the same with a ripple on its last effect, a gauge's bend, if that leaves much less.
    pub(crate) fn rippled(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let last = model.terms.len() - 1;
        let info = model.terms[last].effect.info();
        let left = model.fit.cost - self.noise;
        if info.name != BEND
            || left < CLOSED * self.gap
            || left > MOST * self.gap
            || model.fit.cost > effort.hopeless
        {
            return Ok(model);
        }
        let index = |name: &str| info.parameters.iter().position(|p| p.name == name);
        let ([Some(sine), Some(cosine)], Some(period)) = (SIZES.map(index), index(PERIOD)) else {
            return Ok(model);
        };
        let (width, range) = (info.parameters.len(), model.knob_range(last));
        let places = || range.clone().step_by(width);
        let is_rippled = |at: usize| [sine, cosine].iter().any(|k| model.fit.values[at + k] != 0.0);
        if places().any(is_rippled) {
            return Ok(model);
        }
        let span = self.ranges.travel_m.1 - self.ranges.travel_m.0;
        let mut best: Option<Model> = None;
        for share in SHORT.into_iter().chain(RIPPLES) {
            let mut values = model.fit.values.clone();
            for at in places() {
                values[at + sine] = info.parameters[sine].typical;
                values[at + period] = share * span;
            }
            let most = best.as_ref().unwrap_or(&model).fit.cost;
            let effort = Effort { hopeless: most, ..effort };
            let other = self.fit_model(model.terms.clone(), values, effort)?;
            if other.fit.cost < most {
                best = Some(other);
            }
        }
        let line = self.noise + MUCH_LESS * left;
        Ok(best.filter(|best| best.fit.cost < line).unwrap_or(model))
    }
}
