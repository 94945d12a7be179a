//! sensor-hum: mains frequency in the gauge's reading.

use super::hum::{self, Hum};
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorHum;

pub(super) const EFFECT: SensorHum = SensorHum;

const NAMES: [&str; 6] =
    ["cos_m", "sin_m", "second_cos_m", "second_sin_m", "third_cos_m", "third_sin_m"];
static PARAMETERS: [Parameter; hum::COUNT] = hum::parameters(NAMES, "m", 1.0e-5, 1.0e-8);

static INFO: Info = Info {
    name: "sensor-hum",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &PARAMETERS,
    threshold: false,
    physics: "y = x + cos_m cos(w t) + sin_m sin(w t) and the same at 2 w and 3 w (a rectifier has them), t on the session's clock: pick-up of bridge and conditioner. It \
              moves nothing, so it is the same at every bias and absent from the monitor.",
    source: "mains at 50 or 60 Hz and harmonics",
    revealed_by: "rest; the monitor (absent there); a second sample rate tells aliases",
    confused_with: &["amplifier-hum"],
};

impl SensorBlock for Hum {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], time_s: f64) -> f64 {
        value_m + self.at(time_s)
    }
}

impl Effect for SensorHum {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let hum = Hum::new(values);
        model.axes[place.on()].sensor.blocks.push(Box::new(hum));
    }
}
