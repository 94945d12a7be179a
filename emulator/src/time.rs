//! The emulator's clock: integers that every clock of the board divides.
//!
//! One unit is 1/4.08 GHz, the reciprocal of the least common multiple of 170 MHz (core), 16 MHz (HSI), 24 MHz
//! (HSE), 48 MHz (HSI48, USB) and 32 kHz (LSI). A `u64` of it lasts 143 years, and no clock ratio is ever rounded,
//! so that two runs with the same inputs agree to the cycle.

/// A point in time or a duration, in units of 1/4.08 GHz since power-on.
pub type Time = u64;

/// Never.
pub const NEVER: Time = u64::MAX;
/// Units in one second.
pub const SECOND: Time = 4_080_000_000;
/// Units in one millisecond.
pub const MILLISECOND: Time = SECOND / 1_000;
/// Units in one microsecond.
pub const MICROSECOND: Time = SECOND / 1_000_000;
/// Units in one cycle of the 170 MHz core clock.
pub const CYCLE: Time = SECOND / 170_000_000;
/// Units in one control period, 100 us.
pub const TICK: Time = 100 * MICROSECOND;

/// Seconds, for people and for the plant.
pub fn seconds(t: Time) -> f64 {
    t as f64 / SECOND as f64
}

/// Milliseconds, for people.
pub fn milliseconds(t: Time) -> f64 {
    t as f64 / MILLISECOND as f64
}

/// The nearest time to so many seconds.
pub fn from_seconds(s: f64) -> Time {
    (s.max(0.0) * SECOND as f64).round() as Time
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_clock_of_the_board_divides_the_unit() {
        for hz in [170_000_000, 16_000_000, 24_000_000, 48_000_000, 42_500_000, 32_000, 12_000_000]
        {
            assert_eq!(SECOND % hz, 0, "{hz} Hz");
        }
        assert_eq!(TICK, 17_000 * CYCLE);
    }
}
