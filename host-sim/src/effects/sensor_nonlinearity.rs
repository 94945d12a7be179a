//! sensor-nonlinearity: the reading bends with displacement.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorNonlinearity;

pub(super) const EFFECT: SensorNonlinearity = SensorNonlinearity;

static INFO: Info = Info {
    name: "sensor-nonlinearity",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("quadratic_per_m", "1/m", 0.0, (-1.0e6, 1.0e6), 1.0e3, "second-order term"),
        Parameter::size("cubic_per_m2", "1/m^2", 0.0, (-1.0e12, 1.0e12), 1.0e8, "third-order term"),
        Parameter::shape("zero_m", "m", (0.0, 1.0e-3), 0.0, "displacement at which the reading is right again: the far end of the line that the gauge was calibrated by"),
        Parameter::size("ripple_sine_m", "m", 0.0, (-1.0e-4, 1.0e-4), 2.0e-8, "periodic error: what starts with the displacement"),
        Parameter::size("ripple_cosine_m", "m", 0.0, (-1.0e-4, 1.0e-4), 2.0e-8, "periodic error: what starts with its square"),
        Parameter::shape("ripple_period_m", "m", (1.0e-7, 1.0e-3), 1.0e-5, "displacement after which the error repeats").by_ratio(),
    ],
    threshold: false,
    physics: "y = x + quadratic x (x - zero) + cubic x (x - zero) (x - zero/2): bridge and conditioner, as a data sheet states them, \
              by the deviation from a line through both ends; and sine sin(2 pi x/period) + cosine (1 - cos(2 pi x/period)), the integral error \
              of a converter or the cyclic one of a fringe or a scale. A static function of the displacement: gain \
              moves with bias, the resonance does not, the monitor shows nothing.",
    source: "gauge accuracy 1 %; ADC integral error of 2 to 3 LSB (notes/physics.md, sections 4 and 7)",
    revealed_by: "large triangles, small signals at several biases",
    confused_with: &["stiffness-hardening", "hysteresis-shape", "preload-loss"],
};

struct Bend {
    quadratic: f64,
    cubic: f64,
    zero_m: f64,
    /// Amplitudes of a periodic error (m) and its wave number (rad/m), if there is one.
    ripple: Option<([f64; 2], f64)>,
}

impl SensorBlock for Bend {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], _time_s: f64) -> f64 {
        let beyond_m = value_m - self.zero_m;
        let beyond_middle_m = value_m - 0.5 * self.zero_m;
        let bent_m = value_m + value_m * beyond_m * (self.quadratic + self.cubic * beyond_middle_m);
        let Some(([sine_m, cosine_m], per_m)) = self.ripple else { return bent_m };
        let (sine, cosine) = (per_m * value_m).sin_cos();
        bent_m + sine_m * sine + cosine_m * (1.0 - cosine)
    }
}

impl Effect for SensorNonlinearity {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [quadratic, cubic, zero_m, sine_m, cosine_m, period_m] = values[..6] else { return };
        let is_rippled = sine_m != 0.0 || cosine_m != 0.0;
        let ripple = is_rippled.then_some(([sine_m, cosine_m], std::f64::consts::TAU / period_m));
        let bend = Bend { quadratic, cubic, zero_m, ripple };
        model.axes[place.on()].sensor.blocks.push(Box::new(bend));
    }
}
