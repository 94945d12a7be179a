//! The time that translated code may still take before anything is due.
//!
//! A block is the unit in which time advances, some five million of them in an emulated second, so what each of them
//! does has to be little: it adds to these two sums. [`Soc::now`](crate::periph::Soc::now) is brought up to date by
//! whoever looks at it: a register that is read or written, the end of the allowance, the end of a run.

use std::cell::Cell;

use super::Core;
use super::memory::Memory;
use super::{CCM, SRAM};
use crate::periph::Soc;
use crate::time::Time;

/// What blocks have taken since the chip last looked, and how much they may take.
#[derive(Default)]
pub(super) struct Meter {
    spent: Cell<Time>,
    instructions: Cell<u64>,
    unit: Cell<Time>,
    allowance: Cell<Time>,
}

impl Meter {
    /// Charges a block of `n` instructions; false, and nothing charged, when something is due before it.
    #[inline]
    pub(super) fn pass(&self, n: u64) -> bool {
        let spent = self.spent.get();
        if spent >= self.allowance.get() {
            return false;
        }
        self.spent.set(spent + n * self.unit.get());
        self.instructions.set(self.instructions.get() + n);
        true
    }
}

impl Core {
    /// Lets blocks pass until the next deadline; none while anything wants each of them looked at.
    #[inline]
    pub(super) fn grant(&mut self) {
        let soc = &self.soc;
        let free = !soc.attention && !self.profile.watching();
        self.meter.unit.set(soc.insn_unit);
        self.meter.allowance.set(if free { soc.deadline.saturating_sub(soc.now) } else { 0 });
    }

    /// Charges the chip with what blocks took.
    #[inline]
    pub(super) fn settle(&mut self) {
        self.soc.now += self.meter.spent.take();
        self.soc.instructions += self.meter.instructions.take();
    }

    /// Does something with the chip, in the middle of translated code.
    #[inline]
    pub(super) fn with_soc<T>(&mut self, act: impl FnOnce(&mut Soc) -> T) -> T {
        self.settle();
        let result = act(&mut self.soc);
        self.grant();
        result
    }

    /// The memory that holds all of so many bytes, and where in it they begin.
    pub(super) fn ram(&self, address: u32, bytes: usize) -> Option<(&Memory, usize)> {
        [(CCM, &self.ccm), (SRAM, &self.sram)].into_iter().find_map(|(base, memory)| {
            let offset = address.wrapping_sub(base) as usize;
            (offset < memory.len() && bytes <= memory.len() - offset).then_some((memory, offset))
        })
    }
}
