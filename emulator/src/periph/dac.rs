//! DAC1 and DAC2 with the trigger latch (RM0440 22).
//!
//! DHR is copied to DOR at the trigger (TEN) or at once. Left out: DMA, wave and sawtooth generation, sample and
//! hold, calibration, the three-AHB-cycle delay of the copy (it is the same for every sample). DAC3 and DAC4 have no
//! pins and are plain registers.

/// TSEL of TIM6_TRGO (RM0440 table 187).
const TSEL_TIM6: u32 = 7;

/// One converter with two channels.
#[derive(Default)]
pub struct Dac {
    cr: u32,
    mcr: u32,
    dhr: [u32; 2],
    dor: [u32; 2],
}

impl Dac {
    /// Output code of a channel, `None` while it is off.
    pub fn output(&self, channel: usize) -> Option<u16> {
        (self.cr >> (16 * channel) & 1 != 0).then_some(self.dor[channel] as u16)
    }

    /// Whether MCR.HFSEL suits the AHB clock (RM0440 22.7.17): above 80 MHz, above 160 MHz.
    pub fn high_frequency_ok(&self, ahb_hz: f64) -> bool {
        match self.mcr >> 14 & 3 {
            0 => ahb_hz <= 80e6,
            1 => ahb_hz <= 160e6,
            _ => true,
        }
    }

    fn triggered(&self, channel: usize) -> bool {
        self.cr >> (16 * channel + 1) & 1 != 0
    }

    /// A rising edge of TIM6_TRGO; says whether any channel latched.
    pub fn trigger_tim6(&mut self) -> bool {
        let mut latched = false;
        for c in 0..2 {
            if self.cr >> (16 * c) & 1 != 0
                && self.triggered(c)
                && self.cr >> (16 * c + 2) & 15 == TSEL_TIM6
            {
                self.dor[c] = self.dhr[c];
                latched = true;
            }
        }
        latched
    }

    fn hold(&mut self, channel: usize, code: u32) {
        self.dhr[channel] = code & 0xfff;
        if !self.triggered(channel) {
            self.dor[channel] = self.dhr[channel];
        }
    }

    /// Register read.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x00 => self.cr,
            0x08 => self.dhr[0],
            0x14 => self.dhr[1],
            0x20 => self.dhr[0] | self.dhr[1] << 16,
            0x2c => self.dor[0],
            0x30 => self.dor[1],
            // DAC1RDY, DAC2RDY
            0x34 => 0x0800_0800,
            0x3c => self.mcr,
            _ => 0,
        }
    }

    /// Register write; says whether an output may have changed.
    pub fn write(&mut self, offset: u32, value: u32) -> bool {
        let before = (self.output(0), self.output(1));
        match offset {
            0x00 => self.cr = value,
            0x04 => {
                for c in 0..2 {
                    if value >> c & 1 != 0 && self.triggered(c) && self.cr >> (16 * c + 2) & 15 == 0
                    {
                        self.dor[c] = self.dhr[c];
                    }
                }
            }
            0x08 => self.hold(0, value),
            0x0c => self.hold(0, value >> 4),
            0x10 => self.hold(0, (value & 0xff) << 4),
            0x14 => self.hold(1, value),
            0x18 => self.hold(1, value >> 4),
            0x1c => self.hold(1, (value & 0xff) << 4),
            0x20 => {
                self.hold(0, value);
                self.hold(1, value >> 16);
            }
            0x24 => {
                self.hold(0, value >> 4);
                self.hold(1, value >> 20);
            }
            0x3c => self.mcr = value,
            _ => {}
        }
        before != (self.output(0), self.output(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triggered_channel_waits_for_the_edge() {
        let mut d = Dac::default();
        assert_eq!(d.output(0), None);
        d.write(0x00, 1 | 2 | 7 << 2);
        assert!(!d.write(0x08, 1234), "held back");
        assert_eq!(d.output(0), Some(0));
        assert!(d.trigger_tim6());
        assert_eq!(d.output(0), Some(1234));
        d.write(0x00, 1);
        assert!(d.write(0x08, 5));
        assert_eq!(d.output(0), Some(5));
    }
}
