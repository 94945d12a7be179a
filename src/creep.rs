//! Creep: displacement that keeps growing for minutes after a step, as a sum of Kelvin-Voigt elements.
//!
//! x = x_elastic + sum of c_j / (1 + tau_j s) x_elastic. The compensation tracks the sum and takes it off the wanted position. A time
//! constant of 1 000 s at 10 kHz would move a 32-bit state by less than one bit a tick, so each element is updated at 100 Hz
//! and keeps 64 bits (46 of them fraction): one element of one axis a tick, so that every tick costs the same.

use crate::units::{Gain, Um, Wide};
use crate::{MAX_CREEP, TICK_HZ};

/// Ticks between two updates of an element.
pub(crate) const DIVIDER: u32 = TICK_HZ / 100;

/// One element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Creep {
    /// Final displacement per elastic displacement.
    pub(crate) gain: Gain<Um, Um>,
    /// Share of the distance to the final value covered in one update (Q0.31).
    pub(crate) rate: i32,
}

/// Displacement of every element.
#[derive(Clone, Copy, Debug)]
pub struct CreepState {
    elements: [Wide<Um>; MAX_CREEP],
    sum: Um,
}

impl CreepState {
    /// Nothing has crept.
    pub const REST: Self = Self { elements: [Wide::ZERO; MAX_CREEP], sum: Um::ZERO };

    /// As [`CreepState::REST`], in place.
    #[inline(always)]
    pub fn reset(&mut self) {
        crate::math::fill(&mut self.elements, Wide::ZERO);
        self.sum = Um::ZERO;
    }

    /// Displacement by creep.
    #[inline(always)]
    pub const fn displacement(&self) -> Um {
        self.sum
    }

    /// Update element `slot`, if there is one, for the present elastic displacement.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn step(&mut self, elements: &[Creep], slot: usize, elastic: Um) {
        if let (Some(state), Some(element)) = (self.elements.get_mut(slot), elements.get(slot)) {
            let distance = (element.gain * elastic - *state).to_bits();
            // The distance has 46 fraction bits and at most 8 integer bits: 23 bits less make room for the rate's 31.
            let change = ((distance >> 23).wrapping_mul(element.rate as i64)) >> 8;
            *state = *state + Wide::from_bits(change);
            let mut sum = Wide::ZERO;
            for state in &self.elements {
                sum = sum + *state;
            }
            self.sum = sum.narrow();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thousand_seconds_does_not_stall() {
        let element =
            Creep { gain: Gain::from_f32(0.015), rate: (1.0e-5 * 2_147_483_648.0f64) as i32 };
        let mut state = CreepState::REST;
        for _ in 0..200_000 {
            state.step(&[element], 0, Um::from_f32(10.0)); // 2 000 s
        }
        let expected = 0.15 * (1.0 - (-2.0f64).exp());
        assert!(
            (state.displacement().to_f64() - expected).abs() < 2e-5,
            "{}",
            state.displacement()
        );
    }
}
