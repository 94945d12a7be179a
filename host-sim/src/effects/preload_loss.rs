//! preload-loss: below some displacement the stack does not push the whole mechanism.

use super::bend::softplus;
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Force, Model};

pub(super) struct PreloadLoss;

pub(super) const EFFECT: PreloadLoss = PreloadLoss;

static INFO: Info = Info {
    name: "preload-loss",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("lost_share", "1", 0.0, (0.0, 1.0), 0.5, "share of the mechanism's stiffness lost while open"),
        Parameter::shape("contact_m", "m", (-5.0e-5, 1.0e-4), 3.0e-6, "displacement at which the contact closes"),
        Parameter::shape("softness_m", "m", (1.0e-10, 1.0e-5), 5.0e-8, "width over which it closes").by_ratio(),
        Parameter::shape("since_zero", "1", (0.0, 1.0), 0.0, "1 where the gauge was zeroed before the preload went, 0 where after: whether the stage rests at zero"),
    ],
    threshold: true,
    physics: "dF/dx = -k (1 - lost/(1 + e^((x - contact)/softness))): without preload the contact between \
              stack and mechanism opens at small force. F(0) = 0, or with since_zero 1 F as before while closed. The kink stands at one displacement.",
    source: "preload and contact compliance: frame against stack 0.53 um/K (notes/physics.md, section 4)",
    revealed_by: "large slow triangles from the lowest voltage up",
    confused_with: &["stiffness-hardening", "amplifier-clipping", "sensor-nonlinearity", "hysteresis-shape", "sensor-offset", "drive-offset"],
};

struct OpenContact {
    lost_n_per_m: f64,
    contact_m: f64,
    softness_m: f64,
    since_zero: f64,
    /// How far it is closed without a force.
    closed_at_rest_m: f64,
}

impl Force for OpenContact {
    fn force(&self, x_m: f64) -> (f64, f64) {
        let s = self.softness_m;
        let (closed, of_closed) = softplus((x_m - self.contact_m) / s);
        // How far it is open, counted from rest; and all of it, which is what closing takes.
        let from_rest_m = x_m - (s * closed - self.closed_at_rest_m);
        let open_m = from_rest_m - self.since_zero * (self.contact_m + self.closed_at_rest_m);
        (self.lost_n_per_m * open_m, self.lost_n_per_m * (1.0 - of_closed))
    }
}

impl Effect for PreloadLoss {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let axis = &mut model.axes[place.on()];
        axis.mechanism.forces.push(Box::new(OpenContact {
            lost_n_per_m: values[0] * axis.mechanism.stiffness_n_per_m,
            contact_m: values[1],
            softness_m: values[2],
            since_zero: values[3],
            closed_at_rest_m: values[2] * softplus(-values[1] / values[2]).0,
        }));
    }
}
