//! stiffness: the mechanism is stiffer or softer than thought.

use super::{Effect, Info, Kind, MOST_OF_STACK, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model};

pub(super) struct Stiffness;

pub(super) const EFFECT: Stiffness = Stiffness;

static INFO: Info = Info {
    name: "stiffness",
    stage: Stage::Mechanism,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "change_n_per_m",
        "N/m",
        0.0,
        (-1.0e12, 1.0e12),
        5.0e5,
        "stiffness of the mechanism beyond the nominal one",
    )],
    threshold: false,
    physics: "k' = k + change: geometry of the hinges, contact compliance. Stroke goes with T/(k_p + k'), the resonance \
              with its root; the charge at a given voltage changes little, so loops keep their height in volts. \
              Stack and mechanism together keep at least 1 % of the stack's stiffness.",
    source: "k = 4.8e6 N/m found by hand in the first paper; contact of 200 N/um takes 20 % of k_p (notes/physics.md, 4)",
    revealed_by: "large slow triangles with and without load; resonance",
    confused_with: &["piezo-gain", "sensor-gain", "drive-gain"],
};

impl Effect for Stiffness {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let axis = &mut model.axes[place.on()];
        let stack = axis.piezo.stiffness_n_per_m;
        axis.mechanism.stiffness_n_per_m =
            (axis.mechanism.stiffness_n_per_m + values[0]).max(-MOST_OF_STACK * stack);
    }
}
