//! RCC: clock tree, peripheral clock gates and resets, reset flags (RM0440 7).
//!
//! Oscillators and the PLL are ready as soon as they are on. A peripheral whose clock is gated reads 0 and ignores
//! writes, as the chip's do. Left out: start-up times, clock security, MCO, APB prescalers (timers and converters
//! are clocked from AHB; a prescaler other than 1 is reported as a violation), LSE and RTC.

use crate::time::{SECOND, Time};

const HSI_HZ: u64 = 16_000_000;

/// What pulled the last reset (RCC_CSR).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power-on or brown-out.
    PowerOn,
    /// NRST pin.
    Pin,
    /// SYSRESETREQ.
    Software,
    /// Independent watchdog.
    Watchdog,
}

/// The clock controller.
pub struct Rcc {
    words: [u32; 0x28],
    /// Crystal on the board.
    pub hse_hz: u64,
    /// It dies when its ready flag has been seen so often; reset or not, it stays dead.
    pub hse_dies_after: Option<u32>,
}

impl Rcc {
    /// After a reset: HSI runs, everything is gated but flash.
    pub fn new(cause: ResetCause, hse_hz: u64) -> Rcc {
        let mut words = [0; 0x28];
        words[0] = 0x500;
        words[0x08 / 4] = 1;
        words[0x0c / 4] = 0x1000;
        words[0x48 / 4] = 0x100;
        words[0x58 / 4] = 0x400;
        words[0x94 / 4] = match cause {
            ResetCause::PowerOn => 1 << 27 | 1 << 26,
            ResetCause::Pin => 1 << 26,
            ResetCause::Software => 1 << 28 | 1 << 26,
            ResetCause::Watchdog => 1 << 29 | 1 << 26,
        };
        Rcc { words, hse_hz, hse_dies_after: None }
    }

    fn word(&self, offset: u32) -> u32 {
        self.words.get(offset as usize / 4).copied().unwrap_or(0)
    }

    /// SYSCLK in Hz, `None` while the selected source does not run.
    pub fn sysclk_hz(&self) -> Option<u64> {
        let cr = self.word(0);
        let source = |select: u32| match select {
            1 | 2 if select == 1 => (cr & 1 << 8 != 0).then_some(HSI_HZ),
            2 => (cr & 1 << 16 != 0).then_some(self.hse_hz),
            _ => None,
        };
        match self.word(8) & 3 {
            3 => {
                let pll = self.word(0x0c);
                let input = match pll & 3 {
                    2 => source(1)?,
                    3 => source(2)?,
                    _ => return None,
                };
                let on = cr & 1 << 24 != 0 && pll & 1 << 24 != 0;
                let (m, n, r) = ((pll >> 4 & 15) + 1, pll >> 8 & 127, ((pll >> 25 & 3) + 1) * 2);
                on.then_some(input * n as u64 / m as u64 / r as u64)
            }
            s => source(s),
        }
    }

    /// VCO frequency, for the rule that it stays within 96 to 344 MHz (range 1 boost).
    pub fn vco_hz(&self) -> u64 {
        let pll = self.word(0x0c);
        let input = if pll & 3 == 3 { self.hse_hz } else { HSI_HZ };
        input * (pll >> 8 & 127) as u64 / ((pll >> 4 & 15) + 1) as u64
    }

    /// One AHB (and core) cycle.
    pub fn ahb_unit(&self) -> Time {
        let divide = match self.word(8) >> 4 & 15 {
            h if h < 8 => 1,
            h => [2, 4, 8, 16, 64, 128, 256, 512][h as usize - 8],
        };
        (SECOND / self.sysclk_hz().unwrap_or(HSI_HZ)) * divide
    }

    /// Whether both APB prescalers are 1, as the timers' model supposes.
    pub fn apb_undivided(&self) -> bool {
        self.word(8) >> 8 & 0x3f & 0x24 == 0
    }

    /// HSI48 runs and feeds USB (CCIPR.CLK48SEL = 0).
    pub fn usb_clocked(&self) -> bool {
        self.word(0x98) & 1 != 0 && self.word(0x88) >> 26 & 3 == 0
    }

    /// Whether the clock of the peripheral in this 1 KiB slot is on; slots without an entry always are.
    pub fn is_clocked(&self, address: u32) -> bool {
        let Some((_, _, enable, bit)) = GATES.iter().find(|g| (g.0..g.1).contains(&address)) else {
            return true;
        };
        self.word(*enable) >> bit & 1 != 0
    }

    /// Whether a crystal that is on says so.
    fn crystal_runs(&mut self) -> bool {
        if self.word(0) & 1 << 16 == 0 {
            return false;
        }
        match &mut self.hse_dies_after {
            None => true,
            Some(0) => false,
            Some(left) => {
                *left -= 1;
                true
            }
        }
    }

    /// Register read.
    pub fn read(&mut self, offset: u32) -> u32 {
        let v = self.word(offset);
        match offset {
            // HSIRDY, HSERDY, PLLRDY follow their switches.
            0x00 => {
                let crystal = if self.crystal_runs() { v & 1 << 16 } else { 0 };
                v | (v & 1 << 8) << 2 | crystal << 1 | (v & 1 << 24) << 1
            }
            0x08 => v & !0xc | (v & 3) << 2,
            // LSERDY, LSIRDY, HSI48RDY
            0x90 | 0x94 | 0x98 => v | (v & 1) << 1,
            _ => v,
        }
    }

    /// Register write; returns `(start, end)` of a peripheral whose reset line was pulled.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<(u32, u32)> {
        let value = match offset {
            // RMVF clears the reset flags, which are read-only otherwise.
            0x94 if value & 1 << 23 != 0 => value & 0x1,
            0x94 => value & 1 | self.word(0x94) & 0xfe00_0000,
            _ => value,
        };
        if let Some(w) = self.words.get_mut(offset as usize / 4) {
            *w = value;
        }
        (0x28..=0x40)
            .contains(&offset)
            .then(|| GATES.iter().find(|g| g.2 == offset + 0x20 && value >> g.3 & 1 != 0))
            .flatten()
            .map(|g| (g.0, g.1))
    }

    /// IWDG needs LSI; so does nothing else here.
    pub fn lsi_on(&mut self) {
        self.words[0x94 / 4] |= 1;
    }
}

/// `(first address, end, enable register, bit)`.
const GATES: &[(u32, u32, u32, u32)] = &[
    (0x4000_0000, 0x4000_0400, 0x58, 0),
    (0x4000_0400, 0x4000_0800, 0x58, 1),
    (0x4000_0800, 0x4000_0c00, 0x58, 2),
    (0x4000_0c00, 0x4000_1000, 0x58, 3),
    (0x4000_1000, 0x4000_1400, 0x58, 4),
    (0x4000_1400, 0x4000_1800, 0x58, 5),
    (0x4000_2000, 0x4000_2400, 0x58, 8),
    (0x4000_5c00, 0x4000_6000, 0x58, 23),
    (0x4000_7000, 0x4000_7400, 0x58, 28),
    (0x4001_0000, 0x4001_0030, 0x60, 0),
    (0x4002_0000, 0x4002_0400, 0x48, 0),
    (0x4002_0400, 0x4002_0800, 0x48, 1),
    (0x4002_0800, 0x4002_0c00, 0x48, 2),
    (0x4002_0c00, 0x4002_1000, 0x48, 3),
    (0x4002_3000, 0x4002_3400, 0x48, 12),
    (0x4800_0000, 0x4800_0400, 0x4c, 0),
    (0x4800_0400, 0x4800_0800, 0x4c, 1),
    (0x4800_0800, 0x4800_0c00, 0x4c, 2),
    (0x4800_0c00, 0x4800_1000, 0x4c, 3),
    (0x4800_1000, 0x4800_1400, 0x4c, 4),
    (0x4800_1400, 0x4800_1800, 0x4c, 5),
    (0x4800_1800, 0x4800_1c00, 0x4c, 6),
    (0x5000_0000, 0x5000_0400, 0x4c, 13),
    (0x5000_0400, 0x5000_0800, 0x4c, 14),
    (0x5000_0800, 0x5000_0c00, 0x4c, 16),
    (0x5000_0c00, 0x5000_1000, 0x4c, 17),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crystal_and_pll_make_170_mhz() {
        let mut r = Rcc::new(ResetCause::PowerOn, 24_000_000);
        assert_eq!(r.sysclk_hz(), Some(16_000_000));
        r.write(0x0c, 3 | 5 << 4 | 85 << 8 | 1 << 24);
        r.write(0x00, 1 << 8 | 1 << 16 | 1 << 24);
        assert_eq!(r.read(0) & 0x0202_0400, 0x0202_0400, "ready flags");
        r.write(0x08, 3);
        assert_eq!(r.sysclk_hz(), Some(170_000_000));
        assert_eq!(r.ahb_unit(), crate::time::CYCLE);
        assert_eq!(r.vco_hz(), 340_000_000);
    }

    #[test]
    fn reset_flags_stay_until_removed() {
        let mut r = Rcc::new(ResetCause::Watchdog, 24_000_000);
        r.write(0x94, 1);
        assert_ne!(r.read(0x94) & 1 << 29, 0);
        r.write(0x94, 1 << 23 | 1);
        assert_eq!(r.read(0x94) >> 25, 0);
    }

    #[test]
    fn gates() {
        let mut r = Rcc::new(ResetCause::PowerOn, 24_000_000);
        assert!(!r.is_clocked(0x5000_0800));
        r.write(0x4c, 1 << 16);
        assert!(r.is_clocked(0x5000_0800));
        assert_eq!(r.write(0x2c, 1 << 16), Some((0x5000_0800, 0x5000_0c00)));
    }
}
