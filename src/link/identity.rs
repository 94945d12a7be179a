//! Who the device is: the one payload that every version can read.
//!
//! Laid out by hand, little-endian, and only ever extended at the end: a host reads the fields it knows and ignores the rest.

/// Length of the layout below.
pub const BYTES: usize = 48;

/// Content of a [`Kind::Identity`](super::Kind::Identity) frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    /// What the converter self-test found: bit mask, zero is good (bits 0-4 ADC1-5, 8-10 DAC of axis 1-3, 12 supply).
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
