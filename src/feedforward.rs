//! Feedforward: the explicit inverse of amplifier, Goldfarb-Celanovic stack and mechanism.
//!
//! Wanted motion x gives the transducer voltage v_t = (m x'' + b x' + (k_p + k) x) / T, the charge q = T x + C v_t, and the drive
//! v_t + v_h(q), with v_h the Maxwell slip voltage. No solver is needed (Goldfarb and Celanovic 1997; the inverse is
//! derived in `notes/physics.md`, section 2). The stiffness term is three independent scalars, as the first paper found;
//! a cross term is there for mechanisms that are not so kind. Damping and inertia are that paper's open step towards
//! computed torque.
//!
//! The amplifier's first-order lag with a held input is v(n+1) = p v(n) + (1 - p) u(n), p = exp(-T_s / tau). Its exact inverse is
//! u(n) = v(n+1) + p / (1 - p) (v(n+1) - v(n)): the reference ahead of time makes v(n+1) known.

use heapless::Vec;

use crate::creep::{Creep, CreepState};
use crate::hysteresis::{HysteresisState, Maxwell};
use crate::trajectory::Motion;
use crate::units::{Gain, MicroCoulomb, Um, UmPer2Ticks, UmPer4Ticks2, Volt};
use crate::{MAX_CREEP, MAX_MAXWELL};

/// Coefficients of one axis.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Feedforward {
    pub(crate) origin: Um,
    /// (k_p + k) / T
    pub(crate) stiffness: Gain<Um, Volt>,
    /// b / T, and the advance of the stiffness term
    pub(crate) damping: Gain<UmPer2Ticks, Volt>,
    /// m / T, and the advance of the damping term
    pub(crate) inertia: Gain<UmPer4Ticks2, Volt>,
    /// T
    pub(crate) charge_per_um: Gain<Um, MicroCoulomb>,
    /// C
    pub(crate) charge_per_volt: Gain<Volt, MicroCoulomb>,
    /// Off-diagonal stiffness / T, from the other two axes in cyclic order.
    pub(crate) cross: [Gain<Um, Volt>; 2],
    pub(crate) is_crossed: bool,
    /// p / (1 - p)
    pub(crate) lead: Gain<Volt, Volt>,
    /// In the order of the charges at which they slip.
    pub(crate) maxwell: Vec<Maxwell, MAX_MAXWELL>,
    pub(crate) creep: Vec<Creep, MAX_CREEP>,
    /// Digest of all of these, never 0: the slip elements only have to be taken over where it changes.
    pub(crate) model: u32,
}

/// Memory of one axis.
#[derive(Clone, Copy, Debug)]
pub struct FeedforwardState {
    pub(crate) hysteresis: HysteresisState,
    pub(crate) creep: CreepState,
    stack: Volt,
    change: Volt,
    /// [`Feedforward::model`] that the slip elements stand for; 0: none.
    model: u32,
}

impl FeedforwardState {
    /// A stack that was never driven.
    pub const REST: Self = Self {
        hysteresis: HysteresisState::RELAXED,
        creep: CreepState::REST,
        stack: Volt::ZERO,
        change: Volt::ZERO,
        model: 0,
    };

    /// As [`FeedforwardState::REST`], in place.
    #[inline(always)]
    pub(crate) fn reset(&mut self) {
        self.hysteresis.reset();
        self.creep.reset();
        self.stack = Volt::ZERO;
        self.change = Volt::ZERO;
        self.model = 0;
    }
}

impl Feedforward {
    /// Drive for a motion two ticks ahead. `others`: displacements of the next two axes in cyclic order. `rebase`: coefficients
    /// have changed, take present values as the start. Slip elements, where they or their charge are other ones, wait for
    /// [`Feedforward::take_over`], unless they are relaxed.
    #[inline(always)]
    pub(crate) fn step(
        &self,
        state: &mut FeedforwardState,
        motion: Motion,
        others: [Um; 2],
        creep_slot: usize,
        rebase: bool,
    ) -> Volt {
        let wanted = motion.position - self.origin;
        let elastic = wanted - state.creep.displacement();
        if creep_slot < self.creep.len() {
            state.creep.step(&self.creep, creep_slot, elastic);
        }
        let [next, after_next] = others;
        let [cross_next, cross_after_next] = self.cross;
        let mut force = self.stiffness * elastic
            + self.damping * motion.velocity
            + self.inertia * motion.acceleration;
        if self.is_crossed {
            force = force + cross_next * next + cross_after_next * after_next;
        }
        let transducer: Volt = force.narrow();
        let mut stack = transducer;
        if !self.maxwell.is_empty() {
            let charge =
                (self.charge_per_um * elastic + self.charge_per_volt * transducer).narrow();
            if rebase && (state.model != self.model || state.hysteresis.is_carried()) {
                if state.hysteresis.is_relaxed() {
                    state.model = self.model;
                    state.hysteresis.relax(&self.maxwell, charge);
                } else {
                    state.hysteresis.carry(charge);
                }
            }
            stack += state.hysteresis.step(&self.maxwell, charge);
        }
        // With new coefficients the stack's voltage is another one; it goes on changing as before.
        let change = if rebase { state.change } else { stack - state.stack };
        state.change = change;
        state.stack = stack;
        if self.lead.is_zero() { stack } else { stack + (self.lead * change).narrow() }
    }

    /// The slip elements of a model that came into effect some ticks ago take over from the old ones, a few a tick. When all have: by
    /// how much the drive for the motion of the tick of the change is another one.
    #[inline(always)]
    pub(crate) fn take_over(&self, state: &mut FeedforwardState) -> Option<Volt> {
        if self.maxwell.is_empty() || !state.hysteresis.is_carried() {
            return Some(Volt::ZERO);
        }
        if !state.hysteresis.fit(&self.maxwell) {
            return None;
        }
        state.model = self.model;
        let change = state.hysteresis.take_over(&self.maxwell);
        // The amplifier's lead is for changes of the motion, not of the model.
        state.stack += change;
        Some(change)
    }

    /// Drive for a motion that has not changed for some ticks, and neither has anything else: as [`Feedforward::step`] would return.
    #[inline(always)]
    pub(crate) fn rest(&self, state: &FeedforwardState) -> Volt {
        state.stack
    }

    /// Whether an axis at rest has a constant drive: nothing creeps, and no other axis pushes.
    #[inline(always)]
    pub(crate) fn can_rest(&self) -> bool {
        self.creep.is_empty() && !self.is_crossed
    }

    /// Displacement from the relaxed position, before creep compensation.
    #[inline(always)]
    pub(crate) fn displacement(&self, motion: &Motion) -> Um {
        motion.position - self.origin
    }
}
