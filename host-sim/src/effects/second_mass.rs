//! second-mass: a part of the mechanism swings on its own spring, or two of them do.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{LinearBlock, Model, StateKind};

pub(super) struct SecondMass;

pub(super) const EFFECT: SecondMass = SecondMass;

static INFO: Info = Info {
    name: "second-mass",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("mass_kg", "kg", 0.0, (0.0, 1.0e3), 0.1, "mass that swings"),
        Parameter::shape("frequency_hz", "Hz", (1.0, 2.0e4), 800.0, "its frequency with the axis held").by_ratio(),
        Parameter::shape("damping_ratio", "1", (1.0e-4, 2.0), 0.02, "its damping ratio with the axis held").by_ratio(),
        Parameter::size("further_kg", "kg", 0.0, (0.0, 1.0e3), 0.03, "mass of a further part that swings beside it"),
        Parameter::shape("further_hz", "Hz", (1.0, 2.0e4), 1500.0, "the further part's frequency with the axis held").by_ratio(),
        Parameter::shape("further_damping", "1", (1.0e-4, 2.0), 0.02, "the further part's damping ratio with the axis held").by_ratio(),
    ],
    threshold: false,
    physics: "m2 x2'' = -k2 (x2 - x) - c2 (x2' - x'), the reaction on the axis: a platform on the flexures, or its links. The \
              response dips at the frequency and peaks below; the static gain does not change. Propagated exactly.",
    source: "loaded stages 1.2 to 3.7 kHz, second modes of platform and links (notes/physics.md, sections 3 and 4)",
    revealed_by: "multisine and steps: a resonance with an antiresonance",
    confused_with: &["inertia", "viscoelasticity"],
};

struct Swinging {
    mass_kg: f64,
    stiffness: f64,
    damping: f64,
}

impl LinearBlock for Swinging {
    fn states(&self) -> &'static [StateKind] {
        &[StateKind::Position, StateKind::Velocity]
    }

    fn assemble(&self, a: &mut nalgebra::DMatrix<f64>, at: usize, mass_kg: f64) {
        let (k, c) = (self.stiffness, self.damping);
        a[(at, at + 1)] = 1.0;
        for (row, mass, sign) in [(1, mass_kg, 1.0), (at + 1, self.mass_kg, -1.0)] {
            a[(row, at)] += sign * k / mass;
            a[(row, 0)] -= sign * k / mass;
            a[(row, at + 1)] += sign * c / mass;
            a[(row, 1)] -= sign * c / mass;
        }
    }
}

impl Effect for SecondMass {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        for part in values.chunks_exact(3) {
            let [mass_kg, frequency_hz, damping_ratio] = *part else { continue };
            if mass_kg <= 0.0 {
                continue;
            }
            let rate = std::f64::consts::TAU * frequency_hz;
            model.axes[place.on()].mechanism.linear.push(Box::new(Swinging {
                mass_kg,
                stiffness: mass_kg * rate * rate,
                damping: 2.0 * damping_ratio * rate * mass_kg,
            }));
        }
    }
}
