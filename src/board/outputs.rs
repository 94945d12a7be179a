//! The three drive outputs: DAC1 channel 1 (PA4), DAC1 channel 2 (PA5), DAC2 channel 1 (PA6).
//!
//! # Design
//! RM0440 section 22. Twelve bits, right-aligned, output buffer on. While the loop runs, a value waits in the holding
//! register until TIM6_TRGO latches it (TSEL 7): all three outputs change at the sample instant, one period after the sample that
//! they answer, without jitter. Before that the trigger is off and values act at once.
//!
//! The board turns 0..3.3 V into 0..10 V at the amplifier input, which makes -10..150 V of it: 0 V is [`PARK_CODE`]. A
//! resistor network holds the same 0 V while the pin floats (reset, DFU loader): see docs/board.md.
//!
//! # Limits
//! Register access only: embassy's driver resets the peripheral when it is created (a step to -10 V), and its `set` has a panic
//! path. The reference is VDDA (3.3 V).

use embassy_stm32::pac;
use embassy_stm32::pac::dac::vals::Mode;

use crate::AXES;

/// DAC code of 0 V at the amplifier output: (0 + 10) / 160 * 4096.
pub const PARK_CODE: u16 = 256;

/// The highest code: twelve bits.
pub const FULL_CODE: u16 = 4_095;

/// TSEL of TIM6_TRGO (RM0440 table 184).
const TIM6_TRGO: u8 = 7;

/// DAC code steps a millisecond of a soft return without controller: 0.5 V/ms at 39 mV a code.
const RETURN_CODES_PER_MS: u16 = 13;

/// Brings the outputs to [`PARK_CODE`], from any state of the clock tree. The first thing after reset.
pub fn park_at_reset() {
    pac::RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_dac1en(true);
        w.set_dac2en(true);
    });
    // A read back makes sure that the clocks run before the next access (RM0440 section 7.2.17).
    let _ = pac::RCC.ahb2enr().read();
    for pin in [4, 5, 6] {
        pac::GPIOA.moder().modify(|w| w.set_moder(pin, pac::gpio::vals::Moder::ANALOG));
    }
    for dac in [pac::DAC1, pac::DAC2] {
        dac.mcr().write(|w| {
            // For AHB clocks above 160 MHz; harmless below.
            w.set_hfsel(2);
            w.set_mode(0, Mode::NORMAL_EXT_BUFEN);
            w.set_mode(1, Mode::NORMAL_EXT_BUFEN);
        });
    }
    write([PARK_CODE; AXES]);
    pac::DAC1.cr().write(|w| {
        w.set_en(0, true);
        w.set_en(1, true);
    });
    pac::DAC2.cr().write(|w| w.set_en(0, true));
    write([PARK_CODE; AXES]);
}

/// From now on values act at the next trigger.
pub fn latch_on_trigger() {
    for (dac, channels) in [(pac::DAC1, 2), (pac::DAC2, 1)] {
        dac.cr().modify(|w| {
            for channel in 0..channels {
                w.set_tsel(channel, TIM6_TRGO);
                w.set_ten(channel, true);
            }
        });
    }
}

/// Writes the codes of all axes into the holding registers. None is beyond [`FULL_CODE`]: the controller saturates at the settings' last code,
/// and [`fits`](super::device::fits) lets no other one in.
#[inline(always)]
pub fn write(codes: [u16; AXES]) {
    let [a, b, c] = codes;
    pac::DAC1.dhr12rd().write_value(pac::dac::regs::Dhr12rd(u32::from(a) | u32::from(b) << 16));
    pac::DAC2.dhr12r(0).write_value(pac::dac::regs::Dhr12r(u32::from(c)));
}

/// The codes at the pins.
pub fn read() -> [u16; AXES] {
    [pac::DAC1.dor(0).read().dor(), pac::DAC1.dor(1).read().dor(), pac::DAC2.dor(0).read().dor()]
}

/// Returns the outputs slowly to [`PARK_CODE`], where they will float, without the controller: for what the tick cannot interrupt, before a
/// reset. Takes up to 300 ms, for which the watchdog waits; the timer goes on latching.
pub fn return_softly_blocking() {
    // Once, so that it still ends what hangs here.
    pac::IWDG.kr().write(|w| w.set_key(pac::iwdg::vals::Key::RESET));
    loop {
        let now = read();
        let next = now.map(|code| {
            PARK_CODE.clamp(
                code.saturating_sub(RETURN_CODES_PER_MS),
                code.saturating_add(RETURN_CODES_PER_MS),
            )
        });
        write(next);
        if now == [PARK_CODE; AXES] {
            return;
        }
        super::timebase::delay_us(1_000);
    }
}
