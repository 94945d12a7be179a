//! sensor-offset: the gauge does not read zero at rest.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::Model;

pub(super) struct SensorOffset;

pub(super) const EFFECT: SensorOffset = SensorOffset;

static INFO: Info = Info {
    name: "sensor-offset",
    stage: Stage::Sensor,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "offset_m",
        "m",
        0.0,
        (-1.0e-4, 1.0e-4),
        2.0e-8,
        "reading at zero displacement, beyond the rig's own",
    )],
    threshold: false,
    physics: "y = x + offset: bridge balance and conditioner zero.",
    source: "bridge balance of strain gauges; stack expansion -70 nm/K (notes/physics.md, section 4)",
    revealed_by: "rest; any recording whose memory is known",
    confused_with: &["drive-offset", "preload-loss", "amplifier-clipping", "sensor-drift"],
};

impl Effect for SensorOffset {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].sensor.offset_m += values[0];
    }
}
