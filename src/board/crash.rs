//! What survives a reset: the panic or fault message, the reset reason, the wish to enter the DFU loader.
//!
//! # Design
//! A record in `.uninit` RAM, which start-up code leaves alone (SRAM keeps its content through every reset but power loss; a
//! magic number and a CRC tell content from noise). The message stays as it is until the next one, and says of which run it is: the
//! next start reports it, and no later one. Whoever crashes outside the tick asks the tick for a soft return of the
//! drives and waits for it before the reset; a HardFault, which even the tick cannot interrupt, returns them itself.
//!
//! # Limits
//! A reset by the watchdog or the pin leaves the outputs floating at the voltage of the bias network (0 V drive): a step that
//! only the amplifier softens. A crash inside the tick itself ends in HardFault or the watchdog.

use core::cell::UnsafeCell;
use core::fmt::Write;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::pac;
use heapless::String;

use crate::link::frame::crc32;
use crate::link::message::CRASH_TEXT;

const MAGIC: u32 = 0xc0de_fa11;
const DFU_MAGIC: u32 = 0xdf0b_007e;
/// Start of the ROM with the DFU loader (AN2606; RM0440 section 2.6).
const SYSTEM_MEMORY: u32 = 0x1fff_0000;
/// Time that a crashed board gives the tick to return the drives, which take 0.6 s at most (`Config::build`); the watchdog allows more.
const RETURN_US: u32 = 700_000;

#[repr(C)]
struct Kept {
    magic: u32,
    crc: u32,
    length: u32,
    text: [u8; CRASH_TEXT],
    /// `restarts` of the run that left the message.
    run: u32,
    restarts: u32,
    restarts_check: u32,
    dfu: u32,
}

struct Cell(UnsafeCell<MaybeUninit<Kept>>);
// SAFETY: written by start-up code before interrupts run, by `set_dfu` (one task), and by crash handlers, which never return.
unsafe impl Sync for Cell {}

#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.crash")]
static CRASH: Cell = Cell(UnsafeCell::new(MaybeUninit::uninit()));

/// Double words of flash that the error correction could not read.
pub static FLASH_ERRORS: AtomicU32 = AtomicU32::new(0);

/// How the last run ended.
#[derive(Clone, Copy)]
pub struct Report {
    /// RCC_CSR bits 31:24.
    pub reset_flags: u8,
    /// Restarts since power-on.
    pub restarts: u16,
    /// Whether there is a message.
    pub has_message: bool,
}

fn kept() -> *mut Kept {
    CRASH.0.get().cast()
}

/// Enters the DFU loader if the last run asked for it. The very first thing after reset: nothing but the record is initialised.
pub fn enter_dfu_if_asked() {
    // SAFETY: the record lies in RAM that nobody else uses; any bit pattern is a valid integer.
    unsafe {
        let dfu = &raw mut (*kept()).dfu;
        if dfu.read_volatile() != DFU_MAGIC {
            return;
        }
        dfu.write_volatile(0);
    }
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    let _ = pac::RCC.apb2enr().read();
    // MEM_MODE = system memory at address 0 (RM0440 section 10.2.1), as the loader expects.
    pac::SYSCFG.memrmp().modify(|w| w.set_mem_mode(1));
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    // SAFETY: the ROM starts with a vector table; no interrupt is enabled and no state of ours is needed again.
    unsafe { cortex_m::asm::bootload(SYSTEM_MEMORY as *const u32) }
}

/// Asks the next start to enter the DFU loader.
pub fn set_dfu() {
    // SAFETY: as above; volatile, because the reader is another run of the program.
    unsafe { (&raw mut (*kept()).dfu).write_volatile(DFU_MAGIC) };
}

/// Reads and clears the reset flags, counts the restart.
pub fn take_report() -> Report {
    let reset_flags = (pac::RCC.csr().read().0 >> 24) as u8;
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // BORRSTF (bit 27) is set at power-on too (RM0440 section 7.4.30): nothing in RAM means anything then.
    let lost_power = reset_flags & (1 << 3) != 0;
    // SAFETY: single-threaded start-up; any bit pattern is a valid integer.
    unsafe {
        let kept = kept();
        let before = (&raw const (*kept).restarts).read_volatile();
        let check = (&raw const (*kept).restarts_check).read_volatile();
        let restarts = if lost_power || check != !before { 0 } else { before.wrapping_add(1) };
        (&raw mut (*kept).restarts).write_volatile(restarts);
        (&raw mut (*kept).restarts_check).write_volatile(!restarts);
        // The runs are counted anew: a message from before would come up again.
        if restarts == 0 {
            (&raw mut (*kept).magic).write_volatile(0);
        }
        Report { reset_flags, restarts: restarts as u16, has_message: !message().is_empty() }
    }
}

/// The message of the last run; empty if it ended without one. Not inlined: it is in flash once.
#[inline(never)]
pub fn message() -> String<CRASH_TEXT> {
    let mut out = String::new();
    let mut text = [0; CRASH_TEXT];
    // SAFETY: any bit pattern is a valid integer; nobody writes while a program that has not crashed runs.
    let (magic, crc, length, is_of_last_run) = unsafe {
        let kept = kept();
        // One by one: the whole array at once is a load and a store for each byte of it, 2.3 KiB of code.
        let mut from = (&raw const (*kept).text).cast::<u8>();
        for to in &mut text {
            *to = from.read_volatile();
            from = from.add(1);
        }
        (
            (&raw const (*kept).magic).read_volatile(),
            (&raw const (*kept).crc).read_volatile(),
            (&raw const (*kept).length).read_volatile() as usize,
            (&raw const (*kept).run).read_volatile().wrapping_add(1)
                == (&raw const (*kept).restarts).read_volatile(),
        )
    };
    if let Some(bytes) = text.get(..length)
        && magic == MAGIC
        && is_of_last_run
        && crc32(bytes) == crc
        && let Ok(text) = core::str::from_utf8(bytes)
    {
        // A text of CRASH_TEXT bytes fits a string of CRASH_TEXT bytes.
        let _ = out.push_str(text);
    }
    out
}

#[inline(never)]
fn keep(message: &str) {
    let bytes = message.as_bytes();
    let bytes = bytes.get(..CRASH_TEXT).unwrap_or(bytes);
    // SAFETY: only crash handlers write, and they never return; there are no more bytes than the text has room for; the magic number is
    // written last.
    unsafe {
        let kept = kept();
        let mut to = (&raw mut (*kept).text).cast::<u8>();
        for byte in bytes {
            to.write_volatile(*byte);
            to = to.add(1);
        }
        (&raw mut (*kept).length).write_volatile(bytes.len() as u32);
        (&raw mut (*kept).run).write_volatile((&raw const (*kept).restarts).read_volatile());
        (&raw mut (*kept).crc).write_volatile(crc32(bytes));
        (&raw mut (*kept).magic).write_volatile(MAGIC);
    }
}

/// A text that takes as much as fits.
struct Cut(String<CRASH_TEXT>);

impl Write for Cut {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for c in text.chars() {
            if self.0.push(c).is_err() {
                break;
            }
        }
        Ok(())
    }
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    let mut text = Cut(String::new());
    let _ = write!(text, "{info}");
    keep(&text.0);
    super::tick::return_drives();
    defmt::error!("{=str}", text.0.as_str());
    // The tick goes on above whatever priority this is, and returns the drives.
    super::timebase::wait_us(RETURN_US, || super::tick::is_parked());
    restart()
}

/// Restarts the board. Pins float at 0 V of drive from the reset on, which a parked drive need not be at (`guard.safe_v`), and the loop may
/// have been closed since the restart was asked for: so the drives go there first.
pub fn restart() -> ! {
    cortex_m::interrupt::disable();
    super::outputs::return_softly_blocking();
    cortex_m::peripheral::SCB::sys_reset()
}

/// Bus, memory and usage faults, all escalated. Nothing can interrupt this, so the drives are returned here.
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    // First of all: what follows may fault again, and then only the watchdog is left.
    super::outputs::return_softly_blocking();
    // SAFETY: reading fault status registers has no effect.
    let scb = unsafe { &*cortex_m::peripheral::SCB::PTR };
    let (cfsr, hfsr) = (scb.cfsr.read(), scb.hfsr.read());
    let (mmfar, bfar) = (scb.mmfar.read(), scb.bfar.read());
    let mut text = Cut(String::new());
    let _ = write!(
        text,
        "hard fault at {:#010x}, called from {:#010x}: CFSR {cfsr:#010x}, HFSR {hfsr:#010x}, MMFAR {mmfar:#010x}, BFAR {bfar:#010x}",
        frame.pc(),
        frame.lr(),
    );
    keep(&text.0);
    cortex_m::peripheral::SCB::sys_reset()
}

/// Flash that the error correction could not read (RM0440 section 3.3.8): counted and acknowledged; whoever read it checks the
/// counter. Any other cause has no enabled source.
#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() {
    let eccr = pac::FLASH.eccr().read();
    if eccr.eccd() || eccr.eccd2() {
        // Write-1-to-clear; ECCC and ECCC2 are left alone.
        pac::FLASH.eccr().write(|w| {
            w.set_eccd(true);
            w.set_eccd2(true);
        });
        FLASH_ERRORS.store(FLASH_ERRORS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
}
