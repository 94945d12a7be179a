//! The nominal rig as the generator knows it, and as the rig file that the diagnosis is given.
//!
//! A description of its own: nothing of the simulator under test is used to make the recordings that test it.

use std::fmt::Write;

use rand::{Rng, RngExt};

/// One axis of the nominal rig, SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Time constant of the amplifier (s).
    pub amplifier_s: f64,
    /// Lower and upper rail of the amplifier (V).
    pub rails_v: (f64, f64),
    /// Transformer ratio of the stack (N/V).
    pub transformer_n_per_v: f64,
    /// Clamped capacitance of the stack (F).
    pub capacitance_f: f64,
    /// Stiffness of the stack (N/m).
    pub stiffness_n_per_m: f64,
    /// Damping of the stack (N s/m).
    pub damping_n_s_per_m: f64,
    /// Effective mass of the stack (kg).
    pub mass_kg: f64,
    /// Slip elements: capacitance (F) and limit (V).
    pub slip: Vec<(f64, f64)>,
    /// Stiffness of the mechanism (N/m).
    pub mechanism_n_per_m: f64,
    /// Noise of the gauge (m rms).
    pub noise_m: f64,
    /// Step of the gauge's converter (m).
    pub resolution_m: f64,
    /// Noise (V rms) and step (V) of the amplifier monitor.
    pub monitor_v: (f64, f64),
}

/// The nominal rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Name.
    pub name: String,
    /// Sample rate of the controller (Hz).
    pub sample_rate_hz: f64,
    /// Axes.
    pub axes: Vec<Axis>,
}

impl Rig {
    /// Three Tokin AE0505D16 stacks in the flexure mechanism of the first paper.
    pub fn handley() -> Self {
        let axis = Axis {
            amplifier_s: 4.0e-4,
            rails_v: (-10.0, 150.0),
            transformer_n_per_v: 7.10,
            capacitance_f: 1.063e-6,
            stiffness_n_per_m: 48.6e6,
            damping_n_s_per_m: 50.0,
            mass_kg: 1.3e-3,
            slip: (1..=8).map(|i| (33.6e-6, 0.372 * f64::from(i))).collect(),
            mechanism_n_per_m: 4.8e6,
            noise_m: 4.0e-9,
            resolution_m: 0.5e-9,
            monitor_v: (0.02, 0.01),
        };
        Self { name: "handley-2002".into(), sample_rate_hz: 10_000.0, axes: vec![axis; 3] }
    }

    /// A rig of the same make whose known values differ: nothing may be tuned to one set of numbers.
    pub fn another(rng: &mut impl Rng) -> Self {
        let mut rig = Self::handley();
        rig.name = "another".into();
        // Spread of a batch of stacks (10 %) and of mechanisms and amplifiers (more).
        let mut near =
            |value: &mut f64, spread: f64| *value *= 1.0 + spread * rng.random_range(-1.0..1.0);
        for axis in &mut rig.axes {
            near(&mut axis.amplifier_s, 0.5);
            near(&mut axis.transformer_n_per_v, 0.1);
            near(&mut axis.capacitance_f, 0.1);
            near(&mut axis.stiffness_n_per_m, 0.1);
            near(&mut axis.damping_n_s_per_m, 0.2);
            near(&mut axis.mechanism_n_per_m, 0.4);
            near(&mut axis.noise_m, 0.5);
            for (capacitance, limit) in &mut axis.slip {
                near(capacitance, 0.15);
                near(limit, 0.15);
            }
        }
        rig
    }

    /// The rig file.
    pub fn to_toml(&self) -> String {
        let mut text =
            format!("name = \"{}\"\nsample_rate_hz = {:?}\n", self.name, self.sample_rate_hz);
        for axis in &self.axes {
            let capacitances: Vec<f64> = axis.slip.iter().map(|slip| slip.0).collect();
            let limits: Vec<f64> = axis.slip.iter().map(|slip| slip.1).collect();
            let written = write!(
                text,
                "\n[[axis]]\n\
                 amplifier = {{ time_constant_s = {:?}, min_v = {:?}, max_v = {:?} }}\n\
                 piezo.transformer_n_per_v = {:?}\n\
                 piezo.capacitance_f = {:?}\n\
                 piezo.stiffness_n_per_m = {:?}\n\
                 piezo.damping_n_s_per_m = {:?}\n\
                 piezo.mass_kg = {:?}\n\
                 piezo.hysteresis.capacitance_f = {capacitances:?}\n\
                 piezo.hysteresis.limit_v = {limits:?}\n\
                 mechanism = {{ stiffness_n_per_m = {:?}, mass_kg = 0.0, damping_n_s_per_m = 0.0 }}\n\
                 sensor = {{ noise_rms_m = {:?}, resolution_m = {:?} }}\n\
                 monitor = {{ noise_rms_v = {:?}, resolution_v = {:?} }}\n",
                axis.amplifier_s,
                axis.rails_v.0,
                axis.rails_v.1,
                axis.transformer_n_per_v,
                axis.capacitance_f,
                axis.stiffness_n_per_m,
                axis.damping_n_s_per_m,
                axis.mass_kg,
                axis.mechanism_n_per_m,
                axis.noise_m,
                axis.resolution_m,
                axis.monitor_v.0,
                axis.monitor_v.1,
            );
            written.expect("writing to a string does not fail");
        }
        text
    }
}
