//! sensor-drift: the zero of the gauge wanders with session time.

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
    ],
    threshold: false,
    physics: "y = x + rate t + settling (1 - e^(-t/settling_s)), t on the session's clock, running on between files: warm \
              electronics, thermal expansion. Ignores the input.",
    source: "stack -70 nm/K, frame 0.53 um/K, warm-up in minutes (notes/physics.md, section 4)",
    revealed_by: "rest at the start and the end of a session; the same probe repeated",
    confused_with: &["creep", "viscoelasticity", "sensor-offset"],
};

struct Drift {
    rate: f64,
    settling_m: f64,
    settling_s: f64,
}

impl SensorBlock for Drift {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], time_s: f64) -> f64 {
        value_m + self.rate * time_s - self.settling_m * (-time_s / self.settling_s).exp_m1()
    }
}

impl Effect for SensorDrift {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let drift = Drift { rate: values[0], settling_m: values[1], settling_s: values[2] };
        model.axes[place.on()].sensor.blocks.push(Box::new(drift));
    }
}
