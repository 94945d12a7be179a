//! The board behind the window: connects, reconnects, stores every sample, sends commands without blocking the drawing.
//!
//! Threads: one connects and takes in samples; one sends commands in their order; a stop has a thread of its own, so that
//! nothing that is waiting can delay it.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use flexstage::Settings;
use flexstage::link::message::{Command, Reply};
use flexstage::link::{Fields, Profile};
use telemetry::decode::StreamStatistics;
use telemetry::probe;
use telemetry::recorder::{Progress, Recorder};
use telemetry::{AXES, Device, DeviceInfo, Error, History, Result, Sample, Target};

use crate::Source;

/// Pause between two attempts to connect.
const RETRY: Duration = Duration::from_millis(700);
/// Lines of the log that are kept.
const LOG_LINES: usize = 200;

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
    /// What happened.
    pub text: String,
    /// Whether it is bad news.
    pub is_error: bool,
}

/// Where a probe run stands.
#[derive(Clone, Debug, PartialEq)]
pub enum ProbeState {
    /// None was started.
    Idle,
    /// It runs.
    Running(probe::Progress),
    /// Its recordings are being diagnosed.
    Diagnosing,
    /// It ended.
    Done {
        /// The session folder.
        folder: PathBuf,
        /// The report, when a diagnosis was made.
        report: Option<PathBuf>,
        /// The verdict in a sentence.
        verdict: String,
    },
    /// It failed or was stopped.
    Failed(String),
}

type Job = Box<dyn FnOnce(&Shared) + Send>;

/// What the threads share with the window.
pub struct Shared {
    state: Mutex<LinkState>,
    device: Mutex<Option<Arc<Device>>>,
    history: Mutex<History>,
    log: Mutex<VecDeque<LogLine>>,
    settings: Mutex<Option<Settings>>,
    stored: AtomicBool,
    recorder: Mutex<Option<Recorder>>,
    recorded: Mutex<Option<Progress>>,
    probe: Mutex<ProbeState>,
    probe_stop: AtomicBool,
    quit: AtomicBool,
    generation: AtomicU64,
}

/// Handle of the window on the board.
pub struct Link {
    shared: Arc<Shared>,
    jobs: Sender<Job>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Link {
    /// Start connecting, or read the recording.
    pub fn start(source: &Source, history_s: f64) -> anyhow::Result<Self> {
        let (history, state) = match source {
            Source::Board(_) => (History::new(10_000.0, history_s), LinkState::Connecting),
            Source::Recording { path, sample_rate_hz } => load(path, *sample_rate_hz)?,
        };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            device: Mutex::default(),
            history: Mutex::new(history),
            log: Mutex::default(),
            settings: Mutex::default(),
            stored: AtomicBool::new(true),
            recorder: Mutex::default(),
            recorded: Mutex::default(),
            probe: Mutex::new(ProbeState::Idle),
            probe_stop: AtomicBool::new(false),
            quit: AtomicBool::new(false),
            generation: AtomicU64::new(0),
        });
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

    /// Add a line of the window's own.
    pub fn note(&self, text: impl Into<String>, is_error: bool) {
        self.shared.note(text, is_error);
    }

    /// Send commands in order; the first that fails ends the sequence. `what` names it in the log.
    pub fn send(&self, what: impl Into<String>, commands: Vec<Command>) {
        let what = what.into();
        self.queue(move |shared| {
            let result = shared.with_device(|device| {
                let mut tick = None;
                for command in commands {
                    if let Reply::Done { tick: at } = device.command(command)? {
                        tick = Some(at);
                    }
                }
                Ok(tick)
            });
            match result {
                Ok(Some(tick)) => shared.note(format!("{what}: from tick {tick}"), false),
                Ok(None) => shared.note(what, false),
                Err(error) => shared.note(format!("{what}: {error}"), true),
            }
        });
    }

    /// Open the loop and park, past everything that waits. Also ends a probe run.
    pub fn stop(&self) {
        self.shared.probe_stop.store(true, Ordering::Release);
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

    /// Where the probe run stands.
    pub fn probe_state(&self) -> ProbeState {
        lock(&self.shared.probe).clone()
    }

    /// Run the probe suite into a folder, then diagnose it against a rig file when there is one.
    pub fn probe(&self, options: probe::Options, folder: PathBuf, diagnose: Option<PathBuf>) {
        let plan = probe::plan(&options);
        let total_s = plan.iter().map(probe::Experiment::total_s).sum();
        let first = probe::Progress {
            index: 0,
            count: plan.len(),
            name: "preparing".into(),
            done_s: 0.0,
            total_s,
        };
        *lock(&self.shared.probe) = ProbeState::Running(first);
        self.shared.probe_stop.store(false, Ordering::Release);
        let shared = self.shared.clone();
        std::thread::spawn(move || {
            let rig = diagnose.as_deref().and_then(Path::file_stem).unwrap_or_default();
            let rig = rig.to_string_lossy().into_owned();
            let result = shared.with_device(|device| {
                let axes = &options.axes;
                let mut show = |p: &probe::Progress| {
                    *lock(&shared.probe) = ProbeState::Running(p.clone());
                };
                probe::run(device, &plan, axes, &rig, &folder, &shared.probe_stop, &mut show)
            });
            let report = match result {
                Ok(report) => report,
                Err(error) => {
                    shared.note(format!("probe: {error}"), true);
                    *lock(&shared.probe) = ProbeState::Failed(error.to_string());
                    return;
                }
            };
            shared.note(
                format!(
                    "probe: {} recordings in {}, {} ticks lost",
                    report.files.len(),
                    folder.display(),
                    report.lost_ticks
                ),
                report.lost_ticks > 0,
            );
            let state = match diagnose {
                Some(rig) => {
                    *lock(&shared.probe) = ProbeState::Diagnosing;
                    diagnose_session(&rig, &folder)
                }
                None => Ok((None, "recorded; not diagnosed".to_owned())),
            };
            *lock(&shared.probe) = match state {
                Ok((report, verdict)) => {
                    shared.note(format!("diagnosis: {verdict}"), false);
                    ProbeState::Done { folder, report, verdict }
                }
                Err(error) => {
                    shared.note(format!("diagnosis: {error}"), true);
                    ProbeState::Failed(error)
                }
            };
        });
    }

    fn queue(&self, job: impl FnOnce(&Shared) + Send + 'static) {
        // The worker lives as long as the link.
        let _ = self.jobs.send(Box::new(job));
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shared.quit.store(true, Ordering::Release);
        self.shared.probe_stop.store(true, Ordering::Release);
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

impl Shared {
    fn note(&self, text: impl Into<String>, is_error: bool) {
        let mut log = lock(&self.log);
        log.push_back(LogLine { text: text.into(), is_error });
        while log.len() > LOG_LINES {
            log.pop_front();
        }
    }

    fn recording_ended(&self, progress: Progress) {
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

    fn with_device<T>(&self, act: impl FnOnce(&Device) -> Result<T>) -> Result<T> {
        let device = lock(&self.device).clone();
        match device {
            Some(device) => act(&device),
            None => {
                Err(Error::Lost { board: "the board".into(), reason: "it is not connected".into() })
            }
        }
    }

    fn read_settings(&self, device: &Device) -> Result<()> {
        if let Reply::Settings(settings) = device.command(Command::ReadSettings)? {
            *lock(&self.settings) = Some(settings);
            self.generation.fetch_add(1, Ordering::AcqRel);
        }
        if let Reply::Status(status) = device.command(Command::Status)? {
            self.stored.store(status.is_stored, Ordering::Relaxed);
        }
        Ok(())
    }

    fn keep_connected(&self, target: &Target) {
        while !self.quit.load(Ordering::Acquire) {
            let reason = match self.stay(target) {
                Ok(reason) | Err(reason) => reason,
            };
            *lock(&self.device) = None;
            let waiting = LinkState::Waiting { reason: reason.clone() };
            let mut state = lock(&self.state);
            if *state != waiting {
                *state = waiting;
                drop(state);
                self.note(reason, true);
            }
            std::thread::sleep(RETRY);
        }
    }

    /// One connection from beginning to end; why it ended, or why there was none.
    fn stay(&self, target: &Target) -> std::result::Result<String, String> {
        let words = |error: Error| error.to_string();
        let device = Arc::new(Device::open(target).map_err(words)?);
        let samples = device.subscribe();
        let fields = Fields::RECORDING.with(Fields::CYCLES);
        device.command(Command::StreamOn { fields, profile: Profile::Exact }).map_err(words)?;
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

/// A recording as history.
fn load(path: &Path, sample_rate_hz: Option<f64>) -> anyhow::Result<(History, LinkState)> {
    let is_csv = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    let recording = match sample_rate_hz {
        Some(rate) if is_csv => recording::Recording::read_csv(path, rate)?,
        // An interrupted recording is finished first.
        _ if !path.exists() => recording::recover(path)?,
        _ => recording::Recording::read(path)?,
    };
    let rate = recording.meta.sample_rate_hz;
    let mut history = History::new(rate, recording.span_ticks() as f64 / rate + 1.0);
    let value =
        |column: &Option<Vec<f32>>, row: usize| column.as_ref().map_or(f32::NAN, |c| c[row]);
    for row in 0..recording.len() {
        let mut sample = Sample { tick: recording.tick[row], ..Sample::default() };
        sample.flags = recording.flags.as_ref().map_or(0, |flags| flags[row]);
        for axis in 0..recording.axes().min(AXES) {
            sample.drive_v[axis] = recording.drive_v[axis][row];
            sample.position_um[axis] = value(&recording.position_um[axis], row);
            sample.reference_um[axis] = value(&recording.reference_um[axis], row);
            sample.monitor_v[axis] = value(&recording.monitor_v[axis], row);
        }
        history.push(&sample);
    }
    let about = format!(
        "{}{} axes, {:.1} s at {rate} Hz, {} ticks lost",
        if recording.meta.experiment.is_empty() {
            String::new()
        } else {
            format!("{}, ", recording.meta.experiment)
        },
        recording.axes(),
        recording.span_ticks() as f64 / rate,
        recording.lost().iter().map(|l| l.ticks).sum::<u64>()
    );
    Ok((history, LinkState::Recording { path: path.to_owned(), about }))
}

/// Run `flexstage diagnose` on a session as a process of its own: minutes of both cores must not share the window's memory.
fn diagnose_session(
    rig: &Path,
    folder: &Path,
) -> std::result::Result<(Option<PathBuf>, String), String> {
    let program = std::env::current_exe().map_err(|e| format!("the program is gone: {e}"))?;
    let mut out = folder.as_os_str().to_owned();
    out.push("-diagnosis");
    let out = PathBuf::from(out);
    let run = std::process::Command::new(program)
        .arg("diagnose")
        .arg("--rig")
        .arg(rig)
        .arg(folder)
        .arg("--out")
        .arg(&out)
        .output()
        .map_err(|e| format!("`flexstage diagnose` cannot be started: {e}"))?;
    if !run.status.success() {
        let words = String::from_utf8_lossy(&run.stderr);
        return Err(words.lines().last().unwrap_or("`flexstage diagnose` failed").to_owned());
    }
    let text = std::fs::read_to_string(out.join("diagnosis.json"))
        .map_err(|e| format!("{}: {e}", out.join("diagnosis.json").display()))?;
    let json: serde_json::Value =
        serde_json::from_str(&text).map_err(|e| format!("diagnosis.json: {e}"))?;
    let causes: Vec<String> = json["causes"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|cause| {
            let axes: Vec<String> =
                cause["axes"].as_array().into_iter().flatten().map(|a| a.to_string()).collect();
            format!("{} (axis {})", cause["effect"].as_str().unwrap_or("?"), axes.join(", "))
        })
        .collect();
    let verdict = format!(
        "{}{}, gap {:.1} nm before, {:.1} nm after",
        json["verdict"].as_str().unwrap_or("?"),
        if causes.is_empty() { String::new() } else { format!(": {}", causes.join(" + ")) },
        json["gap"]["before_nm"].as_f64().unwrap_or(f64::NAN),
        json["gap"]["after_nm"].as_f64().unwrap_or(f64::NAN),
    );
    Ok((Some(out.join("report.html")), verdict))
}
