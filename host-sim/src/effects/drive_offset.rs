//! drive-offset: a constant voltage on top of the command.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::Model;

pub(super) struct DriveOffset;

pub(super) const EFFECT: DriveOffset = DriveOffset;

static INFO: Info = Info {
    name: "drive-offset",
    stage: Stage::Drive,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "offset_v",
        "V",
        0.0,
        (-20.0, 20.0),
        0.5,
        "voltage asked of the amplifier at a command of zero",
    )],
    threshold: false,
    physics: "u' = u + offset: zero error of the DAC and of the amplifier. It moves the bias of the stack, hence the \
              first rise; once settled it is little more than a shift of the position.",
    source: "offset of amplifier and 12-bit DAC, tens of mV to 1 V at the output (notes/physics.md, section 1)",
    revealed_by: "the monitor; without it only the bias dependence of hysteresis",
    confused_with: &["sensor-offset", "preload-loss", "amplifier-clipping", "sensor-drift"],
};

impl Effect for DriveOffset {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].drive.offset_v += values[0];
    }
}
