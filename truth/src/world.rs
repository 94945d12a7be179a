//! The rig as it really is: the nominal one plus whatever is wrong with it.
//!
//! All quantities SI. A neutral value of every field is the nominal rig; [`crate::effects`] and [`crate::faults`] set them.

use std::f64::consts::TAU;

use crate::faults::Fault;
use crate::hysteresis::Hysteresis;
use crate::rig::{Axis, Rig};

/// Three axes, what couples them, and what is out of order.
#[derive(Clone, Debug)]
pub struct World {
    /// Name of the rig.
    pub name: String,
    /// Axes as they really are.
    pub axes: Vec<AxisWorld>,
    /// Share of the other axes' commands that reaches an axis: `[to][from]`.
    pub drive_cross: Vec<Vec<f64>>,
    /// Stiffness (N/m) by which another axis' displacement pushes back: `[on][from]`, symmetric.
    pub stiffness_cross: Vec<Vec<f64>>,
    /// Share of the other axes' displacements that a gauge sees: `[gauge][from]`.
    pub sensor_cross: Vec<Vec<f64>>,
    /// What no catalogue has.
    pub faults: Vec<Fault>,
}

/// One axis as it really is.
#[derive(Clone, Debug)]
pub struct AxisWorld {
    /// Constants, true ones.
    pub constants: Axis,
    /// Hysteresis with its memory.
    pub hysteresis: Hysteresis,
    /// Factor and offset (V) between the command and what the amplifier is asked for.
    pub drive: (f64, f64),
    /// Dead time of the command (s).
    pub delay_s: f64,
    /// Second pole of the amplifier (s); 0 for none.
    pub second_pole_s: f64,
    /// Natural frequency (rad/s) and damping ratio of an amplifier whose feedback rings, instead of its pole.
    pub ringing: Option<(f64, f64)>,
    /// Largest current of the amplifier (A), and whether it is reached softly.
    pub current: (f64, bool),
    /// Fastest slope of the amplifier (V/s); 0 for any.
    pub slew_v_per_s: f64,
    /// Rails where the output saturates (V) and width of the soft knee (V; 0 for a hard one).
    pub clip: (f64, f64, f64),
    /// Mains on the amplifier's output (V).
    pub amplifier_hum: Hum,
    /// Growth of the hysteresis voltage with the rate: per decade above `1e-4` C/s, or as a power of the rate.
    pub rate: Rate,
    /// Creep of the stack.
    pub creep: Option<Creep>,
    /// Restoring force beyond the linear one: `stiffness * scale * |x/scale|^exponent` (N/m, m).
    pub hardening: Option<(f64, f64, f64)>,
    /// Stiffness (N/m) lost below the contact point (m), over a transition of this width (m); whether rest is the reference.
    pub contact: Option<(f64, f64, f64, bool)>,
    /// Masses hung onto the stage.
    pub modes: Vec<Mode>,
    /// Maxwell branches of the mechanism: stiffness (N/m) and time constant (s).
    pub branches: Vec<(f64, f64)>,
    /// Friction of the guide.
    pub friction: Option<Friction>,
    /// Contacts of the guide that slip one after the other: limit (N) and stiffness (N/m) of each.
    pub contacts: Vec<(f64, f64)>,
    /// Friction without rest: force (N), and speed (m/s) where it reaches 0.7 of that, on a hyperbola's way from damper to Coulomb.
    pub viscous_at_rest: Option<(f64, f64)>,
    /// Factor and offset (m) of the gauge.
    pub sensor: (f64, f64),
    /// Nonlinearity of the gauge.
    pub bend: Option<Bend>,
    /// Low-pass of the gauge.
    pub lowpass: Option<Lowpass>,
    /// Drift of the gauge on the session's clock.
    pub drift: Option<Drift>,
    /// Mains on the gauge (m).
    pub sensor_hum: Hum,
}

/// A mains frequency with two harmonics, running on the session's clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Hum {
    /// Fundamental (Hz).
    pub frequency_hz: f64,
    /// Amplitudes of fundamental, second and third harmonic.
    pub amplitudes: [f64; 3],
    /// Phases (rad).
    pub phases: [f64; 3],
    /// A grid whose frequency comes and goes: by how much (Hz), in what time (s), and its phase (rad).
    pub sway: Option<(f64, f64, f64)>,
}

impl Hum {
    /// Value at a time on the session's clock.
    pub fn at(&self, time_s: f64) -> f64 {
        if self.amplitudes == [0.0; 3] {
            return 0.0;
        }
        let ahead = self.sway.map_or(0.0, |(by_hz, period_s, phase)| {
            by_hz * period_s * (phase.cos() - (TAU * time_s / period_s + phase).cos())
        });
        let part = |n: usize| {
            let order = (n + 1) as f64;
            let angle = order * (TAU * self.frequency_hz * time_s + ahead) + self.phases[n];
            self.amplitudes[n] * angle.sin()
        };
        part(0) + part(1) + part(2)
    }
}

/// How the hysteresis depends on the rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// Not at all.
    None,
    /// Voltage grows by this share a decade of dq/dt above 1e-4 C/s.
    PerDecade(f64),
    /// A further voltage (V) at 1e-3 C/s, growing with this power of the rate.
    Power(f64, f64),
    /// Voltage grows by up to this share, half of it reached at about half of this rate (C/s).
    Saturating(f64, f64),
    /// A further voltage (V) at 1e-3 C/s that relaxes with this time constant (s): a resistor beside a capacitance.
    Relaxing(f64, f64),
    /// The stack pushes by this voltage (V) less for each factor of e by which the rate grows beyond this one (C/s).
    Late(f64, f64),
}

/// Creep with a logarithmic law: a response per decade of time, kept as densely spaced relaxations.
#[derive(Clone, Debug)]
pub struct Creep {
    /// Share of the displacement per decade.
    pub per_decade: f64,
    /// Shortest time (s): nothing creeps faster.
    pub from_s: f64,
    /// Tilt of the spectrum: weight of a relaxation goes with its time constant to this power.
    pub tilt: f64,
    /// Growth of the share with the voltage, at 100 V.
    pub level: f64,
    /// One relaxation in this many is there.
    pub every: usize,
    /// State of each relaxation (V).
    pub states: Vec<f64>,
}

impl Creep {
    /// Relaxations a decade: so many that the sum's ripple is below a thousandth of the response.
    const PER_DECADE: usize = 3;
    /// Decades covered.
    const DECADES: usize = 6;

    /// At rest.
    pub fn new(per_decade: f64, from_s: f64, tilt: f64, level: f64) -> Self {
        let states = vec![0.0; Self::PER_DECADE * Self::DECADES];
        Self { per_decade, from_s, tilt, level, every: 1, states }
    }

    /// A relaxation a decade and a bit, the first soon after `from_s`.
    pub fn sparse(per_decade: f64, from_s: f64) -> Self {
        Self { every: 4, ..Self::new(per_decade, from_s, 0.0, 0.0) }
    }

    fn time_s(&self, index: usize) -> f64 {
        self.from_s * 10f64.powf((index as f64 + 0.5) / Self::PER_DECADE as f64)
    }

    /// Weights and, for a step of `dt` seconds, decays of all relaxations.
    pub fn table(&self, dt: f64) -> Vec<(f64, f64)> {
        let entry = |index| {
            let time = self.time_s(index);
            let weight = self.per_decade / Self::PER_DECADE as f64 * (time / 1.0).powf(self.tilt);
            let there = if index % self.every == 0 { self.every as f64 } else { 0.0 };
            (there * weight, -(-dt / time).exp_m1())
        };
        (0..self.states.len()).map(entry).collect()
    }

    /// Follows the voltage for one step of the table; returns what has crept (V).
    pub fn step(&mut self, table: &[(f64, f64)], voltage_v: f64) -> f64 {
        let target = voltage_v * (1.0 + self.level * voltage_v.abs() / 100.0);
        let mut sum = 0.0;
        for (state, (weight, decay)) in self.states.iter_mut().zip(table) {
            *state += (target - *state) * decay;
            sum += weight * *state;
        }
        sum
    }
}

/// A mass hung onto the stage by a spring.
#[derive(Clone, Copy, Debug)]
pub struct Mode {
    /// Mass (kg).
    pub mass_kg: f64,
    /// Own angular frequency (rad/s).
    pub omega: f64,
    /// Damping ratio.
    pub zeta: f64,
}

/// LuGre friction: bristles of stiffness `bristle` that slip at a level falling with speed.
#[derive(Clone, Copy, Debug)]
pub struct Friction {
    /// Coulomb force (N).
    pub coulomb_n: f64,
    /// Static over Coulomb force.
    pub breakaway: f64,
    /// Stribeck speed (m/s).
    pub stribeck_m_per_s: f64,
    /// Displacement (m) over which the bristles load.
    pub presliding_m: f64,
}

/// Static nonlinearity of a gauge over a range of 12 um.
#[derive(Clone, Copy, Debug)]
pub enum Bend {
    /// Parabola: error (m) at mid range, zero at both ends.
    Bow(f64),
    /// S-shape: error (m) at a quarter and three quarters.
    Ess(f64),
    /// Saturating: error (m) at full range.
    Saturation(f64),
    /// Parabola about zero: error (m) at full range.
    Square(f64),
    /// Integral error of a converter: amplitude (m), period (m), phase (rad); none at zero.
    Ripple(f64, f64, f64),
}

impl Bend {
    /// Error (m) at a displacement (m).
    pub fn at(self, x: f64) -> f64 {
        let along = x / 12e-6;
        match self {
            Self::Bow(size) => 4.0 * size * along * (1.0 - along),
            Self::Ess(size) => size * 10.39 * along * (along - 0.5) * (along - 1.0) * 2.0,
            Self::Saturation(size) => size * along.abs().powf(2.5) * along.signum(),
            Self::Square(size) => size * along * along,
            Self::Ripple(size, period_m, phase) => {
                size * ((TAU * x / period_m + phase).sin() - phase.sin())
            }
        }
    }
}

/// Low-pass of a gauge's conditioner.
#[derive(Clone, Copy, Debug)]
pub struct Lowpass {
    /// Corner (Hz).
    pub corner_hz: f64,
    /// Whether there are two poles (Butterworth) instead of one.
    pub second_order: bool,
}

/// Slow drift of a gauge that ignores the input.
#[derive(Clone, Copy, Debug)]
pub enum Drift {
    /// Constant speed (m/s).
    Linear(f64),
    /// Warm-up to this much (m) with this time constant (s).
    WarmUp(f64, f64),
    /// Room temperature: amplitude (m), period (s), phase (rad).
    Room(f64, f64, f64),
    /// Wandering without a period: size (m) and phase (rad).
    Wander(f64, f64),
}

impl Drift {
    /// Drift (m) at a time on the session's clock.
    pub fn at(self, time_s: f64) -> f64 {
        match self {
            Self::Linear(speed) => speed * time_s,
            Self::WarmUp(size, time) => size * -(-time_s / time).exp_m1(),
            Self::Room(size, period, phase) => {
                size * ((TAU * time_s / period + phase).sin() - phase.sin())
            }
            // The longer the period, the larger.
            Self::Wander(size, phase) => [23.0f64, 61.0, 149.0, 407.0]
                .iter()
                .zip(1..)
                .map(|(period, nth)| {
                    let phase = phase * f64::from(nth * nth);
                    let turn = (TAU * time_s / period + phase).sin() - phase.sin();
                    size * (period / 407.0).sqrt() * turn
                })
                .sum(),
        }
    }
}

impl World {
    /// Nothing is wrong.
    pub fn nominal(rig: &Rig) -> Self {
        let axes: Vec<_> = rig.axes.iter().map(AxisWorld::nominal).collect();
        let none = vec![vec![0.0; axes.len()]; axes.len()];
        Self {
            name: rig.name.clone(),
            axes,
            drive_cross: none.clone(),
            stiffness_cross: none.clone(),
            sensor_cross: none,
            faults: Vec::new(),
        }
    }
}

impl AxisWorld {
    fn nominal(axis: &Axis) -> Self {
        Self {
            hysteresis: Hysteresis::nominal(axis),
            drive: (1.0, 0.0),
            delay_s: 0.0,
            second_pole_s: 0.0,
            ringing: None,
            current: (f64::INFINITY, false),
            slew_v_per_s: 0.0,
            clip: (axis.rails_v.0, axis.rails_v.1, 0.0),
            amplifier_hum: Hum::default(),
            rate: Rate::None,
            creep: None,
            hardening: None,
            contact: None,
            modes: Vec::new(),
            branches: Vec::new(),
            friction: None,
            contacts: Vec::new(),
            viscous_at_rest: None,
            sensor: (1.0, 0.0),
            bend: None,
            lowpass: None,
            drift: None,
            sensor_hum: Hum::default(),
            constants: axis.clone(),
        }
    }
}
