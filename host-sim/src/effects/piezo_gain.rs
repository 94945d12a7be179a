//! piezo-gain: another transformer ratio.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::Model;

pub(super) struct PiezoGain;

pub(super) const EFFECT: PiezoGain = PiezoGain;

static INFO: Info = Info {
    name: "piezo-gain",
    stage: Stage::Piezo,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "ratio",
        "1",
        1.0,
        (0.5, 1.5),
        1.03,
        "transformer ratio over the nominal one",
    )],
    threshold: false,
    physics: "T' = ratio * T in both directions (force and charge), so displacement, charge and with the charge the \
              width of the loop change together.",
    source: "stroke tolerance +-2 of 11.6 um (maker's data sheet); d33 0.1 to 0.3 %/K (notes/physics.md, 1 and 4)",
    revealed_by: "large slow triangles at several strokes",
    confused_with: &["sensor-gain", "drive-gain", "stiffness", "hysteresis-shape"],
};

impl Effect for PiezoGain {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        model.axes[place.on()].piezo.transformer_n_per_v *= values[0];
    }
}
