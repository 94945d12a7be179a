//! amplifier-clipping: the output saturates inside the rails, hard or soft.

use super::bend::softplus;
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, VoltageBlock};

pub(super) struct AmplifierClipping;

pub(super) const EFFECT: AmplifierClipping = AmplifierClipping;

static INFO: Info = Info {
    name: "amplifier-clipping",
    stage: Stage::Amplifier,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("max_v", "V", 1.0e3, (-1.0e3, 1.0e3), 85.0, "highest output; 1000 V is none"),
        Parameter::size("min_v", "V", -1.0e3, (-1.0e3, 1.0e3), 1.0, "lowest output; -1000 V is none"),
        Parameter::shape("softness_v", "V", (1.0e-3, 50.0), 0.1, "width of the bend").by_ratio(),
        Parameter::shape("ahead", "1", (0.0, 1.0), 0.0, "how much of it acts before the amplifier's lag: 0 none, 1 all"),
    ],
    threshold: true,
    physics: "v = max - s ln(1 + e^((max - v0)/s)) and the same below: supply too low, a clamp, a sagging output stage. \
              s -> 0 is a hard stop. The kink stands at one voltage, whatever the displacement. Behind the lag it cuts what comes out; \
              before it, where the lag is that of an output stage which charges the stack, what the output tends to.",
    source: "rails -10 and 150 V of the ENV 400, clamp at -10 V (notes/physics.md, sections 1 and 4)",
    revealed_by: "large triangles; the monitor",
    confused_with: &["amplifier-current-limit", "preload-loss", "sensor-nonlinearity", "stiffness-hardening", "sensor-offset"],
};

#[derive(Clone, Copy)]
struct Clip {
    max_v: f64,
    min_v: f64,
    softness_v: f64,
    /// How much of the cut is made, 0 to 1.
    share: f64,
}

impl VoltageBlock for Clip {
    fn output(&mut self, v: f64, _time_s: f64) -> f64 {
        let s = self.softness_v;
        let low = self.max_v - s * softplus((self.max_v - v) / s).0;
        let cut = self.min_v + s * softplus((low - self.min_v) / s).0;
        v + self.share * (cut - v)
    }
}

impl Effect for AmplifierClipping {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let (max_v, min_v) = (values[0], values[1].min(values[0]));
        let amplifier = &mut model.axes[place.on()].amplifier;
        let clip = Clip { max_v, min_v, softness_v: values[2], share: 1.0 };
        if values[3] > 0.0 {
            amplifier.input.push(Box::new(Clip { share: values[3], ..clip }));
        }
        // Behind the lag: what was not cut before it.
        amplifier.output.push(Box::new(clip));
    }
}
