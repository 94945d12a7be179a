//! Physics of a healthy rig that no catalogue has: drag, stops, supplies, heat, conditioners, converters and output stages.

use std::f64::consts::{PI, TAU};

use rand::RngExt;
use rand_distr::StandardNormal;

use super::{Fault, Kind};

/// Speed at which the drag of a fluid is given (m/s).
const DRAG_AT_M_PER_S: f64 = 1e-3;
/// Rms speed of 100 V at 100 Hz (m/s), at which heat is given.
const HEAT_AT_M_PER_S: f64 = 2.2e-3;
/// Current at which a supply's sag is given (A).
const SAG_AT_A: f64 = 0.1;
/// Fastest reading of a conditioner of size zero (m/s).
const SLEW_M_PER_S: f64 = 0.1;
/// Displacement at which a tilt is given (m).
const TILT_AT_M: f64 = 1e-5;
/// Voltage over which a drive bends (V).
const BENT_OVER_V: f64 = 100.0;
/// Ways in which it does: see [`bent`].
const BENDS: f64 = 3.0;

/// What a kind has beside its size, from a share of 0 to 1: critical speed (m/s) of a brake, place (m) of a stop, way in which a drive bends,
/// time constant (s) of the others.
pub(super) fn drawn(kind: Kind, share: f64) -> f64 {
    let between = |low: f64, high: f64| low * (high / low).powf(share);
    match kind {
        Kind::Brake => between(5e-4, 2e-2),
        Kind::EndStop => between(4e-6, 8e-6),
        Kind::SupplySag => between(5e-3, 0.1),
        Kind::SelfHeating => between(4.0, 60.0),
        Kind::DriveBend => BENDS * share,
        Kind::DriveTail => between(5e-3, 2.0),
        _ => between(0.5, 30.0),
    }
}

impl Fault {
    /// Time since this was last asked, at most an hour; nothing the first time.
    fn elapsed_s(&mut self, time: f64) -> f64 {
        let last = self.asked_s.replace(time);
        last.map_or(0.0, |last| (time - last).clamp(0.0, 3600.0))
    }

    /// Drag (N s/m) on a stage that moves at `speed` (m/s).
    pub fn drag(&self, speed: f64) -> f64 {
        match self.kind {
            Kind::Brake => {
                2.0 * self.size / self.constant / (1.0 + (speed / self.constant).powi(2))
            }
            Kind::FluidDrag => self.size * speed.abs() / DRAG_AT_M_PER_S.powi(2),
            _ => 0.0,
        }
    }

    /// Stiffness (N/m) of a stop that a stage at `position` (m) touches, and where it begins (m).
    pub fn stop(&self, position: f64) -> (f64, f64) {
        let touches = self.kind == Kind::EndStop && position > self.constant;
        if touches { (self.size, self.constant) } else { (0.0, 0.0) }
    }

    /// What a healthy conditioner makes of a `reading` (m); `seen` are the displacements (m) of all axes.
    pub(super) fn conditioned(&mut self, time: f64, reading: f64, seen: &[f64]) -> f64 {
        let dt = self.elapsed_s(time);
        let relax = -(-dt / self.constant).exp_m1();
        let speed = if dt > 0.0 { (reading - self.last) / dt } else { 0.0 };
        self.last = reading;
        match self.kind {
            Kind::SelfHeating => {
                let power = (speed / HEAT_AT_M_PER_S).powi(2);
                self.value += (power - self.value) * relax;
                reading + self.size * self.value
            }
            Kind::HighPass => {
                self.value += (reading - self.value) * relax;
                reading - self.size * self.value
            }
            Kind::SlewLimit => {
                let most = SLEW_M_PER_S / (1.0 + self.size) * dt;
                self.value += (reading - self.value).clamp(-most, most);
                self.value
            }
            Kind::Tilt => {
                let other = seen[(self.axis + 1) % seen.len()] / TILT_AT_M;
                reading + self.size * other * seen[self.axis] / TILT_AT_M
            }
            Kind::Jitter => reading + speed * self.size * self.rng.sample::<f64, _>(StandardNormal),
            _ => reading,
        }
    }

    /// What a healthy amplifier is asked for by a command of `asked` (V) while it gives `current` (A).
    pub(super) fn supplied(&mut self, time: f64, asked: f64, current: f64) -> f64 {
        match self.kind {
            Kind::SupplySag => {
                let relax = -(-self.elapsed_s(time) / self.constant).exp_m1();
                self.value += (current.abs() / SAG_AT_A - self.value) * relax;
                asked * (1.0 - self.size * self.value).max(0.0)
            }
            Kind::DeadBand => {
                if (asked - self.value).abs() > self.size {
                    self.value = asked;
                }
                self.value
            }
            Kind::DriveBend => bent(asked, self.size, self.constant),
            Kind::DriveTail => {
                let relax = -(-self.elapsed_s(time) / self.constant).exp_m1();
                self.value += (asked - self.value) * relax;
                asked + self.size * (self.value - asked)
            }
            _ => asked,
        }
    }
}

/// A voltage (V) off its line by up to `size` (V): the whole part of `way` tells how, what is behind its point where.
fn bent(asked: f64, size: f64, way: f64) -> f64 {
    let u = asked / BENT_OVER_V;
    let place = way.fract();
    let off = match way as u32 {
        0 => (PI * u).sin() * (1.0 + (place - 0.5) * u),
        1 => (TAU * u * (0.7 + 0.6 * place)).sin(),
        _ => {
            // Half a hyperbola: an output stage that takes over from another one.
            let (corner, width) = (0.2 + 0.6 * place, 0.005);
            let beyond = u - corner;
            0.5 * (beyond + beyond.hypot(width)) / (1.0 - corner)
        }
    };
    asked + size * off
}
