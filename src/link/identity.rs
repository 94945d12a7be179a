//! Who the device is: the one payload that every version can read.
//!
//! Laid out by hand, little-endian, and only ever extended at the end: a host reads the fields it knows and ignores the rest.

/// Length of the layout below.
pub const BYTES: usize = 48;

/// Bits of [`Identity::self_test`]. Bits 0 to 4: ADC1 to ADC5 do not calibrate or convert.
pub mod self_test {
    /// Output 1 read back differs from what was set; outputs 2 and 3 are the next two bits.
    pub const OUTPUT_1: u16 = 1 << 8;
    /// VDDA, the reference of all converters, is not 3.3 V within 10 %.
    pub const SUPPLY: u16 = 1 << 12;
    /// The crystal does not start: the internal oscillator runs the board (sample rate within 1 %).
    pub const CRYSTAL: u16 = 1 << 13;
    /// Failures with which the loop may still be closed.
    pub const TOLERABLE: u16 = CRYSTAL;

    /// The set bits, in words.
    pub fn describe(bits: u16) -> impl Iterator<Item = &'static str> {
        const WORDS: [(u16, &str); 10] = [
            (1 << 0, "ADC1 (gauge 1) does not convert"),
            (1 << 1, "ADC2 (gauge 2) does not convert"),
            (1 << 2, "ADC3 (gauge 3) does not convert"),
            (1 << 3, "ADC4 (monitors 1 and 2) does not convert"),
            (1 << 4, "ADC5 (monitor 3) does not convert"),
            (OUTPUT_1, "output 1 (PA4) is not at the voltage that was set"),
            (OUTPUT_1 << 1, "output 2 (PA5) is not at the voltage that was set"),
            (OUTPUT_1 << 2, "output 3 (PA6) is not at the voltage that was set"),
            (SUPPLY, "VDDA is not 3.3 V within 10 %"),
            (CRYSTAL, "the crystal does not start: the sample rate is only within 1 %"),
        ];
        WORDS.into_iter().filter(move |(bit, _)| bits & bit != 0).map(|(_, words)| words)
    }
}

/// Content of a [`Kind::Identity`](super::Kind::Identity) frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Schema hash of the firmware's messages.
    pub schema: u32,
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
    /// Number of axes.
    pub axes: u8,
    /// 96-bit unique id of the microcontroller (RM0440 section 48.1); in hexadecimal it is the USB serial number.
    pub serial: [u8; 12],
    /// Control rate in hertz.
    pub sample_rate_hz: u32,
    /// Core clock in hertz.
    pub core_hz: u32,
    /// Why the controller last restarted (RCC_CSR bits 31:24, see [`Identity::reset_reason`]).
    pub reset_flags: u8,
    /// Nonzero if a panic or fault message of the previous run waits to be read.
    pub has_crash_report: u8,
    /// Nonzero if the configuration came from flash, zero if it is the built-in default.
    pub has_stored_config: u8,
    /// What the self-test at the restart found: [`self_test`] bits, zero is good.
    pub self_test: u16,
    /// Restarts since power-on.
    pub restarts: u16,
}

impl Identity {
    /// Encodes the payload.
    pub fn to_bytes(&self) -> [u8; BYTES] {
        let mut out = [0; BYTES];
        let mut at = 0;
        let mut put = |bytes: &[u8]| {
            for byte in bytes {
                if let Some(place) = out.get_mut(at) {
                    *place = *byte;
                }
                at += 1;
            }
        };
        put(&self.schema.to_le_bytes());
        put(&self.firmware);
        put(&[self.axes]);
        put(&self.serial);
        put(&self.sample_rate_hz.to_le_bytes());
        put(&self.core_hz.to_le_bytes());
        put(&[self.reset_flags, self.has_crash_report, self.has_stored_config, 0]);
        put(&self.self_test.to_le_bytes());
        put(&self.restarts.to_le_bytes());
        out
    }

    /// Decodes a payload; longer ones (of newer firmware) are read as far as this version knows.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let b = bytes.first_chunk::<BYTES>()?;
        let u32_at = |i: usize| u32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
        let u16_at = |i: usize| u16::from_le_bytes([b[i], b[i + 1]]);
        let mut serial = [0; 12];
        serial.copy_from_slice(&b[8..20]);
        Some(Self {
            schema: u32_at(0),
            firmware: [b[4], b[5], b[6]],
            axes: b[7],
            serial,
            sample_rate_hz: u32_at(20),
            core_hz: u32_at(24),
            reset_flags: b[28],
            has_crash_report: b[29],
            has_stored_config: b[30],
            self_test: u16_at(32),
            restarts: u16_at(34),
        })
    }

    /// The reset reason in words, most telling flag first (RM0440 RCC_CSR).
    pub fn reset_reason(&self) -> &'static str {
        const REASONS: [(u8, &str); 7] = [
            (1 << 7, "low-power reset"),
            (1 << 6, "window watchdog"),
            (1 << 5, "independent watchdog"),
            (1 << 4, "software"),
            (1 << 3, "brown-out or power-on"),
            (1 << 1, "option byte loader"),
            (1 << 2, "reset pin"),
        ];
        REASONS.iter().find(|(bit, _)| self.reset_flags & bit != 0).map_or("unknown", |(_, s)| s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trip_and_growth() {
        let identity = Identity {
            schema: 0x1234_5678,
            firmware: [0, 1, 2],
            axes: 3,
            serial: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12],
            sample_rate_hz: 10_000,
            core_hz: 170_000_000,
            reset_flags: 1 << 5,
            has_crash_report: 1,
            has_stored_config: 0,
            self_test: 0x0102,
            restarts: 3,
        };
        let bytes = identity.to_bytes();
        assert_eq!(Identity::from_bytes(&bytes), Some(identity));
        assert_eq!(identity.reset_reason(), "independent watchdog");
        let mut longer = [0xff; BYTES + 5];
        longer[..BYTES].copy_from_slice(&bytes);
        assert_eq!(Identity::from_bytes(&longer), Some(identity));
        assert_eq!(Identity::from_bytes(&bytes[..BYTES - 1]), None);
    }
}
