//! The two settings slots in flash bank 2.
//!
//! # Design
//! RM0440 section 3.3. Code runs from bank 1, so erasing and programming bank 2 never stalls a fetch (read-while-write, section
//! 3.3.1), and every wait is a task's sleep. Slot 0 is pages 0 and 1 of bank 2, slot 1 pages 4 and 5: neighbours share no page.
//! Code is read from bank 1 while bank 2 is written, which may corrupt the data cache (erratum ES0430 2.2.2): the cache is off from before an
//! operation until after it, and reset before it is on again, which RM0440 section 3.3.4 wants after every change anyhow.
//! A double word whose programming was cut short may fail the error correction when it is read; that raises an NMI, which counts
//! it ([`crash::FLASH_ERRORS`]), and the slot reads as damaged.
//!
//! # Limits
//! Needs the factory option DBANK = 1; without it every save is refused. embassy's driver is not used because it erases inside a
//! critical section.

use core::sync::atomic::Ordering;

use embassy_stm32::pac;
use embassy_time::{Duration, Instant, Timer};

use super::crash;
use crate::store::{Memory, MemoryError, SLOT_BYTES};

/// Start of bank 2 with DBANK = 1 on 512 KiB parts.
const BANK_2: usize = 0x0804_0000;
/// Bytes of a page in dual-bank mode.
const PAGE: usize = 2_048;
const PAGES_PER_SLOT: usize = SLOT_BYTES / PAGE;
/// First page of each slot.
const FIRST_PAGE: [usize; 2] = [0, 4];
/// Longest erase of a page is 24.5 ms, of programming a double word 125 us (DS12288 table 47).
const PATIENCE: Duration = Duration::from_millis(60);

/// Bank 2, opened for writing while it exists.
pub struct Bank2(());

impl Bank2 {
    /// There is one; the caller makes one.
    pub fn new() -> Self {
        Self(())
    }

    fn address(slot: u8) -> Option<usize> {
        FIRST_PAGE.get(usize::from(slot)).map(|page| BANK_2 + page * PAGE)
    }

    fn unlock(&self) -> Result<Unlocked, MemoryError> {
        if !pac::FLASH.optr().read().dbank() || pac::FLASH.sr().read().bsy() {
            return Err(MemoryError);
        }
        if pac::FLASH.cr().read().lock() {
            // Two keys in a row (RM0440 section 3.3.5); a wrong sequence would lock until reset.
            critical_section::with(|_| {
                pac::FLASH.keyr().write_value(0x4567_0123);
                pac::FLASH.keyr().write_value(0xcdef_89ab);
            });
        }
        // Errors of the past would make every operation fail: write-1-to-clear.
        pac::FLASH.sr().write_value(pac::flash::regs::Sr(0xc3fb));
        pac::FLASH.acr().modify(|w| w.set_dcen(false));
        let unlocked = Unlocked(());
        if pac::FLASH.cr().read().lock() { Err(MemoryError) } else { Ok(unlocked) }
    }
}

/// Flash that locks itself again, and the data cache that is off meanwhile.
struct Unlocked(());

impl Unlocked {
    /// Waits for the operation, short ones by polling; whether it succeeded.
    async fn finish(&self) -> Result<(), MemoryError> {
        let start = Instant::now();
        while pac::FLASH.sr().read().bsy() {
            if start.elapsed() > PATIENCE {
                return Err(MemoryError);
            }
            Timer::after_micros(50).await;
        }
        // Everything but EOP (bit 0) and BSY (bit 16) is an error.
        if pac::FLASH.sr().read().0 & 0xc3fa != 0 { Err(MemoryError) } else { Ok(()) }
    }
}

impl Drop for Unlocked {
    fn drop(&mut self) {
        pac::FLASH.cr().write(|w| w.set_lock(true));
        // An operation that never ends leaves the cache off: slower, but right.
        if !pac::FLASH.sr().read().bsy() {
            pac::FLASH.acr().modify(|w| w.set_dcrst(true));
            pac::FLASH.acr().modify(|w| w.set_dcrst(false));
            pac::FLASH.acr().modify(|w| w.set_dcen(true));
        }
    }
}

impl Memory for Bank2 {
    fn read(&self, slot: u8) -> Result<&[u8], MemoryError> {
        let address = Self::address(slot).ok_or(MemoryError)?;
        let errors = crash::FLASH_ERRORS.load(Ordering::Relaxed);
        // Touch every double word first, so that the error correction has seen all of them before anything is believed.
        for offset in (0..SLOT_BYTES).step_by(8) {
            // SAFETY: memory-mapped flash of bank 2, aligned, inside the slot.
            unsafe { ((address + offset) as *const u32).read_volatile() };
        }
        cortex_m::asm::dsb();
        if crash::FLASH_ERRORS.load(Ordering::Relaxed) != errors {
            return Err(MemoryError);
        }
        // SAFETY: as above; writing needs `&mut self`, so the content cannot change under the slice.
        Ok(unsafe { core::slice::from_raw_parts(address as *const u8, SLOT_BYTES) })
    }

    async fn erase(&mut self, slot: u8) -> Result<(), MemoryError> {
        let first = *FIRST_PAGE.get(usize::from(slot)).ok_or(MemoryError)?;
        for page in first..first + PAGES_PER_SLOT {
            let flash = self.unlock()?;
            pac::FLASH.cr().write(|w| {
                w.set_per(true);
                w.set_bker(true);
                w.set_pnb(page as u8);
            });
            pac::FLASH.cr().modify(|w| w.set_strt(true));
            let result = flash.finish().await;
            pac::FLASH.cr().write(|w| w.set_per(false));
            result?;
        }
        Ok(())
    }

    async fn program(
        &mut self,
        slot: u8,
        offset: usize,
        bytes: [u8; 8],
    ) -> Result<(), MemoryError> {
        let address = Self::address(slot).ok_or(MemoryError)? + offset;
        if offset % 8 != 0 || offset + 8 > SLOT_BYTES {
            return Err(MemoryError);
        }
        let [a0, a1, a2, a3, b0, b1, b2, b3] = bytes;
        let flash = self.unlock()?;
        pac::FLASH.cr().write(|w| w.set_pg(true));
        // SAFETY: two words of one double word of an erased slot, in order, as RM0440 section 3.3.7 wants; the tick, the only thing
        // that may come between them, does not touch flash.
        critical_section::with(|_| unsafe {
            (address as *mut u32).write_volatile(u32::from_le_bytes([a0, a1, a2, a3]));
            cortex_m::asm::isb();
            ((address + 4) as *mut u32).write_volatile(u32::from_le_bytes([b0, b1, b2, b3]));
        });
        let result = flash.finish().await;
        pac::FLASH.cr().write(|w| w.set_pg(false));
        result
    }
}
