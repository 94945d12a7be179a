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
    parameters: &[
        Parameter::size("ratio", "1", 1.0, (0.5, 1.5), 1.03, "transformer ratio over the nominal one"),
        Parameter::shape("polarisation", "1", (0.0, 1.0), 0.0, "whether the capacitance goes along: 1 with the square of the ratio, 0 not"),
    ],
    threshold: false,
    physics: "T' = ratio * T in both directions (force and charge), so displacement, charge and with the charge the \
              width of the loop change together. A stack that is polarised otherwise keeps its coupling, T^2/(C K): \
              C' = C * ratio^(2 polarisation).",
    source: "stroke tolerance +-2 of 11.6 um (maker's data sheet); d33 0.1 to 0.3 %/K (notes/physics.md, 1 and 4)",
    revealed_by: "large slow triangles at several strokes",
    confused_with: &["sensor-gain", "drive-gain", "stiffness", "hysteresis-shape"],
};

impl Effect for PiezoGain {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let piezo = &mut model.axes[place.on()].piezo;
        piezo.transformer_n_per_v *= values[0];
        piezo.capacitance_f *= values[0].powf(2.0 * values[1]);
    }
}
