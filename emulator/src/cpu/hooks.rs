//! What unicorn calls back for: blocks (time), exception returns, bad addresses, the hints WFE, WFI and SEV.

use anyhow::Result;
use unicorn_engine::unicorn_const::{HookType, MemType};
use unicorn_engine::{RegisterARM as R, Unicorn};

use super::exception::get;
use super::image::{FLASH, Image, is_wide};
use super::memory::Memory;
use super::{CCM, CCM_BYTES, Core, Machine, SRAM, SYSTEM_MEMORY, Stop, uc};

/// Instructions in a block, decoded once for each block.
pub(super) struct Lengths {
    regions: [(u32, Memory, Vec<u32>); 3],
}

impl Lengths {
    pub(super) fn new(flash: &Memory, ccm: &Memory, sram: &Memory) -> Lengths {
        let region = |base: u32, m: &Memory| (base, m.clone(), vec![0; m.len() / 2]);
        Lengths { regions: [region(FLASH, flash), region(CCM, ccm), region(SRAM, sram)] }
    }

    pub(super) fn forget_ram(&mut self) {
        for r in &mut self.regions[1..] {
            r.2.fill(0);
        }
    }

    #[inline]
    fn count(&mut self, address: u32, size: u32) -> u64 {
        for (base, memory, cache) in &mut self.regions {
            let offset = address.wrapping_sub(*base) as usize;
            if offset < memory.len() {
                let known = cache[offset / 2];
                if known >> 16 == size {
                    return (known & 0xffff) as u64;
                }
                let (mut at, mut n) = (offset, 0);
                while at < offset + size as usize {
                    at += if is_wide(memory.u16(at)) { 4 } else { 2 };
                    n += 1;
                }
                cache[offset / 2] = size << 16 | n;
                return n as u64;
            }
        }
        (size / 2) as u64
    }
}

impl Machine {
    pub(super) fn add_hooks(u: &mut Unicorn<'static, Core>, image: &Image) -> Result<()> {
        let block = |u: &mut Unicorn<'_, Core>, address: u64, size: u32| {
            let core = u.get_data_mut();
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
            let address = address as u32;
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
