//! Slow strains of one stack, each exact for a transducer voltage that is straight over the tick.
//!
//! They may go with more than the voltage, `v (1 + level |v|)`: of what goes with its square the change over a tick is added once the tick
//! is done, since a tick adds next to nothing to what moves slowly.

use super::model::Kelvin;
use crate::start::Stretch;

/// Strains done at once.
const LANES: usize = 4;

/// The strains, in groups of lanes; lanes without a strain stay at zero.
pub struct CreepSim {
    strains: Vec<Lanes>,
    from_end: f64,
    shares: f64,
    level_per_v: f64,
    /// What goes with the square of the voltage at the start of the tick, V.
    squared_v: f64,
}

#[derive(Clone, Copy, Default)]
struct Lanes {
    state_v: [f64; LANES],
    /// State at the end of the tick for a transducer voltage of zero there.
    coming_v: [f64; LANES],
    decay: [f64; LANES],
    from_start: [f64; LANES],
    from_end: [f64; LANES],
    share: [f64; LANES],
    /// 1/s.
    rate: [f64; LANES],
}

impl CreepSim {
    /// Build for a tick of `step_s`; the strains grow with the transducer voltage by `level_per_v`.
    pub fn new(strains: &[Kelvin], level_per_v: f64, step_s: f64) -> Self {
        let mut sim = Self {
            strains: vec![Lanes::default(); strains.len().div_ceil(LANES)],
            from_end: 0.0,
            shares: 0.0,
            level_per_v,
            squared_v: 0.0,
        };
        for (i, kelvin) in strains.iter().enumerate() {
            let ratio = step_s / kelvin.time_constant_s;
            // First-order response to a ramp: mean weight of the tick minus its end.
            let rise = -(-ratio).exp_m1();
            let from_end =
                if ratio > 1.0e-4 { 1.0 - rise / ratio } else { ratio / 2.0 - ratio * ratio / 6.0 };
            let (lanes, lane) = (&mut sim.strains[i / LANES], i % LANES);
            lanes.decay[lane] = (-ratio).exp();
            lanes.from_start[lane] = kelvin.share * (rise - from_end);
            lanes.from_end[lane] = kelvin.share * from_end;
            lanes.share[lane] = kelvin.share;
            lanes.rate[lane] = kelvin.time_constant_s.recip();
            sim.from_end += lanes.from_end[lane];
            sim.shares += kelvin.share;
        }
        sim
    }

    /// Whether there are none.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.strains.is_empty()
    }

    /// Take over the states of the same strains in other steps.
    pub fn take_over(&mut self, other: &Self) {
        for (own, other) in self.strains.iter_mut().zip(&other.strains) {
            own.state_v = other.state_v;
        }
    }

    /// Transducer voltage at which strains that add up to the same would rest; none without strains.
    pub fn held_v(&self) -> Option<f64> {
        let driven_v = (self.shares != 0.0).then(|| self.sum_v() / self.shares)?;
        if self.level_per_v == 0.0 {
            return Some(driven_v);
        }
        // The root of |v| + level v^2 = |driven| that tends to it without a level.
        let root = (1.0 + 4.0 * self.level_per_v * driven_v.abs()).max(0.0).sqrt();
        Some(2.0 * driven_v / (1.0 + root))
    }

    /// Sum of what a volt at the end of a tick adds there, 1.
    pub fn per_volt(&self) -> f64 {
        self.from_end
    }

    /// Sum of the states, V.
    pub fn sum_v(&self) -> f64 {
        self.strains.iter().flat_map(|lanes| lanes.state_v).sum()
    }

    /// Settle at a transducer voltage held for ever, then live through a past, the oldest stretch first.
    pub fn settle(&mut self, held_v: f64, past: &[Stretch]) {
        let level_per_v = self.level_per_v;
        let drives_v = |voltage_v: f64| voltage_v + squared(level_per_v, voltage_v);
        for lanes in &mut self.strains {
            lanes.state_v = std::array::from_fn(|lane| {
                let strain_v = past.iter().fold(drives_v(held_v), |before_v, stretch| {
                    let gone = -(-stretch.lasted_s * lanes.rate[lane]).exp_m1();
                    before_v + (drives_v(stretch.transducer_v) - before_v) * gone
                });
                lanes.share[lane] * strain_v
            });
        }
    }

    /// Begin a tick at a transducer voltage: the sum of the states at its end as `(v, per_v)`, in the voltage there.
    #[inline]
    pub fn begin(&mut self, start_v: f64) -> (f64, f64) {
        let mut sum = [0.0; LANES];
        self.squared_v = squared(self.level_per_v, start_v);
        let (start_v, held_v) = (start_v + self.squared_v, self.squared_v);
        for lanes in &mut self.strains {
            for (lane, sum) in sum.iter_mut().enumerate() {
                lanes.coming_v[lane] = lanes.decay[lane] * lanes.state_v[lane]
                    + lanes.from_start[lane] * start_v
                    + lanes.from_end[lane] * held_v;
                *sum += lanes.coming_v[lane];
            }
        }
        ((sum[0] + sum[1]) + (sum[2] + sum[3]), self.from_end)
    }

    /// Accept the tick that began last, at the end of which the transducer voltage is `end_v`.
    #[inline]
    pub fn commit(&mut self, end_v: f64) {
        let end_v = end_v + (squared(self.level_per_v, end_v) - self.squared_v);
        for lanes in &mut self.strains {
            for lane in 0..LANES {
                lanes.state_v[lane] = lanes.coming_v[lane] + lanes.from_end[lane] * end_v;
            }
        }
    }
}

/// What goes with the square of a voltage, V.
#[inline]
fn squared(level_per_v: f64, voltage_v: f64) -> f64 {
    level_per_v * voltage_v * voltage_v.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_taken_up_where_it_was_left_at_any_level() {
        let strains =
            [0.1, 1.0, 10.0].map(|time_constant_s| Kelvin { share: 0.01, time_constant_s });
        for level_per_v in [0.0, 4.0e-3, -2.0e-3] {
            let mut sim = CreepSim::new(&strains, level_per_v, 1.0e-2);
            for _ in 0..300 {
                sim.begin(60.0);
                sim.commit(60.0);
            }
            let left_v = sim.sum_v();
            let held_v = sim.held_v().expect("there are strains");
            sim.settle(held_v, &[]);
            assert!((sim.sum_v() - left_v).abs() < 1.0e-9, "{} of {left_v} V", sim.sum_v());
        }
    }
}
