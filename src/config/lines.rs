//! Straight lines between codes and quantities: gauges, monitors, drives.

use crate::settings::{Check, ConverterSettings, DacSettings, SettingsError};
use crate::units::{Volt, minus, narrow, plus, saturate};

/// Straight line from codes to a quantity's bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Converter {
    offset: i32,
    /// Bits per code, times 2^12.
    scale: i32,
}

impl Converter {
    #[inline(always)]
    pub(crate) fn value(&self, code: i32) -> i32 {
        plus(narrow::<12>((code as i64).wrapping_mul(self.scale as i64)), self.offset)
    }
    /// Nearest code for a quantity's bits: for simulators; not for the tick.
    pub(super) fn code(&self, bits: i64) -> i32 {
        let scaled = (bits - self.offset as i64) << 12;
        let scale = if self.scale == 0 { 1 } else { self.scale as i64 };
        saturate((scaled + scale / 2).div_euclid(scale))
    }
}

/// Straight line from volts to DAC codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Dac {
    pub(super) zero: Volt,
    /// Codes per volt, times 2^20.
    pub(super) scale: i32,
    full_code: i32,
    noise_shaping: bool,
}

impl Dac {
    #[inline(always)]
    pub(crate) fn code(&self, drive: Volt, error: &mut i32) -> u16 {
        let level = (drive - self.zero).to_bits() as i64;
        let carried = if self.noise_shaping { *error } else { 0 };
        // 22 + 20 fraction bits, to 16.
        let exact = plus(narrow::<26>(level.wrapping_mul(self.scale as i64)), carried);
        let nearest = plus(exact, 0x8000) >> 16;
        let code = if nearest > self.full_code { self.full_code } else { nearest };
        let code = if code < 0 { 0 } else { code };
        let rest = minus(exact, code << 16);
        *error = rest.clamp(-0x8000, 0x7fff);
        code as u16
    }
}

/// The highest code that a gauge in order gives, of a converter that ends at `full`: amplifiers and buffers stop some way before the
/// supplies, and the converter's noise takes single readings of a gauge at its end below the last code. A 64th is 52 mV of 3.3 V; the front
/// end's own margin is 150 mV.
pub(super) fn last_code(full: u32) -> i32 {
    full.saturating_sub((full / 64).max(1)) as i32
}

pub(super) fn build_converter(
    check: Check,
    settings: &ConverterSettings,
    fraction: u32,
) -> Result<Converter, SettingsError> {
    let full = check.range("full_code", settings.full_code as f32, 15.0, 16_777_215.0, "codes")?;
    let most = (1i64 << (31 - fraction)) as f32;
    let zero = check.range("at_zero", settings.at_zero, -most, most, "um or V")?;
    let at_full = check.range("at_full", settings.at_full, -most, most, "um or V")?;
    // Double precision: a 24-bit mantissa would cost half a code at the far end.
    let bits = (f64::from(at_full) - f64::from(zero)) * (1i64 << fraction) as f64 / f64::from(full)
        * 4_096.0;
    check.range(
        "at_full",
        bits as f32,
        1.0,
        i32::MAX as f32,
        "above at_zero in the controller's units per code",
    )?;
    Ok(Converter {
        offset: (f64::from(zero) * (1i64 << fraction) as f64) as i32,
        scale: (bits + 0.5) as i32,
    })
}

pub(super) fn build_dac(check: Check, settings: &DacSettings) -> Result<Dac, SettingsError> {
    let full = check.range("full_code", settings.full_code as f32, 15.0, 32_767.0, "codes")?;
    let zero = check.range("at_zero_v", settings.at_zero_v, -400.0, 400.0, "V")?;
    let at_full = check.range("at_full_v", settings.at_full_v, -400.0, 500.0, "V")?;
    let span = check.range("at_full_v", at_full - zero, 0.1, 900.0, "V above at_zero_v")?;
    let scale = full / span;
    check.range("full_code", scale, 1.0e-3, 2_000.0, "codes per volt")?;
    Ok(Dac {
        zero: Volt::from_f32(zero),
        scale: (f64::from(scale) * 1_048_576.0) as i32,
        full_code: settings.full_code as i32,
        noise_shaping: settings.noise_shaping,
    })
}
