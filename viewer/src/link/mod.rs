//! The board behind the window: connects, reconnects, stores every sample, sends commands without blocking the drawing.
//!
//! Threads: one connects and takes in samples; one sends commands in their order; a stop has a thread of its own, so that
//! nothing that is waiting can delay it; a probe run or a measurement has its own too, and there is one at a time.

mod diagnosis;
mod load;
mod runs;
mod shared;

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, MutexGuard};

use flexstage::Settings;
use flexstage::link::message::{Command, Reply};
use telemetry::decode::StreamStatistics;
use telemetry::recorder::{Progress, Recorder};
use telemetry::{DeviceInfo, Error, History};

use crate::Source;
pub use diagnosis::show_file;
use load::load;
pub use runs::{MeasureState, Measured, Measurement, ProbeState};
use shared::{Shared, lock};

/// How things stand with the board.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkState {
    /// First attempt runs.
    Connecting,
    /// Connected.
    Connected(Box<DeviceInfo>),
    /// Not connected; tried again.
    Waiting {
        /// Why.
        reason: String,
    },
    /// A file is shown.
    Recording {
        /// Its name.
        path: PathBuf,
        /// What it is.
        about: String,
    },
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq)]
pub struct LogLine {
    /// Counts up from 1.
    pub number: u64,
    /// Time of day, UTC.
    pub utc: String,
    /// What happened.
    pub text: String,
    /// Whether it is bad news.
    pub is_error: bool,
}

type Job = Box<dyn FnOnce(&Shared) + Send>;

/// Handle of the window on the board.
pub struct Link {
    shared: Arc<Shared>,
    jobs: Sender<Job>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

impl Link {
    /// Start connecting, or read the recording.
    pub fn start(source: &Source, history_s: f64) -> anyhow::Result<Self> {
        let (history, state) = match source {
            Source::Board(_) => (History::new(10_000.0, history_s), LinkState::Connecting),
            Source::Recording { path, sample_rate_hz } => load(path, *sample_rate_hz)?,
        };
        let shared = Arc::new(Shared::new(history, state));
        let (jobs, inbox) = mpsc::channel::<Job>();
        let mut threads = Vec::new();
        let worker = shared.clone();
        threads.push(std::thread::Builder::new().name("commands".into()).spawn(move || {
            while let Ok(job) = inbox.recv() {
                job(&worker);
            }
        })?);
        if let Source::Board(target) = source {
            let (shared, target) = (shared.clone(), target.clone());
            let ingest = move || shared.keep_connected(&target);
            threads.push(std::thread::Builder::new().name("board".into()).spawn(ingest)?);
        }
        Ok(Self { shared, jobs, threads })
    }

    /// How things stand.
    pub fn state(&self) -> LinkState {
        lock(&self.shared.state).clone()
    }

    /// The samples. Held only while drawing.
    pub fn history(&self) -> MutexGuard<'_, History> {
        lock(&self.shared.history)
    }

    /// Settings in effect on the board.
    pub fn settings(&self) -> Option<Settings> {
        lock(&self.shared.settings).clone()
    }

    /// Whether the settings in effect are also in flash.
    pub fn is_stored(&self) -> bool {
        self.shared.stored.load(Ordering::Relaxed)
    }

    /// Grows whenever settings were read from the board: editors start anew.
    pub fn generation(&self) -> u64 {
        self.shared.generation.load(Ordering::Acquire)
    }

    /// Whether commands can be sent.
    pub fn is_connected(&self) -> bool {
        lock(&self.shared.device).as_ref().is_some_and(|device| device.is_connected())
    }

    /// What arrived so far.
    pub fn statistics(&self) -> Option<StreamStatistics> {
        lock(&self.shared.device).as_ref().map(|device| device.statistics())
    }

    /// Newest lines last.
    pub fn log(&self) -> Vec<LogLine> {
        lock(&self.shared.log).iter().cloned().collect()
    }

    /// The newest bad news.
    pub fn last_error(&self) -> Option<LogLine> {
        lock(&self.shared.log).iter().rev().find(|line| line.is_error).cloned()
    }

    /// Do something that takes a while and say how it went.
    pub fn background(&self, act: impl FnOnce() -> Result<String, String> + Send + 'static) {
        let shared = self.shared.clone();
        std::thread::spawn(move || match act() {
            Ok(text) => shared.note(text, false),
            Err(text) => shared.note(text, true),
        });
    }

    /// Add a line of the window's own.
    pub fn note(&self, text: impl Into<String>, is_error: bool) {
        self.shared.note(text, is_error);
    }

    /// Send commands in order; the first that fails ends the sequence, and so does a stop that comes meanwhile: what was asked for before
    /// it must not close the loop after it. `what` names it in the log.
    pub fn send(&self, what: impl Into<String>, commands: Vec<Command>) {
        let what = what.into();
        let asked = self.shared.stops.load(Ordering::Acquire);
        self.queue(move |shared| {
            let is_stopped = || shared.stops.load(Ordering::Acquire) != asked;
            let result = shared.with_device(|device| {
                let mut tick = None;
                for command in commands {
                    if is_stopped() {
                        break;
                    }
                    if let Reply::Done { tick: at } = device.command(command)? {
                        tick = Some(at);
                    }
                }
                if is_stopped() {
                    // One of these commands may have been on its way when the stop overtook it.
                    device.command(Command::Disarm)?;
                }
                Ok(tick)
            });
            match result {
                Ok(_) if is_stopped() => shared.note(format!("{what}: not done, stopped"), true),
                Ok(Some(tick)) => shared.note(format!("{what}: from tick {tick}"), false),
                Ok(None) => shared.note(what, false),
                Err(error) => shared.note(format!("{what}: {error}"), true),
            }
        });
    }

    /// Open the loop and park, past everything that waits, and is then not done any more. Also ends a probe run.
    pub fn stop(&self) {
        self.shared.stops.fetch_add(1, Ordering::AcqRel);
        self.shared.run_stop.store(true, Ordering::Release);
        let shared = self.shared.clone();
        std::thread::spawn(move || {
            match shared.with_device(|device| device.command(Command::Disarm)) {
                Ok(_) => shared.note("stop: the drives return to the safe voltage", false),
                Err(error) => shared.note(format!("stop: {error}"), true),
            }
        });
    }

    /// Put settings into effect and read back what took effect.
    pub fn apply(&self, settings: Settings) {
        self.queue(move |shared| {
            let result = shared.with_device(|device| {
                let reply = device.command(Command::SetSettings(settings))?;
                shared.read_settings(device)?;
                Ok(reply)
            });
            match result {
                Ok(Reply::Configured { tick, digest }) => shared.note(
                    format!("settings {digest:08x} act from tick {tick}; not saved yet"),
                    false,
                ),
                Ok(_) => shared.note("settings: unexpected answer", true),
                Err(error) => shared.note(format!("settings: {error}"), true),
            }
        });
    }

    /// Write the settings in effect to flash.
    pub fn save(&self) {
        self.queue(|shared| {
            let result = shared.with_device(|device| {
                let reply = device.command(Command::Save)?;
                shared.read_settings(device)?;
                Ok(reply)
            });
            match result {
                Ok(Reply::Saved { version, slot }) => {
                    shared.note(format!("saved as number {version} in slot {slot}"), false);
                }
                Ok(_) => shared.note("save: unexpected answer", true),
                Err(error) => shared.note(format!("save: {error}"), true),
            }
        });
    }

    /// Start recording to a file.
    pub fn record(&self, path: PathBuf) {
        let result = self.shared.with_device(|device| {
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder)
                    .map_err(|source| Error::File { path: folder.display().to_string(), source })?;
            }
            Recorder::start(device, &path, "viewer", "")
        });
        match result {
            Ok(recorder) => *lock(&self.shared.recorder) = Some(recorder),
            Err(error) => self.note(format!("record: {error}"), true),
        }
    }

    /// Stop recording.
    pub fn stop_recording(&self) {
        let recorder = lock(&self.shared.recorder).take();
        self.queue(move |shared| {
            if let Some(recorder) = recorder {
                shared.recording_ended(recorder.stop());
            }
        });
    }

    /// The recording that runs.
    pub fn recording(&self) -> Option<Progress> {
        let progress = lock(&self.shared.recorder).as_ref().map(Recorder::progress)?;
        if progress.ended.is_some() {
            *lock(&self.shared.recorder) = None;
            self.shared.recording_ended(progress);
            return None;
        }
        Some(progress)
    }

    /// The last finished recording.
    pub fn recorded(&self) -> Option<Progress> {
        lock(&self.shared.recorded).clone()
    }

    fn queue(&self, job: impl FnOnce(&Shared) + Send + 'static) {
        // The worker lives as long as the link.
        let _ = self.jobs.send(Box::new(job));
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shared.quit.store(true, Ordering::Release);
        self.shared.run_stop.store(true, Ordering::Release);
        self.stop_diagnosis();
        // Ends the recording properly before the process goes.
        let recorder = lock(&self.shared.recorder).take();
        drop(recorder);
        let (closed, _) = mpsc::channel();
        self.jobs = closed;
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};
    use telemetry::Target;

    fn until(what: &str, is_so: impl Fn() -> bool) {
        let start = Instant::now();
        while !is_so() {
            assert!(start.elapsed() < Duration::from_secs(20), "{what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn what_waits_when_a_stop_comes_does_not_arm_the_board_after_it() {
        let board = Target::Virtual(Default::default());
        let link = Link::start(&Source::Board(board), 1.0).unwrap();
        until("connected", || link.is_connected());
        let said = |words: &str| link.log().iter().any(|line| line.text.contains(words));
        let (go, wait) = mpsc::channel();
        link.queue(move |_| {
            let _ = wait.recv();
        });
        link.send("arm", vec![Command::Arm]);
        link.stop();
        until("stopped", || said("stop: the drives return"));
        go.send(()).unwrap();
        until("dropped", || said("arm: not done, stopped"));
        let status = link.shared.with_device(|device| device.command(Command::Status));
        let Ok(Reply::Status(status)) = status else { panic!("{status:?}") };
        assert_eq!(flexstage::Flags(status.flags).state(), flexstage::State::Off);
        // What is asked for after it is done.
        link.send("arm", vec![Command::Arm]);
        until("armed", || said("arm: from tick"));
    }
}
