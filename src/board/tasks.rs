//! Tasks at the lowest priority: the watch and the lamps.

use core::sync::atomic::Ordering;

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::peripherals::{IWDG, PC6, PC7};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::{Duration, Ticker, Timer};

use super::{crash, device, pump, tick};
use crate::{Flags, State};

/// Timeout of the independent watchdog. Longer than the patience of the tick with the tasks (250 ms) and the longest return that settings
/// may ask for (0.6 s, `Config::build`) together, so that the drives are parked before it bites, if the tick still runs. Start-up takes a tenth of it at most.
const WATCHDOG_US: u32 = 1_000_000;
/// Time for the last reply to leave before a restart.
const FAREWELL: Duration = Duration::from_millis(50);

/// Starts the independent watchdog (RM0440 section 43), once; it needs no clock but its own.
pub fn start_watchdog() -> IndependentWatchdog<'static, IWDG> {
    // SAFETY: `embassy_stm32::init`, which hands out the peripherals, waits for clocks that the watchdog is to watch; nobody takes what it has of
    // this one.
    let mut watchdog = IndependentWatchdog::new(unsafe { IWDG::steal() }, WATCHDOG_US);
    watchdog.unleash();
    watchdog
}

/// Pets the watchdog while the tick, the USB tasks and this executor run; restarts on request.
///
/// Each side watches the other: the tick returns the drives when this task's heartbeat stops.
#[embassy_executor::task]
pub async fn watch(mut watchdog: IndependentWatchdog<'static, IWDG>) {
    let mut ticker = Ticker::every(Duration::from_millis(20));
    let mut before = (0, 0);
    loop {
        ticker.next().await;
        let now =
            (tick::SHOWN.ticks.load(Ordering::Relaxed), pump::HEARTBEAT.load(Ordering::Relaxed));
        if now.0 != before.0 {
            if now.1 != before.1 {
                let beat = tick::SHOWN.heartbeat.load(Ordering::Relaxed);
                tick::SHOWN.heartbeat.store(beat.wrapping_add(1), Ordering::Relaxed);
                watchdog.pet();
            }
        }
        before = now;
        match device::REBOOT.load(Ordering::Acquire) {
            0 => {}
            kind => {
                Timer::after(FAREWELL).await;
                if kind == 2 {
                    crash::set_dfu();
                }
                crash::restart();
            }
        }
    }
}

/// PC6: off while parked, slow blinking while arming, on while the loop is closed. PC7: blinks on a fault.
#[embassy_executor::task]
pub async fn lamps(state: Peri<'static, PC6>, fault: Peri<'static, PC7>) {
    let mut state = Output::new(state, Level::Low, Speed::Low);
    let mut fault = Output::new(fault, Level::Low, Speed::Low);
    let mut ticker = Ticker::every(Duration::from_millis(125));
    let mut phase = 0u32;
    loop {
        ticker.next().await;
        phase = phase.wrapping_add(1);
        let slow = phase % 8 < 4;
        let now = Flags(tick::SHOWN.flags.load(Ordering::Relaxed)).state();
        state.set_level(match now {
            State::Run | State::Hold => Level::High,
            State::Arming => Level::from(slow),
            State::Off | State::Fault => Level::Low,
        });
        fault.set_level(Level::from(now == State::Fault && phase % 2 == 0));
    }
}
