//! What no catalogue of effects has: faults that come and go, that jump, or that are there all the time. A diagnosis must not rename them.

use std::f64::consts::TAU;

use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng};
use rand_distr::{Exp, StandardNormal};

/// Kinds of faults; `size` in [`Fault`] is in the unit given here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The gauge bridge jumps between two states at random (m).
    Telegraph,
    /// The reading freezes for a while, again and again (fraction of the time).
    Freeze,
    /// The reading falls towards zero for some milliseconds (fraction of the reading).
    Dropout,
    /// The gauge's gain flips between two values at random times (relative).
    GainFlip,
    /// A tone whose frequency wanders over the band and beyond (m).
    Interference,
    /// The dead time of the command wanders (s).
    DeadTime,
    /// Knocks: random impulses that ring (N).
    Knocks,
    /// The noise swells now and then (m rms).
    NoiseBursts,
    /// The floor shakes: random force below 30 Hz (N).
    Vibration,
    /// One bit of the converter is stuck (m of the bit).
    StuckBit,
    /// The amplifier collapses for some milliseconds now and then (fraction of the voltage).
    Brownout,
    /// The guide catches at random and lets go again (N).
    Catching,
    /// A pump on the same table shakes the stage at one frequency (N).
    Pump,
    /// The gauge follows the stage with play (m).
    Play,
    /// The conditioner warms up, its gain creeps to another value (relative).
    Warming,
    /// The command arrives in coarse steps: lower bits of the converter are lost (V).
    CoarseDrive,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 16] = [
        Self::Telegraph,
        Self::Freeze,
        Self::Dropout,
        Self::GainFlip,
        Self::Interference,
        Self::DeadTime,
        Self::Knocks,
        Self::NoiseBursts,
        Self::Vibration,
        Self::StuckBit,
        Self::Brownout,
        Self::Catching,
        Self::Pump,
        Self::Play,
        Self::Warming,
        Self::CoarseDrive,
    ];

    /// Name, for the key.
    pub fn name(self) -> &'static str {
        match self {
            Self::Telegraph => "telegraph-gauge",
            Self::Freeze => "frozen-reading",
            Self::Dropout => "dropouts",
            Self::GainFlip => "gain-flips",
            Self::Interference => "wandering-interference",
            Self::DeadTime => "wandering-dead-time",
            Self::Knocks => "knocks",
            Self::NoiseBursts => "noise-bursts",
            Self::Vibration => "floor-vibration",
            Self::StuckBit => "stuck-bit",
            Self::Brownout => "brownouts",
            Self::Catching => "catching-guide",
            Self::Pump => "pump",
            Self::Play => "play",
            Self::Warming => "warming",
            Self::CoarseDrive => "coarse-drive",
        }
    }

    /// Where it sits, in the contract's words.
    pub fn stage(self) -> &'static str {
        match self {
            Self::DeadTime | Self::CoarseDrive => "drive",
            Self::Brownout => "amplifier",
            Self::Catching => "mechanism",
            Self::Knocks | Self::Vibration | Self::Pump => "environment",
            _ => "sensor",
        }
    }

    /// A size in the kind's unit.
    pub fn draw(self, rng: &mut impl Rng) -> f64 {
        let (low, high): (f64, f64) = match self {
            Self::Telegraph => (1e-8, 2e-7),
            Self::Freeze => (0.02, 0.3),
            Self::Dropout => (0.05, 1.0),
            Self::GainFlip => (2e-3, 5e-2),
            Self::Interference => (1e-8, 1e-7),
            Self::DeadTime => (1e-4, 1e-3),
            Self::Knocks => (1.0, 30.0),
            Self::NoiseBursts => (1e-8, 1e-7),
            Self::Vibration => (0.3, 8.0),
            Self::StuckBit => (3e-8, 3e-7),
            Self::Brownout => (0.05, 0.5),
            Self::Catching => (5.0, 60.0),
            Self::Pump => (0.3, 15.0),
            Self::Play => (2e-8, 3e-7),
            Self::Warming => (2e-3, 3e-2),
            Self::CoarseDrive => (0.1, 2.0),
        };
        (rng.random_range(low.ln()..high.ln())).exp()
    }
}

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
    rng: Xoshiro256PlusPlus,
    on: bool,
    until_s: f64,
    value: f64,
    speed: f64,
    phase: f64,
    tick: Option<usize>,
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

    /// What the gauge's reading becomes.
    pub fn reading(&mut self, tick: usize, time: f64, reading: f64) -> f64 {
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

    /// What the amplifier is asked for.
    pub fn drive(&mut self, tick: usize, time: f64, asked: f64) -> f64 {
        match self.kind {
            Kind::CoarseDrive => return (asked / self.size).round() * self.size,
            Kind::Brownout => {}
            _ => return asked,
        }
        // Called several times a tick; the dice are thrown once.
        if self.tick != Some(tick) || tick == 0 {
            self.switch(time, 5e-3, self.every_s);
        }
        self.tick = Some(tick);
        if self.on { asked * (1.0 - self.size) } else { asked }
    }
}
