//! What times the loop: TIM6 (the sample clock), TIM7 (its deadline), the cycle counter.
//!
//! # Design
//! RM0440 section 31 (basic timers). TIM6 counts core clock cycles and its update event is TRGO: it starts the converters and
//! latches the outputs, [`TICK_HZ`] times a second, whatever software does. Each tick puts TIM7 off until half a period after the
//! next trigger: if the tick has not run by then because a converter stopped, TIM7's interrupt starts the tick without it.
//! DWT_CYCCNT (ARMv7-M ARM C1.8) counts core cycles; it wraps after 25 s, so only differences are used.
//!
//! # Limits
//! TIM7 is set from TIM6 by software, a few cycles late, which the half period absorbs.

use embassy_stm32::{pac, rcc};

use crate::TICK_HZ;

/// Core clock in hertz.
pub const CORE_HZ: u32 = 170_000_000;
/// Core clock cycles of a tick.
pub const TICK_CYCLES: u32 = CORE_HZ / TICK_HZ;
/// From a trigger to the moment by which the tick of the next one has to run.
const DEADLINE_CYCLES: u32 = TICK_CYCLES + TICK_CYCLES / 2;

/// Starts the cycle counter.
pub fn start_cycle_counter() {
    // SAFETY: nobody else uses DCB and DWT.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.DCB.enable_trace();
    // SAFETY: the counter is only ever read as differences.
    unsafe { core.DWT.cyccnt.write(0) };
    core.DWT.enable_cycle_counter();
}

/// Cycles now, wrapping.
#[inline(always)]
pub fn cycles() -> u32 {
    // SAFETY: reading DWT_CYCCNT has no effect.
    unsafe { (*cortex_m::peripheral::DWT::PTR).cyccnt.read() }
}

/// Waits; for start-up and fault handlers.
pub fn delay_us(us: u32) {
    let start = cycles();
    while cycles().wrapping_sub(start) < us.saturating_mul(CORE_HZ / 1_000_000) {}
}

/// Waits until `ready`, at most `us`. Whether it became so.
pub fn wait_us(us: u32, ready: impl Fn() -> bool) -> bool {
    let start = cycles();
    while !ready() {
        if cycles().wrapping_sub(start) > us.saturating_mul(CORE_HZ / 1_000_000) {
            return ready();
        }
    }
    true
}

/// Starts sample clock and deadline.
pub fn start() {
    rcc::enable_and_reset::<embassy_stm32::peripherals::TIM6>();
    rcc::enable_and_reset::<embassy_stm32::peripherals::TIM7>();
    for (timer, period) in [(pac::TIM6, TICK_CYCLES), (pac::TIM7, DEADLINE_CYCLES)] {
        timer.psc().write_value(0);
        timer.arr().write(|w| w.set_arr((period - 1) as u16));
        // Only overflows are updates, and the new period is taken over at once.
        timer.cr1().write(|w| w.set_urs(pac::timer::vals::Urs::COUNTER_ONLY));
        timer.egr().write(|w| w.set_ug(true));
    }
    pac::TIM6.cr2().write(|w| w.set_mms(pac::timer::vals::Mms::UPDATE));
    pac::TIM7.dier().write(|w| w.set_uie(true));
    pac::TIM6.cr1().modify(|w| w.set_cen(true));
    pac::TIM7.cr1().modify(|w| w.set_cen(true));
}

/// Whether TIM6 has triggered since [`clear_trigger`].
#[inline(always)]
pub fn has_triggered() -> bool {
    pac::TIM6.sr().read().uif()
}

/// Acknowledges the trigger.
#[inline(always)]
pub fn clear_trigger() {
    // Write 0 to clear; the other bits are reserved.
    pac::TIM6.sr().write_value(pac::timer::regs::SrCore(0));
}

/// Puts the deadline off until half a period after the next trigger: both timers count cycles since the last one from here on.
#[inline(always)]
pub fn postpone_deadline() {
    pac::TIM7.cnt().write_value(pac::TIM6.cnt().read());
}

/// Acknowledges the deadline interrupt.
#[inline(always)]
pub fn clear_deadline() {
    pac::TIM7.sr().write_value(pac::timer::regs::SrCore(0));
}
