//! amplifier-hum: mains frequency on the amplifier's output.

use super::hum::{self, Hum};
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, VoltageBlock};

pub(super) struct AmplifierHum;

pub(super) const EFFECT: AmplifierHum = AmplifierHum;

const NAMES: [&str; 6] =
    ["cos_v", "sin_v", "second_cos_v", "second_sin_v", "third_cos_v", "third_sin_v"];
static PARAMETERS: [Parameter; hum::COUNT] = hum::parameters(NAMES, "V", 20.0, 0.2);

static INFO: Info = Info {
    name: "amplifier-hum",
    stage: Stage::Amplifier,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &PARAMETERS,
    threshold: false,
    physics: "v = v0 + cos_v cos(w t) + sin_v sin(w t) and the same at 2 w and 3 w (a rectifier has them), t on the session's clock: ripple of the supply. It moves the \
              stack, through hysteresis and mechanism, and shows in the monitor.",
    source: "mains at 50 or 60 Hz and harmonics; ENV 400 noise 0.3 mV rms when healthy (notes/physics.md, section 1)",
    revealed_by: "rest at two biases; the monitor; a second sample rate tells aliases",
    confused_with: &["sensor-hum"],
};

impl VoltageBlock for Hum {
    fn output(&mut self, v: f64, time_s: f64) -> f64 {
        v + self.at(time_s)
    }
}

impl Effect for AmplifierHum {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let hum = Hum::new(values);
        model.axes[place.on()].amplifier.output.push(Box::new(hum));
    }
}
