//! GPIO ports A to G (RM0440 9).
//!
//! Modes, output data and its atomic set and reset, input data from the board. Left out: alternate functions (the
//! peripherals here are wired to their pins whatever AFR says), pulls, speed, lock.

/// One port.
pub struct Gpio {
    words: [u32; 10],
    odr: u16,
}

impl Gpio {
    /// Out of reset: analog, but for the debug pins of ports A and B.
    pub fn new(port: usize) -> Gpio {
        let mut words = [0; 10];
        words[0] = match port {
            0 => 0xabff_ffff,
            1 => 0xffff_febf,
            _ => 0xffff_ffff,
        };
        Gpio { words, odr: 0 }
    }

    /// `(pins that are outputs, their levels)`.
    pub fn outputs(&self) -> (u16, u16) {
        let modes = self.words[0];
        let outputs = (0..16).fold(0u16, |o, i| o | ((modes >> (2 * i) & 3 == 1) as u16) << i);
        (outputs, self.odr & outputs)
    }

    /// Register read; `inputs` are the levels the board applies.
    pub fn read(&self, offset: u32, inputs: u16) -> u32 {
        match offset {
            0x10 => {
                let (outputs, levels) = self.outputs();
                (levels | inputs & !outputs) as u32
            }
            0x14 => self.odr as u32,
            o => self.words.get(o as usize / 4).copied().unwrap_or(0),
        }
    }

    /// Register write; says whether an output may have changed.
    pub fn write(&mut self, offset: u32, value: u32) -> bool {
        let before = self.outputs();
        match offset {
            0x14 => self.odr = value as u16,
            0x18 => self.odr = self.odr & !((value >> 16) as u16) | value as u16,
            0x28 => self.odr &= !(value as u16),
            o => {
                if let Some(w) = self.words.get_mut(o as usize / 4) {
                    *w = value;
                }
            }
        }
        before != self.outputs()
    }
}
