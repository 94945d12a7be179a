//! The border between the chip and the analogue world.

use crate::time::Time;

/// The instants at which one conversion (or all the conversions that the oversampler adds up) holds its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First sampling instant.
    pub first: Time,
    /// From one sampling instant to the next.
    pub period: Time,
    /// Number of conversions added up.
    pub count: u32,
}

impl Window {
    /// Last sampling instant.
    pub fn last(&self) -> Time {
        self.first + self.period * (self.count as Time - 1)
    }

    /// Mean sampling instant, doubled to stay exact.
    pub fn middle(&self) -> Time {
        (self.first + self.last()) / 2
    }
}

/// What is wired to the chip's analogue pins. Times never run backwards by more than one control period.
pub trait Analog {
    /// The sum of `window.count` conversions, 12 bits each, of `channel` of ADC `adc` (1 to 5).
    fn convert(&mut self, adc: u8, channel: u8, window: &Window) -> u32;

    /// The three DAC pins (DAC1_OUT1, DAC1_OUT2, DAC2_OUT1) from `at` on: 12-bit code, or `None` for a pin that is
    /// not driven. Called at every edge of the control trigger (`latched`), changed or not, and at every other change.
    fn drive(&mut self, at: Time, codes: [Option<u16>; 3], latched: bool);

    /// Every digital output pin of a port changed: bits that are outputs, their levels.
    fn pins(&mut self, at: Time, port: usize, outputs: u16, levels: u16);

    /// Levels that the board puts on the input pins of a port.
    fn inputs(&self, port: usize) -> u16;
}
