//! How many instructions a block has, decoded once for each block.

use std::cell::Cell;

use super::image::{FLASH, is_wide};
use super::memory::Memory;
use super::{CCM, SRAM};

/// Instruction counts of blocks by their addresses.
pub(super) struct Lengths {
    regions: [Region; 3],
}

struct Region {
    base: u32,
    memory: Memory,
    /// For each half-word that a block was seen to begin at: its half-words and its instructions, a byte each.
    known: Vec<Cell<u16>>,
}

/// In which region an address can lie, by its top four bits: flash, CCM, SRAM. Others are refused by their offset.
fn slot(address: u32) -> usize {
    (address >> 28).min(2) as usize
}

impl Lengths {
    pub(super) fn new(flash: &Memory, ccm: &Memory, sram: &Memory) -> Lengths {
        let region = |base: u32, memory: &Memory| Region {
            base,
            memory: memory.clone(),
            known: vec![Cell::new(0); memory.len() / 2],
        };
        Lengths { regions: [region(FLASH, flash), region(CCM, ccm), region(SRAM, sram)] }
    }

    /// Other code may be in RAM from now on.
    pub(super) fn forget_ram(&self) {
        for region in &self.regions[1..] {
            region.known.iter().for_each(|k| k.set(0));
        }
    }

    /// Instructions of a block that was counted before.
    #[inline]
    pub(super) fn known(&self, address: u32, size: u32) -> Option<u64> {
        let region = &self.regions[slot(address)];
        let known = region.known.get((address.wrapping_sub(region.base) / 2) as usize)?.get();
        (u32::from(known >> 8) * 2 == size).then_some(u64::from(known & 0xff))
    }

    /// Instructions of a block.
    pub(super) fn count(&self, address: u32, size: u32) -> u64 {
        self.known(address, size).unwrap_or_else(|| self.decode(address, size))
    }

    fn decode(&self, address: u32, size: u32) -> u64 {
        let region = &self.regions[slot(address)];
        let start = address.wrapping_sub(region.base) as usize;
        if start >= region.memory.len() {
            return u64::from(size / 2);
        }
        let end = (start + size as usize).min(region.memory.len());
        let (mut at, mut n) = (start, 0u64);
        while at < end {
            at += if is_wide(region.memory.u16(at)) { 4 } else { 2 };
            n += 1;
        }
        // A longer block is counted anew each time.
        if let (Ok(halfwords), Ok(n)) = (u8::try_from(size / 2), u8::try_from(n)) {
            region.known[start / 2].set(u16::from_be_bytes([halfwords, n]));
        }
        n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_counted_once_and_again_after_a_change() {
        let (flash, ccm, sram) = (Memory::new(4096), Memory::new(4096), Memory::new(4096));
        let lengths = Lengths::new(&flash, &ccm, &sram);
        // nop; movw r0, #0; nop
        for (i, h) in [0xbf00, 0xf240, 0x0000, 0xbf00].into_iter().enumerate() {
            ccm.set_u16(0x100 + 2 * i, h);
        }
        let at = CCM + 0x100;
        assert_eq!(lengths.known(at, 8), None);
        assert_eq!(lengths.count(at, 8), 3);
        assert_eq!(lengths.known(at, 8), Some(3));
        assert_eq!(lengths.known(at, 6), None, "a shorter block from the same address");
        lengths.forget_ram();
        assert_eq!(lengths.known(at, 8), None);
        for nowhere in [0, 0x1fff_0000, 0x2100_0000, 0x4000_0000, 0xf000_0000] {
            assert_eq!(lengths.known(nowhere, 8), None, "{nowhere:#x}");
            assert_eq!(lengths.count(nowhere, 8), 4);
        }
    }
}
