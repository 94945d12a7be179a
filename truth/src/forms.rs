//! Further forms of the contract's effects, kept apart from those of [`crate::effects`] so that the cases of earlier seeds stay what they are.
//!
//! Other rigs do it in other ways: a slew limit instead of a current limit, hum of a rectifier or a fan instead of the mains, friction that
//! is viscous at creeping speeds, few relaxations instead of a law. The effect has the same name, and the same owner would mend it.

use std::f64::consts::TAU;

use rand::rngs::StdRng;
use rand::{Rng, RngExt};

use crate::hysteresis::Hysteresis;
use crate::world::{AxisWorld, Bend, Creep, Drift, Hum, Mode, Rate};

/// Gives an axis the effect `name` of a `size` (`signed`: with its sign) in a further form; `false` if there is none. `form` is the same
/// for all axes, `rng` is not.
pub(crate) fn apply(
    axis: &mut AxisWorld,
    name: &str,
    (size, signed): (f64, f64),
    form: &mut StdRng,
    rng: &mut StdRng,
) -> bool {
    match name {
        // Feedback with less phase margin than one pole has.
        "amplifier-bandwidth" => {
            let zeta = form.random_range(0.4..0.95);
            let rise_s = axis.constants.amplifier_s * (1.0 + size);
            axis.ringing = Some((2.0 * zeta / rise_s, zeta));
        }
        // Into the small-signal capacitance of one size of stack, whatever the stack takes.
        "amplifier-current-limit" => axis.slew_v_per_s = 0.6 / (1.0 + size) / 2e-6,
        "amplifier-hum" => axis.amplifier_hum = hum(size, form, rng),
        "sensor-hum" => axis.sensor_hum = hum(size, form, rng),
        "hysteresis-shape" => {
            axis.hysteresis = Hysteresis::partly_wen(&axis.constants, size, form);
        }
        "hysteresis-rate" => {
            axis.rate = match form.random_range(0..3) {
                0 => Rate::Saturating(2.0 * size, between(form, 1e-4, 3e-3)),
                1 => Rate::Relaxing(3.0 * size, between(form, 1e-3, 0.1)),
                _ => Rate::Late(3.0 * size, between(form, 3e-4, 5e-3)),
            };
        }
        "creep" => axis.creep = Some(Creep::sparse(size, between(form, 0.02, 0.2))),
        "stiffness-hardening" => axis.hardening = Some((size, 10e-6, 2.0)),
        "second-mass" => axis.modes.push(Mode {
            mass_kg: size,
            omega: TAU * between(form, 90.0, 2500.0),
            zeta: between(form, 0.03, 0.15),
        }),
        "viscoelasticity" => {
            // Alike in every decade.
            for decade in -3..=1 {
                axis.branches.push((size / 3.0, 10f64.powi(decade)));
            }
        }
        "friction" => {
            let speed = between(form, 5e-5, 2e-3);
            if form.random_bool(0.5) {
                axis.viscous_at_rest = Some((size, speed));
            } else {
                // Contacts of any strength, in any order, each with a reach of its own.
                for _ in 0..form.random_range(4..10) {
                    let limit_n = size * between(rng, 0.05, 0.5);
                    axis.contacts.push((limit_n, limit_n / between(form, 2e-8, 1.5e-6)));
                }
            }
        }
        "sensor-nonlinearity" => {
            axis.bend = Some(if form.random_bool(0.5) {
                Bend::Square(signed)
            } else {
                Bend::Ripple(signed, between(form, 4e-6, 12e-6), form.random_range(0.0..TAU))
            });
        }
        "sensor-drift" => axis.drift = Some(Drift::Wander(signed, rng.random_range(0.0..TAU))),
        _ => return false,
    }
    true
}

fn between(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    rng.random_range(low.ln()..high.ln()).exp()
}

/// A rectifier, a railway's supply, a fan or a switched supply's beat, without harmonics.
fn hum(size: f64, form: &mut StdRng, rng: &mut StdRng) -> Hum {
    let kind = form.random_range(0..4);
    let frequency_hz = match kind {
        0 => 100.0 + form.random_range(-0.08..0.08),
        1 => 16.7,
        2 => between(form, 20.0, 300.0),
        _ => between(form, 300.0, 3000.0),
    };
    let phase = rng.random_range(0.0..TAU);
    // A grid's frequency sways by some hundredths of a hertz in minutes (continental Europe: 50 Hz, within 0.02 Hz as a rule, twice of that behind
    // a rectifier).
    let sway = (kind < 2).then(|| {
        (between(form, 0.01, 0.05), between(form, 25.0, 300.0), form.random_range(0.0..TAU))
    });
    Hum { frequency_hz, amplitudes: [size, 0.0, 0.0], phases: [phase, 0.0, 0.0], sway }
}
