//! The core: executes the firmware's own instructions with unicorn, one virtual cycle each, and takes exceptions.
//!
//! A block hook adds the instruction count of every translated block to virtual time, wherever the code lies (flash,
//! SRAM, CCM), and leaves translated code before a block when an exception is due. WFE, WFI and SEV are hooked at
//! their addresses; sleeping jumps to the next deadline. Interrupts are therefore taken at block boundaries, a few
//! instructions late at most, and a timer that is read inside a block has that granularity. Nothing models flash
//! wait states, bus contention or the pipeline.

pub mod exception;
mod hooks;
pub mod image;
mod inject;
mod lengths;
mod map;
pub mod memory;
mod meter;
mod pages;
pub mod profile;

use std::rc::Rc;

use anyhow::{Context, Result, anyhow, bail};
use unicorn_engine::unicorn_const::{Arch, Mode, Prot, uc_error};
use unicorn_engine::{RegisterARM as R, Unicorn};

use crate::periph::nvic::exception as number;
use crate::periph::{Analog, ResetCause, Soc};
use crate::rtt::Rtt;
use crate::time::{MILLISECOND, NEVER, Time};
use exception::{get, set};
use hooks::{BlockHook, due};
use image::{FLASH, Image};
use lengths::Lengths;
use memory::Memory;
use meter::Meter;
use profile::Profile;

const CORTEX_M4: i32 = 9;
/// Not the core's 1 KiB: blocks are linked to each other, and not looked up, within a page only.
const PAGE: u32 = 4096;
const FLASH_BYTES: usize = 256 * 1024;
const SRAM: u32 = 0x2000_0000;
const SRAM_BYTES: usize = 96 * 1024;
const CCM: u32 = 0x1000_0000;
const CCM_BYTES: usize = 32 * 1024;
/// The ROM boot loader (RM0440 2.6; AN2606 section on STM32G47xxx).
const SYSTEM_MEMORY: u32 = 0x1fff_0000;
const SYSTEM_BYTES: usize = 32 * 1024;
/// What RAM holds after power-on; also how the untouched part of the stack is recognised.
const PAINT: u8 = 0xc5;
/// How often logs are fetched.
const DRAIN: Time = 10 * MILLISECOND;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    Attention,
    WaitForEvent,
    WaitForInterrupt,
    ExceptionReturn,
    Supervisor,
    Breakpoint,
    Bootloader,
    Prefetch,
}

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The time asked for has come.
    Time,
    /// Power was cut at the flash operation asked for.
    PowerLost,
    /// The ROM boot loader was entered (USB DFU).
    Bootloader,
    /// The chip reset itself and runs on.
    Reset(ResetCause),
}

/// What unicorn's hooks share.
pub struct Core {
    /// The chip around the core.
    pub soc: Soc,
    /// Costs.
    pub profile: Profile,
    stop: Stop,
    meter: Rc<Meter>,
    lengths: Rc<Lengths>,
    sram: Memory,
    ccm: Memory,
    bad_address: Option<u32>,
}

/// A powered board: chip, plant and host.
pub struct Machine {
    /// Refers to `uc` and is dropped first.
    _block_hook: Rc<BlockHook>,
    uc: Unicorn<'static, Core>,
    image: Rc<Image>,
    flash: Memory,
    sram: Memory,
    ccm: Memory,
    _system: Memory,
    /// Log messages.
    pub rtt: Rtt,
    next_drain: Time,
    /// Resets since power-on: when and why.
    pub resets: Vec<(Time, ResetCause)>,
    /// Times the core left translated code.
    pub stops: u64,
    /// Nothing wakes the core but an interrupt: the last handler has returned with SCR.SLEEPONEXIT set.
    asleep: bool,
    /// Where the last task was that was sent elsewhere.
    derailed_from: u32,
}

fn uc<T>(what: &str, r: std::result::Result<T, uc_error>) -> Result<T> {
    r.map_err(|e| anyhow!("unicorn: {what}: {e:?}"))
}

impl Machine {
    /// Powers a board with `image` in flash bank 1; the core stands at its reset vector.
    pub fn new(image: Rc<Image>, analog: Box<dyn Analog>, hse_hz: u64) -> Result<Machine> {
        let (flash, sram, ccm) =
            (Memory::new(FLASH_BYTES), Memory::new(SRAM_BYTES), Memory::new(CCM_BYTES));
        let (packets, system) = (Memory::new(4096), Memory::new(SYSTEM_BYTES));
        flash.fill(0xff);
        for (at, bytes) in &image.segments {
            flash.write((at - FLASH) as usize, bytes);
        }
        let soc = Soc::new(analog, packets.clone(), hse_hz);
        Self::fill_system_memory(&system, &soc);
        let core = Core {
            soc,
            profile: Profile::default(),
            stop: Stop::Attention,
            meter: Rc::new(Meter::default()),
            lengths: Rc::new(Lengths::new(&flash, &ccm, &sram)),
            sram: sram.clone(),
            ccm: ccm.clone(),
            bad_address: None,
        };
        // Mode::MCLASS would make it a Cortex-M33, whatever the model.
        let mut u = uc("create", Unicorn::new_with_data(Arch::ARM, Mode::THUMB, core))?;
        uc("cpu model", u.ctl_set_cpu_model(CORTEX_M4))?;
        uc("page size", u.ctl_set_page_size(PAGE))?;
        let read_exec = Prot(Prot::READ.0 | Prot::EXEC.0);
        let read_write = Prot(Prot::READ.0 | Prot::WRITE.0);
        // SAFETY: every block outlives its mapping: `Machine` keeps all of them (the chip the packet memory), and
        // unicorn, dropped with `Machine`, is declared first.
        let mut map = |at: u32, memory: &Memory, from: usize, len: usize, prot: Prot| unsafe {
            uc(
                "map memory",
                u.mem_map_ptr(at as u64, len as u64, prot, memory.pointer().byte_add(from)),
            )
        };
        map(FLASH, &flash, 0, FLASH_BYTES, read_exec)?;
        map(0, &flash, 0, FLASH_BYTES, read_exec)?;
        map(SYSTEM_MEMORY, &system, 0, SYSTEM_BYTES, read_exec)?;
        map(0x4000_6000, &packets, 0, 4096, read_write)?;
        map(SRAM + SRAM_BYTES as u32, &ccm, 0, CCM_BYTES, read_write)?;
        map(SRAM, &sram, 0, SRAM_BYTES, Prot::ALL)?;
        map(CCM, &ccm, 0, CCM_BYTES, Prot::ALL)?;
        Self::map_registers(&mut u)?;
        Self::add_pages(&mut u, &image)?;
        let block_hook = Self::add_hooks(&mut u, &image)?;
        let rtt = Rtt::new(&image)?;
        let mut m = Machine {
            _block_hook: block_hook,
            uc: u,
            image,
            flash,
            sram,
            ccm,
            _system: system,
            rtt,
            next_drain: 0,
            resets: Vec::new(),
            stops: 0,
            asleep: false,
            derailed_from: 0,
        };
        m.power_on(None);
        Ok(m)
    }

    /// The chip and everything around it.
    pub fn soc(&self) -> &Soc {
        &self.uc.get_data().soc
    }

    /// The chip and everything around it.
    pub fn soc_mut(&mut self) -> &mut Soc {
        &mut self.uc.get_data_mut().soc
    }

    /// Handler costs.
    pub fn profile(&mut self) -> &mut Profile {
        &mut self.uc.get_data_mut().profile
    }

    /// The firmware.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Now.
    pub fn now(&self) -> Time {
        self.soc().now
    }

    /// RAM loses its contents (to a pattern, or to noise from a seed) and the chip starts.
    pub fn power_on(&mut self, noise: Option<u64>) {
        for memory in [&self.sram, &self.ccm] {
            memory.fill(PAINT);
            if let Some(mut x) = noise.map(|s| s | 1) {
                for at in (0..memory.len()).step_by(8) {
                    x ^= x << 13;
                    x ^= x >> 7;
                    x ^= x << 17;
                    memory.write(at, &x.to_le_bytes());
                }
            }
        }
        self.reset(ResetCause::PowerOn);
    }

    /// Resets the chip; RAM keeps its contents.
    pub fn reset(&mut self, cause: ResetCause) {
        let now = self.now();
        self.asleep = false;
        self.drain();
        self.resets.push((now, cause));
        let core = self.uc.get_data_mut();
        core.soc.reset(cause);
        core.soc.ipsr = 0;
        core.profile.reset();
        core.lengths.forget_ram();
        let _ = self.uc.ctl_flush_tb();
        let registers = [
            R::R0,
            R::R1,
            R::R2,
            R::R3,
            R::R4,
            R::R5,
            R::R6,
            R::R7,
            R::R8,
            R::R9,
            R::R10,
            R::R11,
            R::R12,
        ];
        for r in registers {
            set(&mut self.uc, r, 0);
        }
        for r in [R::CONTROL, R::PRIMASK, R::BASEPRI, R::FAULTMASK, R::FPSCR] {
            set(&mut self.uc, r, 0);
        }
        set(&mut self.uc, R::EPSR, 1 << 24);
        set(&mut self.uc, R::IPSR, 0);
        set(&mut self.uc, R::APSR_NZCV, 0);
        set(&mut self.uc, R::LR, 0xffff_ffff);
        set(&mut self.uc, R::SP, self.flash.u32(0));
        set(&mut self.uc, R::PC, self.flash.u32(4) | 1);
    }

    /// Runs for so long, or to the event that ends it.
    pub fn run_for(&mut self, time: Time) -> Result<Event> {
        self.run_until(self.now() + time)
    }

    /// Runs to a time, or to the event that ends it.
    pub fn run_until(&mut self, until: Time) -> Result<Event> {
        loop {
            let slice = until.min(self.next_drain.max(self.now() + 1));
            match self.run_slice(slice)? {
                Event::Time if self.now() >= self.next_drain => {
                    self.drain();
                    self.next_drain = self.now() + DRAIN;
                    if self.now() >= until {
                        return Ok(Event::Time);
                    }
                }
                Event::Time if self.now() < until => {}
                event => {
                    self.drain();
                    return Ok(event);
                }
            }
        }
    }

    fn drain(&mut self) {
        let now = self.now();
        self.rtt.drain(&self.image, &self.sram, SRAM, now);
    }

    fn run_slice(&mut self, until: Time) -> Result<Event> {
        self.soc_mut().stop_at = until;
        self.soc_mut().sync();
        loop {
            let soc = self.soc_mut();
            if soc.now >= soc.deadline {
                soc.sync();
            }
            if soc.wants_out() {
                if soc.flash.power_lost {
                    return Ok(Event::PowerLost);
                }
                if soc.watchdog_reset {
                    self.reset(ResetCause::Watchdog);
                    return Ok(Event::Reset(ResetCause::Watchdog));
                }
                if soc.nvic.reset_request {
                    self.reset(ResetCause::Software);
                    return Ok(Event::Reset(ResetCause::Software));
                }
                if soc.now >= until {
                    soc.stop_at = NEVER;
                    return Ok(Event::Time);
                }
            }
            if self.asleep {
                self.asleep = !self.sleep(until);
                continue;
            }
            if self.soc().nvic.any_pending()
                && let Some(n) = due(&self.uc, &self.soc().nvic)
            {
                exception::enter(&mut self.uc, n)
                    .map_err(|b| self.lockup(&format!("bad stack {:#010x}", b.0)))?;
                continue;
            }
            let pc = get(&self.uc, R::PC);
            self.stops += 1;
            self.uc.get_data_mut().grant();
            // `until` 0 is never reached and costs no invalidation.
            let ended = self.uc.emu_start(pc as u64 | 1, 0, 0, 0);
            self.uc.get_data_mut().settle();
            if let Err(error) = ended {
                self.fault(error)?;
                continue;
            }
            match self.uc.get_data().stop {
                Stop::Attention => {}
                Stop::ExceptionReturn => {
                    exception::leave(&mut self.uc)
                        .map_err(|b| self.lockup(&format!("bad return {:#010x}", b.0)))?;
                    if self.soc().nvic.sleep_on_exit() && self.soc().ipsr == 0 {
                        self.asleep = true;
                    }
                }
                stop @ (Stop::WaitForEvent | Stop::WaitForInterrupt) => {
                    self.step_over(2);
                    let nvic = &mut self.soc_mut().nvic;
                    if stop == Stop::WaitForEvent && std::mem::take(&mut nvic.event) {
                        continue;
                    }
                    if !self.sleep(until) {
                        // Time is up: the wait is executed again when the run goes on.
                        let pc = get(&self.uc, R::PC);
                        set(&mut self.uc, R::PC, (pc - 2) | 1);
                    }
                }
                Stop::Supervisor => self.soc_mut().nvic.pend(number::SV_CALL),
                Stop::Breakpoint => self.raise(number::HARD_FAULT, 0, None)?,
                Stop::Prefetch => self.raise(number::BUS_FAULT, 1 << 8, None)?,
                Stop::Bootloader => return Ok(Event::Bootloader),
            }
        }
    }

    fn step_over(&mut self, bytes: u32) {
        let pc = get(&self.uc, R::PC);
        set(&mut self.uc, R::PC, (pc + bytes) | 1);
    }

    /// Sleeps to the next exception that would wake the core; false when `until` comes first.
    fn sleep(&mut self, until: Time) -> bool {
        let soc = self.soc_mut();
        loop {
            if soc.nvic.would_wake() {
                return true;
            }
            if soc.wants_out() || soc.now >= until {
                return false;
            }
            soc.skip();
        }
    }

    fn fault(&mut self, error: uc_error) -> Result<()> {
        let address = self.uc.get_data_mut().bad_address.take();
        let pc = get(&self.uc, R::PC) & !1;
        match error {
            uc_error::INSN_INVALID => {
                let mut op = [0; 2];
                let _ = self.uc.mem_read(pc as u64, &mut op);
                // YIELD is a hint that unicorn does not know.
                if op == [0x10, 0xbf] {
                    self.step_over(2);
                    return Ok(());
                }
                self.raise(number::USAGE_FAULT, 1 << 16, None)
            }
            uc_error::FETCH_UNMAPPED | uc_error::FETCH_PROT => {
                self.raise(number::BUS_FAULT, 1 << 8, None)
            }
            uc_error::READ_UNMAPPED
            | uc_error::WRITE_UNMAPPED
            | uc_error::READ_PROT
            | uc_error::WRITE_PROT => self.raise(number::BUS_FAULT, 1 << 9 | 1 << 15, address),
            uc_error::READ_UNALIGNED | uc_error::WRITE_UNALIGNED | uc_error::FETCH_UNALIGNED => {
                self.raise(number::USAGE_FAULT, 1 << 24, address)
            }
            other => bail!("unicorn stopped with {other:?} at {}", self.place(pc)),
        }
    }

    fn raise(&mut self, kind: u32, cfsr: u32, address: Option<u32>) -> Result<()> {
        match self.soc_mut().nvic.fault(kind, cfsr, address) {
            Some(n) => exception::enter(&mut self.uc, n)
                .map_err(|b| self.lockup(&format!("bad stack {:#010x}", b.0))),
            None => Err(self.lockup("a fault in a fault handler")),
        }
    }

    /// The core stops for good: nothing but a reset would help it.
    fn lockup(&self, why: &str) -> anyhow::Error {
        let (cfsr, hfsr, bfar) = self.soc().nvic.fault_status();
        let pc = get(&self.uc, R::PC) & !1;
        let lr = get(&self.uc, R::LR) & !1;
        anyhow!(
            "lockup: {why}; pc {}, lr {}, CFSR {cfsr:#010x}, HFSR {hfsr:#010x}, BFAR {bfar:#010x}, at {:.3} ms",
            self.place(pc),
            self.place(lr),
            crate::time::milliseconds(self.now())
        )
    }

    fn place(&self, address: u32) -> String {
        match self.image.function_at(address) {
            Some((name, offset)) => format!("{address:#010x} ({name} + {offset:#x})"),
            None => format!("{address:#010x}"),
        }
    }

    /// Where the core is.
    pub fn location(&self) -> String {
        self.place(get(&self.uc, R::PC) & !1)
    }

    /// Reads memory as a debugger would.
    pub fn read_memory(&self, address: u32, bytes: &mut [u8]) -> Result<()> {
        uc("read", self.uc.mem_read(address as u64, bytes))
            .with_context(|| format!("{address:#010x}"))
    }

    /// Writes memory as a debugger would.
    pub fn write_memory(&mut self, address: u32, bytes: &[u8]) -> Result<()> {
        uc("write", self.uc.mem_write(address as u64, bytes))
            .with_context(|| format!("{address:#010x}"))
    }

    /// Bytes of stack ever used since power-on, out of those between the end of the statics and the start of the
    /// stack: the painted part that is still untouched is not used.
    pub fn stack_use(&self) -> Option<(usize, usize)> {
        let top = self.image.symbol("_stack_start")?;
        let end = ["_stack_end", "__euninit", "__ebss"]
            .iter()
            .find_map(|n| self.image.symbol(n))?
            .next_multiple_of(8);
        let (memory, base) = if top > SRAM { (&self.sram, SRAM) } else { (&self.ccm, CCM) };
        let room = top.checked_sub(end)? as usize;
        // Our paint, or the firmware's own where it paints its stack itself.
        let from = (end - base) as usize;
        let paint = memory.u32(from);
        let words = (0..room / 4).take_while(|i| memory.u32(from + 4 * i) == paint).count();
        let untouched = if words > 1 { 4 * words } else { 0 };
        Some((room - untouched, room))
    }
}
