//! When an axis may take several ticks at once.
//!
//! Most of a session is slow: triangles of a hertz, half a minute of holding. There an axis follows its amplifier, and four ticks in
//! one step come to where four steps do: the mechanism is exact in any step, and the charge has one answer as long as the voltage goes
//! one way. Ticks in between go with the voltage, round a corner where a loop closes. A heavy mechanism swings, and is followed in
//! sub-steps so that the hysteresis sees it: that goes in whole ticks where it hardly does, and half a minute of holding at 1 kHz no longer
//! takes 32 sub-steps a tick.
//!
//! The amplifier goes through every tick in any case. What this costs in accuracy, over the effects of the catalogue: `tests/leaps.rs`.

use super::axis::AxisSim;
use super::mechanism::swings_at;
use super::model::AxisModel;

/// Most ticks taken at once, and ticks that are decided upon together.
pub const LEAP: usize = 4;

/// Ticks that an axis which goes in so many sub-steps may take at once, if it ever does. Between the ticks of a leap nothing may swing, and what rubs
/// takes no whole ticks on an axis that swings: friction that holds at the end of one sets it swinging, which ends the calm, and so on, a
/// limit cycle that no rig has.
pub fn leap(model: &AxisModel, substeps: usize) -> Option<usize> {
    let swings = swings_at(model) != 0.0;
    if substeps > 1 {
        let rubs = model.mechanism.forces.iter().any(|force| force.rubs());
        (!swings || !rubs).then_some(1)
    } else {
        (!swings).then_some(LEAP)
    }
}

/// Change of the voltage in a tick up to which an axis is calm, V.
const CALM_V: f64 = 0.1;
/// Travel in a tick up to which it is calm, m.
const CALM_M: f64 = 12.0e-9;
/// Ticks that it has to have been calm for.
const PATIENCE: usize = 16;

/// Whether the voltage goes one way, in calm steps.
pub fn is_one_way(before_v: f64, volts: &[f64]) -> bool {
    let (mut last, mut rises, mut falls, mut is_calm) = (before_v, false, false, true);
    for &v in volts {
        let step = v - last;
        rises |= step > 0.0;
        falls |= step < 0.0;
        is_calm &= step.abs() <= CALM_V;
        last = v;
    }
    is_calm && !(rises && falls)
}

/// Change of the amplifier's output in a leap below which it rests, V.
const LEAST_V: f64 = 1.0e-6;

/// How an axis got from the start of a leap to its end.
pub struct Way {
    from: (f64, f64),
    to: (f64, f64),
    bend: Bend,
}

/// How the displacement goes in between.
enum Bend {
    /// With time.
    InTime,
    /// With the voltage, so many metres a volt.
    Straight(f64),
    /// With the voltage at one slope until it has gone so far, V, at the other one from there, m/V.
    Corner(f64, [f64; 2]),
}

impl Way {
    /// Between two amplifier outputs, V, and the displacements there, m, where the branch has these slopes, m/V; 0 where they are not known.
    #[inline]
    pub fn new(from: (f64, f64), to: (f64, f64), [first, last]: [f64; 2]) -> Self {
        let (whole_v, whole_m) = (to.0 - from.0, to.1 - from.1);
        if whole_v.abs() < LEAST_V {
            return Self { from, to, bend: Bend::InTime };
        }
        // first corner + last (whole - corner) = way
        let corner_v = (whole_m - last * whole_v) / (first - last);
        let is_between = corner_v.abs() < whole_v.abs() && corner_v * whole_v > 0.0;
        let bend = if first > 0.0 && last > 0.0 && is_between {
            Bend::Corner(corner_v, [first, last])
        } else {
            Bend::Straight(whole_m / whole_v)
        };
        Self { from, to, bend }
    }

    /// Displacement at an output in between, `tick` of so many ticks on: with the voltage, and where that rests, with time. Where a loop closes
    /// in between, or an element begins to slip, the way has a corner.
    #[inline]
    pub fn at(&self, v: f64, tick: usize, ticks: usize) -> f64 {
        let gone_v = v - self.from.0;
        match self.bend {
            Bend::InTime => self.from.1 + (self.to.1 - self.from.1) * tick as f64 / ticks as f64,
            Bend::Straight(slope) => self.from.1 + slope * gone_v,
            Bend::Corner(corner_v, [first, _]) if gone_v.abs() < corner_v.abs() => {
                self.from.1 + first * gone_v
            }
            Bend::Corner(_, [_, last]) => self.to.1 - last * (self.to.0 - v),
        }
    }
}

/// Share of the ticks held at these commands, V, that an axis is expected to take one by one: by what is asked of it alone. It is more where it
/// rings on, where others talk into its drive, or where a volt moves it by more than 0.12 um.
pub fn lively_share(commands_v: &[f64]) -> f64 {
    let mut calm_for = 0;
    let mut lively = 0;
    let mut last_v = commands_v.first().copied().unwrap_or(0.0);
    for part in commands_v.chunks(LEAP) {
        for &asked_v in part {
            calm_for = if (asked_v - last_v).abs() <= CALM_V { calm_for + 1 } else { 0 };
            last_v = asked_v;
        }
        // It has been calm before these as well.
        lively += if calm_for >= PATIENCE + part.len() { 0 } else { part.len() };
    }
    lively as f64 / commands_v.len().max(1) as f64
}

/// Watches one axis.
pub struct Pace {
    asked_v: f64,
    last_m: f64,
    last_v: f64,
    calm_for: usize,
    patience: usize,
}

impl Pace {
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

    /// Whether the ticks to come, at which these voltages are asked for, may be taken at once.
    #[inline]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_lively_for_a_moment_and_a_slow_ramp_never() {
        let share = |v: &dyn Fn(usize) -> f64| {
            let volts: Vec<f64> = (0..10_000).map(v).collect();
            lively_share(&volts)
        };
        // The first sixteen ticks of a recording.
        assert_eq!(share(&|_| 40.0), 0.0016);
        assert_eq!(share(&|n| n as f64 * 0.01), 0.0016);
        // A step, and the sixteen after the four that it is among.
        assert_eq!(share(&|n| if n < 5000 { 0.0 } else { 20.0 }), 0.0036);
        assert_eq!(share(&|n| (n as f64).sin()), 1.0);
        assert_eq!(lively_share(&[]), 0.0);
    }
}
