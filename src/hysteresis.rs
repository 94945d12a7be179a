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
//!
//! Where the model changes in motion, its elements have to be found anew from those of the old one. That takes several ticks, a few
//! elements each, in which the voltage goes on along its line: [`HysteresisState::carry`], [`HysteresisState::fit`] until it says that all
//! are, [`HysteresisState::take_over`].

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
    /// The charge, and the charge at which the next element slips, both [mirrored](HysteresisState::mirrored) while the charge falls:
    /// both directions are then one comparison.
    last: i32,
    end: i32,
    /// All bits set while the charge falls, none while it rises.
    falling: i32,
    /// Elements that slip: the first ones.
    slipping: usize,
    /// The line: voltage = slope * charge + offset.
    slope: Gain<MicroCoulomb, Volt>,
    offset: Wide<Volt>,
    /// The slope while all elements stick.
    stiffest: Gain<MicroCoulomb, Volt>,
    /// Elastic charge e of an element that slips, origin b of one that sticks.
    places: [MicroCoulomb; MAX_MAXWELL],
    /// Elements that `places` knows; others are relaxed.
    known: usize,
    /// Between [`HysteresisState::carry`] and [`HysteresisState::take_over`]: the charges of the old and of the new model at one and
    /// the same instant.
    carried: Option<[MicroCoulomb; 2]>,
    fitted: Fitted,
    /// It turned, or elements slipped, since this was last asked.
    followed: bool,
}

/// What of the new elements' line is known, while they are fitted.
#[derive(Clone, Copy, Debug)]
struct Fitted {
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
    const NONE: Self = Self {
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
const FIT_AT_ONCE: usize = 2;

impl HysteresisState {
    /// Relaxed: a stack that was never driven, or was demagnetised. [`HysteresisState::relax`] comes before the first step.
    pub const RELAXED: Self = Self {
        last: 0,
        end: i32::MAX,
        falling: 0,
        slipping: 0,
        slope: Gain::ZERO,
        offset: Wide::ZERO,
        stiffest: Gain::ZERO,
        places: [MicroCoulomb::ZERO; MAX_MAXWELL],
        known: 0,
        carried: None,
        fitted: Fitted::NONE,
        followed: false,
    };

    /// As [`HysteresisState::RELAXED`], in place.
    #[inline(always)]
    pub fn reset(&mut self) {
        self.known = 0;
        self.carried = None;
    }

    /// Whether there is nothing that other elements could take over.
    #[inline(always)]
    pub const fn is_relaxed(&self) -> bool {
        self.known == 0
    }

    /// Whether new elements have not taken over yet.
    #[inline(always)]
    pub const fn is_carried(&self) -> bool {
        self.carried.is_some()
    }

    /// Whether it turned, or elements slipped, since this was last asked.
    #[inline(always)]
    pub fn has_followed(&mut self) -> bool {
        core::mem::take(&mut self.followed)
    }

    /// The bits of a charge, all inverted while it falls: the order of charges is then the other way round, and nothing can
    /// overflow. What is added to a mirrored charge is added in the direction of the motion.
    #[inline(always)]
    const fn mirrored(&self, charge: MicroCoulomb) -> i32 {
        charge.to_bits() ^ self.falling
    }

    /// The charge that has these bits when it is mirrored.
    #[inline(always)]
    const fn unmirrored(&self, bits: i32) -> MicroCoulomb {
        MicroCoulomb::from_bits(bits ^ self.falling)
    }

    /// Takes `charge` as the present one, at which all of `elements` are relaxed. On the tick that closes the loop all axes come here.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn relax(&mut self, elements: &[Maxwell], charge: MicroCoulomb) {
        let mut slope = Gain::ZERO;
        for (place, element) in self.places.iter_mut().zip(elements) {
            *place = charge;
            slope = slope + element.elastance;
        }
        (self.slope, self.stiffest, self.offset) = (slope, slope, Wide::ZERO - slope * charge);
        self.last = self.mirrored(charge);
        (self.slipping, self.known) = (0, elements.len());
        self.find_end(elements);
    }

    /// The charge at which the next element slips.
    #[inline(always)]
    fn find_end(&mut self, elements: &[Maxwell]) {
        self.end = match (self.places.get(self.slipping), elements.get(self.slipping)) {
            (Some(place), Some(element)) => {
                self.mirrored(*place).saturating_add(element.slip.to_bits())
            }
            _ => i32::MAX,
        };
    }

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
        if let Some(sticking) = self.places.get_mut(slipping..elements) {
            for place in sticking {
                *place = charge - *place;
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
                *place
            } else if n < self.known {
                before - *place
            } else {
                MicroCoulomb::ZERO
            };
            // New limits may be narrower, or wider apart than the order of slipping allows.
            let slip = element.slip.to_bits();
            let room = slip.wrapping_sub(fitted.slip);
            // Sums of two numbers within +-500 uC do not wrap.
            let low = MicroCoulomb::from_bits(fitted.elastic.wrapping_sub(room));
            let high = MicroCoulomb::from_bits(fitted.elastic.wrapping_add(room));
            let elastic = old.limit(low, high);
            fitted.stiffest = fitted.stiffest + element.elastance;
            fitted.voltage = fitted.voltage + element.elastance * elastic;
            // Those at their limits in the direction of the motion, which are the first ones, slip; all others stick.
            let ahead = (elastic.to_bits() ^ self.falling).wrapping_sub(self.falling);
            *place = if n == fitted.slipping && ahead == slip {
                fitted.slipping += 1;
                elastic
            } else {
                fitted.slope = fitted.slope + element.elastance;
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

    /// Moves the charge and returns the hysteresis voltage.
    #[inline(always)]
    pub fn step(&mut self, elements: &[Maxwell], charge: MicroCoulomb) -> Volt {
        let mirrored = self.mirrored(charge);
        if mirrored < self.last || mirrored > self.end {
            self.follow(elements, charge);
        } else {
            self.last = mirrored;
        }
        // |slope * charge + offset| is at most the sum of the limits, below 512 V: exact, whatever wraps on the way.
        (self.slope * charge + self.offset).narrow()
    }

    /// The charge turns, or passes the point where an element slips.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    fn follow(&mut self, elements: &[Maxwell], charge: MicroCoulomb) {
        if self.carried.is_some() {
            return;
        }
        if self.mirrored(charge) < self.last {
            self.turn();
        }
        self.last = self.mirrored(charge);
        self.followed = true;
        self.slip(elements);
    }

    /// The charge turns: all elements stick, where they are. [`HysteresisState::slip`] comes next.
    ///
    /// An element that slips adds its elastance times its elastic charge to the offset; once it sticks it takes off its elastance
    /// times its origin, which is the charge less that. Together: the elastances that the slope gets back, times the charge.
    #[inline(always)]
    fn turn(&mut self) {
        let charge = self.unmirrored(self.last);
        self.falling = !self.falling;
        for place in self.places.iter_mut().take(self.slipping) {
            *place = charge - *place;
        }
        self.offset = self.offset - (self.stiffest - self.slope) * charge;
        self.slope = self.stiffest;
        self.slipping = 0;
    }

    /// All elements slip whose time has come; finds the charge at which the next one does.
    #[inline(always)]
    fn slip(&mut self, elements: &[Maxwell]) {
        let (mut slope, mut offset, mut slipping) = (self.slope, self.offset, self.slipping);
        let (last, falling) = (self.last, self.falling);
        // Whether there is another one is asked of each: that takes less than to find out how many there are, as few slip at once.
        let end = loop {
            let (Some(place), Some(element)) =
                (self.places.get_mut(slipping), elements.get(slipping))
            else {
                break i32::MAX;
            };
            let at = (place.to_bits() ^ falling).saturating_add(element.slip.to_bits());
            if last <= at {
                break at;
            }
            let at = MicroCoulomb::from_bits(at ^ falling);
            // Its origin no longer counts, its elastic charge does: together the charge at which it slips.
            *place = at - *place;
            slope = slope - element.elastance;
            offset = offset + element.elastance * at;
            slipping += 1;
        };
        (self.slope, self.offset, self.slipping, self.end) = (slope, offset, slipping, end);
    }
}

#[cfg(test)]
mod tests;
