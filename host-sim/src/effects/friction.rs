//! friction: the mechanism rubs.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Force, Model};

pub(super) struct Friction;

pub(super) const EFFECT: Friction = Friction;

static INFO: Info = Info {
    name: "friction",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("coulomb_n", "N", 0.0, (0.0, 1.0e5), 3.0, "friction once sliding"),
        Parameter::shape("presliding_m", "m", (1.0e-9, 1.0e-4), 1.0e-7, "displacement in which it builds up").by_ratio(),
    ],
    threshold: false,
    physics: "Dahl: dF/dx = -(coulomb/presliding) (1 + F sgn(dx)/coulomb), so after a reversal the force goes to the other \
              side within a few presliding lengths, whatever the speed and stroke; presliding -> 0 is Coulomb. In closed \
              form over a tick, so it does not depend on the step.",
    source: "Dahl, 1968; a touching cable, a guide or a stop; loop height constant in force (notes/gap.md, section 3)",
    revealed_by: "slow triangles at small and large strokes: the same step at each reversal",
    confused_with: &["hysteresis-shape", "preload-loss", "hysteresis-rate"],
};

struct Dahl {
    coulomb_n: f64,
    presliding_m: f64,
    force_n: f64,
    at_m: f64,
}

impl Force for Dahl {
    fn force(&self, x_m: f64) -> (f64, f64) {
        let travel = x_m - self.at_m;
        let end = -self.coulomb_n * if travel >= 0.0 { 1.0 } else { -1.0 };
        let left = (self.force_n - end) * (-travel.abs() / self.presliding_m).exp();
        (end + left, -left.abs() / self.presliding_m)
    }

    fn commit(&mut self, x_m: f64, step_s: f64) {
        if step_s > 0.0 {
            self.force_n = self.force(x_m).0;
        }
        self.at_m = x_m;
    }
}

impl Effect for Friction {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].mechanism.forces.push(Box::new(Dahl {
            coulomb_n: values[0],
            presliding_m: values[1],
            force_n: 0.0,
            at_m: 0.0,
        }));
    }
}
