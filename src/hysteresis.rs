//! Hysteresis of a piezo stack: the generalized Maxwell slip model of Goldfarb and Celanovic, as a function of charge.
//!
//! M. Goldfarb, N. Celanovic, "Modeling piezoelectric stack actuators for control of micromanipulation", IEEE Control
//! Systems 17(3), 1997. Each element is a spring that slips at a limit; here in electrical terms a capacitance with a
//! voltage limit: v_i = (q - b_i) / C_i, |v_i| <= limit_i. The state kept is the elastic charge e_i = q - b_i, clamped to
//! +-C_i limit_i, so that a tick is one saturating addition, one clamp and one multiply-accumulate an element.

use crate::MAX_MAXWELL;
use crate::units::{Gain, MicroCoulomb, Volt, Wide};

/// One slip element: volts per microcoulomb below slip, and the charge at which it slips.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Maxwell {
    pub(crate) elastance: Gain<MicroCoulomb, Volt>,
    pub(crate) slip: MicroCoulomb,
}

/// Elastic charges of all elements.
#[derive(Clone, Copy, Debug)]
pub struct HysteresisState {
    elastic: [MicroCoulomb; MAX_MAXWELL],
    charge: MicroCoulomb,
}

impl HysteresisState {
    /// Relaxed: a stack that was never driven, or was demagnetised, holding `charge`.
    pub const fn relaxed(charge: MicroCoulomb) -> Self {
        Self { elastic: [MicroCoulomb::ZERO; MAX_MAXWELL], charge }
    }
    /// As [`HysteresisState::relaxed`], in place.
    #[inline(always)]
    pub fn reset(&mut self, charge: MicroCoulomb) {
        crate::math::fill(&mut self.elastic, MicroCoulomb::ZERO);
        self.charge = charge;
    }
    /// Take `charge` as the present one without slipping any element.
    #[inline(always)]
    pub fn rebase(&mut self, charge: MicroCoulomb) {
        self.charge = charge;
    }
    /// Move the charge and return the hysteresis voltage.
    #[inline(always)]
    pub fn step(&mut self, elements: &[Maxwell], charge: MicroCoulomb) -> Volt {
        let change = charge - self.charge;
        self.charge = charge;
        // |elastance * elastic| <= limit_i, and a configuration's limits sum to less than 512 V: exact, no wrap.
        let mut sum = Wide::ZERO;
        for (elastic, element) in self.elastic.iter_mut().zip(elements) {
            *elastic = (*elastic + change).limit(-element.slip, element.slip);
            sum = sum + element.elastance * *elastic;
        }
        sum.narrow()
    }
}
