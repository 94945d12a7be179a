//! gauge-play: the gauge follows the stage with play. Not in the catalogue: neither friction nor the stack loses anything.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct GaugePlay;

pub(super) const EFFECT: GaugePlay = GaugePlay;

static INFO: Info = Info {
    name: "gauge-play",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "width_m",
        "m",
        0.0,
        (0.0, 1.0e-5),
        5.0e-8,
        "way that the stage goes after a reversal before the reading follows",
    )],
    threshold: false,
    physics: "The reading stands still within a play of width_m and follows at its ends, at all speeds and strokes.",
    source: "a gauge that has come loose, or a lever with play; the play operator of Prandtl and Ishlinskii",
    revealed_by: "small triangles: below the width nothing is read",
    confused_with: &["friction", "hysteresis-shape"],
};

struct Play {
    half_width_m: f64,
    reading_m: Option<f64>,
}

impl SensorBlock for Play {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], _time_s: f64) -> f64 {
        let (low, high) = (value_m - self.half_width_m, value_m + self.half_width_m);
        let reading_m = self.reading_m.unwrap_or(value_m).max(low).min(high);
        self.reading_m = Some(reading_m);
        reading_m
    }
}

impl Effect for GaugePlay {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let play = Play { half_width_m: 0.5 * values[0], reading_m: None };
        model.axes[place.on()].sensor.blocks.push(Box::new(play));
    }
}
