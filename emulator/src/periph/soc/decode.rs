//! Loads and stores: which peripheral an address belongs to (RM0440 2.2.2), and the few registers that have no other home.

use super::Soc;
use crate::periph::adc::{Adc, AdcCommon};
use crate::periph::dac::Dac;
use crate::periph::gpio::Gpio;
use crate::periph::tim::Timer;
use crate::periph::usb::Usb;
use crate::time::MILLISECOND;

impl Soc {
    /// A peripheral read of `size` bytes.
    pub fn read(&mut self, address: u32, size: usize) -> u32 {
        self.accesses += 1;
        let word = self.read_word(address & !3);
        let v = word >> ((address & 3) * 8);
        match size {
            1 => v & 0xff,
            2 => v & 0xffff,
            _ => v,
        }
    }

    fn gated(&mut self, address: u32) -> bool {
        if self.rcc.is_clocked(address) {
            return false;
        }
        self.violations
            .insert(format!("access to {:#010x}.. while its clock is off", address & !0x3ff));
        true
    }

    fn read_word(&mut self, a: u32) -> u32 {
        let now = self.now;
        if now >= self.deadline {
            self.sync();
        }
        match a {
            0xe000_1004 => return self.cyccnt(),
            0xe000_1000 => return 0x4000_0000 | self.dwt_on as u32,
            0xe000_e000..=0xe000_efff => return self.nvic.read(a & 0xfff, now, self.ipsr),
            0xe004_2000 => return 0x2019_6469,
            _ => {}
        }
        if self.gated(a) {
            return 0;
        }
        let o = a & 0x3ff;
        match a {
            0x4000_0000..=0x4000_17ff => self.tim[(a >> 10 & 7) as usize].read(o, now),
            0x4000_3000..=0x4000_33ff => self.iwdg.read(o),
            0x4000_5c00..=0x4000_5fff => self.usb.read(o, (now / MILLISECOND) as u32),
            // PWR_SR2: PVDO follows the supply; the regulator is always ready.
            0x4000_7014 => (self.brown as u32) << 11,
            0x4002_1000..=0x4002_13ff => self.rcc.read(o),
            0x4002_2000..=0x4002_23ff => self.flash.read(o),
            0x4800_0000..=0x4800_1bff => {
                let port = (a >> 10 & 7) as usize;
                self.gpio[port].read(o, self.analog.inputs(port))
            }
            0x5000_0000..=0x5000_07ff => {
                let (pair, slot) = ((a >> 10 & 1) as usize, (o >> 8) as usize);
                match slot {
                    3 => self.common[pair].read(o & 0xff),
                    s => self.adc[pair * 2 + s].read(o & 0xff),
                }
            }
            0x5000_0800..=0x5000_0fff => self.dac[(a >> 10 & 1) as usize].read(o),
            _ => {
                self.plain_registers.insert((a, false));
                self.plain.get(&a).copied().unwrap_or(if a == 0x4000_7080 { 0x100 } else { 0 })
            }
        }
    }

    /// A peripheral write of `size` bytes.
    pub fn write(&mut self, address: u32, size: usize, value: u32) {
        self.accesses += 1;
        let now = self.now;
        if now >= self.deadline {
            self.sync();
        }
        let a = address & !3;
        match address {
            0xe000_1000 => return self.set_dwt(value & 1 != 0, None),
            0xe000_1004 => return self.set_dwt(self.dwt_on, Some(value)),
            0xe000_e000..=0xe000_efff => {
                self.nvic.write(address & 0xfff, size, value, now);
                self.find_deadline();
                return;
            }
            _ => {}
        }
        if self.gated(a) {
            return;
        }
        let o = a & 0x3ff;
        match a {
            0x4000_0000..=0x4000_17ff => {
                let i = (a >> 10 & 7) as usize;
                self.tim[i].write(o, value, now);
                if i == 4
                    && let Some(at) = self.tim[4].take_trgo()
                {
                    self.trigger(at);
                }
            }
            0x4000_3000..=0x4000_33ff => {
                self.iwdg.write(o, value, now);
                if self.iwdg.running() {
                    self.rcc.lsi_on();
                }
            }
            0x4000_5c00..=0x4000_5fff => {
                if !self.rcc.usb_clocked() {
                    self.violations.insert("USB is used without its 48 MHz clock (HSI48)".into());
                }
                self.usb.write(o, value);
                self.stack.update(now, &mut self.usb);
            }
            0x4002_1000..=0x4002_13ff => {
                let reset = self.rcc.write(o, value);
                if let Some((start, _)) = reset {
                    self.reset_peripheral(start);
                }
                if o <= 0x0c {
                    self.clocks_changed();
                }
            }
            0x4002_2000..=0x4002_23ff => self.flash.write(o, value, now),
            0x4800_0000..=0x4800_1bff => {
                let port = (a >> 10 & 7) as usize;
                if self.gpio[port].write(o, value) {
                    self.pins(port);
                }
            }
            0x5000_0000..=0x5000_07ff => {
                let (pair, slot) = ((a >> 10 & 1) as usize, (o >> 8) as usize);
                let ahb = self.ahb;
                match slot {
                    3 => self.common[pair].write(o & 0xff, value),
                    s => {
                        self.adc[pair * 2 + s].write(o & 0xff, value, now, &self.common[pair], ahb);
                        // ISR: flags are cleared, which moves no event.
                        if o & 0xff == 0 {
                            self.lines();
                            self.attention |= self.nvic.any_pending();
                            return;
                        }
                    }
                }
            }
            0x5000_0800..=0x5000_0fff => {
                if self.dac[(a >> 10 & 1) as usize].write(o, value) {
                    self.drive();
                }
                return;
            }
            _ => {
                self.plain_registers.insert((a, true));
                let shift = (address & 3) * 8;
                let mask = if size >= 4 { u32::MAX } else { ((1 << (8 * size)) - 1) << shift };
                let word = self.plain.entry(a).or_insert(0);
                *word = *word & !mask | (value << shift) & mask;
                return;
            }
        }
        self.sync();
    }

    fn set_dwt(&mut self, on: bool, count: Option<u32>) {
        let value = count.unwrap_or_else(|| self.cyccnt());
        self.dwt_on = on;
        self.cyccnt_base = (self.now, value);
    }

    fn reset_peripheral(&mut self, start: u32) {
        match start {
            0x4000_0000..=0x4000_17ff => {
                let i = (start >> 10 & 7) as usize;
                self.tim[i] = Timer::new(if matches!(i, 0 | 3) { u32::MAX } else { 0xffff });
                self.tim[i].set_clock(self.now, self.ahb);
            }
            0x4000_5c00 => self.usb = Usb::new(self.usb.memory.clone()),
            0x5000_0000 | 0x5000_0400 => {
                let pair = (start >> 10 & 1) as usize;
                self.common[pair] = AdcCommon::default();
                let range = if pair == 0 { 0..2 } else { 2..5 };
                for i in range {
                    let dead = self.adc[i].dead;
                    self.adc[i] = Adc::new(i as u8 + 1);
                    self.adc[i].dead = dead;
                }
            }
            0x5000_0800 | 0x5000_0c00 => {
                self.dac[(start >> 10 & 1) as usize] = Dac::default();
                self.drive();
            }
            0x4800_0000..=0x4800_1bff => {
                let port = (start >> 10 & 7) as usize;
                self.gpio[port] = Gpio::new(port);
                self.pins(port);
            }
            _ => {}
        }
    }

    /// Waits, as the core does, until bank 2 is free.
    pub fn wait_for_flash(&mut self) {
        let wait = self.flash.stall(self.now);
        if wait > 0 {
            self.now += wait;
            self.sync();
        }
    }

    /// A load from bank 2.
    pub fn flash_load(&mut self, offset: u32, size: usize) -> u32 {
        self.wait_for_flash();
        let v = self.flash.load(offset, size);
        if self.flash.nmi {
            self.sync();
        }
        v
    }

    /// A store to bank 2.
    pub fn flash_store(&mut self, offset: u32, size: usize, value: u32) {
        self.wait_for_flash();
        self.flash.store(offset, size, value, self.now);
        self.sync();
    }
}
