//! Maxwell slip model of a stack's hysteresis: rate-independent, in charge.
//!
//! M. Goldfarb and N. Celanovic, "Modeling piezoelectric stack actuators for control of micromanipulation", IEEE Control
//! Systems 17(3), 1997. Each element is a spring that slips at a limit; here in electrical terms a capacitance with a
//! voltage limit: v_i = (q - b_i) / C_i, |v_i| <= limit_i, with an origin b_i that is dragged along while it slips.
//!
//! A tick does not visit the elements. Between two turning points the voltage of all of them is one straight line in the charge,
//! until the next one slips: those that slip add their limits, those that stick their slope. With the elements in the order of
//! the charges at which they slip, they slip in this order on every branch (|e_i - e_j| <= |slip_i - slip_j| holds from the
//! relaxed state on, for e_i = q - b_i, and no motion breaks it). So the state is the line, the charge where it
//! ends, and the number of elements that slip; a turning point makes these stick again. In integers this is the
//! clamp of every element in every tick, to the bit.

use crate::MAX_MAXWELL;
use crate::units::{Gain, MicroCoulomb, Volt, Wide};

/// One slip element: volts per microcoulomb below slip, and the charge at which it slips. A model holds them in the order of
/// that charge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Maxwell {
    pub(crate) elastance: Gain<MicroCoulomb, Volt>,
    pub(crate) slip: MicroCoulomb,
}

/// Where the elements stand.
#[derive(Clone, Copy, Debug)]
pub struct HysteresisState {
    charge: MicroCoulomb,
    is_rising: bool,
    /// Elements that slip: the first ones.
    slipping: usize,
    /// Charge at which the next one slips.
    end: MicroCoulomb,
    /// The line: voltage = slope * charge + offset.
    slope: Gain<MicroCoulomb, Volt>,
    offset: Wide<Volt>,
    /// Elastic charge e of an element that slips, origin b of one that sticks.
    places: [MicroCoulomb; MAX_MAXWELL],
    /// Elements that `places` knows; others are relaxed.
    known: usize,
}

impl HysteresisState {
    /// Relaxed: a stack that was never driven, or was demagnetised. [`HysteresisState::rebase`] comes before the first step.
    pub const RELAXED: Self = Self {
        charge: MicroCoulomb::ZERO,
        is_rising: true,
        slipping: 0,
        end: MicroCoulomb::MAX,
        slope: Gain::ZERO,
        offset: Wide::ZERO,
        places: [MicroCoulomb::ZERO; MAX_MAXWELL],
        known: 0,
    };

    /// As [`HysteresisState::RELAXED`], in place.
    #[inline(always)]
    pub fn reset(&mut self) {
        self.known = 0;
    }

    /// Takes `charge` as the present one, and `elements` as the elements, without making one slip that did not before.
    #[inline(always)]
    pub fn rebase(&mut self, elements: &[Maxwell], charge: MicroCoulomb) {
        (self.slope, self.offset) = (Gain::ZERO, Wide::ZERO);
        let (mut elastic, mut slip) = (MicroCoulomb::ZERO, MicroCoulomb::ZERO);
        for (i, (place, element)) in self.places.iter_mut().zip(elements).enumerate() {
            let stood = if i >= self.known {
                MicroCoulomb::ZERO
            } else if i < self.slipping {
                *place
            } else {
                self.charge - *place
            };
            // New limits may be narrower, or wider apart than the order of slipping allows.
            let room = element.slip - slip;
            elastic = stood.limit(elastic - room, elastic + room);
            slip = element.slip;
            *place = charge - elastic;
            self.slope = self.slope + element.elastance;
            self.offset = self.offset - element.elastance * *place;
        }
        self.charge = charge;
        self.slipping = 0;
        self.known = elements.len();
        self.look_ahead(elements);
    }

    /// Moves the charge and returns the hysteresis voltage.
    #[inline(always)]
    pub fn step(&mut self, elements: &[Maxwell], charge: MicroCoulomb) -> Volt {
        if charge != self.charge {
            if (charge > self.charge) != self.is_rising {
                self.turn(elements);
            }
            self.charge = charge;
            while if self.is_rising { charge > self.end } else { charge < self.end } {
                self.slip(elements);
            }
        }
        // |slope * charge + offset| is at most the sum of the limits, below 512 V: exact, whatever wraps on the way.
        (self.slope * charge + self.offset).narrow()
    }

    /// The charge turns: all elements stick, where they are.
    #[inline(always)]
    fn turn(&mut self, elements: &[Maxwell]) {
        self.is_rising = !self.is_rising;
        for (place, element) in self.places.iter_mut().zip(elements).take(self.slipping) {
            let elastic = *place;
            *place = self.charge - elastic;
            self.slope = self.slope + element.elastance;
            self.offset = self.offset - element.elastance * elastic - element.elastance * *place;
        }
        self.slipping = 0;
        self.look_ahead(elements);
    }

    /// The next element slips from now on.
    #[inline(always)]
    fn slip(&mut self, elements: &[Maxwell]) {
        if let (Some(place), Some(element)) =
            (self.places.get_mut(self.slipping), elements.get(self.slipping))
        {
            let origin = *place;
            *place = if self.is_rising { element.slip } else { -element.slip };
            self.slope = self.slope - element.elastance;
            self.offset = self.offset + element.elastance * origin + element.elastance * *place;
            self.slipping += 1;
        }
        self.look_ahead(elements);
    }

    /// Finds the charge at which the next element slips.
    #[inline(always)]
    fn look_ahead(&mut self, elements: &[Maxwell]) {
        self.end = match (self.places.get(self.slipping), elements.get(self.slipping)) {
            (Some(origin), Some(element)) if self.is_rising => *origin + element.slip,
            (Some(origin), Some(element)) => *origin - element.slip,
            _ if self.is_rising => MicroCoulomb::MAX,
            _ => MicroCoulomb::MIN,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// The model as the paper writes it: every element in every tick.
    struct Plain {
        elastic: Vec<MicroCoulomb>,
        charge: MicroCoulomb,
    }

    impl Plain {
        fn step(&mut self, elements: &[Maxwell], charge: MicroCoulomb) -> Volt {
            let change = charge - self.charge;
            self.charge = charge;
            let mut sum = Wide::ZERO;
            for (elastic, element) in self.elastic.iter_mut().zip(elements) {
                *elastic = (*elastic + change).limit(-element.slip, element.slip);
                sum = sum + element.elastance * *elastic;
            }
            sum.narrow()
        }
    }

    fn random(seed: &mut u64) -> u32 {
        *seed ^= *seed << 13;
        *seed ^= *seed >> 7;
        *seed ^= *seed << 17;
        (*seed >> 20) as u32
    }

    #[test]
    fn a_line_until_the_next_slip_is_the_clamp_of_every_element() {
        let mut seed = 0x1234_5678_9abc_def1;
        for round in 0..200 {
            let mut elements: Vec<Maxwell> = (0..random(&mut seed) % 17)
                .map(|_| Maxwell {
                    elastance: Gain::from_f32((random(&mut seed) % 1000) as f32 * 1e-3),
                    slip: MicroCoulomb::from_bits((random(&mut seed) % 40_000_000) as i32),
                })
                .collect();
            elements.sort_by_key(|e| e.slip);
            let mut plain =
                Plain { elastic: std::vec![MicroCoulomb::ZERO; 16], charge: MicroCoulomb::ZERO };
            let mut state = HysteresisState::RELAXED;
            state.rebase(&elements, MicroCoulomb::ZERO);
            let mut charge = 0i32;
            for n in 0..5_000 {
                // Strides from a standstill to jumps over all elements.
                let most = 1u32 << (random(&mut seed) % 27);
                let stride = (random(&mut seed) % most) as i32 - (most / 2) as i32;
                charge = (charge + stride).clamp(-400_000_000, 400_000_000);
                let q = MicroCoulomb::from_bits(charge);
                let (fast, slow) = (state.step(&elements, q), plain.step(&elements, q));
                assert_eq!(fast, slow, "round {round}, tick {n}");
            }
        }
    }

    #[test]
    fn other_elements_take_over_where_the_old_ones_stood() {
        let element = |slip_uc: f32| Maxwell {
            elastance: Gain::from_f32(0.03),
            slip: MicroCoulomb::from_f32(slip_uc),
        };
        let (three, two) =
            ([element(1.0), element(2.0), element(4.0)], [element(1.0), element(3.0)]);
        let mut state = HysteresisState::RELAXED;
        let at = MicroCoulomb::from_f32;
        state.rebase(&three, at(0.0));
        let before = state.step(&three, at(3.0)).to_f64();
        assert!((before - 0.03 * (1.0 + 2.0 + 3.0)).abs() < 1e-5);
        // Another charge for the same position, one element less.
        state.rebase(&two, at(5.0));
        let after = state.step(&two, at(5.0)).to_f64();
        assert!((after - 0.03 * (1.0 + 2.0)).abs() < 1e-5, "{after}");
        let on = state.step(&two, at(5.5)).to_f64();
        assert!((on - 0.03 * (1.0 + 2.5)).abs() < 1e-5, "{on}");
        let back = state.step(&two, at(4.5)).to_f64();
        assert!((back - 0.03 * (0.0 + 1.5)).abs() < 1e-5, "{back}");
    }
}
