//! The core: executes the firmware's own instructions with unicorn, one virtual cycle each, and takes exceptions.
//!
//! A block hook adds the instruction count of every translated block to virtual time, wherever the code lies (flash,
//! SRAM, CCM), and leaves translated code before a block when an exception is due. WFE, WFI and SEV are hooked at
//! their addresses; sleeping jumps to the next deadline. Interrupts are therefore taken at block boundaries, a few
//! instructions late at most, and a timer that is read inside a block has that granularity. Nothing models flash
//! wait states, bus contention or the pipeline.

pub mod exception;
pub mod image;
pub mod memory;
pub mod profile;

use std::rc::Rc;

use anyhow::{Context, Result, anyhow, bail};
use unicorn_engine::unicorn_const::{
    Arch, HookType, MemType, Mode, Prot, TlbEntry, TlbType, uc_error,
};
use unicorn_engine::{RegisterARM as R, Unicorn};

use crate::periph::nvic::exception as number;
use crate::periph::{Analog, ResetCause, Soc, flash};
use crate::rtt::Rtt;
use crate::time::{MICROSECOND, MILLISECOND, NEVER, Time};
use exception::{get, set};
use image::{FLASH, Image, is_wide};
use memory::Memory;
use profile::Profile;

const CORTEX_M4: i32 = 9;
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
    lengths: Lengths,
    bad_address: Option<u32>,
}

/// Instructions in a block, decoded once for each block.
struct Lengths {
    regions: [(u32, Memory, Vec<u32>); 3],
}

impl Lengths {
    fn new(flash: &Memory, ccm: &Memory, sram: &Memory) -> Lengths {
        let region = |base: u32, m: &Memory| (base, m.clone(), vec![0; m.len() / 2]);
        Lengths { regions: [region(FLASH, flash), region(CCM, ccm), region(SRAM, sram)] }
    }

    fn forget_ram(&mut self) {
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

/// A powered board: chip, plant and host.
pub struct Machine {
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
            lengths: Lengths::new(&flash, &ccm, &sram),
            bad_address: None,
        };
        // Mode::MCLASS would make it a Cortex-M33, whatever the model.
        let mut u = uc("create", Unicorn::new_with_data(Arch::ARM, Mode::THUMB, core))?;
        uc("cpu model", u.ctl_set_cpu_model(CORTEX_M4))?;
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
        Self::add_tlb(&mut u, &image)?;
        Self::map_registers(&mut u)?;
        Self::add_hooks(&mut u, &image)?;
        let rtt = Rtt::new(&image)?;
        let mut m = Machine {
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
        };
        m.power_on(None);
        Ok(m)
    }

    fn fill_system_memory(system: &Memory, soc: &Soc) {
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

    fn map_registers(u: &mut Unicorn<'static, Core>) -> Result<()> {
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
                u.get_data_mut().soc.read(base + offset as u32, size) as u64
            };
            let write = move |u: &mut Unicorn<'_, Core>, offset: u64, size: usize, value: u64| {
                u.get_data_mut().soc.write(base + offset as u32, size, value as u32);
            };
            uc("map registers", u.mmio_map(base as u64, size as u64, Some(read), Some(write)))?;
        }
        let read = |u: &mut Unicorn<'_, Core>, offset: u64, size: usize| {
            u.get_data_mut().soc.flash_load(offset as u32, size) as u64
        };
        let write = |u: &mut Unicorn<'_, Core>, offset: u64, size: usize, value: u64| {
            u.get_data_mut().soc.flash_store(offset as u32, size, value as u32);
        };
        uc(
            "map bank 2",
            u.mmio_map(flash::BANK2 as u64, flash::BANK2_BYTES as u64, Some(read), Some(write)),
        )
    }

    /// Address translation: every address is itself. Its point is that pages without code are not executable: unicorn
    /// sends every store to a page that may hold code the slow way.
    fn add_tlb(u: &mut Unicorn<'static, Core>, image: &Rc<Image>) -> Result<()> {
        uc("tlb type", u.ctl_set_tlb_type(TlbType::VIRTUAL))?;
        let image = image.clone();
        let translate = move |_: &mut Unicorn<'_, Core>, at: u64, _: MemType| {
            let ram = (CCM as u64..CCM as u64 + CCM_BYTES as u64).contains(&at)
                || (SRAM as u64..0x2002_0000).contains(&at);
            let data = ram && !image.runs_code(at as u32, 4096);
            let perms = if data { Prot(Prot::READ.0 | Prot::WRITE.0) } else { Prot::ALL };
            Some(TlbEntry { paddr: at, perms })
        };
        uc("tlb hook", u.add_tlb_hook(0, u64::MAX, translate))?;
        Ok(())
    }

    fn add_hooks(u: &mut Unicorn<'static, Core>, image: &Image) -> Result<()> {
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
            if self.soc().nvic.any_pending()
                && let Some(n) = due(&self.uc)
            {
                exception::enter(&mut self.uc, n)
                    .map_err(|b| self.lockup(&format!("bad stack {:#010x}", b.0)))?;
                continue;
            }
            let pc = get(&self.uc, R::PC);
            self.stops += 1;
            // `until` 0 is never reached and costs no invalidation.
            let ended = self.uc.emu_start(pc as u64 | 1, 0, 0, 0);
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
                        self.sleep(until);
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

/// The exception to take now, with PRIMASK, FAULTMASK and BASEPRI.
fn due(u: &Unicorn<'_, Core>) -> Option<u32> {
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
