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

mod takeover;
use takeover::Fitted;

/// One slip element: volts per microcoulomb below slip (lower half of its bits), and the charge at which it slips (upper half). A model
/// holds them in the order of that charge.
///
/// One number: the compiler then steps from element to element by address, an instruction less for each than by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Maxwell(u64);

impl Maxwell {
    pub(crate) const fn new(elastance: Gain<MicroCoulomb, Volt>, slip: MicroCoulomb) -> Self {
        Self(elastance.to_bits() as u32 as u64 | (slip.to_bits() as u32 as u64) << 32)
    }

    #[inline(always)]
    const fn elastance(self) -> Gain<MicroCoulomb, Volt> {
        Gain::from_bits(self.0 as i32)
    }

    #[inline(always)]
    pub(crate) const fn slip(self) -> MicroCoulomb {
        MicroCoulomb::from_bits((self.0 >> 32) as i32)
    }
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
    /// Elastic charge e of an element that slips, in the direction of the motion: its limit; origin b of one that sticks.
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
            slope = slope + element.elastance();
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
                self.mirrored(*place).saturating_add(element.slip().to_bits())
            }
            _ => i32::MAX,
        };
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
        self.followed = true;
        if self.mirrored(charge) < self.last {
            self.turn();
        }
        self.last = self.mirrored(charge);
        if self.falling == 0 {
            self.slip::<false>(elements, charge);
        } else {
            self.slip::<true>(elements, charge);
        }
    }

    /// The charge turns: all elements stick, where they are. [`HysteresisState::slip`] comes next.
    ///
    /// An element that slips adds its elastance times its elastic charge to the offset; once it sticks it takes off its elastance
    /// times its origin, which is the charge less that. Together: the elastances that the slope gets back, times the charge.
    #[inline(always)]
    fn turn(&mut self) {
        let charge = self.unmirrored(self.last);
        let sticking = self.places.iter_mut().take(self.slipping);
        if self.falling == 0 {
            for place in sticking {
                *place = charge - *place;
            }
        } else {
            for place in sticking {
                *place = charge + *place;
            }
        }
        self.offset = self.offset - (self.stiffest - self.slope) * charge;
        self.slope = self.stiffest;
        self.slipping = 0;
        self.falling = !self.falling;
    }

    /// All elements slip whose time has come; finds the charge at which the next one does. A function for each direction: mirrored charges
    /// would take two instructions more an element.
    #[inline(always)]
    fn slip<const FALLING: bool>(&mut self, elements: &[Maxwell], charge: MicroCoulomb) {
        let (mut slope, mut offset, mut slipping) = (self.slope, self.offset, self.slipping);
        let count = elements.len().min(MAX_MAXWELL);
        let mut end = i32::MAX;
        // Whether there is another one is asked of each: that takes less than to find out how many there are, as few slip at once.
        while slipping < count
            && let (Some(place), Some(element)) =
                (self.places.get_mut(slipping), elements.get(slipping))
        {
            let slip = element.slip();
            let at = if FALLING { *place - slip } else { *place + slip };
            if if FALLING { charge >= at } else { charge <= at } {
                end = self.mirrored(at);
                break;
            }
            // Its origin no longer counts, its elastic charge does: together the charge at which it slips.
            *place = slip;
            slope = slope - element.elastance();
            offset = offset + element.elastance() * at;
            slipping += 1;
        }
        (self.slope, self.offset, self.slipping, self.end) = (slope, offset, slipping, end);
    }
}

#[cfg(test)]
mod tests;
