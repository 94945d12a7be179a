//! Fault injection into the core.

use anyhow::{Context, Result, bail};
use unicorn_engine::RegisterARM as R;

use super::exception::{get, set};
use super::image::FLASH;
use super::{FLASH_BYTES, Machine};
use crate::time::{MICROSECOND, Time};

/// Part of the name of `core::panicking::panic(message, &location)`, in both manglings.
const CORE_PANIC: &str = "9panicking5panic";
/// Tasks run at this priority and below it (docs/board.md).
const TASKS: i16 = 0x60;
/// RAM that no image uses: they have 64 of 96 KiB.
const SCRATCH: u32 = 0x2001_7000;

impl Machine {
    /// Fault injection: sends the core, once it is in a task, to another address.
    pub fn derail(&mut self, pc: u32) -> Result<()> {
        for _ in 0..100_000 {
            let soc = self.soc();
            if soc.ipsr >= 16 && soc.nvic.priority_of(soc.ipsr) >= TASKS {
                self.derailed_from = get(&self.uc, R::PC) & !1;
                set(&mut self.uc, R::PC, pc | 1);
                return Ok(());
            }
            self.run_for(MICROSECOND)?;
        }
        bail!("no task has run for 0.1 s")
    }

    /// Fault injection: a task panics as Rust code does, by a call of `core::panicking::panic` with a message and a place.
    pub fn panic(&mut self, message: &str, file: &str, line: u32) -> Result<()> {
        let function = self.image().symbol_with(CORE_PANIC);
        let function = function.context("the image has no core::panicking::panic")?;
        let place = SCRATCH + 0x400;
        let path = SCRATCH + 0x800;
        self.write_memory(SCRATCH, message.as_bytes())?;
        self.write_memory(path, file.as_bytes())?;
        // core::panic::Location: file name (address, length), line, column.
        let location = [path, file.len() as u32, line, 5].map(u32::to_le_bytes).concat();
        self.write_memory(place, &location)?;
        self.derail(function)?;
        for (register, value) in [(R::R0, SCRATCH), (R::R1, message.len() as u32), (R::R2, place)] {
            set(&mut self.uc, register, value);
        }
        Ok(())
    }

    /// Fault injection: the core spins for ever with interrupts masked, as after a runaway pointer into a wait loop.
    pub fn derail_into_loop(&mut self) -> Result<()> {
        self.derail_task_into_loop()?;
        set(&mut self.uc, R::PRIMASK, 1);
        Ok(())
    }

    /// Fault injection: a task spins for ever, and no other task runs again. What interrupts it goes on.
    pub fn derail_task_into_loop(&mut self) -> Result<()> {
        // `b .` in the last half-word of flash bank 1, which no image uses.
        let last = FLASH_BYTES - 2;
        self.flash.set_u16(last, 0xe7fe);
        self.derail(FLASH + last as u32)
    }

    /// Fault injection: a task spins for so long, and no other task runs meanwhile; then it goes on where it was.
    pub fn hold_task(&mut self, time: Time) -> Result<()> {
        // As `derail` finds it.
        self.derail_task_into_loop()?;
        let (spinning, task) = (get(&self.uc, R::PC) & !1, self.soc().ipsr);
        let place = self.derailed_from;
        self.run_for(time)?;
        for _ in 0..100_000 {
            if self.soc().ipsr == task && get(&self.uc, R::PC) & !1 == spinning {
                set(&mut self.uc, R::PC, place | 1);
                return Ok(());
            }
            self.run_for(MICROSECOND)?;
        }
        bail!("the task does not spin any more")
    }
}
