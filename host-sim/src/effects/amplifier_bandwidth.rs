//! amplifier-bandwidth: another time constant, or a further one, or two that ring.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::Model;

pub(super) struct AmplifierBandwidth;

pub(super) const EFFECT: AmplifierBandwidth = AmplifierBandwidth;

static INFO: Info = Info {
    name: "amplifier-bandwidth",
    stage: Stage::Amplifier,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("ratio", "1", 1.0, (0.02, 50.0), 1.2, "time constant over the nominal one").by_ratio(),
        Parameter::size(
            "further_pole",
            "1",
            0.0,
            (0.0, 10.0),
            0.3,
            "time constant of a second pole over that of the first; above 1 the two ring, with a damping ratio of 1/sqrt(further_pole)",
        ),
    ],
    threshold: false,
    physics: "tau' = ratio * tau of the first-order amplifier: output stage and load capacitance; where the stage before it is slow too, a \
              second pole of further_pole * tau'; where its feedback has little phase margin, further_pole tau'^2 v'' + 2 tau' v' + v = target. \
              Linear, the same at all levels.",
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
        amplifier.further_pole = values[1];
    }
}
