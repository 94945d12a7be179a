//! amplifier-hum: mains frequency on the amplifier's output.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, OutputBlock};

pub(super) struct AmplifierHum;

pub(super) const EFFECT: AmplifierHum = AmplifierHum;

static INFO: Info = Info {
    name: "amplifier-hum",
    stage: Stage::Amplifier,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("cos_v", "V", 0.0, (-20.0, 20.0), 0.2, "part in phase with the session's clock"),
        Parameter::size("sin_v", "V", 0.0, (-20.0, 20.0), 0.2, "part a quarter period behind"),
        Parameter::shape("frequency_hz", "Hz", (1.0, 5.0e3), 50.0, "frequency"),
    ],
    threshold: false,
    physics: "v = v0 + cos_v cos(w t) + sin_v sin(w t), t on the session's clock: ripple of the supply. It moves the \
              stack, through hysteresis and mechanism, and shows in the monitor.",
    source: "mains at 50 or 60 Hz and harmonics; ENV 400 noise 0.3 mV rms when healthy (notes/physics.md, section 1)",
    revealed_by: "rest at two biases; the monitor; a second sample rate tells aliases",
    confused_with: &["sensor-hum"],
};

struct Hum {
    cos: f64,
    sin: f64,
    rate_per_s: f64,
}

impl OutputBlock for Hum {
    fn output(&mut self, v: f64, time_s: f64) -> f64 {
        let (sin, cos) = (self.rate_per_s * time_s).sin_cos();
        v + self.cos * cos + self.sin * sin
    }
}

impl Effect for AmplifierHum {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let rate_per_s = std::f64::consts::TAU * values[2];
        let hum = Hum { cos: values[0], sin: values[1], rate_per_s };
        model.axes[place.on()].amplifier.output.push(Box::new(hum));
    }
}
