//! What faults do to a command, a force, a reading.

use std::f64::consts::TAU;

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use rand_distr::{Exp, StandardNormal};

use super::{Kind, physics};

/// A fault of one axis, and what it remembers.
#[derive(Clone, Debug)]
pub struct Fault {
    /// Axis, from 0.
    pub axis: usize,
    /// Kind.
    pub kind: Kind,
    /// Size in the kind's unit.
    pub size: f64,
    /// Mean time between events (s), or the time scale of wandering.
    pub every_s: f64,
    pub(super) rng: Xoshiro256PlusPlus,
    on: bool,
    until_s: f64,
    pub(super) value: f64,
    pub(super) speed: f64,
    phase: f64,
    tick: Option<usize>,
    /// What a kind of physics has beside its size: see [`physics::drawn`], which says the unit. Not drawn for what is broken: the dice of
    /// earlier seeds stay what they are.
    pub(super) constant: f64,
    /// Reading before (m).
    pub(super) last: f64,
    /// When a time was last asked for (s).
    pub(super) asked_s: Option<f64>,
}

impl Fault {
    /// A fault that begins in a random state.
    pub fn new(axis: usize, kind: Kind, size: f64, seed: u64) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let every_s: f64 = match kind {
            Kind::Telegraph => rng.random_range(-2.0..0.3),
            Kind::GainFlip => rng.random_range(-0.7..0.7),
            Kind::NoiseBursts => rng.random_range(-0.5..0.3),
            // Periods of 17 to 120 Hz.
            Kind::Pump => rng.random_range(-2.08..-1.23),
            Kind::Warming => rng.random_range(1.3..2.3),
            _ => rng.random_range(-1.0..-0.1),
        };
        let on = rng.random_bool(0.5);
        let phase = rng.random_range(0.0..TAU);
        let constant = if kind.is_steady() { physics::drawn(kind, rng.random()) } else { 0.0 };
        Self {
            axis,
            kind,
            size,
            every_s: 10f64.powf(every_s),
            rng,
            on,
            until_s: 0.0,
            value: 0.0,
            speed: 0.0,
            phase,
            tick: None,
            constant,
            last: 0.0,
            asked_s: None,
        }
    }

    /// Switches between on and off at random: mean times `on_s` and `off_s`.
    fn switch(&mut self, time: f64, on_s: f64, off_s: f64) -> bool {
        // The session's clock jumps between files; whatever ended in between begins anew.
        if time >= self.until_s || self.until_s - time > 100.0 * (on_s + off_s) {
            self.on = !self.on;
            let mean = if self.on { on_s } else { off_s };
            let exponential = Exp::new(1.0 / mean).expect("a mean time is positive");
            self.until_s = time + self.rng.sample(exponential);
        }
        self.on
    }

    /// What the gauge's reading (m) becomes; `seen` are the displacements (m) of all axes.
    pub fn reading(&mut self, tick: usize, time: f64, reading: f64, seen: &[f64]) -> f64 {
        let size = self.size;
        let every = self.every_s;
        match self.kind {
            Kind::Telegraph => {
                if self.switch(time, every, every) {
                    reading + size
                } else {
                    reading
                }
            }
            Kind::Freeze => {
                if self.switch(time, 0.3 * every * size, every * (1.0 - size)) && tick > 0 {
                    return self.value;
                }
                self.value = reading;
                reading
            }
            Kind::Dropout => {
                if self.switch(time, 3e-3, every) {
                    reading * (1.0 - size)
                } else {
                    reading
                }
            }
            Kind::GainFlip => {
                if self.switch(time, every, every) {
                    reading * (1.0 + size)
                } else {
                    reading
                }
            }
            Kind::Interference => {
                // A random walk in frequency between 0 and 20 kHz: aliases come for free at the sampling instants.
                self.speed += 30.0 * self.rng.sample::<f64, _>(StandardNormal);
                self.speed = self.speed.clamp(-2e4, 2e4);
                self.phase += TAU * (1500.0 + self.speed) * 1e-4;
                reading + size * self.phase.sin()
            }
            Kind::NoiseBursts => {
                let on = self.switch(time, 0.3 * every, every);
                if on {
                    reading + size * self.rng.sample::<f64, _>(StandardNormal)
                } else {
                    reading
                }
            }
            Kind::StuckBit => {
                let counts = (reading / size).floor();
                if counts.rem_euclid(2.0) == 0.0 { reading } else { reading - size }
            }
            Kind::Play => {
                self.value = self.value.clamp(reading - 0.5 * size, reading + 0.5 * size);
                self.value
            }
            Kind::Warming => reading * (1.0 + size * (1.0 - (-time / every).exp())),
            Kind::SelfHeating | Kind::HighPass | Kind::SlewLimit | Kind::Tilt | Kind::Jitter => {
                self.conditioned(time, reading, seen)
            }
            _ => reading,
        }
    }

    /// Force on the stage, held for a tick (N).
    pub fn force(&mut self, tick: usize, time: f64) -> f64 {
        let size = self.size;
        let fresh = self.tick != Some(tick);
        self.tick = Some(tick);
        match self.kind {
            Kind::Knocks => {
                // A blow, then 200 Hz ringing for some tens of milliseconds.
                if fresh && self.rng.random_bool((1e-4 / self.every_s).min(1.0)) {
                    self.value = size * self.rng.random_range(0.3..1.0);
                    self.until_s = time;
                }
                let since = (time - self.until_s).max(0.0);
                self.value * (-since / 0.02).exp() * (TAU * 200.0 * since).cos()
            }
            Kind::Vibration => {
                // Second-order filtered noise around 12 Hz.
                let kick: f64 = self.rng.sample(StandardNormal);
                let omega = TAU * 12.0;
                self.speed +=
                    1e-4 * (-omega * omega * self.value - 0.6 * omega * self.speed) + 0.9 * kick;
                self.value += 1e-4 * self.speed;
                size * self.value * 12.0
            }
            Kind::Catching => {
                let caught = self.switch(time, 0.3 * self.every_s, self.every_s);
                let target = if caught { -size } else { 0.0 };
                self.value += (target - self.value) * 0.05;
                self.value
            }
            _ => 0.0,
        }
    }

    /// Force that goes on between ticks (N).
    pub fn shaking(&self, time: f64) -> f64 {
        match self.kind {
            Kind::Pump => self.size * (TAU * time / self.every_s + self.phase).sin(),
            _ => 0.0,
        }
    }

    /// Added dead time (s).
    pub fn dead_time(&mut self, _tick: usize, time: f64, tick_s: f64) -> f64 {
        if self.kind != Kind::DeadTime {
            return 0.0;
        }
        let slow = (TAU * time / (20.0 * self.every_s) + self.phase).sin();
        if self.switch(time, self.every_s, self.every_s) {
            self.value = 0.5;
        } else {
            self.value = 0.0;
        }
        (self.size * (0.5 + 0.25 * slow + self.value)).max(0.1 * tick_s)
    }

    /// What the amplifier is asked for by a command of `asked` (V) while it gives `current` (A).
    pub fn drive(&mut self, tick: usize, time: f64, asked: f64, current: f64) -> f64 {
        match self.kind {
            Kind::CoarseDrive => return (asked / self.size).round() * self.size,
            Kind::Brownout => {}
            _ => return self.supplied(time, asked, current),
        }
        // Called several times a tick; the dice are thrown once.
        if self.tick != Some(tick) || tick == 0 {
            self.switch(time, 5e-3, self.every_s);
        }
        self.tick = Some(tick);
        if self.on { asked * (1.0 - self.size) } else { asked }
    }
}
