//! What may be done with a page, told to unicorn page by page.
//!
//! Left to itself, unicorn takes all RAM for executable, as the architecture's default map does, and has to look for
//! translated code behind every single store: half of the time of a run. So it asks here instead, and is told that only
//! pages with code of the image in them execute.

use anyhow::Result;
use unicorn_engine::unicorn_const::{MemType, Prot, TlbEntry, TlbType};
use unicorn_engine::{RegisterARM as R, Unicorn};

use super::exception::set;
use super::image::Image;
use super::{CCM, CCM_BYTES, Core, Machine, SRAM, SRAM_BYTES, uc};

impl Machine {
    pub(super) fn add_pages(u: &mut Unicorn<'static, Core>, image: &Image) -> Result<()> {
        let page = uc("page size", u.ctl_get_page_size())?;
        let code = |base: u32, bytes: usize| -> Vec<bool> {
            (0..bytes as u32 / page).map(|i| image.runs_code(base + i * page, page)).collect()
        };
        let (sram, ccm) = (code(SRAM, SRAM_BYTES), code(CCM, CCM_BYTES));
        uc("page table", u.ctl_set_tlb_type(TlbType::VIRTUAL))?;
        let fill = move |u: &mut Unicorn<'_, Core>, address: u64, access: MemType| {
            // When a load or store within an IT block has to ask, unicorn puts ITSTATE back as it was before the
            // instruction, and leaves it there: the next block would be translated as if it began inside that IT
            // block. Translated code keeps it at 0 but at the ends of blocks, so that is what it has to be here.
            if access != MemType::FETCH {
                set(u, R::EPSR, 1 << 24);
            }
            let at = address as u32;
            let ram = |base: u32, pages: &[bool]| {
                pages.get((at.wrapping_sub(base) / page) as usize).copied()
            };
            let executes = ram(SRAM, &sram).or_else(|| ram(CCM, &ccm)).unwrap_or(at < SRAM);
            let perms = if executes || access == MemType::FETCH {
                Prot::ALL
            } else {
                Prot(Prot::READ.0 | Prot::WRITE.0)
            };
            Some(TlbEntry { paddr: address, perms })
        };
        // From 1 to 0: everywhere.
        uc("page hook", u.add_tlb_hook(1, 0, fill))?;
        Ok(())
    }
}
