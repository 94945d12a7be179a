//! Feedback: proportional, integral and filtered derivative action, then notches.
//!
//! The derivative acts on `weight * reference - position` through a first-order low-pass filter; references are continuous, so
//! there is no kick. The integral is a 64-bit sum that stops growing in the direction in which the drive was cut in the tick
//! before, by voltage or slew limit (conditional integration), and is clamped besides.

use heapless::Vec;

use crate::MAX_NOTCH;
use crate::filter::{Notch, NotchState};
use crate::units::{Gain, Um, Volt, Wide};

/// Coefficients of one axis.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Feedback {
    pub(crate) proportional: Gain<Um, Volt>,
    /// Per tick.
    pub(crate) integral: Gain<Um, Volt>,
    /// Per tick, times (1 - pole).
    pub(crate) derivative: Gain<Um, Volt>,
    pub(crate) derivative_pole: Gain<Volt, Volt>,
    pub(crate) setpoint_weight: Gain<Um, Um>,
    pub(crate) integral_limit: Volt,
    /// In ticks.
    pub(crate) sensor_delay: Gain<Um, Um>,
    pub(crate) notches: Vec<Notch, MAX_NOTCH>,
}

/// Memory of one axis.
#[derive(Clone, Copy, Debug)]
pub struct FeedbackState {
    integral: Wide<Volt>,
    derivative: Volt,
    weighted: Um,
    notches: [NotchState; MAX_NOTCH],
}

impl FeedbackState {
    /// Nothing yet.
    pub const REST: Self = Self {
        integral: Wide::ZERO,
        derivative: Volt::ZERO,
        weighted: Um::ZERO,
        notches: [NotchState::REST; MAX_NOTCH],
    };

    /// As [`FeedbackState::REST`], in place.
    #[inline(always)]
    pub(crate) fn reset(&mut self) {
        (self.integral, self.derivative, self.weighted) = (Wide::ZERO, Volt::ZERO, Um::ZERO);
        crate::math::fill(&mut self.notches, NotchState::REST);
    }
}

impl Feedback {
    /// One tick. `excess`: what the limits took off the drive in the tick before. `rebase`: coefficients have changed, or the
    /// loop was just closed. Returns the drive and whether the integral is at its limit.
    #[inline(always)]
    pub(crate) fn step(
        &self,
        state: &mut FeedbackState,
        reference: Um,
        last_change: Um,
        position: Um,
        excess: Volt,
        rebase: bool,
    ) -> (Volt, bool) {
        // Where the reference was when the position was true: a straight line through the last tick.
        let reference = if self.sensor_delay.is_zero() {
            reference
        } else {
            reference - (self.sensor_delay * last_change).narrow()
        };
        let error = reference - position;

        let mut at_limit = false;
        // A gain of zero keeps the sum that it has: exchanging it must not make a step. The limit acts when it grows again.
        if !self.integral.is_zero() {
            let growth = self.integral * error;
            let blocked = (growth.to_bits() > 0 && excess > Volt::ZERO)
                || (growth.to_bits() < 0 && excess < Volt::ZERO);
            let sum = if blocked { state.integral } else { state.integral + growth };
            state.integral = sum.limit(self.integral_limit);
            at_limit = sum.to_bits() != state.integral.to_bits();
        }

        if !self.derivative.is_zero() || state.derivative != Volt::ZERO {
            let weighted = (self.setpoint_weight * reference).narrow() - position;
            if rebase {
                state.weighted = weighted;
            }
            let change = weighted - state.weighted;
            state.weighted = weighted;
            state.derivative =
                (self.derivative_pole * state.derivative + self.derivative * change).narrow();
        }

        let mut sum = (self.proportional * error + state.integral).narrow() + state.derivative;
        for (notch, memory) in self.notches.iter().zip(state.notches.iter_mut()) {
            if rebase {
                memory.settle(sum);
            }
            sum = notch.step(memory, sum);
        }
        (sum, at_limit)
    }
}
