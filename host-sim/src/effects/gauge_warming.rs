//! gauge-warming: the gauge's gain goes to another value while the conditioner warms up. Not in the catalogue: no single gain is right.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct GaugeWarming;

pub(super) const EFFECT: GaugeWarming = GaugeWarming;

static INFO: Info = Info {
    name: "gauge-warming",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("growth", "1", 0.0, (-0.5, 0.5), 1.0e-2, "change of the gain in the end"),
        Parameter::shape("time_constant_s", "s", (1.0, 1.0e5), 60.0, "time in which it gets there")
            .by_ratio(),
    ],
    threshold: false,
    physics: "y = x (1 + growth (1 - exp(-t / time_constant))), t on the session's clock.",
    source: "bridge supply and gauge factor with temperature, 0.1 to 0.3 %/K (notes/physics.md, section 4)",
    revealed_by: "the same excursion at the start and at the end of a session",
    confused_with: &[
        "sensor-gain",
        "piezo-gain",
        "drive-gain",
        "stiffness",
        "sensor-nonlinearity",
        "stiffness-hardening",
        "preload-loss",
        "sensor-drift",
    ],
};

struct Warming {
    growth: f64,
    time_constant_s: f64,
}

impl SensorBlock for Warming {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], time_s: f64) -> f64 {
        value_m * (1.0 - self.growth * (-time_s / self.time_constant_s).exp_m1())
    }
}

impl Effect for GaugeWarming {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let warming = Warming { growth: values[0], time_constant_s: values[1] };
        model.axes[place.on()].sensor.blocks.push(Box::new(warming));
    }
}
