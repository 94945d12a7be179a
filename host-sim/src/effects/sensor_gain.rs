//! sensor-gain: the gauge reads more or less than the displacement.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorGain;

pub(super) const EFFECT: SensorGain = SensorGain;

static INFO: Info = Info {
    name: "sensor-gain",
    stage: Stage::Sensor,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "ratio",
        "1",
        1.0,
        (0.5, 1.5),
        1.02,
        "reading over displacement",
    )],
    threshold: false,
    physics: "y = ratio * x: gauge factor, bridge excitation and conditioner gain. Behind everything that happens to \
              the displacement: loops, creep and resonances all scale alike.",
    source: "0.5 to 1 % absolute accuracy of strain gauges (notes/physics.md, section 7)",
    revealed_by: "large motion at several strokes",
    confused_with: &["piezo-gain", "drive-gain", "stiffness"],
};

struct Gain(f64);

impl SensorBlock for Gain {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], _time_s: f64) -> f64 {
        self.0 * value_m
    }
}

impl Effect for SensorGain {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].sensor.blocks.push(Box::new(Gain(values[0])));
    }
}
