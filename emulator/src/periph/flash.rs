//! Flash memory of a category 3 device in dual-bank mode: program, erase, ECC, power loss (RM0440 3 and 5).
//!
//! Bank 1 holds the code and is read directly by the core. Bank 2 is behind this model: 64-bit double words are
//! programmed by two 32-bit stores with PG set, once per erase; pages of 2 KiB are erased by PER, BKER, PNB, STRT.
//! A double word that a power cut left half programmed, or a page half erased, fails its ECC: reading it sets ECCD
//! and raises NMI (RM0440 3.3.2). Reading or writing bank 2 while it is busy stalls the core until it is done.
//! The data cache is not modelled, but the rules for it are checked: off from before a change until after it (erratum
//! ES0430 2.2.2), reset before it is on again, and reset only while it is off (RM0440 3.7.1).
//! Left out: fast programming, mass erase of bank 1, option bytes (OPTR reads as delivered, dual bank), protection,
//! single-bit ECC correction, wear.

use std::collections::BTreeSet;

use crate::time::{MICROSECOND, MILLISECOND, NEVER, Time};

/// Bank 2 in the memory map.
pub const BANK2: u32 = 0x0804_0000;
/// Bytes in bank 2.
pub const BANK2_BYTES: usize = 256 * 1024;
/// Bytes in a page.
pub const PAGE_BYTES: usize = 2048;
/// Programming time of a double word (DS12288 table 52, typical 81.7 us).
const PROGRAM: Time = 85 * MICROSECOND;
/// Erase time of a page (DS12288 table 52, typical 22 ms).
const ERASE: Time = 22 * MILLISECOND;

const EOP: u32 = 1;
const PROGERR: u32 = 1 << 3;
const PGAERR: u32 = 1 << 5;
const SIZERR: u32 = 1 << 6;
const PGSERR: u32 = 1 << 7;
const ERRORS: u32 = 0xc3fa;
const BSY: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
const DCEN: u32 = 1 << 10;
const DCRST: u32 = 1 << 12;

/// One change of the array, in the order they happened: power can be cut at each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// A double word at this offset in bank 2.
    Program(u32),
    /// A page of bank 2.
    Erase(u32),
}

/// Where a power cut falls within the operation it hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// Before the array changed.
    Before,
    /// Part of the bits changed, ECC is wrong.
    Torn,
    /// After the array changed, before the firmware saw it.
    After,
}

/// The flash interface and bank 2.
pub struct Flash {
    cells: Vec<u8>,
    broken: BTreeSet<u32>,
    acr: u32,
    cr: u32,
    sr: u32,
    eccr: u32,
    key_step: u8,
    latch: Option<(u32, u32)>,
    busy_until: Time,
    finishing: bool,
    /// The array changed since the data cache was reset.
    stale: bool,
    /// Everything done since power-on of the emulator.
    pub journal: Vec<(Time, Operation)>,
    /// Cut the power at operation number `.0` of the journal.
    pub cut: Option<(usize, Cut)>,
    /// The cut fell: the machine loses power now.
    pub power_lost: bool,
    /// An uncorrectable error was read: NMI.
    pub nmi: bool,
    /// Rules broken, for the report.
    pub violations: Vec<String>,
    noise: u64,
}

impl Default for Flash {
    fn default() -> Self {
        Flash {
            cells: vec![0xff; BANK2_BYTES],
            broken: BTreeSet::new(),
            acr: 0x0600,
            cr: LOCK | 1 << 30,
            sr: 0,
            eccr: 0,
            key_step: 0,
            latch: None,
            busy_until: 0,
            finishing: false,
            stale: false,
            journal: Vec::new(),
            cut: None,
            power_lost: false,
            nmi: false,
            violations: Vec::new(),
            noise: 0x9e37_79b9_7f4a_7c15,
        }
    }
}

impl Flash {
    /// A reset of the chip: registers go to their reset values, the array keeps what it has.
    pub fn reset(&mut self) {
        let kept = Flash {
            cells: std::mem::take(&mut self.cells),
            broken: std::mem::take(&mut self.broken),
            journal: std::mem::take(&mut self.journal),
            violations: std::mem::take(&mut self.violations),
            noise: self.noise,
            ..Default::default()
        };
        *self = kept;
    }

    /// The bytes of bank 2, for tests and for `--flash` files.
    pub fn bytes(&self) -> &[u8] {
        &self.cells
    }

    /// Replaces bytes of bank 2 behind the firmware's back (corruption, an older firmware's configuration).
    pub fn overwrite(&mut self, offset: usize, bytes: &[u8]) {
        self.cells[offset..offset + bytes.len()].copy_from_slice(bytes);
    }

    /// Marks the double word at `offset` as failing its ECC.
    pub fn break_ecc(&mut self, offset: usize) {
        self.broken.insert(offset as u32 & !7);
    }

    /// Seeds the pattern that torn operations leave.
    pub fn seed(&mut self, seed: u64) {
        self.noise = seed | 1;
    }

    /// Wait states programmed (ACR.LATENCY).
    pub fn latency(&self) -> u32 {
        self.acr & 15
    }

    fn random(&mut self) -> u64 {
        // xorshift64*: only has to be reproducible.
        self.noise ^= self.noise >> 12;
        self.noise ^= self.noise << 25;
        self.noise ^= self.noise >> 27;
        self.noise.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// How long an access to bank 2 has to wait.
    pub fn stall(&self, now: Time) -> Time {
        self.busy_until.saturating_sub(now)
    }

    /// Reads `size` bytes of bank 2.
    pub fn load(&mut self, offset: u32, size: usize) -> u32 {
        if self.broken.contains(&(offset & !7)) {
            // Flags of the first error stay until cleared; address in words, bank 2.
            if self.eccr & 1 << 31 == 0 {
                self.eccr = self.eccr & 1 << 24 | 1 << 31 | 1 << 21 | (offset >> 3) & 0x7_ffff;
            }
            self.nmi = true;
        }
        let at = offset as usize;
        (0..size).fold(0, |v, k| v | (self.cells[at + k] as u32) << (8 * k))
    }

    /// A store to bank 2.
    pub fn store(&mut self, offset: u32, size: usize, value: u32, now: Time) {
        if self.cr & LOCK != 0 || self.cr & 1 == 0 {
            self.error(PGSERR, format!("store to flash offset {offset:#x} without PG"));
        } else if size != 4 {
            self.error(
                SIZERR,
                format!("{size}-byte store to flash offset {offset:#x}, expected two words"),
            );
        } else if self.sr & ERRORS != 0 {
            self.error(PGSERR, format!("store to flash offset {offset:#x} with error flags set"));
        } else {
            match self.latch.take() {
                None if offset & 7 == 0 => self.latch = Some((offset, value)),
                Some((at, low)) if offset == at + 4 => {
                    self.program(at, low as u64 | (value as u64) << 32, now)
                }
                _ => self.error(
                    PGAERR,
                    format!(
                        "store to flash offset {offset:#x} is not the second half of a double word"
                    ),
                ),
            }
        }
    }

    fn error(&mut self, flag: u32, what: String) {
        self.latch = None;
        self.sr |= flag;
        self.violations.push(what);
    }

    fn program(&mut self, at: u32, value: u64, now: Time) {
        let old = u64::from_le_bytes(
            self.cells[at as usize..at as usize + 8].try_into().expect("8 bytes"),
        );
        if (old != u64::MAX && value != 0) || self.broken.contains(&at) {
            return self.error(
                PROGERR,
                format!("double word {at:#x} is programmed twice without an erase"),
            );
        }
        let cut = self.begin(Operation::Program(at), now, PROGRAM);
        match cut {
            Some(Cut::Before) => {}
            Some(Cut::Torn) => {
                let kept = self.random();
                self.set_word(at, value | !value & kept & old);
                self.broken.insert(at);
            }
            _ => self.set_word(at, value),
        }
    }

    fn set_word(&mut self, at: u32, value: u64) {
        self.cells[at as usize..at as usize + 8].copy_from_slice(&value.to_le_bytes());
    }

    fn erase(&mut self, now: Time) {
        if self.cr >> 11 & 1 == 0 {
            return self.error(PGSERR, "erase of bank 1, where the code is".into());
        }
        let page = self.cr >> 3 & 0x7f;
        let start = page * PAGE_BYTES as u32;
        let cut = self.begin(Operation::Erase(page), now, ERASE);
        for at in (start..start + PAGE_BYTES as u32).step_by(8) {
            match cut {
                Some(Cut::Before) => {}
                Some(Cut::Torn) => {
                    let old = u64::from_le_bytes(
                        self.cells[at as usize..at as usize + 8].try_into().expect("8 bytes"),
                    );
                    let risen = self.random();
                    self.set_word(at, old | risen);
                    if old != u64::MAX {
                        self.broken.insert(at);
                    }
                }
                _ => {
                    self.set_word(at, u64::MAX);
                    self.broken.remove(&at);
                }
            }
        }
    }

    fn begin(&mut self, operation: Operation, now: Time, takes: Time) -> Option<Cut> {
        let number = self.journal.len();
        self.journal.push((now, operation));
        self.stale = true;
        if self.acr & DCEN != 0 {
            self.violations.push(format!("{operation:?} with the data cache on (ES0430 2.2.2)"));
        }
        self.busy_until = now + takes;
        self.finishing = true;
        let cut = self.cut.filter(|(n, _)| *n == number).map(|(_, c)| c);
        self.power_lost |= cut.is_some();
        cut
    }

    /// When a running operation ends.
    pub fn next_event(&self) -> Time {
        if self.finishing { self.busy_until } else { NEVER }
    }

    /// Brings the flags up to `now`.
    pub fn update(&mut self, now: Time) {
        if self.finishing && now >= self.busy_until {
            self.finishing = false;
            if self.cr & 1 << 24 != 0 {
                self.sr |= EOP;
            }
        }
    }

    /// Interrupt line.
    pub fn line(&self) -> bool {
        self.sr & EOP != 0 && self.cr & 1 << 24 != 0
            || self.sr & ERRORS != 0 && self.cr & 1 << 25 != 0
    }

    fn set_acr(&mut self, value: u32) {
        if value & DCRST != 0 {
            if (self.acr | value) & DCEN != 0 {
                self.violations.push("DCRST while the data cache is on".into());
            } else if self.finishing {
                self.violations.push("DCRST before the operation has ended".into());
            } else {
                self.stale = false;
            }
        }
        if value & DCEN != 0 && self.stale {
            self.violations.push("data cache on again, but not reset since flash changed".into());
        }
        self.acr = value;
    }

    /// Register read.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x00 => self.acr,
            0x10 => self.sr | if self.finishing { BSY } else { 0 },
            0x14 => self.cr,
            0x18 => self.eccr,
            // Delivery state: dual bank (DBANK), BOOT0 pin, hardware watchdog off.
            0x20 => 0xffef_f8aa,
            _ => 0,
        }
    }

    /// Register write.
    pub fn write(&mut self, offset: u32, value: u32, now: Time) {
        match offset {
            0x00 => self.set_acr(value),
            0x08 => {
                self.key_step = match (self.key_step, value) {
                    (0, 0x4567_0123) => 1,
                    (1, 0xcdef_89ab) => {
                        self.cr &= !LOCK;
                        0
                    }
                    // A wrong key locks the interface until the next reset.
                    _ => 2,
                };
                if self.key_step == 2 {
                    self.violations.push(format!("wrong flash key {value:#010x}"));
                }
            }
            0x10 => self.sr &= !(value & 0xffff),
            0x14 if self.cr & LOCK != 0 => {}
            0x14 => {
                self.cr = value & !(1 << 16);
                if value & 1 << 16 != 0 && value & 2 != 0 {
                    self.erase(now);
                }
                if value & 1 << 27 != 0 || value & 1 << 2 != 0 || value & 1 << 15 != 0 {
                    self.violations
                        .push(format!("FLASH_CR = {value:#010x}: mass erase or option load"));
                }
            }
            0x18 => self.eccr &= !(value & 0xf000_0000),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unlocked() -> Flash {
        let mut f = Flash::default();
        f.write(0x00, f.acr & !DCEN, 0);
        f.write(0x08, 0x4567_0123, 0);
        f.write(0x08, 0xcdef_89ab, 0);
        f
    }

    fn put(f: &mut Flash, at: u32, value: u64, now: Time) {
        f.write(0x14, 1, now);
        f.store(at, 4, value as u32, now);
        f.store(at + 4, 4, (value >> 32) as u32, now);
    }

    #[test]
    fn double_words_program_once_and_pages_erase() {
        let mut f = unlocked();
        put(&mut f, 16, 0x0123_4567_89ab_cdef, 0);
        assert_ne!(f.read(0x10) & BSY, 0);
        f.update(PROGRAM);
        assert_eq!(f.read(0x10), 0);
        assert_eq!(f.load(16, 4), 0x89ab_cdef);
        put(&mut f, 16, 1, PROGRAM);
        assert_ne!(f.read(0x10) & PROGERR, 0);
        f.write(0x10, PROGERR, 0);
        f.write(0x14, 2 | 1 << 11 | 1 << 16, PROGRAM);
        assert_eq!(f.load(16, 4), 0xffff_ffff);
        assert_eq!(f.journal.len(), 2);
    }

    #[test]
    fn misuse_is_flagged_and_locked_flash_ignores() {
        let mut f = Flash::default();
        f.write(0x14, 1, 0);
        f.store(0, 4, 0, 0);
        assert_ne!(f.read(0x10) & PGSERR, 0);
        let mut f = unlocked();
        f.write(0x14, 1, 0);
        f.store(4, 4, 0, 0);
        assert_ne!(f.read(0x10) & PGAERR, 0);
        f.write(0x10, PGAERR, 0);
        f.store(0, 2, 0, 0);
        assert_ne!(f.read(0x10) & SIZERR, 0);
        assert_eq!(f.bytes()[..8], [0xff; 8]);
    }

    #[test]
    fn the_data_cache_is_off_meanwhile_and_reset_after() {
        let mut f = unlocked();
        put(&mut f, 16, 1, 0);
        f.update(PROGRAM);
        f.write(0x00, DCRST, PROGRAM);
        f.write(0x00, 0, PROGRAM);
        f.write(0x00, DCEN, PROGRAM);
        assert!(f.violations.is_empty(), "{:?}", f.violations);
        let broken = |wrong: fn(&mut Flash)| {
            let mut f = unlocked();
            wrong(&mut f);
            f.violations.len()
        };
        let on_meanwhile = |f: &mut Flash| {
            f.write(0x00, DCEN, 0);
            put(f, 16, 1, 0);
        };
        let not_reset = |f: &mut Flash| {
            put(f, 16, 1, 0);
            f.update(PROGRAM);
            f.write(0x00, DCEN, PROGRAM);
        };
        let reset_too_soon = |f: &mut Flash| {
            put(f, 16, 1, 0);
            f.write(0x00, DCRST, 0);
        };
        let reset_while_on = |f: &mut Flash| f.write(0x00, DCEN | DCRST, 0);
        for wrong in [on_meanwhile as fn(&mut Flash), not_reset, reset_too_soon, reset_while_on] {
            assert_eq!(broken(wrong), 1);
        }
    }

    #[test]
    fn a_torn_word_breaks_its_ecc() {
        let mut f = unlocked();
        f.cut = Some((0, Cut::Torn));
        put(&mut f, 8, 0x1122_3344_5566_7788, 0);
        assert!(f.power_lost);
        f.reset();
        assert!(!f.power_lost);
        f.load(12, 4);
        assert!(f.nmi);
        assert_ne!(f.read(0x18) >> 31, 0);
        assert_eq!(f.read(0x18) & 0x7_ffff, 1);
        f.write(0x18, 1 << 31, 0);
        assert_eq!(f.read(0x18) >> 31, 0);
    }
}
