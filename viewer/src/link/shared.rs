//! What the threads behind the window share, and the thread that keeps a board connected.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use flexstage::Settings;
use flexstage::link::message::{Command, Reply};
use telemetry::recorder::{Progress, Recorder};
use telemetry::{Device, Error, History, Result, Target};

use super::runs::{MeasureState, Measured, ProbeState};
use super::{LinkState, LogLine};
use crate::clock;

/// Pause between two attempts to connect.
const RETRY: Duration = Duration::from_millis(700);
/// Lines of the log that are kept.
const LOG_LINES: usize = 200;

/// What the threads share with the window.
pub struct Shared {
    pub(super) state: Mutex<LinkState>,
    pub(super) device: Mutex<Option<Arc<Device>>>,
    pub(super) history: Mutex<History>,
    pub(super) log: Mutex<VecDeque<LogLine>>,
    pub(super) settings: Mutex<Option<Settings>>,
    pub(super) stored: AtomicBool,
    pub(super) recorder: Mutex<Option<Recorder>>,
    pub(super) recorded: Mutex<Option<Progress>>,
    pub(super) probe: Mutex<ProbeState>,
    pub(super) measure: Mutex<MeasureState>,
    pub(super) measured: Mutex<Option<Arc<Measured>>>,
    /// A probe run or a measurement drives the board.
    pub(super) run_active: AtomicBool,
    pub(super) run_stop: AtomicBool,
    /// Stops that were asked for: what was asked for before the last one is not done any more.
    pub(super) stops: AtomicU64,
    /// The diagnosis that runs is given up.
    pub(super) diagnosis_stop: AtomicBool,
    pub(super) quit: AtomicBool,
    pub(super) generation: AtomicU64,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(super) fn new(history: History, state: LinkState) -> Self {
        Self {
            state: Mutex::new(state),
            device: Mutex::default(),
            history: Mutex::new(history),
            log: Mutex::default(),
            settings: Mutex::default(),
            stored: AtomicBool::new(true),
            recorder: Mutex::default(),
            recorded: Mutex::default(),
            probe: Mutex::new(ProbeState::Idle),
            measure: Mutex::new(MeasureState::Idle),
            measured: Mutex::default(),
            run_active: AtomicBool::new(false),
            run_stop: AtomicBool::new(false),
            stops: AtomicU64::new(0),
            diagnosis_stop: AtomicBool::new(false),
            quit: AtomicBool::new(false),
            generation: AtomicU64::new(0),
        }
    }

    pub(super) fn note(&self, text: impl Into<String>, is_error: bool) {
        let mut log = lock(&self.log);
        let number = log.back().map_or(1, |line| line.number + 1);
        let utc = clock::time_of_day(SystemTime::now());
        log.push_back(LogLine { number, utc, text: text.into(), is_error });
        while log.len() > LOG_LINES {
            log.pop_front();
        }
    }

    pub(super) fn recording_ended(&self, progress: Progress) {
        use telemetry::recorder::Ended;
        let path = progress.path.display();
        let kept =
            format!("{:.1} s in {path}, {} ticks lost", progress.seconds, progress.lost_ticks);
        match &progress.ended {
            Some(Ended::BoardGone { reason }) => {
                self.note(format!("recording ended, {reason}: {kept}"), true)
            }
            Some(Ended::CannotWrite { reason }) => {
                self.note(format!("recording failed: {reason}"), true)
            }
            Some(Ended::Stopped) | None => {
                self.note(format!("recorded {kept}"), progress.lost_ticks > 0)
            }
        }
        *lock(&self.recorded) = Some(progress);
    }

    pub(super) fn with_device<T>(&self, act: impl FnOnce(&Device) -> Result<T>) -> Result<T> {
        let device = lock(&self.device).clone();
        match device {
            Some(device) => act(&device),
            None => {
                Err(Error::Lost { board: "the board".into(), reason: "it is not connected".into() })
            }
        }
    }

    /// Whether they are saved is known before they show: else "Save to board" stays off for the
    /// pictures in between.
    pub(super) fn read_settings(&self, device: &Device) -> Result<()> {
        let settings = device.command(Command::ReadSettings)?;
        if let Reply::Status(status) = device.command(Command::Status)? {
            self.stored.store(status.is_stored, Ordering::Relaxed);
        }
        if let Reply::Settings(settings) = settings {
            *lock(&self.settings) = Some(settings);
            self.generation.fetch_add(1, Ordering::AcqRel);
        }
        Ok(())
    }

    pub(super) fn keep_connected(&self, target: &Target) {
        while !self.quit.load(Ordering::Acquire) {
            let reason = match self.stay(target) {
                Ok(reason) | Err(reason) => reason,
            };
            *lock(&self.device) = None;
            let waiting = LinkState::Waiting { reason: reason.clone() };
            // The lock must not be held over the pause: the window waits for it in every picture.
            let is_new = {
                let mut state = lock(&self.state);
                let is_new = *state != waiting;
                *state = waiting;
                is_new
            };
            if is_new {
                self.note(reason, true);
            }
            std::thread::sleep(RETRY);
        }
    }

    /// One connection from beginning to end; why it ended, or why there was none.
    fn stay(&self, target: &Target) -> std::result::Result<String, String> {
        let words = |error: Error| error.to_string();
        let device = Arc::new(Device::open(target).map_err(words)?);
        device.stream().map_err(words)?;
        let samples = device.subscribe();
        self.read_settings(&device).map_err(words)?;
        {
            let rate = device.info().sample_rate_hz;
            let mut history = lock(&self.history);
            if history.sample_rate_hz() == rate { history.forget() } else { history.set_rate(rate) }
        }
        self.note(
            format!("connected to {}, firmware {}", device.info().name, device.info().firmware),
            false,
        );
        if device.info().has_crash_report
            && let Ok(Reply::Crash(crash)) = device.command(Command::Crash)
        {
            self.note(format!("the board's last run ended badly: {}", crash.message), true);
        }
        *lock(&self.state) = LinkState::Connected(Box::new(device.info().clone()));
        *lock(&self.device) = Some(device.clone());
        while !self.quit.load(Ordering::Acquire) {
            match samples.recv_timeout(Duration::from_millis(100)) {
                Ok(batch) => {
                    let mut history = lock(&self.history);
                    if batch.restarted {
                        history.forget();
                    }
                    for sample in batch.samples.iter() {
                        history.push(sample);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Ok(device.ended().unwrap_or_else(|| "the session was closed".into()))
    }
}
