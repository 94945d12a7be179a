//! The memory map (RM0440 2.2): what lies where, and who answers.

use anyhow::Result;
use unicorn_engine::Unicorn;

use super::memory::Memory;
use super::{Core, Machine, SYSTEM_MEMORY, uc};
use crate::periph::{Soc, flash};

impl Machine {
    pub(super) fn fill_system_memory(system: &Memory, soc: &Soc) {
        system.fill(0xff);
        let word = |at: usize, v: u32| system.write(at, &v.to_le_bytes());
        // Boot loader: a vector table and a loop; entering it ends the run.
        word(0, 0x2000_2000);
        word(4, SYSTEM_MEMORY + 0x101);
        system.set_u16(0x100, 0xe7fe);
        for (i, w) in soc.uid().into_iter().enumerate() {
            word(0x7590 + 4 * i, w);
        }
        // Flash size in KiB; TS_CAL1, VREFINT and TS_CAL2 at 3.0 V (DS12288 3.18).
        system.set_u16(0x75e0, 512);
        system.set_u16(0x75a8, 1037);
        system.set_u16(0x75aa, 1654);
        system.set_u16(0x75ca, 1378);
    }

    pub(super) fn map_registers(u: &mut Unicorn<'static, Core>) -> Result<()> {
        let regions: [(u32, u32); 6] = [
            (0x4000_0000, 0x6000),
            (0x4000_7000, 0x2_9000),
            (0x4800_0000, 0x2000),
            (0x5000_0000, 0x2000),
            (0x5006_0000, 0x1000),
            (0xe000_0000, 0x10_0000),
        ];
        for (base, size) in regions {
            let read = move |u: &mut Unicorn<'_, Core>, offset: u64, size: usize| {
                u.get_data_mut().with_soc(|soc| soc.read(base + offset as u32, size)) as u64
            };
            let write = move |u: &mut Unicorn<'_, Core>, offset: u64, size: usize, value: u64| {
                u.get_data_mut()
                    .with_soc(|soc| soc.write(base + offset as u32, size, value as u32));
            };
            uc("map registers", u.mmio_map(base as u64, size as u64, Some(read), Some(write)))?;
        }
        let read = |u: &mut Unicorn<'_, Core>, offset: u64, size: usize| {
            u.get_data_mut().with_soc(|soc| soc.flash_load(offset as u32, size)) as u64
        };
        let write = |u: &mut Unicorn<'_, Core>, offset: u64, size: usize, value: u64| {
            u.get_data_mut().with_soc(|soc| soc.flash_store(offset as u32, size, value as u32));
        };
        uc(
            "map bank 2",
            u.mmio_map(flash::BANK2 as u64, flash::BANK2_BYTES as u64, Some(read), Some(write)),
        )
    }
}
