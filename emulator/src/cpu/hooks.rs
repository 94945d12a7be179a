//! What unicorn calls back for: blocks (time), exception returns, bad addresses, the hints WFE, WFI and SEV.

use std::ffi::c_void;
use std::rc::Rc;

use anyhow::Result;
use unicorn_engine::hook::sys::{uc_engine, uc_hook, uc_hook_add};
use unicorn_engine::unicorn_const::{HookType, MemType, uc_error};
use unicorn_engine::{RegisterARM as R, Unicorn};

use super::exception::get;
use super::image::{FLASH, Image};
use super::lengths::Lengths;
use super::meter::Meter;
use super::{CCM, CCM_BYTES, Core, Machine, SRAM, SYSTEM_MEMORY, Stop, uc};
use crate::periph::nvic::{IDLE, Nvic};

/// What the block hook needs.
///
/// The hook is unicorn's own, not its Rust wrapper's, which counts references at every block: more than what is to be done there.
pub(super) struct BlockHook {
    meter: Rc<Meter>,
    lengths: Rc<Lengths>,
    core: *mut Core,
    /// The same engine, with nothing attached.
    engine: Unicorn<'static, ()>,
}

/// Before each block.
extern "C" fn block(_: *mut uc_engine, address: u64, size: u32, hook: *mut c_void) {
    // SAFETY: what `add_hooks` makes, which `Machine` keeps as long as the engine.
    let hook = unsafe { &*hook.cast::<BlockHook>() };
    let address = address as u32;
    // Nearly always nothing is due: half of a run's time would go by here.
    if let Some(n) = hook.lengths.known(address, size)
        && hook.meter.pass(n)
    {
        return;
    }
    look(hook, address, size);
}

impl Machine {
    pub(super) fn add_hooks(
        u: &mut Unicorn<'static, Core>,
        image: &Image,
    ) -> Result<Rc<BlockHook>> {
        // SAFETY: the handle is that of a live engine, and `Machine` drops this before it.
        let engine = unsafe { Unicorn::from_handle(u.get_handle()) };
        let hook = Rc::new(BlockHook {
            meter: u.get_data().meter.clone(),
            lengths: u.get_data().lengths.clone(),
            core: std::ptr::from_mut(u.get_data_mut()),
            engine: uc("engine", engine)?,
        });
        let mut id: uc_hook = 0;
        // SAFETY: `block` is what unicorn calls for this kind of hook, with this address, which stays valid.
        let added = unsafe {
            uc_hook_add(
                u.get_handle(),
                &raw mut id,
                HookType::BLOCK.0 as i32,
                block as *mut c_void,
                Rc::as_ptr(&hook).cast_mut().cast(),
                u64::from(FLASH),
                0x2002_0000,
            )
        };
        uc("block hook", if added == uc_error::OK { Ok(()) } else { Err(added) })?;
        let interrupt = |u: &mut Unicorn<'_, Core>, n: u32| {
            u.get_data_mut().stop = match n {
                8 => Stop::ExceptionReturn,
                7 => Stop::Breakpoint,
                2 => Stop::Supervisor,
                _ => Stop::Prefetch,
            };
            let _ = u.emu_stop();
        };
        uc("interrupt hook", u.add_intr_hook(interrupt))?;
        // Not over RAM: unicorn sends every store to a hooked page the slow way.
        for (first, last) in
            [(0, CCM - 1), (CCM + CCM_BYTES as u32, SRAM - 1), (0x2002_0000, u32::MAX)]
        {
            let invalid =
                |u: &mut Unicorn<'_, Core>, _: MemType, address: u64, _: usize, _: i64| {
                    u.get_data_mut().bad_address = Some(address as u32);
                    false
                };
            uc(
                "memory hook",
                u.add_mem_hook(HookType::MEM_INVALID, first as u64, last as u64, invalid),
            )?;
        }
        for (op, stop) in [(0xbf20, Stop::WaitForEvent), (0xbf30, Stop::WaitForInterrupt)] {
            for at in image.hints(op) {
                let wait = move |u: &mut Unicorn<'_, Core>, _: u64, _: u32| {
                    u.get_data_mut().stop = stop;
                    let _ = u.emu_stop();
                };
                uc("wait hook", u.add_code_hook(at as u64, at as u64, wait))?;
            }
        }
        for at in image.hints(0xbf40) {
            let send =
                |u: &mut Unicorn<'_, Core>, _: u64, _: u32| u.get_data_mut().soc.nvic.event = true;
            uc("event hook", u.add_code_hook(at as u64, at as u64, send))?;
        }
        Ok(hook)
    }
}

/// Before a block at which something may be due: leaves translated code, or charges the block. Not inlined, so that the hook itself
/// has no registers to save.
#[cold]
#[inline(never)]
fn look(hook: &BlockHook, address: u32, size: u32) {
    // SAFETY: it lies in the engine that calls this, at the same place as long as that lives; nobody holds a reference to it
    // while translated code runs.
    let core = unsafe { &mut *hook.core };
    let mut u = hook.engine.clone();
    core.settle();
    let soc = &mut core.soc;
    if soc.now >= soc.deadline {
        soc.sync();
    }
    if soc.attention {
        let out = soc.wants_out()
            || soc.nvic.next_exception(IDLE).is_some() && due(&u, &soc.nvic).is_some();
        if out {
            core.stop = Stop::Attention;
            let _ = u.emu_stop();
            return;
        }
    }
    if address >> 16 == SYSTEM_MEMORY >> 16 {
        core.stop = Stop::Bootloader;
        let _ = u.emu_stop();
        return;
    }
    let n = core.lengths.count(address, size);
    core.soc.instructions += n;
    core.soc.now += n * core.soc.insn_unit;
    if core.profile.watching() {
        *core.profile.blocks.entry((address, size)).or_insert(0) += 1;
    }
    core.grant();
}

/// The exception to take now, with PRIMASK, FAULTMASK and BASEPRI.
pub(super) fn due<D>(u: &Unicorn<'_, D>, nvic: &Nvic) -> Option<u32> {
    let mask = if get(u, R::FAULTMASK) & 1 != 0 {
        -1
    } else if get(u, R::PRIMASK) & 1 != 0 {
        0
    } else {
        match get(u, R::BASEPRI) & 0xf0 {
            0 => IDLE,
            b => b as i16,
        }
    };
    nvic.next_exception(mask)
}
