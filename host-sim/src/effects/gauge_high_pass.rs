//! gauge-high-pass: what lasts fades from the reading. Not in the catalogue: a stack that creeps goes the other way.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct GaugeHighPass;

pub(super) const EFFECT: GaugeHighPass = GaugeHighPass;

static INFO: Info = Info {
    name: "gauge-high-pass",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size(
            "fading",
            "1",
            0.0,
            (0.0, 1.0),
            3.0e-2,
            "share of a lasting displacement that fades",
        ),
        Parameter::shape("time_constant_s", "s", (1.0e-2, 1.0e4), 3.0, "time in which it fades")
            .by_ratio(),
    ],
    threshold: false,
    physics: "y = x - fading z, time_constant z' = x - z: a coupling capacitor in the gauge's amplifier, or a glue that lets go under \
              lasting strain.",
    source: "one real pole and zero; creep of a gauge's carrier against its foil (makers of strain gauges trim the two)",
    revealed_by: "a step held for some time constants: the reading goes back, and beyond zero afterwards",
    confused_with: &[
        "creep",
        "viscoelasticity",
        "hysteresis-shape",
        "sensor-drift",
        "sensor-gain",
        "sensor-offset",
        "preload-loss",
    ],
};

struct HighPass {
    fading: f64,
    /// Share of the way that the average goes in a tick.
    share: f64,
    /// Average of what was read; a stage that is looked at first has been there for long.
    average_m: Option<f64>,
}

impl SensorBlock for HighPass {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], _time_s: f64) -> f64 {
        let average_m = self.average_m.unwrap_or(value_m);
        let average_m = average_m + (value_m - average_m) * self.share;
        self.average_m = Some(average_m);
        value_m - self.fading * average_m
    }
}

impl Effect for GaugeHighPass {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, step_s: f64) {
        let share = -(-step_s / values[1]).exp_m1();
        let block = HighPass { fading: values[0], share, average_m: None };
        model.axes[place.on()].sensor.blocks.push(Box::new(block));
    }
}
