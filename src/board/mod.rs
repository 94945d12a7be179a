//! The controller board: the only code that knows embassy and registers.
//!
//! ```text
//! TIM6 --TRGO--> ADC1..ADC5 --JEOS--> tick (P0, CCM) --> DAC1, DAC2 (latched by the next TRGO)
//!   \--------------------------------------^   |
//!                                              v records
//!                    host <-- USB <-- frames <-- pump       commands --> session --> orders --> tick
//! ```
//!
//! [`tick`] is the control interrupt, alone at the highest priority; [`usb`] the link, on an interrupt executor below it;
//! the watch and the lamps run on another below everything else. Wiring, clock tree, memory map and what was never run on silicon:
//! `docs/board.md`.

use defmt_rtt as _;
use embassy_executor::InterruptExecutor;
use embassy_stm32::peripherals::{IWDG, PC6, PC7};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, interrupt};
use static_cell::StaticCell;

use crate::link::Identity;
use crate::link::identity::self_test;
use crate::{AXES, Config, Faults, Settings, TICK_HZ, store};

pub mod clocks;
pub mod converters;
mod copy;
pub mod crash;
pub mod critical;
pub mod device;
pub mod flash;
pub mod halts;
pub mod outputs;
pub mod priorities;
pub mod pump;
pub mod reader;
pub mod records;
pub mod stack;
pub mod tasks;
pub mod tick;
pub mod timebase;
pub mod usb;

/// Firmware version: that of the package.
pub const VERSION: [u8; 3] = [
    decimal(env!("CARGO_PKG_VERSION_MAJOR")),
    decimal(env!("CARGO_PKG_VERSION_MINOR")),
    decimal(env!("CARGO_PKG_VERSION_PATCH")),
];

const fn decimal(text: &str) -> u8 {
    let bytes = text.as_bytes();
    let mut value = 0;
    let mut i = 0;
    while i < bytes.len() {
        value = value * 10 + (bytes[i] - b'0');
        i += 1;
    }
    value
}

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());

static USB_EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// Runs the USB tasks; pended by their wakers.
#[interrupt]
unsafe fn UART4() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { USB_EXECUTOR.on_interrupt() }
}

static REST_EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// Runs the watch and the lamps. Not in thread mode, which would be woken by every interrupt to find nothing to do.
#[interrupt]
unsafe fn UART5() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { REST_EXECUTOR.on_interrupt() }
}

unsafe extern "C" {
    static mut __sccm: u32;
    static mut __eccm: u32;
    static __siccm: u32;
}

/// Copies the tick from flash to CCM RAM.
fn load_ccm() {
    let (start, end) = (&raw mut __sccm, &raw mut __eccm);
    let words = (end as usize - start as usize) / 4;
    // SAFETY: the linker script reserves both ranges, aligned, of the same length; nothing in CCM runs yet.
    unsafe { core::ptr::copy_nonoverlapping(&raw const __siccm, start, words) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// The first instructions after a reset, before RAM is set up: into the DFU loader if that was asked for, else the outputs to their
/// safe voltage.
///
/// # Safety
/// cortex-m-rt's reset handler calls it once. What it calls uses registers and the crash record, which lies in memory that start-up
/// code leaves alone, and no other static: none has its value yet.
#[unsafe(export_name = "__pre_init")]
unsafe extern "C" fn before_anything_else() {
    crash::enter_dfu_if_asked();
    outputs::park_at_reset();
}

/// Starts the board and runs it for ever.
pub fn run() -> ! {
    stack::paint();
    load_ccm();
    let p = start();
    let rest = REST_EXECUTOR.start(interrupt::UART5);
    match (tasks::watch(p.watchdog), tasks::lamps(p.state, p.fault)) {
        (Ok(watch), Ok(lamps)) => {
            rest.spawn(watch);
            rest.spawn(lamps);
        }
        _ => defmt::error!("the watch or the lamps could not start"),
    }
    // SAFETY: nobody else writes SCR.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SCB.set_sleeponexit();
    loop {
        cortex_m::asm::wfi();
    }
}

/// What the tasks at the lowest priority need.
struct Rest {
    watchdog: IndependentWatchdog<'static, IWDG>,
    state: Peri<'static, PC6>,
    fault: Peri<'static, PC7>,
}

/// Everything up to the running tick and USB. Not inlined, so that the stack it takes is free again afterwards.
#[inline(never)]
fn start() -> Rest {
    // First, so that whatever never ends from here on is ended: a crystal that dies while embassy waits for it, and a panic, which waits for the
    // drives by the cycle counter (longer while the clock is slow).
    let watchdog = tasks::start_watchdog();
    timebase::start_cycle_counter();
    let report = crash::take_report();
    let (p, has_crystal) = clocks::start();
    priorities::set();
    defmt::info!(
        "flexstage {=u8}.{=u8}.{=u8}, reset flags {=u8:#x}, restart {=u16}",
        VERSION[0],
        VERSION[1],
        VERSION[2],
        report.reset_flags,
        report.restarts
    );
    if report.has_message {
        defmt::error!("the last run crashed: {=str}", crash::message().as_str());
    }

    let failed = converters::start() | if has_crystal { 0 } else { self_test::CRYSTAL };
    for words in self_test::describe(failed) {
        defmt::error!("self-test: {=str}", words);
    }

    static SETTINGS: StaticCell<Settings> = StaticCell::new();
    static SCRATCH: StaticCell<[u8; store::MAX_PAYLOAD]> = StaticCell::new();
    let flash = flash::Bank2::new();
    let (settings, config, is_stored, faults) = load_settings(&flash);
    let settings = SETTINGS.init(settings);
    let digest = config.digest();

    let ends = tick::init(config, faults);
    outputs::latch_on_trigger();
    converters::run_on_trigger();
    timebase::start();
    tick::count_from_here();
    priorities::enable_tick();

    let identity = Identity {
        schema: crate::link::message::SCHEMA_HASH,
        firmware: VERSION,
        axes: AXES as u8,
        serial: embassy_stm32::uid::uid(),
        sample_rate_hz: TICK_HZ,
        core_hz: timebase::CORE_HZ,
        reset_flags: report.reset_flags,
        has_crash_report: report.has_message.into(),
        has_stored_config: is_stored.into(),
        self_test: failed,
        restarts: report.restarts,
    };
    let board = device::Board {
        orders: ends.orders,
        answers: ends.answers,
        settings,
        is_stored,
        digest,
        flash,
        scratch: SCRATCH.init_with(|| [0; store::MAX_PAYLOAD]),
        identity,
        report,
    };

    // The executor's interrupt is enabled by `start`, at the priority set before.
    let usb = USB_EXECUTOR.start(interrupt::UART4);
    match usb::run(p.USB, p.PA12, p.PA11, ends.records, board) {
        Ok(task) => usb.spawn(task),
        Err(_) => defmt::error!("the USB task could not start"),
    }
    Rest { watchdog, state: p.PC6, fault: p.PC7 }
}

/// The settings of the last save, or the defaults; what must be said about them.
fn load_settings(flash: &flash::Bank2) -> (Settings, Config, bool, Faults) {
    let (stored, mut faults) = match store::load(flash) {
        Ok(stored) => (stored, Faults::NONE),
        Err(_) => {
            defmt::error!("no settings in flash can be used: running on defaults");
            (None, Faults::BAD_CONFIG)
        }
    };
    if let Some(stored) = stored {
        if let Ok(config) = Config::build(&stored.settings)
            && device::fits(&stored.settings).is_ok()
        {
            defmt::info!("settings of save {=u32}", stored.number);
            return (stored.settings, config, true, faults);
        }
        defmt::error!("the settings in flash are for other converters: running on defaults");
        faults = Faults::BAD_CONFIG;
    }
    let settings = Settings::default();
    match Config::build(&settings) {
        Ok(config) => (settings, config, false, faults),
        // A test of the core builds the defaults; without them there is nothing to run on.
        Err(_) => defmt::unreachable!("the default settings build"),
    }
}
