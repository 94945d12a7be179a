//! What the board does when a host asks: the hardware side of [`link::session`](crate::link::session).

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use embassy_time::{Duration, Instant, Timer};
use heapless::spsc::{Consumer, Producer};

use super::flash::Bank2;
use super::tick::{self, Answer};
use super::{converters, crash, outputs, pump, stack, usb};
use crate::link::message::{Counters, Crash, HISTOGRAM_BINS, Refusal, Status};
use crate::link::session::Device;
use crate::link::{Fields, Identity, Profile};
use crate::settings::Check;
use crate::{Command, Config, Settings, SettingsError, store};

/// Longest time to an answer of the tick, which comes within one period.
const PATIENCE: Duration = Duration::from_millis(5);

/// What the watch task should do when the reply is out: 0 nothing, 1 restart, 2 DFU loader.
pub static REBOOT: AtomicU8 = AtomicU8::new(0);

/// The stream: in the upper half its number, which every start and every end counts up; in the lower half 0 if none is on, else
/// [`STREAM_IS_ON`], the profile in bit 8 and the fields below. Only tasks of the USB executor touch it.
static STREAM: AtomicU32 = AtomicU32::new(0);
const STREAM_IS_ON: u32 = 1 << 15;
/// Orders to open the loop that have acted ahead of their turn and are still to be answered: until then nothing closes it, whatever stands
/// before them. Only the reader's task touches it.
pub static STOPS: AtomicU32 = AtomicU32::new(0);
/// The first tick of the stream that is on.
pub static STREAM_START: AtomicU32 = AtomicU32::new(0);

/// The stream as one word, which is another one after each start and each end.
pub fn stream_word() -> u32 {
    STREAM.load(Ordering::Relaxed)
}

/// The number of a stream. It comes again after 65 536 starts and ends, each of which is answered, so that the ring has long been emptied.
pub const fn stream_number(word: u32) -> u16 {
    (word >> 16) as u16
}

/// What is streamed, if the stream is on.
pub fn selection(word: u32) -> Option<(Fields, Profile)> {
    if word & STREAM_IS_ON == 0 {
        return None;
    }
    Profile::from_byte((word >> 8) as u8 & 1).map(|profile| (Fields(word as u16 & 0xff), profile))
}

/// Starts a stream, or ends the one that is on; the first tick of it.
pub fn set_stream(stream: Option<(Fields, Profile)>) -> u32 {
    let before = stream_word();
    let selected = match stream {
        Some((fields, profile)) => {
            pump::start_count();
            STREAM_IS_ON | u32::from(profile as u8) << 8 | u32::from(fields.0)
        }
        None => {
            pump::end_count();
            0
        }
    };
    // Asked once: a tick may come in between, and its record waits for the pump.
    let start = next_tick();
    STREAM_START.store(start, Ordering::Relaxed);
    STREAM.store((before & 0xffff_0000).wrapping_add(1 << 16) | selected, Ordering::Relaxed);
    start
}

/// The board as the session sees it.
pub struct Board {
    /// Orders to the tick.
    pub orders: Producer<'static, Command>,
    /// Its answers.
    pub answers: Consumer<'static, Answer>,
    /// The settings in effect.
    pub settings: &'static mut Settings,
    /// Whether they are the ones in flash.
    pub is_stored: bool,
    /// Digest of the configuration in effect.
    pub digest: u32,
    /// Flash for settings.
    pub flash: Bank2,
    /// Room to encode them in.
    pub scratch: &'static mut [u8; store::MAX_PAYLOAD],
    /// Who the board is.
    pub identity: Identity,
    /// How the last run ended.
    pub report: crash::Report,
}

/// Whether settings are for the converters of this board: a code that its outputs do not have would be another voltage.
///
/// # Errors
/// The first number of codes that is not the converter's.
pub fn fits(settings: &Settings) -> Result<(), SettingsError> {
    for (k, axis) in settings.axes.iter().enumerate() {
        let inputs = f32::from(converters::FULL_CODE);
        for (group, found, converter) in [
            ("dac", axis.dac.full_code, f32::from(outputs::FULL_CODE)),
            ("gauge", axis.gauge.full_code, inputs),
            ("monitor", axis.monitor.full_code, inputs),
        ] {
            let check = Check::axis(group, k);
            check.range(
                "full_code",
                found as f32,
                converter,
                converter,
                "(this board's converter)",
            )?;
        }
    }
    Ok(())
}

/// The next tick: what changes now acts there.
fn next_tick() -> u32 {
    tick::SHOWN.ticks.load(Ordering::Relaxed)
}

impl Device for Board {
    fn identity(&self) -> Identity {
        self.identity
    }

    fn status(&self) -> Status {
        Status {
            tick: next_tick().wrapping_sub(1),
            flags: tick::SHOWN.flags.load(Ordering::Relaxed),
            digest: self.digest,
            is_stored: self.is_stored,
            stream: selection(stream_word()),
            uptime_ms: Instant::now().as_millis() as u32,
            has_crash: self.report.has_message,
        }
    }

    fn counters(&self) -> Counters {
        let load = |counter: &AtomicU32| counter.load(Ordering::Relaxed);
        let mut cycles_histogram = [0; HISTOGRAM_BINS];
        for (to, from) in cycles_histogram.iter_mut().zip(&tick::SHOWN.cycles_histogram) {
            *to = load(from);
        }
        Counters {
            ticks: load(&tick::SHOWN.ticks),
            overruns: load(&tick::SHOWN.overruns),
            cycles_last: load(&tick::SHOWN.cycles_last),
            cycles_max: load(&tick::SHOWN.cycles_max),
            cycles_histogram,
            dropped: pump::dropped(),
            frames: load(&usb::FRAMES),
            usb_resets: load(&usb::RESETS),
            flash_errors: load(&crash::FLASH_ERRORS),
            stack_free: stack::unused(),
            ..Counters::default()
        }
    }

    fn crash(&self) -> Crash {
        Crash { reset_flags: self.report.reset_flags, message: crash::message() }
    }

    fn settings(&self) -> &Settings {
        self.settings
    }

    fn fits(&self, settings: &Settings) -> Result<(), SettingsError> {
        fits(settings)
    }

    fn configure(&mut self, settings: &Settings, config: Config) -> Result<u32, Refusal> {
        self.settings.clone_from(settings);
        self.is_stored = false;
        self.digest = config.digest();
        Ok(tick::exchange_config(&config))
    }

    fn write_table(&mut self, offset: usize, points: &[f32]) -> Result<(), Refusal> {
        tick::with_table(|table| table.write(offset, points)).map_err(|_| Refusal::Range)
    }

    fn use_table(&mut self, len: usize) -> Result<u32, Refusal> {
        tick::with_table(|table| table.set_len(len)).map_err(|_| Refusal::Range)?;
        Ok(tick::use_table())
    }

    fn stream(&mut self, stream: Option<(Fields, Profile)>) -> u32 {
        set_stream(stream)
    }

    fn reboot(&mut self, dfu: bool) {
        REBOOT.store(if dfu { 2 } else { 1 }, Ordering::Release);
    }

    async fn control(&mut self, command: Command) -> Result<u32, Refusal> {
        // A restart waits for its reply to leave, and nothing should begin until then.
        if REBOOT.load(Ordering::Acquire) != 0 && matches!(command, Command::Arm) {
            return Err(Refusal::Busy);
        }
        // The host has already said that the loop is to be open.
        if STOPS.load(Ordering::Relaxed) != 0
            && matches!(command, Command::Arm | Command::Start { .. })
        {
            return Err(Refusal::Busy);
        }
        if self.identity.self_test & !crate::link::identity::self_test::TOLERABLE != 0
            && matches!(command, Command::Arm)
        {
            return Err(Refusal::NotReady);
        }
        // An answer that came after its caller lost patience belongs to nobody.
        while self.answers.dequeue().is_some() {}
        self.orders.enqueue(command).map_err(|_| Refusal::Busy)?;
        let asked = Instant::now();
        loop {
            Timer::after_micros(50).await;
            if let Some(answer) = self.answers.dequeue() {
                return answer.map_err(Refusal::Control);
            }
            if asked.elapsed() > PATIENCE {
                return Err(Refusal::NotReady);
            }
        }
    }

    async fn save(&mut self) -> Result<(u32, u8), Refusal> {
        let saved = store::save(&mut self.flash, self.settings, self.scratch.as_mut_slice()).await;
        self.is_stored |= saved.is_ok();
        saved.map_err(|_| Refusal::Flash)
    }

    async fn pause(&mut self) {
        // Only to the tasks of this executor: the watch gets its time while the tick takes over what was found.
        embassy_futures::yield_now().await;
    }
}
