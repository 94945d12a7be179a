//! stiffness-coupling: the mechanism carries force from one stack to another.

use super::{Effect, Info, Kind, MOST_OF_STACK, Parameter, Place, Scope, Stage};
use crate::stages::model::{CouplingSpring, Model};

pub(super) struct StiffnessCoupling;

pub(super) const EFFECT: StiffnessCoupling = StiffnessCoupling;

static INFO: Info = Info {
    name: "stiffness-coupling",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::ReciprocalPair,
    parameters: &[
        Parameter::size(
            "stiffness_n_per_m",
            "N/m",
            0.0,
            (-1.0e9, 1.0e9),
            2.0e5,
            "off-diagonal entry of the stiffness matrix",
        ),
        Parameter::shape(
            "own",
            "1",
            (-1.0, 1.0),
            0.0,
            "what it adds to both diagonal entries, as a share: 0 of a matrix, -1 of a spring from axis to axis, 1 of a base that both stand on",
        ),
    ],
    threshold: false,
    physics: "F_i = -k_ij (x_j + own x_i) and F_j = -k_ij (x_i + own x_j): the flexure mechanism is one body. The neighbour moves by \
              -k_ij/(k_p + k) of the motion, statically and through its own resonance, whatever its voltage. Held to 45 % of the \
              smaller own stiffness, or to half of that with own at either end.",
    source: "pseudo-rigid-body model of a 3-RRR: 0.14e6 N/m off, 0.98e6 on the diagonal (notes/physics.md, section 5)",
    revealed_by: "one axis driven alone, others held at two voltages; neighbours' resonance in cross responses",
    confused_with: &["sensor-crosstalk", "drive-crosstalk"],
};

impl Effect for StiffnessCoupling {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let axes = (place.on(), place.from());
        let own = |axis: usize| {
            let axis = &model.axes[axis];
            axis.piezo.stiffness_n_per_m + axis.mechanism.stiffness_n_per_m
        };
        // Three such springs must leave the stiffness matrix positive definite.
        // What goes off the diagonal entries as well counts twice.
        let most = 0.45 / (1.0 + values[1].abs()) * own(axes.0).min(own(axes.1));
        let stiffness_n_per_m = values[0].clamp(-most, most);
        for axis in [axes.0, axes.1] {
            let stack = model.axes[axis].piezo.stiffness_n_per_m;
            let mechanism = &mut model.axes[axis].mechanism;
            mechanism.stiffness_n_per_m = (mechanism.stiffness_n_per_m
                + values[1] * stiffness_n_per_m)
                .max(-MOST_OF_STACK * stack);
        }
        model.springs.push(CouplingSpring { axes, stiffness_n_per_m });
    }
}
