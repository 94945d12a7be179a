//! amplifier-bandwidth: another time constant, or a further one.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model};

pub(super) struct AmplifierBandwidth;

pub(super) const EFFECT: AmplifierBandwidth = AmplifierBandwidth;

static INFO: Info = Info {
    name: "amplifier-bandwidth",
    stage: Stage::Amplifier,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("ratio", "1", 1.0, (0.02, 50.0), 1.2, "time constant over the nominal one").by_ratio(),
        Parameter::size("further_pole", "1", 0.0, (0.0, 1.0), 0.3, "time constant of a second pole over that of the first"),
    ],
    threshold: false,
    physics: "tau' = ratio * tau of the first-order amplifier: output stage and load capacitance; where the stage before it is slow too, a \
              second pole of further_pole * tau'. Linear, the same at all levels.",
    source: "set 0.5 to 2 kHz, capacitance up to twice the small-signal one (notes/physics.md, sections 1 and 4)",
    revealed_by: "steps, multisine; the monitor",
    confused_with: &["drive-delay", "sensor-bandwidth", "amplifier-current-limit"],
};

impl Effect for AmplifierBandwidth {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let amplifier = &mut model.axes[place.on()].amplifier;
        amplifier.time_constant_s *= values[0];
        amplifier.further_s = values[1] * amplifier.time_constant_s;
    }
}
