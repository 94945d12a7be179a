//! Independent watchdog on the 32 kHz LSI (RM0440 43).
//!
//! Left out: the window, the update delay of PR and RLR (PVU and RVU are always clear), LSI tolerance (29.5 to
//! 34 kHz on silicon).

use crate::time::{NEVER, SECOND, Time};

/// The watchdog.
pub struct Iwdg {
    open: bool,
    pr: u32,
    rlr: u32,
    fires: Time,
}

impl Default for Iwdg {
    fn default() -> Self {
        Iwdg { open: false, pr: 0, rlr: 0xfff, fires: NEVER }
    }
}

impl Iwdg {
    /// Time from a reload to the reset.
    pub fn timeout(&self) -> Time {
        (self.rlr as Time + 1) * (4 << self.pr.min(6)) * (SECOND / 32_000)
    }

    /// Whether it was started; it cannot be stopped.
    pub fn running(&self) -> bool {
        self.fires != NEVER
    }

    /// When it resets the chip.
    pub fn next_event(&self) -> Time {
        self.fires
    }

    /// Register read.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            4 => self.pr,
            8 => self.rlr,
            0x10 => 0xfff,
            _ => 0,
        }
    }

    /// Register write.
    pub fn write(&mut self, offset: u32, value: u32, now: Time) {
        match (offset, value & 0xffff) {
            (0, 0x5555) => self.open = true,
            (0, key @ (0xaaaa | 0xcccc)) => {
                self.open = false;
                if key == 0xcccc || self.running() {
                    self.fires = now + self.timeout();
                }
            }
            (4, v) if self.open => self.pr = v & 7,
            (8, v) if self.open => self.rlr = v & 0xfff,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::MILLISECOND;

    #[test]
    fn starved_it_fires_and_petted_it_does_not() {
        let mut w = Iwdg::default();
        w.write(0, 0x5555, 0);
        w.write(4, 0, 0);
        w.write(8, 399, 0);
        w.write(0, 0xcccc, 0);
        assert_eq!(w.next_event(), 50 * MILLISECOND);
        w.write(0, 0xaaaa, 10 * MILLISECOND);
        assert_eq!(w.next_event(), 60 * MILLISECOND);
    }
}
