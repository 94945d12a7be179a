//! stiffness-hardening: the mechanism's force is not proportional to its displacement.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Force, Model};

pub(super) struct StiffnessHardening;

pub(super) const EFFECT: StiffnessHardening = StiffnessHardening;

static INFO: Info = Info {
    name: "stiffness-hardening",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("cubic_n_per_m3", "N/m^3", 0.0, (-1.0e19, 1.0e19), 5.0e15, "cubic term of the force"),
        Parameter::size("quadratic_n_per_m2", "N/m^2", 0.0, (-1.0e14, 1.0e14), 5.0e10, "quadratic term of the force"),
        Parameter::size("extra_n_per_m", "N/m", 0.0, (-1.0e9, 1.0e9), 1.0e6, "stiffness added beyond the kink"),
        Parameter::shape("kink_m", "m", (-1.0e-4, 1.0e-4), 5.0e-6, "displacement of the kink"),
    ],
    threshold: false,
    physics: "F = -(k x + quadratic x^2 + cubic x^3 + extra (x - kink) for x > kink): stretching hinges, a stop. Gain and \
              resonance move with bias; the charge loop does not.",
    source: "membrane stretching of flexures (Duffing); bilinear form for stops (notes/gap.md, section 3)",
    revealed_by: "small signals at several biases, large triangles",
    confused_with: &["sensor-nonlinearity", "preload-loss", "amplifier-clipping", "hysteresis-shape"],
};

struct Hardening {
    cubic: f64,
    quadratic: f64,
    extra: f64,
    kink_m: f64,
}

impl Force for Hardening {
    fn force(&self, x_m: f64) -> (f64, f64) {
        let beyond = x_m - self.kink_m;
        // At rest the mechanism gives no force, also with a kink below zero.
        let origin = self.extra * (-self.kink_m).max(0.0);
        let (bent, bent_slope) = if beyond > 0.0 { (self.extra * beyond, self.extra) } else { (0.0, 0.0) };
        let force = x_m * x_m * (self.quadratic + self.cubic * x_m) + bent - origin;
        let slope = x_m * (2.0 * self.quadratic + 3.0 * self.cubic * x_m) + bent_slope;
        (-force, -slope)
    }
}

impl Effect for StiffnessHardening {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [cubic, quadratic, extra, kink_m] = values[..4] else { return };
        let hardening = Hardening { cubic, quadratic, extra, kink_m };
        model.axes[place.on()].mechanism.forces.push(Box::new(hardening));
    }
}
