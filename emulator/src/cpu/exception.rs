//! Exception entry and return as the core does them (ARM DDI 0403E B1.5.6 to B1.5.8).
//!
//! Unicorn's Cortex-M4 has the registers and recognises EXC_RETURN, but takes no exceptions: frames are built and
//! taken apart here. Floating-point state is stacked eagerly whenever CONTROL.FPCA is set. Left out: frames on the
//! process stack (the firmware has one stack), tail-chaining, the exclusive monitor's clear on entry (STREX compares
//! the value it loaded, which is at least as strict for a single core).

use unicorn_engine::unicorn_const::uc_error;
use unicorn_engine::{RegisterARM as R, Unicorn};

use super::Core;

/// Registers of a basic frame, in order.
const FRAME: [R; 6] = [R::R0, R::R1, R::R2, R::R3, R::R12, R::LR];
/// Cycles from the interrupt to the first instruction of its handler (Cortex-M4 TRM 3.3.4).
pub const ENTRY_CYCLES: u64 = 12;
/// Cycles of a return.
pub const RETURN_CYCLES: u64 = 10;

/// Reads a core register.
#[inline]
pub fn get<D>(uc: &Unicorn<'_, D>, register: R) -> u32 {
    // A register of this core: reading it cannot fail.
    uc.reg_read(register).unwrap_or(0) as u32
}

/// Writes a core register.
#[inline]
pub fn set(uc: &mut Unicorn<'_, Core>, register: R, value: u32) {
    // As above.
    let _ = uc.reg_write(register, value as u64);
}

/// A stack pointer that leads nowhere: the core locks up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadStack(pub u32);

/// Writes a frame. Past unicorn where it lies in RAM, which is most of the cost of its own way.
fn push(uc: &mut Unicorn<'_, Core>, at: u32, bytes: &[u8]) -> Result<(), uc_error> {
    match uc.get_data().ram(at, bytes.len()) {
        Some((memory, offset)) => memory.write(offset, bytes),
        None => uc.mem_write(at as u64, bytes)?,
    }
    Ok(())
}

/// Reads a frame.
fn pop(uc: &Unicorn<'_, Core>, at: u32, bytes: &mut [u8]) -> Result<(), uc_error> {
    match uc.get_data().ram(at, bytes.len()) {
        Some((memory, offset)) => memory.read(offset, bytes),
        None => uc.mem_read(at as u64, bytes)?,
    }
    Ok(())
}

/// Enters the handler of `exception`.
pub fn enter(uc: &mut Unicorn<'_, Core>, exception: u32) -> Result<(), BadStack> {
    let xpsr = get(uc, R::XPSR);
    let control = get(uc, R::CONTROL);
    let fp = control & 4 != 0;
    let in_handler = xpsr & 0x1ff != 0;
    let sp = get(uc, R::SP);
    let size = if fp { 0x68 } else { 0x20 };
    let frame = sp.wrapping_sub(size) & !7;
    let mut bytes = [0u8; 0x68];
    let mut put = |i: usize, v: u32| bytes[4 * i..4 * i + 4].copy_from_slice(&v.to_le_bytes());
    for (i, r) in FRAME.into_iter().enumerate() {
        put(i, get(uc, r));
    }
    put(6, get(uc, R::PC));
    put(7, xpsr & !0x200 | (sp >> 2 & 1) << 9);
    if fp {
        for d in 0..8 {
            let v = uc.reg_read(R::D0 as i32 + d as i32).unwrap_or(0);
            put(8 + 2 * d, v as u32);
            put(9 + 2 * d, (v >> 32) as u32);
        }
        put(24, get(uc, R::FPSCR));
    }
    push(uc, frame, &bytes[..size as usize]).map_err(|_| BadStack(sp))?;
    set(uc, R::SP, frame);
    let lr = match (in_handler, control & 2 != 0) {
        (true, _) => 0xffff_fff1,
        (false, true) => 0xffff_fffd,
        (false, false) => 0xffff_fff9u32,
    };
    set(uc, R::LR, if fp { lr & !0x10 } else { lr });
    if fp {
        set(uc, R::CONTROL, control & !4);
    }
    // Clears ITSTATE, keeps T.
    set(uc, R::EPSR, 1 << 24);
    set(uc, R::IPSR, exception);
    // The one harmless write after which QEMU looks at the mode again; without it EXC_RETURN is not recognised.
    set(uc, R::APSR_NZCV, xpsr & 0xf000_0000);
    let vector = uc.get_data().soc.nvic.vtor + 4 * exception;
    let mut handler = [0; 4];
    uc.mem_read(vector as u64, &mut handler).map_err(|_| BadStack(vector))?;
    set(uc, R::PC, u32::from_le_bytes(handler) | 1);
    let core = uc.get_data_mut();
    core.soc.now += ENTRY_CYCLES * core.soc.cycle();
    core.soc.nvic.enter(exception);
    core.soc.ipsr = exception;
    core.profile.enter(exception, core.soc.instructions, core.soc.now, frame);
    core.soc.attention = core.soc.nvic.any_pending() || core.soc.wants_out();
    Ok(())
}

/// Leaves the running handler; PC holds EXC_RETURN.
pub fn leave(uc: &mut Unicorn<'_, Core>) -> Result<(), BadStack> {
    let exc_return = get(uc, R::PC) | 1;
    let exception = get(uc, R::IPSR) & 0x1ff;
    let sp = get(uc, R::SP);
    let fp = exc_return & 0x10 == 0;
    let size = if fp { 0x68 } else { 0x20 };
    let mut bytes = [0u8; 0x68];
    pop(uc, sp, &mut bytes[..size]).map_err(|_| BadStack(sp))?;
    let word = |i: usize| {
        u32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
    };
    if exc_return & 4 != 0 {
        return Err(BadStack(exc_return));
    }
    if fp {
        for d in 0..8 {
            let v = word(8 + 2 * d) as u64 | (word(9 + 2 * d) as u64) << 32;
            // D registers of this core: cannot fail.
            let _ = uc.reg_write(R::D0 as i32 + d as i32, v);
        }
        set(uc, R::FPSCR, word(24));
    }
    let control = get(uc, R::CONTROL) & !4;
    set(uc, R::CONTROL, control | if fp { 4 } else { 0 });
    for (i, r) in FRAME.into_iter().enumerate() {
        set(uc, r, word(i));
    }
    let xpsr = word(7);
    let aligned = sp + size as u32;
    set(uc, R::SP, if xpsr & 0x200 != 0 { aligned | 4 } else { aligned });
    set(uc, R::IPSR, xpsr & 0x1ff);
    set(uc, R::XPSR_NZCVQG, xpsr & !0x200);
    set(uc, R::APSR_NZCV, xpsr & 0xf000_0000);
    set(uc, R::PC, word(6) | 1);
    let core = uc.get_data_mut();
    core.profile.leave(exception, core.soc.instructions, core.soc.now);
    core.soc.now += RETURN_CYCLES * core.soc.cycle();
    core.soc.nvic.leave(exception);
    core.soc.ipsr = xpsr & 0x1ff;
    core.soc.attention = core.soc.nvic.any_pending() || core.soc.wants_out();
    Ok(())
}
