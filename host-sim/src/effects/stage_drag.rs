//! stage-drag: something brakes the stage the faster it goes, but not in proportion. Not in the catalogue: a damper is linear, friction
//! does not grow.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Force, Model};
use crate::stages::speed::EndSpeed;

pub(super) struct StageDrag;

pub(super) const EFFECT: StageDrag = StageDrag;

static INFO: Info = Info {
    name: "stage-drag",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size(
            "brake_n",
            "N",
            0.0,
            (0.0, 1.0e5),
            3.0,
            "drag of a brake at its critical speed",
        ),
        Parameter::shape(
            "speed_m_per_s",
            "m/s",
            (1.0e-5, 1.0),
            3.0e-3,
            "critical speed of the brake",
        )
        .by_ratio(),
        Parameter::size("fluid_n", "N", 0.0, (0.0, 1.0e5), 3.0, "drag of a fluid at 1 mm/s"),
    ],
    threshold: false,
    physics: "An eddy-current brake, F = -brake 2 u/(1 + u^2), u = v/speed, lets go beyond its critical speed; the drag of a fluid, \
              F = -fluid v|v|/(1 mm/s)^2, grows faster than the speed.",
    source: "Smythe 1942 for brakes, the square law of fluids",
    revealed_by: "triangles and sines of the same stroke at several speeds",
    confused_with: &[
        "hysteresis-rate",
        "viscoelasticity",
        "friction",
        "inertia",
        "amplifier-bandwidth",
        "hysteresis-shape",
    ],
};

/// Speed at which the drag of a fluid is given, m/s.
const FLUID_AT_M_PER_S: f64 = 1.0e-3;

struct Drag {
    brake_n: f64,
    speed_m_per_s: f64,
    fluid_n: f64,
    at_m: f64,
    step_s: f64,
    speed: EndSpeed,
}

impl Force for Drag {
    fn start(&mut self, _time_s: f64) {
        (self.step_s, self.speed) = (0.0, EndSpeed::default());
    }

    fn begin(&mut self, step_s: f64) {
        self.step_s = step_s;
    }

    fn force(&self, x_m: f64) -> (f64, f64) {
        if self.step_s == 0.0 {
            return (0.0, 0.0);
        }
        let (speed, faster) = self.speed.at(x_m - self.at_m);
        let v = speed / self.step_s;
        let u = v / self.speed_m_per_s;
        let brake = 2.0 * self.brake_n / (1.0 + u * u);
        let fluid = self.fluid_n * v.abs() / FLUID_AT_M_PER_S.powi(2);
        // Where the brake lets go the slope is taken for none: the step stays stable.
        let held = brake * ((1.0 - u * u) / (1.0 + u * u)).max(0.0) / self.speed_m_per_s;
        (-brake * u - fluid * v, -(held + 2.0 * fluid) * faster / self.step_s)
    }

    fn commit(&mut self, x_m: f64, step_s: f64) {
        if step_s > 0.0 {
            self.speed.commit(x_m - self.at_m);
        }
        self.at_m = x_m;
    }

    fn goes_with_time(&self) -> bool {
        true
    }
}

impl Effect for StageDrag {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].mechanism.forces.push(Box::new(Drag {
            brake_n: values[0],
            speed_m_per_s: values[1],
            fluid_n: values[2],
            at_m: 0.0,
            step_s: 0.0,
            speed: EndSpeed::default(),
        }));
    }
}
