//! The clock tree.
//!
//! # Design
//! RM0440 section 7. HSE 24 MHz / 6 * 85 / 2 = 170 MHz for core, buses and timers; the converters run on HCLK/4 = 42.5 MHz; USB on HSI48,
//! trimmed by the host. 170 MHz needs range 1 boost mode (section 6.1.5).
//!
//! # Limits
//! stm32-metapac 21 has PWR_CR5.R1MODE at bit 0, but it is bit 8 (section 6.4.17): embassy's `boost` does nothing, so
//! the bit is cleared here before. If the crystal does not start, HSI16 (1 %) takes its place and the self-test says so.

use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals, pac, rcc};

/// Longest start-up of the crystal, in loops of at least four 16 MHz cycles: more than 10 ms.
const CRYSTAL_PATIENCE: u32 = 40_000;
/// PWR_CR5.R1MODE: cleared for boost mode.
const R1MODE: u32 = 1 << 8;

/// Brings everything to speed; whether the crystal runs.
pub fn start() -> (Peripherals, bool) {
    pac::RCC.apb1enr1().modify(|w| w.set_pwren(true));
    let _ = pac::RCC.apb1enr1().read();
    // The core still runs on HSI16, so the order of the steps in section 6.1.5 does not matter.
    pac::PWR.cr5().modify(|w| w.0 &= !R1MODE);
    let has_crystal = crystal_starts();
    let mut config = Config::default();
    config.rcc.hse =
        has_crystal.then_some(rcc::Hse { freq: Hertz(24_000_000), mode: rcc::HseMode::Oscillator });
    let (source, prediv) = if has_crystal {
        (rcc::PllSource::HSE, rcc::PllPreDiv::DIV6)
    } else {
        (rcc::PllSource::HSI, rcc::PllPreDiv::DIV4)
    };
    config.rcc.pll = Some(rcc::Pll {
        source,
        prediv,
        mul: rcc::PllMul::MUL85,
        divp: None,
        divq: None,
        divr: Some(rcc::PllRDiv::DIV2),
    });
    config.rcc.sys = rcc::Sysclk::PLL1_R;
    config.rcc.boost = true;
    config.rcc.hsi48 = Some(rcc::Hsi48Config { sync_from_usb: true });
    config.rcc.mux.clk48sel = rcc::mux::Clk48sel::HSI48;
    config.rcc.mux.adc12sel = rcc::mux::Adcsel::SYS;
    config.rcc.mux.adc345sel = rcc::mux::Adcsel::SYS;
    (embassy_stm32::init(config), has_crystal)
}

/// embassy would wait for a dead crystal for ever.
fn crystal_starts() -> bool {
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    for _ in 0..CRYSTAL_PATIENCE {
        if pac::RCC.cr().read().hserdy() {
            return true;
        }
    }
    pac::RCC.cr().modify(|w| w.set_hseon(false));
    false
}
