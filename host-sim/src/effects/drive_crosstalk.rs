//! drive-crosstalk: part of another axis' command reaches this axis' amplifier.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model};

pub(super) struct DriveCrosstalk;

pub(super) const EFFECT: DriveCrosstalk = DriveCrosstalk;

static INFO: Info = Info {
    name: "drive-crosstalk",
    stage: Stage::Drive,
    kind: Kind::Structural,
    scope: Scope::Pair,
    parameters: &[Parameter::size(
        "share",
        "1",
        0.0,
        (-0.5, 0.5),
        0.01,
        "voltage that arrives here a volt commanded there",
    )],
    threshold: false,
    physics: "u_i' = u_i + share u_j: converters, cabling or amplifiers that share a return. It passes through this \
              axis' amplifier and hysteresis, and shows in its monitor.",
    source: "published crosstalk of three-axis stages 1.2 to 2.5 % (notes/physics.md, section 3)",
    revealed_by: "one axis driven alone, others held; the monitor of the others",
    confused_with: &["stiffness-coupling", "sensor-crosstalk"],
};

impl Effect for DriveCrosstalk {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].drive.crosstalk.push((place.from(), values[0]));
    }
}
