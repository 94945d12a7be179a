//! sensor-drift: the zero of the gauge wanders with session time.

use std::f64::consts::TAU;

use super::walk::Walk;
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorDrift;

pub(super) const EFFECT: SensorDrift = SensorDrift;

static INFO: Info = Info {
    name: "sensor-drift",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("rate_m_per_s", "m/s", 0.0, (-1.0e-6, 1.0e-6), 1.0e-9, "steady drift"),
        Parameter::size("settling_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "drift that settles"),
        Parameter::shape("settling_s", "s", (0.1, 1.0e5), 60.0, "time in which it settles").by_ratio(),
        Parameter::size("swing_sin_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "drift to and fro, as a sine from where the session's clock begins"),
        Parameter::size("swing_cos_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... as a cosine, down from its crest"),
        Parameter::shape("cycle_s", "s", (10.0, 1.0e5), 300.0, "time in which it comes and goes").by_ratio(),
        Parameter::size("wander_1_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "drift without a period: sine of one quarter turn over wander_s"),
        Parameter::size("wander_2_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 3 quarter turns"),
        Parameter::size("wander_3_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 5 quarter turns"),
        Parameter::size("wander_4_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 7 quarter turns"),
        Parameter::size("wander_5_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 9 quarter turns"),
        Parameter::size("wander_6_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 11 quarter turns"),
        Parameter::size("wander_7_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 13 quarter turns"),
        Parameter::size("wander_8_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 15 quarter turns"),
        Parameter::size("wander_9_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 17 quarter turns"),
        Parameter::size("wander_10_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 19 quarter turns"),
        Parameter::size("wander_11_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 21 quarter turns"),
        Parameter::size("wander_12_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 23 quarter turns"),
        Parameter::size("wander_13_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 25 quarter turns"),
        Parameter::size("wander_14_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 27 quarter turns"),
        Parameter::size("wander_15_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 29 quarter turns"),
        Parameter::size("wander_16_m", "m", 0.0, (-1.0e-4, 1.0e-4), 5.0e-8, "... sine of 31 quarter turns"),
        Parameter::shape("wander_s", "s", (1.0, 1.0e6), 60.0, "time over which it wanders: the session's").by_ratio(),
    ],
    threshold: false,
    physics: "y = x + rate t + settling (1 - e^(-t/settling_s)) + swing_sin sin(w t) + swing_cos (cos(w t) - 1), w = 2 pi/cycle_s, or y = x + \
              sum of wander_k sin((k - 1/2) pi t/wander_s), the first terms of a random walk's Karhunen-Loeve series, t on the session's clock, running on between files: warm electronics, thermal expansion, a room whose air conditioning cycles, or nothing in particular. Ignores the \
              input.",
    source: "stack -70 nm/K, frame 0.53 um/K, warm-up in minutes, rooms that cycle in minutes (notes/physics.md, section 4)",
    revealed_by: "rest at the start and the end of a session; the same probe repeated",
    confused_with: &["creep", "viscoelasticity", "sensor-offset"],
};

struct Drift {
    rate: f64,
    settling_m: f64,
    settling_s: f64,
    swing_sin_m: f64,
    swing_cos_m: f64,
    rad_per_s: f64,
    wander_m: Walk,
}

/// Terms of a random walk's series.
const WANDERS: usize = 16;

impl SensorBlock for Drift {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], time_s: f64) -> f64 {
        let settles = -self.settling_m * (-time_s / self.settling_s).exp_m1();
        let (sin, cos) = (self.rad_per_s * time_s).sin_cos();
        let swings = self.swing_sin_m * sin + self.swing_cos_m * (cos - 1.0);
        value_m + self.rate * time_s + settles + swings + self.wander_m.at(time_s)
    }
}

impl Effect for SensorDrift {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let drift = Drift {
            rate: values[0],
            settling_m: values[1],
            settling_s: values[2],
            swing_sin_m: values[3],
            swing_cos_m: values[4],
            rad_per_s: TAU / values[5],
            wander_m: Walk::new(&values[6..6 + WANDERS], values[6 + WANDERS]),
        };
        model.axes[place.on()].sensor.blocks.push(Box::new(drift));
    }
}
