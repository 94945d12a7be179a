//! The six analogue inputs: gauges on ADC1, ADC2, ADC3, amplifier monitors on ADC4 and ADC5.
//!
//! # Design
//! RM0440 section 21. All five start their injected sequence at TIM6_TRGO (JEXTSEL 14), on a clock derived from the core's
//! (HCLK/4 = 42.5 MHz), so that the sample instant has no jitter and no skew between axes.
//!
//! | input | pin | channel | sampling | oversampling | result | ready after |
//! | --- | --- | --- | --- | --- | --- | --- |
//! | gauge 1 | PA0 | ADC1_IN1 | 6.5 cycles | 64x, >> 2 | 0..65520 | 28.6 us |
//! | gauge 2 | PA1 | ADC2_IN2 | 6.5 cycles | 64x, >> 2 | 0..65520 | 28.6 us |
//! | gauge 3 | PB1 | ADC3_IN1 | 6.5 cycles | 64x, >> 2 | 0..65520 | 28.6 us |
//! | monitor 1 | PB12 | ADC4_IN3 | 6.5 cycles | 16x | 0..65520 | 7.2 us |
//! | monitor 2 | PB14 | ADC4_IN4 | 6.5 cycles | 16x | 0..65520 | 14.3 us |
//! | monitor 3 | PA8 | ADC5_IN1 | 6.5 cycles | 16x | 0..65520 | 7.2 us |
//!
//! A conversion takes 6.5 + 12.5 cycles. 64x averages the converter's own noise (about 1.2 LSB rms of 12 bits, 5 nm) to 0.6 nm, far below
//! the gauge's 4 nm; 256x would add 86 us of delay for nothing. The mean sample lies 14.3 us after the trigger.
//!
//! # Limits
//! Register access only: embassy 0.6 exposes no injected oversampling, and its acknowledgement is a read-modify-write of
//! write-1-to-clear flags. ADC1 and ADC2 share a vector, so ADC3, which ends at the same time, interrupts for all.
//! The triggers are simultaneous, as erratum ES0430 2.7.11 asks of converters that share an input or the reference.

use embassy_stm32::pac::adc::vals::{Adcaldif, Adstp, Exten, SampleTime};
use embassy_stm32::pac::adccommon::vals::Ckmode;
use embassy_stm32::{pac, peripherals, rcc};

use super::timebase::{delay_us, wait_us};
use crate::AXES;
use crate::link::identity::self_test;

/// Largest code of every input: 4095 * 64 / 4 = 4095 * 16.
pub const FULL_CODE: u16 = 65_520;

/// JEXTSEL of TIM6_TRGO for all five converters (RM0440 tables 163 and 166).
const TIM6_TRGO: u8 = 14;
/// OVSR and OVSS of the gauges: 64 conversions, sum / 4.
const GAUGE_OVERSAMPLING: (u8, u8) = (5, 2);
/// OVSR and OVSS of the monitors: 16 conversions, sum.
const MONITOR_OVERSAMPLING: (u8, u8) = (3, 0);
/// Longest time that a converter may take for anything at start-up.
const PATIENCE_US: u32 = 1_000;
/// Tolerance of a DAC output read back by ADC2, 12-bit codes: offset and gain errors of both (DS12288 tables 66 and 73).
const READ_BACK_TOLERANCE: u16 = 40;
/// Allowed 12-bit codes of VREFINT (1.182..1.232 V) for VDDA = 3.0..3.6 V (DS12288 table 25).
const VREFINT_CODES: core::ops::RangeInclusive<u16> = 1_344..=1_683;

const ALL: [pac::adc::Adc; 5] = [pac::ADC1, pac::ADC2, pac::ADC3, pac::ADC4, pac::ADC5];

/// Injected sequence of each converter.
const CHANNELS: [&[u8]; 5] = [&[1], &[2], &[1], &[3, 4], &[1]];

/// Powers, calibrates and tests the converters; what failed, as [`self_test`] bits.
pub fn start() -> u16 {
    rcc::enable_and_reset::<peripherals::ADC1>();
    rcc::enable_and_reset::<peripherals::ADC3>();
    pac::RCC.ahb2enr().modify(|w| w.set_gpioben(true));
    for (port, pin) in [
        (pac::GPIOA, 0),
        (pac::GPIOA, 1),
        (pac::GPIOA, 8),
        (pac::GPIOB, 1),
        (pac::GPIOB, 12),
        (pac::GPIOB, 14),
    ] {
        port.moder().modify(|w| w.set_moder(pin, pac::gpio::vals::Moder::ANALOG));
    }
    for common in [pac::ADC12_COMMON, pac::ADC345_COMMON] {
        common.ccr().write(|w| {
            w.set_ckmode(Ckmode::SYNC_DIV4);
            w.set_vrefen(true);
        });
    }
    let mut failed = 0;
    for (i, adc) in ALL.into_iter().enumerate() {
        if !power_up(adc) {
            failed |= 1 << i;
        }
    }
    failed |= test_supply() | test_outputs();
    for (i, (adc, channels)) in ALL.into_iter().zip(CHANNELS).enumerate() {
        let oversampling = if i < 3 { GAUGE_OVERSAMPLING } else { MONITOR_OVERSAMPLING };
        configure(adc, channels, Some(oversampling), Exten::DISABLED);
        if convert_once(adc).is_none() {
            failed |= 1 << i;
        }
    }
    failed
}

/// Regulator, calibration, enable (RM0440 sections 21.4.6 to 21.4.9).
fn power_up(adc: pac::adc::Adc) -> bool {
    adc.cr().write(|w| w.set_deeppwd(false));
    adc.cr().write(|w| w.set_advregen(true));
    delay_us(25);
    adc.cr().modify(|w| w.set_adcaldif(Adcaldif::SINGLE_ENDED));
    adc.cr().modify(|w| w.set_adcal(true));
    let calibrated = wait_us(PATIENCE_US, || !adc.cr().read().adcal());
    // ADEN must not be set within four clocks of the end of calibration.
    delay_us(1);
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().modify(|w| w.set_aden(true));
    calibrated && wait_us(PATIENCE_US, || adc.isr().read().adrdy())
}

/// Sets up the injected sequence of a converter that converts nothing now.
fn configure(adc: pac::adc::Adc, channels: &[u8], oversampling: Option<(u8, u8)>, trigger: Exten) {
    if adc.cr().read().jadstart() {
        adc.cr().modify(|w| w.set_jadstp(Adstp::STOP));
        wait_us(PATIENCE_US, || !adc.cr().read().jadstart());
    }
    // Without a queue of contexts the sequence is what JSQR says, always.
    adc.cfgr().write(|w| w.set_jqdis(true));
    adc.cfgr2().write(|w| {
        if let Some((ratio, shift)) = oversampling {
            w.set_jovse(true);
            w.set_ovsr(ratio);
            w.set_ovss(shift);
        }
    });
    // The internal channels (VREFINT) need longer sampling than the buffered pins.
    let sampling =
        |channel: u8| if channel == 18 { SampleTime::CYCLES640_5 } else { SampleTime::CYCLES6_5 };
    adc.smpr().modify(|w| {
        for channel in channels.iter().filter(|channel| **channel < 10) {
            w.set_smp((*channel).into(), sampling(*channel));
        }
    });
    adc.smpr2().modify(|w| {
        for channel in channels.iter().filter(|channel| **channel >= 10) {
            w.set_smp(usize::from(*channel) - 10, sampling(*channel));
        }
    });
    adc.jsqr().write(|w| {
        w.set_jl(channels.len() as u8 - 1);
        w.set_jextsel(TIM6_TRGO);
        w.set_jexten(trigger);
        for (rank, channel) in channels.iter().enumerate() {
            w.set_jsq(rank, *channel);
        }
    });
    acknowledge(adc);
}

/// One sequence started by software; the first result.
fn convert_once(adc: pac::adc::Adc) -> Option<u16> {
    acknowledge(adc);
    adc.cr().modify(|w| w.set_jadstart(true));
    wait_us(PATIENCE_US, || adc.isr().read().jeos()).then(|| adc.jdr(0).read().jdata())
}

/// VREFINT through ADC1: tells whether VDDA, the reference of everything, is 3.3 V within 10 %.
fn test_supply() -> u16 {
    configure(pac::ADC1, &[18], None, Exten::DISABLED);
    match convert_once(pac::ADC1) {
        Some(code) if VREFINT_CODES.contains(&code) => 0,
        _ => self_test::SUPPLY,
    }
}

/// Reads the parked outputs back through ADC2, which reaches all three pins: PA4 = IN17, PA5 = IN13, PA6 = IN3.
fn test_outputs() -> u16 {
    let mut failed = 0;
    for ((axis, channel), expected) in
        [17, 13, 3].into_iter().enumerate().zip(super::outputs::read())
    {
        configure(pac::ADC2, &[channel], None, Exten::DISABLED);
        let is_right = convert_once(pac::ADC2)
            .is_some_and(|code| code.abs_diff(expected) <= READ_BACK_TOLERANCE);
        if !is_right {
            failed |= self_test::OUTPUT_1 << axis;
        }
    }
    failed
}

/// Hands the converters to the timer; ADC3 interrupts at the end of each sequence.
pub fn run_on_trigger() {
    for (i, (adc, channels)) in ALL.into_iter().zip(CHANNELS).enumerate() {
        let oversampling = if i < 3 { GAUGE_OVERSAMPLING } else { MONITOR_OVERSAMPLING };
        configure(adc, channels, Some(oversampling), Exten::RISING_EDGE);
    }
    pac::ADC3.ier().write(|w| w.set_jeosie(true));
    for adc in ALL {
        adc.cr().modify(|w| w.set_jadstart(true));
    }
}

/// Clears the injected flags. A plain write: the flags are write-1-to-clear.
#[inline(always)]
fn acknowledge(adc: pac::adc::Adc) {
    // JEOC (bit 5) and JEOS (bit 6).
    adc.isr().write_value(pac::adc::regs::Isr(0x60));
}

/// Latest code of every input.
#[derive(Clone, Copy)]
pub struct Codes {
    /// Gauges.
    pub gauge: [u16; AXES],
    /// Amplifier monitors.
    pub monitor: [u16; AXES],
}

/// End of the injected sequence, ADC_ISR bit 6 (RM0440 section 21.7.1).
const JEOS: u32 = 1 << 6;

/// Takes over and acknowledges the results of all converters that have one. Bit i of the result: converter i + 1 has none, and
/// its codes are left as they were.
#[inline(always)]
pub fn take(codes: &mut Codes) -> u32 {
    let ended = |adc: pac::adc::Adc| adc.isr().read().0 & JEOS;
    let [one, two, three, four, five] = ALL.map(ended);
    if one & two & three & four & five != 0 {
        // As a rule.
        for adc in ALL {
            acknowledge(adc);
        }
        codes.gauge = [code(pac::ADC1, 0), code(pac::ADC2, 0), code(pac::ADC3, 0)];
        codes.monitor = [code(pac::ADC4, 0), code(pac::ADC4, 1), code(pac::ADC5, 0)];
        return 0;
    }
    let [gauge_1, gauge_2, gauge_3] = &mut codes.gauge;
    let [monitor_1, monitor_2, monitor_3] = &mut codes.monitor;
    let mut missing = 0;
    missing |= take_one(pac::ADC1, one, gauge_1, None);
    missing |= take_one(pac::ADC2, two, gauge_2, None) << 1;
    missing |= take_one(pac::ADC3, three, gauge_3, None) << 2;
    missing |= take_one(pac::ADC4, four, monitor_1, Some(monitor_2)) << 3;
    missing |= take_one(pac::ADC5, five, monitor_3, None) << 4;
    missing
}

#[inline(always)]
fn code(adc: pac::adc::Adc, rank: usize) -> u16 {
    adc.jdr(rank).read().jdata()
}

#[inline(always)]
fn take_one(adc: pac::adc::Adc, ended: u32, first: &mut u16, second: Option<&mut u16>) -> u32 {
    if ended == 0 {
        return 1;
    }
    acknowledge(adc);
    *first = code(adc, 0);
    if let Some(second) = second {
        *second = code(adc, 1);
    }
    0
}
