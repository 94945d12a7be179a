//! sensor-hum: mains frequency in the gauge's reading.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorHum;

pub(super) const EFFECT: SensorHum = SensorHum;

static INFO: Info = Info {
    name: "sensor-hum",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("cos_m", "m", 0.0, (-1.0e-5, 1.0e-5), 1.0e-8, "part in phase with the session's clock"),
        Parameter::size("sin_m", "m", 0.0, (-1.0e-5, 1.0e-5), 1.0e-8, "part a quarter period behind"),
        Parameter::shape("frequency_hz", "Hz", (1.0, 5.0e3), 50.0, "frequency"),
    ],
    threshold: false,
    physics: "y = x + cos_m cos(w t) + sin_m sin(w t), t on the session's clock: pick-up of bridge and conditioner. It \
              moves nothing, so it is the same at every bias and absent from the monitor.",
    source: "mains at 50 or 60 Hz and harmonics",
    revealed_by: "rest; the monitor (absent there); a second sample rate tells aliases",
    confused_with: &["amplifier-hum"],
};

struct Hum {
    cos: f64,
    sin: f64,
    rate_per_s: f64,
}

impl SensorBlock for Hum {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], time_s: f64) -> f64 {
        let (sin, cos) = (self.rate_per_s * time_s).sin_cos();
        value_m + self.cos * cos + self.sin * sin
    }
}

impl Effect for SensorHum {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let rate_per_s = std::f64::consts::TAU * values[2];
        let hum = Hum { cos: values[0], sin: values[1], rate_per_s };
        model.axes[place.on()].sensor.blocks.push(Box::new(hum));
    }
}
