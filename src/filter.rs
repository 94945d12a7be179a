//! Notch filter: one second-order section, direct form I, 64-bit accumulator, error feedback.
//!
//! Direct form I keeps only inputs and outputs as state, so coefficients can be exchanged while it runs. The rounding
//! error of each output is fed into the next one, which keeps low-frequency notches free of a dead band.
//! Design: bilinear transform of (s^2 + 2 depth zeta w s + w^2) / (s^2 + 2 zeta w s + w^2), prewarped at w.

use crate::math::sin_cos_turns;
use crate::units::{Volt, narrow};

const FRACTION: u32 = 29;

/// Coefficients in Q2.29.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Notch {
    b0: i32,
    b1: i32,
    b2: i32,
    a1: i32,
    a2: i32,
}

/// Memory of one section.
#[derive(Clone, Copy, Debug, Default)]
pub struct NotchState {
    pub(crate) x1: i32,
    pub(crate) x2: i32,
    pub(crate) y1: i32,
    pub(crate) y2: i32,
    pub(crate) error: i32,
}

impl NotchState {
    /// Nothing has passed yet.
    pub(crate) const REST: Self = Self { x1: 0, x2: 0, y1: 0, y2: 0, error: 0 };
}

impl NotchState {
    /// As after a long time at `x`: a notch passes what is constant.
    #[inline(always)]
    pub(crate) fn settle(&mut self, x: Volt) {
        let x = x.to_bits();
        (self.x1, self.x2, self.y1, self.y2, self.error) = (x, x, x, x, 0);
    }
}

impl Notch {
    /// Notch at `turns` cycles per sample (0 < turns < 0.5) with damping ratio `damping` of its poles and `depth` (0 to 1) left
    /// at the centre.
    pub(crate) fn design(turns: f32, damping: f32, depth: f32) -> Self {
        let (sin, cos) = sin_cos_turns(turns);
        let alpha = damping * sin;
        let norm = 1.0 / (1.0 + alpha);
        let q = |x: f32| (x * (1u32 << FRACTION) as f32) as i32;
        let (b0, b1, b2) =
            ((1.0 + depth * alpha) * norm, -2.0 * cos * norm, (1.0 - depth * alpha) * norm);
        let a2 = q((1.0 - alpha) * norm);
        // Rounding of single-precision numbers leaves the gain at zero frequency off by 1e-7; closing the sums in
        // integers makes it exactly one.
        let (b0, b1, b2) = (q(b0), q(b1), q(b2));
        let a1 = b0.wrapping_add(b1).wrapping_add(b2).wrapping_sub(a2).wrapping_sub(1 << FRACTION);
        Self { b0, b1, b2, a1, a2 }
    }
    /// One sample.
    #[inline(always)]
    pub fn step(&self, state: &mut NotchState, x: Volt) -> Volt {
        let x = x.to_bits();
        let product = |c: i32, v: i32| c as i64 * v as i64;
        // |b1|, |a1| <= 2 and the others <= 1: at most 7 * 2^60 in magnitude.
        let sum = (state.error as i64)
            .wrapping_add(product(self.b0, x))
            .wrapping_add(product(self.b1, state.x1))
            .wrapping_add(product(self.b2, state.x2))
            .wrapping_sub(product(self.a1, state.y1))
            .wrapping_sub(product(self.a2, state.y2));
        let y = narrow::<FRACTION>(sum);
        state.error = (sum & ((1 << FRACTION) - 1)) as i32;
        state.x2 = state.x1;
        state.x1 = x;
        state.y2 = state.y1;
        state.y1 = y;
        Volt::from_bits(y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gain_at(notch: &Notch, hz: f64) -> f64 {
        let mut state = NotchState::default();
        let mut peak = 0.0f64;
        for n in 0..20_000 {
            let x = (n as f64 * hz / 10_000.0 * std::f64::consts::TAU).sin() * 10.0;
            let y = notch.step(&mut state, Volt::from_f64(x)).to_f64();
            if n > 10_000 {
                peak = peak.max(y.abs());
            }
        }
        peak / 10.0
    }

    #[test]
    fn cuts_its_frequency_and_leaves_the_rest() {
        let notch = Notch::design(0.16, 0.2, 0.05);
        assert!((gain_at(&notch, 1_600.0) - 0.05).abs() < 0.005);
        assert!((gain_at(&notch, 10.0) - 1.0).abs() < 0.001);
        assert!((gain_at(&notch, 4_500.0) - 1.0).abs() < 0.02);
    }

    #[test]
    fn has_no_dead_band() {
        let notch = Notch::design(0.001, 0.3, 0.0);
        let mut state = NotchState::default();
        let mut y = Volt::ZERO;
        for _ in 0..100_000 {
            y = notch.step(&mut state, Volt::from_bits(1_000));
        }
        assert!((y.to_bits() - 1_000).abs() <= 1, "{}", y.to_bits());
    }
}
