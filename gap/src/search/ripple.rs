//! The periodic error of a gauge beside its bend.
//!
//! A fit of a gauge's bend does not get to a ripple on top of it: it has no sizes to start from, and of its period only what is close by. So where
//! a bend leaves something, its ripple is sought over periods, each with the sizes that take most off, and a fit begins at the best one
//! of each axis. No simulation is needed for that: the axes move as they did.

use nalgebra::{Matrix2, Vector2};

use crate::Error;
use crate::fitting::fit::{Effort, rig_with};
use crate::fitting::model::{Model, knobs_from};
use crate::search::select::{CLOSED, Search};
use crate::session::scene::{Channel, Stack, Wanted, dot};

/// The effect that this is about, and its parameters.
const BEND: &str = "sensor-nonlinearity";
const SIZES: [&str; 2] = ["ripple_sine_m", "ripple_cosine_m"];
const PERIOD: &str = "ripple_period_m";
/// Half periods in the travel that are tried: a fit gets to what is a quarter of one away. Fewer are a bend.
const HALVES: std::ops::RangeInclusive<u32> = 2..=24;
/// Share of the gap that a bend by itself leaves at most. The ripple may be most of it.
const MOST: f64 = 0.9;
/// Share of what it leaves that both leave at most: what is missing besides is nibbled at by a ripple.
const MUCH_LESS: f64 = 0.3;

/// A ripple of an axis.
#[derive(Clone, Copy)]
struct Ripple {
    sizes_m: [f64; 2],
    period_m: f64,
    /// What it takes off the cost.
    gain: f64,
}

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
        let places: Vec<usize> = range.step_by(width).collect();
        let is_rippled =
            |at: &usize| [sine, cosine].iter().any(|k| model.fit.values[at + k] != 0.0);
        if places.iter().any(is_rippled) {
            return Ok(model);
        }
        let span = self.ranges.travel_m.1 - self.ranges.travel_m.0;
        let typical_m = info.parameters[sine].typical;
        let here = self.scene.residuals_at(&model.fit.rig, Wanted::ALL, self.include)?;
        let mut best: Vec<Option<Ripple>> = vec![None; places.len()];
        for halves in HALVES {
            let period_m = 2.0 * span / f64::from(halves);
            let with = |size: usize| {
                let mut values = model.fit.values.clone();
                for at in &places {
                    values[at + size] = typical_m;
                    values[at + period] = period_m;
                }
                let knobs = knobs_from(&model.terms, &values, &self.ranges);
                rig_with(self.nominal, &knobs, &values)
            };
            let rigs = [with(sine)?, with(cosine)?];
            let jobs = [(&rigs[0], Wanted::ALL), (&rigs[1], Wanted::ALL)];
            let moved = self.scene.residuals(&jobs, self.include)?;
            for (nth, best) in best.iter_mut().enumerate() {
                let axis = model.terms[last].places[nth].on();
                let ripple = self.best_of_period(&here, &moved, axis, (typical_m, period_m));
                *best =
                    [*best, ripple].into_iter().flatten().max_by(|a, b| a.gain.total_cmp(&b.gain));
            }
        }
        let mut values = model.fit.values.clone();
        for (at, ripple) in places.iter().zip(&best) {
            let Some(ripple) = ripple else { continue };
            (values[at + sine], values[at + cosine]) = (ripple.sizes_m[0], ripple.sizes_m[1]);
            values[at + period] = ripple.period_m;
        }
        let line = self.noise + MUCH_LESS * left;
        let gain: f64 = best.iter().flatten().map(|ripple| ripple.gain).sum();
        // A fit takes off more than that, by the period.
        if gain < 0.5 * (1.0 - MUCH_LESS) * left {
            return Ok(model);
        }
        let other = self.fit_model(model.terms.clone(), values, effort)?;
        Ok(if other.fit.cost < line { other } else { model })
    }

    /// Sizes of a ripple of one period that take most off the cost of an axis; `moved` are the residuals with a typical sine and cosine.
    fn best_of_period(
        &self,
        here: &Stack,
        moved: &[Stack],
        axis: usize,
        (typical_m, period_m): (f64, f64),
    ) -> Option<Ripple> {
        let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
        let of_axis = |(_, channel): &(usize, &Channel)| channel.axis == axis;
        for (c, _) in self.scene.channels.iter().enumerate().filter(of_axis) {
            let (Some(here), Some(a), Some(b)) = (&here[c], &moved[0][c], &moved[1][c]) else {
                continue;
            };
            let [a, b] = [a, b].map(|row| -> Vec<f32> {
                row.iter().zip(here).map(|(moved, here)| moved - here).collect()
            });
            normal += Matrix2::new(dot(&a, &a), dot(&a, &b), dot(&a, &b), dot(&b, &b));
            gradient += Vector2::new(dot(&a, here), dot(&b, here));
        }
        let sizes = -(normal.try_inverse()? * gradient);
        let gain = -sizes.dot(&gradient);
        let sizes_m = [sizes[0] * typical_m, sizes[1] * typical_m];
        Some(Ripple { sizes_m, period_m, gain })
    }
}
