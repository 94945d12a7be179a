//! When a heavy axis may go in whole ticks.
//!
//! A mechanism with mass is followed in sub-steps, so that the hysteresis sees how it swings. Where it does not swing and is not
//! driven fast there is nothing to see, and that is most of the time: half a minute of holding at 1 kHz would take 32 sub-steps a tick.
//! The mechanism itself is exact in any step; what the hysteresis makes of the way there is off by a thousandth of how far it
//! swings in a tick (90 V squares on 0.45 kg, 1.7 kHz, in whole ticks instead of 64 sub-steps: 3.6 nm rms of swings of micrometres;
//! triangles of 60 V at 20 Hz, 0.24 V a tick: 0.03 nm).

use super::axis::AxisSim;

/// Change of the voltage in a tick up to which an axis is calm, V.
const CALM_V: f64 = 0.3;
/// Travel in a tick up to which it is calm, m.
const CALM_M: f64 = 30.0e-9;
/// Ticks that it has to have been calm for.
const PATIENCE: usize = 16;

/// Watches one axis.
pub struct Pace {
    asked_v: f64,
    last_m: f64,
    last_v: f64,
    calm_for: usize,
    patience: usize,
}

impl Pace {
    /// Ticks that are decided upon together.
    pub const STRETCH: usize = 8;

    /// Of an axis as it is, which goes in so many sub-steps.
    pub fn new(axis: &AxisSim, substeps: usize) -> Self {
        Self {
            asked_v: f64::NAN,
            last_m: axis.position_m(),
            last_v: axis.output_v(),
            calm_for: 0,
            // A command that is still on its way is no calm.
            patience: PATIENCE + axis.amplifier.ticks_of_delay(substeps),
        }
    }

    /// Whether the ticks to come, at which these voltages are asked for, may be taken whole.
    pub fn is_calm(&mut self, asked_v: impl Iterator<Item = f64>) -> bool {
        for asked in asked_v {
            // Before the first one there is none, and no calm.
            let is_calm = (asked - self.asked_v).abs() <= CALM_V;
            self.calm_for = if is_calm { self.calm_for } else { 0 };
            self.asked_v = asked;
        }
        self.calm_for >= self.patience
    }

    /// Hear where a tick ended.
    #[inline]
    pub fn saw(&mut self, position_m: f64, output_v: f64) {
        let is_calm =
            (position_m - self.last_m).abs() <= CALM_M && (output_v - self.last_v).abs() <= CALM_V;
        self.calm_for = if is_calm { self.calm_for + 1 } else { 0 };
        (self.last_m, self.last_v) = (position_m, output_v);
    }
}
