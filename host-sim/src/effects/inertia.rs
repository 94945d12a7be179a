//! inertia: the mass that the stack moves, and its damping.

use super::{Effect, Info, Kind, MOST_OF_STACK, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model};

pub(super) struct Inertia;

pub(super) const EFFECT: Inertia = Inertia;

static INFO: Info = Info {
    name: "inertia",
    stage: Stage::Mechanism,
    kind: Kind::Parametric,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("added_kg", "kg", 0.0, (-100.0, 1.0e3), 0.3, "mass of the mechanism beyond the nominal one"),
        Parameter::size(
            "added_damping_n_s_per_m",
            "N s/m",
            0.0,
            (-1.0e6, 1.0e7),
            200.0,
            "damping of the mechanism beyond the nominal one",
        ),
    ],
    threshold: false,
    physics: "(m + added) x'' + (b + added) x' + (k_p + k) x = F: the mechanism's mass seen at the stack brings the 32 kHz \
              mode of the bare stack down to a few kHz or less. Mass and damping stay at 1 % of the stack's or more.",
    source: "1.2 to 3.7 kHz with 1 to 0.1 kg at the input (notes/physics.md, section 4)",
    revealed_by: "steps and multisine: ringing at one frequency, moving with nothing",
    confused_with: &["second-mass", "drive-delay", "sensor-bandwidth"],
};

impl Effect for Inertia {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let axis = &mut model.axes[place.on()];
        let (piezo, mechanism) = (&axis.piezo, &mut axis.mechanism);
        mechanism.mass_kg = (mechanism.mass_kg + values[0]).max(-MOST_OF_STACK * piezo.mass_kg);
        mechanism.damping_n_s_per_m =
            (mechanism.damping_n_s_per_m + values[1]).max(-MOST_OF_STACK * piezo.damping_n_s_per_m);
    }
}
