//! How much of the stack was ever used.
//!
//! The stack lies at the bottom of the CCM SRAM (memory.x): an overflow leaves the RAM and faults instead of overwriting data. It is
//! painted at start; what still shows the paint was never used.

const PAINT: u32 = 0x5ac3_5ac3;
/// Bytes below the stack pointer that are left alone while painting.
const MARGIN: usize = 256;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Paints what is not in use now.
pub fn paint() {
    let bottom = &raw const _stack_end as usize;
    let top = (cortex_m::register::msp::read() as usize).saturating_sub(MARGIN);
    for address in (bottom..top).step_by(4) {
        // SAFETY: between the end of the stack and well below the stack pointer; no interrupt is enabled yet.
        unsafe { (address as *mut u32).write_volatile(PAINT) };
    }
}

/// Bytes that were never used.
pub fn unused() -> u32 {
    let bottom = &raw const _stack_end as usize;
    let top = &raw const _stack_start as usize;
    (bottom..top)
        .step_by(4)
        // SAFETY: the stack's own memory; reading it has no effect.
        .take_while(|address| unsafe { (*address as *const u32).read_volatile() } == PAINT)
        .count() as u32
        * 4
}
