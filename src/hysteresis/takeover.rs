//! Another model in motion: its slip elements are found anew from those of the old one.

use super::{HysteresisState, Maxwell};
use crate::units::{Gain, MicroCoulomb, Volt, Wide};

/// What of the new elements' line is known, while they are fitted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fitted {
    /// Elements that are fitted: the first ones.
    elements: usize,
    /// Of these, the first ones that are at their limits, and slip.
    slipping: usize,
    /// Sum of the elastances of those that stick, and of all.
    slope: Gain<MicroCoulomb, Volt>,
    stiffest: Gain<MicroCoulomb, Volt>,
    /// Of all of them.
    voltage: Wide<Volt>,
    /// Limit and elastic charge of the last one.
    slip: i32,
    elastic: i32,
}

impl Fitted {
    pub(super) const NONE: Self = Self {
        elements: 0,
        slipping: 0,
        slope: Gain::ZERO,
        stiffest: Gain::ZERO,
        voltage: Wide::ZERO,
        slip: 0,
        elastic: 0,
    };
}

/// Elements that are fitted in one tick.
pub(super) const FIT_AT_ONCE: usize = 2;

impl HysteresisState {
    /// The model has changed, and with it the charge of the present instant: until [`HysteresisState::take_over`] the voltage goes on
    /// along its line, from `charge`.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn carry(&mut self, charge: MicroCoulomb) {
        let (before, from) = match self.carried {
            None => (self.unmirrored(self.last), self.unmirrored(self.last)),
            Some([before, from]) => {
                self.forget_fitted(from);
                (before, from)
            }
        };
        self.offset = self.offset + self.slope * from - self.slope * charge;
        self.carried = Some([before, charge]);
        self.fitted = Fitted::NONE;
    }

    /// The next model comes before this one has taken over: what is fitted is elastic charges again.
    #[inline(always)]
    fn forget_fitted(&mut self, charge: MicroCoulomb) {
        let Fitted { elements, slipping, .. } = self.fitted;
        let falling = self.falling;
        if let Some(sticking) = self.places.get_mut(slipping..elements) {
            for place in sticking {
                *place = ahead(charge - *place, falling);
            }
        }
        self.slipping = self.slipping.max(elements);
        self.known = self.known.max(elements);
    }

    /// A part of taking over: the next elements of the new model stand as far from the charge as those of the old one did when
    /// [`HysteresisState::carry`] was called, as far as they may. Whether all did already: then [`HysteresisState::take_over`] comes.
    ///
    /// Few at a time, and of one axis a tick: all of them would cost as much again as two thirds of a tick.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn fit(&mut self, elements: &[Maxwell]) -> bool {
        let Some([before, charge]) = self.carried else { return true };
        let first = self.fitted.elements;
        let (Some(places), Some(next)) = (self.places.get_mut(first..), elements.get(first..))
        else {
            return true;
        };
        if next.is_empty() {
            return true;
        }
        let mut fitted = self.fitted;
        for (place, element) in places.iter_mut().zip(next).take(FIT_AT_ONCE) {
            let n = fitted.elements;
            let old = if n < self.slipping {
                ahead(*place, self.falling)
            } else if n < self.known {
                before - *place
            } else {
                MicroCoulomb::ZERO
            };
            // New limits may be narrower, or wider apart than the order of slipping allows.
            let slip = element.slip().to_bits();
            let room = slip.wrapping_sub(fitted.slip);
            // Sums of two numbers within +-500 uC do not wrap.
            let low = MicroCoulomb::from_bits(fitted.elastic.wrapping_sub(room));
            let high = MicroCoulomb::from_bits(fitted.elastic.wrapping_add(room));
            let elastic = old.limit(low, high);
            fitted.stiffest = fitted.stiffest + element.elastance();
            fitted.voltage = fitted.voltage + element.elastance() * elastic;
            // Those at their limits in the direction of the motion, which are the first ones, slip; all others stick.
            *place = if n == fitted.slipping && ahead(elastic, self.falling) == element.slip() {
                fitted.slipping += 1;
                element.slip()
            } else {
                fitted.slope = fitted.slope + element.elastance();
                charge - elastic
            };
            (fitted.slip, fitted.elastic) = (slip, elastic.to_bits());
            fitted.elements += 1;
        }
        self.fitted = fitted;
        false
    }

    /// The rest of it: the line is that of the new elements. Returns by how much the voltage is another one at the charge of
    /// [`HysteresisState::carry`].
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn take_over(&mut self, elements: &[Maxwell]) -> Volt {
        let Some([_, charge]) = self.carried.take() else { return Volt::ZERO };
        let old = (self.slope * charge + self.offset).narrow();
        let Fitted { slipping, slope, stiffest, voltage, .. } = self.fitted;
        (self.slope, self.stiffest, self.offset) = (slope, stiffest, voltage - slope * charge);
        self.last = self.mirrored(charge);
        (self.slipping, self.known) = (slipping, elements.len());
        self.find_end(elements);
        voltage.narrow() - old
    }
}

/// An elastic charge, within +-500 uC, counted in the direction of the motion, and back.
#[inline(always)]
const fn ahead(elastic: MicroCoulomb, falling: i32) -> MicroCoulomb {
    MicroCoulomb::from_bits((elastic.to_bits() ^ falling).wrapping_sub(falling))
}
