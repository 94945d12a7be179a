//! drive-delay: dead time between the tick that commands a voltage and the amplifier that gets it.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model};

pub(super) struct DriveDelay;

pub(super) const EFFECT: DriveDelay = DriveDelay;

static INFO: Info = Info {
    name: "drive-delay",
    stage: Stage::Drive,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "delay_s",
        "s",
        0.0,
        (0.0, 0.05),
        5.0e-5,
        "time from tick to amplifier; whole ticks and fractions alike",
    )],
    threshold: false,
    physics: "u'(t) = u(t - delay): computing time, converter latency, a bus. A fraction of a tick switches the held \
              target inside the tick, exactly. All frequencies are late by the same time at every level.",
    source: "one 10 kHz period of computing, 8 us of oversampling (notes/physics.md, section 7); one delay is among \
             the parameters of PACE (notes/gap.md, section 1)",
    revealed_by: "multisine up to 0.4 of the sample rate; steps; the monitor",
    confused_with: &["amplifier-bandwidth", "sensor-bandwidth", "hysteresis-rate"],
};

impl Effect for DriveDelay {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].drive.delay_s += values[0];
    }
}
