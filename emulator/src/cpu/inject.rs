//! Fault injection into the core.

use anyhow::{Result, bail};
use unicorn_engine::RegisterARM as R;

use super::exception::set;
use super::image::FLASH;
use super::{FLASH_BYTES, Machine};
use crate::time::MICROSECOND;

impl Machine {
    /// Fault injection: sends the core, once it is in thread mode, to another address.
    pub fn derail(&mut self, pc: u32) -> Result<()> {
        for _ in 0..10_000 {
            if self.soc().ipsr == 0 {
                set(&mut self.uc, R::PC, pc | 1);
                return Ok(());
            }
            self.run_for(10 * MICROSECOND)?;
        }
        bail!("the core never reached thread mode")
    }

    /// Fault injection: the core spins for ever with interrupts masked, as after a runaway pointer into a wait loop.
    pub fn derail_into_loop(&mut self) -> Result<()> {
        // `b .` in the last half-word of flash bank 1, which no image uses.
        let last = FLASH_BYTES - 2;
        self.flash.set_u16(last, 0xe7fe);
        set(&mut self.uc, R::PRIMASK, 1);
        self.derail(FLASH + last as u32)
    }
}
