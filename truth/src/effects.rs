//! The contract's 27 effects in forms of this crate's own, with sizes drawn from what real stages do.
//!
//! Where the tool's catalogue has one form, there are several here: a fit has to find the effect, not its formula.
//! Magnitudes follow the project's notes on physics (section 4).

use std::f64::consts::TAU;

use rand::rngs::StdRng;
use rand::{Rng, RngExt, SeedableRng};

use crate::forms;
use crate::hysteresis::Hysteresis;
use crate::world::{Bend, Creep, Drift, Friction, Hum, Lowpass, Mode, Rate, World};

/// An effect of the contract: name, stage, and smallest and largest size drawn (unit as in [`Drawn::apply`]).
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Name.
    pub name: &'static str,
    /// Stage.
    pub stage: &'static str,
    /// Range of sizes.
    pub size: (f64, f64),
}

/// All effects.
pub const EFFECTS: [Effect; 27] = [
    effect("drive-gain", "drive", 2e-3, 5e-2),
    effect("drive-offset", "drive", 0.1, 3.0),
    effect("drive-delay", "drive", 2e-5, 1e-3),
    effect("drive-crosstalk", "drive", 2e-3, 5e-2),
    effect("amplifier-bandwidth", "amplifier", 0.05, 2.0),
    effect("amplifier-current-limit", "amplifier", 0.3, 30.0),
    effect("amplifier-clipping", "amplifier", 2.0, 45.0),
    effect("amplifier-hum", "amplifier", 0.05, 1.0),
    effect("piezo-gain", "piezo", 3e-3, 8e-2),
    effect("hysteresis-shape", "piezo", 0.03, 0.5),
    effect("hysteresis-rate", "piezo", 0.01, 0.3),
    effect("creep", "piezo", 2e-3, 3e-2),
    effect("stiffness", "mechanism", 0.03, 1.0),
    effect("stiffness-coupling", "mechanism", 3e4, 1.5e6),
    effect("stiffness-hardening", "mechanism", 2e5, 6e6),
    effect("preload-loss", "mechanism", 0.2, 4.0),
    effect("inertia", "mechanism", 0.02, 1.0),
    effect("second-mass", "mechanism", 0.01, 0.4),
    effect("viscoelasticity", "mechanism", 2e5, 5e6),
    effect("friction", "mechanism", 1.0, 50.0),
    effect("sensor-gain", "sensor", 2e-3, 5e-2),
    effect("sensor-offset", "sensor", 5e-9, 3e-7),
    effect("sensor-nonlinearity", "sensor", 1e-8, 2e-7),
    effect("sensor-bandwidth", "sensor", 5e-5, 2e-3),
    effect("sensor-drift", "sensor", 1e-8, 3e-7),
    effect("sensor-crosstalk", "sensor", 2e-3, 5e-2),
    effect("sensor-hum", "sensor", 4e-9, 8e-8),
];

const fn effect(name: &'static str, stage: &'static str, low: f64, high: f64) -> Effect {
    Effect { name, stage, size: (low, high) }
}

/// The effect of that name.
pub fn find(name: &str) -> Option<&'static Effect> {
    EFFECTS.iter().find(|effect| effect.name == name)
}

/// An effect that was drawn: which, on which axes, how large, and everything else about it as a seed.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Which.
    pub effect: &'static Effect,
    /// Axes that show it, from 0.
    pub axes: Vec<usize>,
    /// Size.
    pub size: f64,
    /// Sign, for effects that have two.
    pub sign: f64,
    /// Form, and what is random in it.
    pub seed: u64,
    /// Whether the effect takes one of [`crate::forms`], if it has any.
    pub is_further: bool,
}

impl Drawn {
    /// Draws axes, size and form. `coupled` effects need a neighbour and list the axes that are acted on.
    pub fn new(effect: &'static Effect, axes: usize, rng: &mut impl Rng) -> Self {
        let mut affected: Vec<usize> = match rng.random_range(0..10) {
            0..5 => vec![rng.random_range(0..axes)],
            5..8 => (0..axes).collect(),
            _ => (0..axes).filter(|_| rng.random_bool(0.5)).collect(),
        };
        if affected.is_empty() {
            affected.push(rng.random_range(0..axes));
        }
        if effect.name == "stiffness-coupling" && affected.len() == 1 && axes > 1 {
            // A spring has two ends.
            affected.push((affected[0] + rng.random_range(1..axes)) % axes);
            affected.sort_unstable();
        }
        let (low, high) = effect.size;
        let size = rng.random_range(low.ln()..high.ln()).exp();
        let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        Self { effect, axes: affected, size, sign, seed: rng.random(), is_further: false }
    }

    /// Adds the effect to a world.
    pub fn apply(&self, world: &mut World) {
        let count = world.axes.len();
        let name = self.effect.name;
        // Axes of one rig share the form of an effect, and differ a little in its size.
        let mut form = StdRng::seed_from_u64(self.seed);
        let variant: u32 = form.random_range(0..6);
        if matches!(name, "drive-crosstalk" | "sensor-crosstalk" | "stiffness-coupling") {
            self.couple(world, &mut form);
            return;
        }
        for &index in &self.axes {
            if index >= count {
                continue;
            }
            let mut rng = StdRng::seed_from_u64(self.seed ^ (index as u64 + 1));
            let alike = if self.axes.len() > 1 { rng.random_range(0.8..1.2) } else { 1.0 };
            let size = self.size * alike;
            let signed = self.sign * size;
            // The same form again for each axis.
            let mut form = StdRng::seed_from_u64(!self.seed);
            self.apply_to_axis(world, index, name, variant, size, signed, &mut rng, &mut form);
        }
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "one match over all effects reads better than 27 closures"
    )]
    fn apply_to_axis(
        &self,
        world: &mut World,
        index: usize,
        name: &str,
        variant: u32,
        size: f64,
        signed: f64,
        rng: &mut StdRng,
        form: &mut StdRng,
    ) {
        let axis = &mut world.axes[index];
        if self.is_further && forms::apply(axis, name, (size, signed), form, rng) {
            return;
        }
        match name {
            "drive-gain" => axis.drive.0 *= 1.0 + signed,
            "drive-offset" => axis.drive.1 += signed,
            "drive-delay" => axis.delay_s += size,
            "amplifier-bandwidth" => match variant {
                // Slower by a share, faster, or with a further pole.
                0..3 => axis.constants.amplifier_s *= 1.0 + size,
                3..5 => axis.constants.amplifier_s /= 1.0 + size,
                _ => axis.second_pole_s = axis.constants.amplifier_s * size,
            },
            // Size is how far the limit is below 0.6 A.
            "amplifier-current-limit" => axis.current = (0.6 / (1.0 + size), variant < 2),
            "amplifier-clipping" => {
                let knee = if variant.is_multiple_of(2) { 0.0 } else { 0.02 * size + 0.05 };
                // Size is how far the rail reaches into 0 to 100 V.
                if variant < 4 {
                    axis.clip.1 = 100.0 - size;
                } else {
                    axis.clip.0 = 0.3 * size;
                }
                axis.clip.2 = knee;
            }
            "amplifier-hum" => axis.amplifier_hum = hum(size, form, rng),
            "sensor-hum" => axis.sensor_hum = hum(size, form, rng),
            "piezo-gain" => {
                axis.constants.transformer_n_per_v *= 1.0 + signed;
                if variant < 2 {
                    // A stack of another polarisation: coupling coefficient kept, capacitance goes along.
                    axis.constants.capacitance_f *= (1.0 + signed).powi(2);
                }
            }
            "hysteresis-shape" => {
                let (height, constants) = (1.0 + signed, &axis.constants);
                axis.hysteresis = match variant {
                    0 | 1 => Hysteresis::bouc_wen(constants, height, form),
                    2 => Hysteresis::preisach(constants, height, form),
                    3 => Hysteresis::uneven(constants, height, form.random_range(-0.3..0.3), form),
                    4 => Hysteresis::uneven(constants, height, 0.0, form),
                    _ => {
                        let mut scaled = constants.clone();
                        scaled.slip.iter_mut().for_each(|slip| slip.1 *= height);
                        scaled.slip.iter_mut().for_each(|slip| slip.0 /= height);
                        Hysteresis::nominal(&scaled)
                    }
                };
            }
            "hysteresis-rate" => {
                axis.rate = match variant {
                    0..4 => Rate::PerDecade(size),
                    _ => Rate::Power(3.0 * size, form.random_range(0.3..0.6)),
                }
            }
            "creep" => {
                let (from, tilt, level) = match variant {
                    0..3 => (0.05, 0.0, 0.0),
                    3 | 4 => (form.random_range(0.01..0.2), form.random_range(-0.1..0.1), 0.0),
                    _ => (0.05, 0.0, form.random_range(0.1..0.4)),
                };
                axis.creep = Some(Creep::new(size, from, tilt, level));
            }
            "stiffness" => {
                let factor = if self.sign > 0.0 { 1.0 + size } else { 1.0 / (1.0 + size) };
                axis.constants.mechanism_n_per_m *= factor;
            }
            "stiffness-hardening" => {
                let exponent = if variant < 4 { 3.0 } else { form.random_range(2.3..4.0) };
                axis.hardening = Some((size, 10e-6, exponent));
            }
            "preload-loss" => {
                let lost = axis.constants.mechanism_n_per_m * form.random_range(0.5..1.0);
                let width = if variant < 3 { 5e-9 } else { 0.1e-6 * form.random_range(0.5..2.0) };
                axis.contact = Some((lost, 1e-6 * size, width, variant.is_multiple_of(2)));
            }
            "inertia" => axis.constants.mass_kg += size,
            "second-mass" => {
                let masses = if variant < 4 { 1 } else { 2 };
                let first = form.random_range(250.0f64..1800.0);
                for mode in 0..masses {
                    axis.modes.push(Mode {
                        mass_kg: size / f64::from(1 + 3 * mode),
                        omega: TAU * first * (1.0 + 1.8 * f64::from(mode)),
                        zeta: form.random_range(0.008..0.04),
                    });
                }
            }
            "viscoelasticity" => {
                let time = 10f64.powf(form.random_range(-2.0..0.5));
                if variant < 4 {
                    axis.branches.push((size, time));
                } else {
                    for part in [0.3, 1.0, 3.0] {
                        axis.branches.push((size / 2.2, time * part));
                    }
                }
            }
            "friction" => {
                axis.friction = Some(Friction {
                    coulomb_n: size,
                    breakaway: if variant < 3 { 1.0 } else { form.random_range(1.0..1.3) },
                    stribeck_m_per_s: 1e-4,
                    presliding_m: 1e-6 * form.random_range(0.05..0.4),
                });
            }
            "sensor-gain" => axis.sensor.0 *= 1.0 + signed,
            "sensor-offset" => axis.sensor.1 += signed,
            "sensor-nonlinearity" => {
                axis.bend = Some(match variant {
                    0..3 => Bend::Bow(signed),
                    3 | 4 => Bend::Ess(signed),
                    _ => Bend::Saturation(signed),
                });
            }
            "sensor-bandwidth" => {
                axis.lowpass =
                    Some(Lowpass { corner_hz: 1.0 / (TAU * size), second_order: variant > 3 });
            }
            "sensor-drift" => {
                axis.drift = Some(match variant {
                    0..2 => Drift::Linear(signed / 60.0),
                    2..4 => Drift::WarmUp(signed, form.random_range(10.0..80.0)),
                    _ => Drift::Room(
                        signed,
                        form.random_range(100.0..500.0),
                        form.random_range(0.0..TAU),
                    ),
                });
            }
            _ => unreachable!("every effect of the table has an arm"),
        }
    }

    /// Effects between axes: each listed axis is acted on by one or all of the others.
    fn couple(&self, world: &mut World, form: &mut StdRng) {
        let count = world.axes.len();
        let all = form.random_bool(0.5);
        let sign = self.sign;
        match self.effect.name {
            "stiffness-coupling" => {
                for (position, &a) in self.axes.iter().enumerate() {
                    for &b in &self.axes[position + 1..] {
                        let size =
                            sign * self.size * if all { 1.0 } else { form.random_range(0.6..1.4) };
                        world.stiffness_cross[a][b] += size;
                        world.stiffness_cross[b][a] += size;
                    }
                }
            }
            name => {
                let matrix = if name == "drive-crosstalk" {
                    &mut world.drive_cross
                } else {
                    &mut world.sensor_cross
                };
                for &to in &self.axes {
                    let one = (to + form.random_range(1..count.max(2))) % count;
                    for from in (0..count).filter(|&from| from != to && (all || from == one)) {
                        matrix[to][from] += sign * self.size * form.random_range(0.6..1.4);
                    }
                }
            }
        }
    }
}

fn hum(size: f64, form: &mut StdRng, rng: &mut StdRng) -> Hum {
    let mains = if form.random_bool(0.7) { 50.0 } else { 60.0 };
    let rich = form.random_bool(0.5);
    let harmonic = |share: f64| if rich { size * share } else { 0.0 };
    Hum {
        frequency_hz: mains + form.random_range(-0.04..0.04),
        amplitudes: [size, harmonic(0.2), harmonic(0.4)],
        phases: [
            rng.random_range(0.0..TAU),
            rng.random_range(0.0..TAU),
            rng.random_range(0.0..TAU),
        ],
        sway: None,
    }
}
