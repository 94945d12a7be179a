//! Critical sections that never delay the control tick.
//!
//! # Design
//! The usual implementation masks all interrupts (PRIMASK). embassy enters one dozens of times a millisecond, for up to several
//! microseconds in the USB driver. Here BASEPRI is raised to P1 instead: everything is masked but P0, where the control
//! tick and its deadline monitor run. (ARMv7-M ARM B1.4.3; PM0214 section 2.1.3)
//!
//! # Limits
//! Code at P0 may neither use critical sections nor touch what they protect. It shares only atomics and single-producer,
//! single-consumer queues with the rest; `cargo xtask firmware` proves that it calls nothing else.

use cortex_m::register::basepri;
use critical_section::RawRestoreState;

/// P1 in the upper four bits, the ones that the STM32G4 implements.
const MASK_BELOW_P0: u8 = 1 << 4;

struct BelowTick;
critical_section::set_impl!(BelowTick);

// SAFETY: raising BASEPRI to P1 stops every interrupt that may take part in critical sections (all but P0) on this single
// core, and nesting is right because the previous value is restored.
unsafe impl critical_section::Impl for BelowTick {
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        // SAFETY: only masks interrupts; code that must not be preempted follows.
        unsafe {
            basepri::write(if before == 0 { MASK_BELOW_P0 } else { before.min(MASK_BELOW_P0) })
        };
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
        u32::from(before)
    }

    unsafe fn release(before: RawRestoreState) {
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
        // SAFETY: the value was read by `acquire`.
        unsafe { basepri::write(before as u8) };
    }
}
