//! What unicorn calls back for: blocks (time), exception returns, bad addresses, the hints WFE, WFI and SEV.

use anyhow::Result;
use unicorn_engine::unicorn_const::{HookType, MemType};
use unicorn_engine::{RegisterARM as R, Unicorn};

use super::exception::get;
use super::image::{FLASH, Image};
use super::{CCM, CCM_BYTES, Core, Machine, SRAM, SYSTEM_MEMORY, Stop, uc};

impl Machine {
    pub(super) fn add_hooks(u: &mut Unicorn<'static, Core>, image: &Image) -> Result<()> {
        let (meter, lengths) = (u.get_data().meter.clone(), u.get_data().lengths.clone());
        let block = move |u: &mut Unicorn<'_, Core>, address: u64, size: u32| {
            let address = address as u32;
            // Nearly always nothing is due: half of a run's time would go by here.
            if let Some(n) = lengths.known(address, size)
                && meter.pass(n)
            {
                return;
            }
            Self::look(u, address, size);
        };
        uc("block hook", u.add_block_hook(FLASH as u64, 0x2002_0000, block))?;
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
        Ok(())
    }

    /// Before a block at which something may be due: leaves translated code, or charges the block.
    fn look(u: &mut Unicorn<'_, Core>, address: u32, size: u32) {
        let core = u.get_data_mut();
        core.settle();
        let soc = &mut core.soc;
        if soc.now >= soc.deadline {
            soc.sync();
        }
        if soc.attention {
            let out =
                soc.wants_out() || soc.nvic.next_exception(crate::periph::nvic::IDLE).is_some();
            if out && (core.soc.wants_out() || due(u).is_some()) {
                u.get_data_mut().stop = Stop::Attention;
                let _ = u.emu_stop();
                return;
            }
        }
        let core = u.get_data_mut();
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
}

/// The exception to take now, with PRIMASK, FAULTMASK and BASEPRI.
pub(super) fn due(u: &Unicorn<'_, Core>) -> Option<u32> {
    let mask = if get(u, R::FAULTMASK) & 1 != 0 {
        -1
    } else if get(u, R::PRIMASK) & 1 != 0 {
        0
    } else {
        match get(u, R::BASEPRI) & 0xf0 {
            0 => crate::periph::nvic::IDLE,
            b => b as i16,
        }
    };
    u.get_data().soc.nvic.next_exception(mask)
}
