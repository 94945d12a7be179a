//! drive-bend: the voltage is no straight line of the command. Not in the catalogue: a gain is one number.

use super::bend::softplus;
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, VoltageBlock};

pub(super) struct DriveBend;

pub(super) const EFFECT: DriveBend = DriveBend;

/// Voltage at which bow and ess come back to the line: what the stacks are driven with.
const SPAN_V: f64 = 100.0;
/// Width of the kink, V.
const SOFTNESS_V: f64 = 1.0;
/// 1 / greatest value of u (u - 1/2) (u - 1) between 0 and 1.
const ESS: f64 = 20.784_609_690_826_528;

static INFO: Info = Info {
    name: "drive-bend",
    stage: Stage::Drive,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size(
            "bow_v",
            "V",
            0.0,
            (-20.0, 20.0),
            0.5,
            "off the line through 0 and 100 V at 50 V",
        ),
        Parameter::size(
            "ess_v",
            "V",
            0.0,
            (-20.0, 20.0),
            0.5,
            "most off that line to one side below 50 V and to the other above",
        ),
        Parameter::size(
            "kink",
            "1",
            0.0,
            (-0.3, 0.3),
            0.02,
            "gain beyond the kink less that before it",
        ),
        Parameter::shape("kink_v", "V", (-10.0, 150.0), 50.0, "where the gain changes"),
    ],
    threshold: false,
    physics: "V = U + bow 4 u (1 - u) + ess 20.8 u (u - 1/2) (u - 1) + kink max(0, U - kink_v), u = U/100 V, the kink rounded over 1 V: integral error of the converter, \
              an output stage whose gain changes. It is in front of the loops, and the monitor shows it.",
    source: "integral errors of converters, crossover and loading of output stages",
    revealed_by: "a slow triangle over all of the range; with the monitor, at once",
    confused_with: &[
        "drive-gain",
        "drive-offset",
        "piezo-gain",
        "hysteresis-shape",
        "stiffness",
        "stiffness-hardening",
        "preload-loss",
        "sensor-gain",
        "sensor-nonlinearity",
    ],
};

struct Bend {
    bow_v: f64,
    ess_v: f64,
    kink: f64,
    kink_v: f64,
}

impl VoltageBlock for Bend {
    fn output(&mut self, v: f64, _time_s: f64) -> f64 {
        let u = v / SPAN_V;
        let line = 4.0 * self.bow_v * u * (1.0 - u) + ESS * self.ess_v * u * (u - 0.5) * (u - 1.0);
        v + line + self.kink * SOFTNESS_V * softplus((v - self.kink_v) / SOFTNESS_V).0
    }
}

impl Effect for DriveBend {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let bend = Bend { bow_v: values[0], ess_v: values[1], kink: values[2], kink_v: values[3] };
        model.axes[place.on()].amplifier.input.push(Box::new(bend));
    }
}
