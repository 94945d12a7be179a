//! drive-gain: the converter and the amplifier's divider scale the command.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::Model;

pub(super) struct DriveGain;

pub(super) const EFFECT: DriveGain = DriveGain;

static INFO: Info = Info {
    name: "drive-gain",
    stage: Stage::Drive,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "ratio",
        "1",
        1.0,
        (0.5, 1.5),
        1.02,
        "voltage asked of the amplifier over voltage commanded",
    )],
    threshold: false,
    physics: "u' = ratio * u: gain error of the DAC and of the amplifier's input divider. It is in front of the \
              hysteresis, so loops widen with it, and the monitor shows it.",
    source: "1 % class gain accuracy of DAC reference and amplifier divider (notes/physics.md, section 1)",
    revealed_by: "any large motion; with the monitor, at once",
    confused_with: &["piezo-gain", "sensor-gain"],
};

impl Effect for DriveGain {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].drive.gain *= values[0];
    }
}
