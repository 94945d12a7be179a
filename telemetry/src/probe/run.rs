//! Drives the probe suite on a board and writes the session folder.
//!
//! Whatever ends it (the end, a person, a fault, a broken cable), the drives are sent back to the safe voltage at the guard's slow
//! rate, the settings from before are put back, and every recording that was complete stays.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use flexstage::link::message::{Command, Reply, TABLE_CHUNK};
use flexstage::{Flags, Settings, State};
use recording::{Meta, Recording};
use serde::Serialize;

use super::limits::{check, open_loop, scale_um_per_v};
use super::plan::{CONDITION_S, Experiment};
use super::waveform::Waveform;
use crate::device::{Batch, Device};
use crate::recorder::to_recording;
use crate::sample::Sample;
use crate::words::fault_line;
use crate::{Error, Result};

/// Silence of the stream after which the board counts as stuck.
const SILENCE: Duration = Duration::from_secs(3);
/// Longest wait for arming, parking or coming to rest, in seconds on the sample clock: 150 V at 0.5 V/ms and arming.
const REST_S: f64 = 10.0;

/// Where the suite stands.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Progress {
    /// Experiment that runs, from 0.
    pub index: usize,
    /// Experiments in all.
    pub count: usize,
    /// Its name.
    pub name: String,
    /// Time done, seconds on the sample clock.
    pub done_s: f64,
    /// Time in all.
    pub total_s: f64,
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The session folder.
    pub folder: PathBuf,
    /// Its recordings.
    pub files: Vec<PathBuf>,
    /// Ticks lost over all of them.
    pub lost_ticks: u64,
}

/// Whether experiments drive volts or positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Waveforms are volts at the amplifier; the loop is open.
    OpenLoop,
    /// Waveforms are micrometres of reference, whatever the plan calls them; the board's settings stay as they are.
    ClosedLoop,
}

/// Run a plan open loop and write a session folder. `axes` from 0 are the ones that may move.
pub fn run(
    device: &Device,
    plan: &[Experiment],
    axes: &[usize],
    rig: &str,
    folder: &Path,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Report> {
    let file_error = |source| Error::File { path: folder.display().to_string(), source };
    if folder.read_dir().is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Error::Invalid(format!(
            "{}: expected a new or empty folder for the session, found files in it",
            folder.display()
        )));
    }
    let is_new = !folder.exists();
    if !is_new && !folder.is_dir() {
        return Err(Error::Invalid(format!(
            "{}: expected a new or empty folder for the session, found a file",
            folder.display()
        )));
    }
    std::fs::create_dir_all(folder).map_err(file_error)?;
    let mut report = Report { folder: folder.to_owned(), files: Vec::new(), lost_ticks: 0 };
    let done =
        capture(device, plan, axes, Mode::OpenLoop, stop, progress, &mut |index, mut recording| {
            recording.meta.rig = rig.to_owned();
            report.lost_ticks += recording.lost().iter().map(|lost| lost.ticks).sum::<u64>();
            let path = folder.join(format!("{index:02}-{}.parquet", recording.meta.experiment));
            recording.write(&path)?;
            report.files.push(path);
            Ok(())
        });
    if done.is_err() && is_new && report.files.is_empty() {
        // Only when it is empty; what cannot be removed stays.
        let _ = std::fs::remove_dir(folder);
    }
    done.map(|()| report)
}

/// Run a plan and hand out each recording as it is complete.
pub fn capture(
    device: &Device,
    plan: &[Experiment],
    axes: &[usize],
    mode: Mode,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
    take: &mut dyn FnMut(usize, Recording) -> Result<()>,
) -> Result<()> {
    let Reply::Settings(before) = device.command(Command::ReadSettings)? else {
        return Err(Error::Invalid("the board did not answer with its settings".into()));
    };
    if mode == Mode::OpenLoop {
        check(plan, &before, axes)?;
    }
    let Reply::Status(status) = device.command(Command::Status)? else {
        return Err(Error::Invalid("the board did not answer with its status".into()));
    };
    if Flags(status.flags).state() != State::Off {
        return Err(Error::Invalid(format!(
            "probing starts with the stage off, it is in state `{}`: stop it{} first",
            Flags(status.flags).state().name(),
            if Flags(status.flags).state() == State::Fault { " and clear its faults" } else { "" },
        )));
    }
    device.stream()?;
    let settings = match mode {
        Mode::OpenLoop => open_loop(&before),
        Mode::ClosedLoop => before.clone(),
    };
    let mut runner = Runner {
        device,
        stream: device.subscribe(),
        rate: device.info().sample_rate_hz,
        axes,
        mode,
        settings,
        stop,
        last: None,
        captured: None,
        watching: true,
        table: Vec::new(),
    };
    if mode == Mode::OpenLoop {
        device.command(Command::SetSettings(runner.settings.clone()))?;
    }
    let result = runner.all(plan, progress, take);
    match (result, runner.restore(&before)) {
        (Err(error), Err(left)) => Err(Error::Invalid(format!("{error}; {left}"))),
        (result, restored) => result.and(restored),
    }
}

struct Runner<'a> {
    device: &'a Device,
    stream: Receiver<Batch>,
    rate: f64,
    axes: &'a [usize],
    mode: Mode,
    settings: Settings,
    stop: &'a AtomicBool,
    last: Option<Sample>,
    captured: Option<Vec<Sample>>,
    /// Whether a fault or a stop ends what is going on; not while cleaning up.
    watching: bool,
    table: Vec<f32>,
}

impl Runner<'_> {
    fn all(
        &mut self,
        plan: &[Experiment],
        progress: &mut dyn FnMut(&Progress),
        take: &mut dyn FnMut(usize, Recording) -> Result<()>,
    ) -> Result<()> {
        let total_s: f64 = plan.iter().map(Experiment::total_s).sum();
        let mut done_s = 0.0;
        let mut origin = None;
        for (index, experiment) in plan.iter().enumerate() {
            let count = plan.len();
            let name = experiment.name.clone();
            progress(&Progress { index, count, name: name.clone(), done_s, total_s });
            let (samples, settle_ticks) = self.experiment(experiment, &mut |seconds| {
                // A late host makes an experiment longer than planned; progress never goes back.
                let done_s = done_s + seconds.min(experiment.total_s());
                progress(&Progress { index, count, name: name.clone(), done_s, total_s });
            })?;
            let first = samples.first().map_or(0, |s| s.tick);
            let origin = *origin.get_or_insert(first);
            let meta = Meta {
                settle_s: settle_ticks as f64 / self.rate,
                start_s: (first - origin) as f64 / self.rate,
                period_s: experiment.period_s,
                ..Meta::new(&experiment.name, self.rate)
            };
            take(index, to_recording(&samples, meta))?;
            done_s += experiment.total_s();
        }
        progress(&Progress {
            index: plan.len(),
            count: plan.len(),
            name: "done".into(),
            done_s: total_s,
            total_s,
        });
        Ok(())
    }

    /// One experiment from rest to rest; its samples and the length of the conditioning in ticks.
    fn experiment(
        &mut self,
        experiment: &Experiment,
        seconds: &mut dyn FnMut(f64),
    ) -> Result<(Vec<Sample>, u64)> {
        if let Some(points) = &experiment.table {
            self.load_table(points)?;
        }
        self.arm()?;
        let everywhere = |to_v: f64, duration_s: f64| -> Vec<(usize, Waveform)> {
            self.axes.iter().map(|&axis| (axis, Waveform::Ramp { to_v, duration_s })).collect()
        };
        let (up, down) = (everywhere(experiment.condition_v, 0.2), everywhere(0.0, 0.2));
        self.come_to_rest(&down)?;
        self.captured = Some(Vec::new());
        // Every wait counts from the tick at which the board says that the command before took effect: a host that is
        // late makes an experiment longer, never cuts it short.
        let mut first = None;
        if experiment.condition_v > 0.0 {
            let up_at = self.start(&up, 0.0)?;
            first = Some(up_at);
            self.until_tick(up_at + self.ticks(CONDITION_S * 0.4), up_at, seconds)?;
            let down_at = self.start(&down, 0.0)?;
            self.until_tick(down_at + self.ticks(CONDITION_S * 0.6), up_at, seconds)?;
        }
        let mut begin = None;
        let (mut last_at, mut last_s) = (self.now()? + 1, 0.0);
        for phase in &experiment.phases {
            if begin.is_some() {
                let due = last_at + self.ticks(phase.at_s - last_s);
                self.until_tick(due, first.unwrap_or(due), seconds)?;
            }
            last_at = self.start(&phase.moves, experiment.duration_s - phase.at_s)?;
            last_s = phase.at_s;
            begin = begin.or(Some(last_at));
        }
        let begin = begin.unwrap_or(last_at);
        let first = first.unwrap_or(begin);
        let end = last_at + self.ticks(experiment.duration_s - last_s);
        self.until_tick(end, first, seconds)?;
        let mut samples = self.captured.take().unwrap_or_default();
        samples.retain(|s| (first..end).contains(&s.tick));
        // A stack remembers the farthest that it was driven, recorded or not.
        self.until(end, "the waves to fade out", REST_S, |s| state(s) == State::Hold)?;
        self.come_to_rest(&down)?;
        Ok((samples, begin - first))
    }

    fn come_to_rest(&mut self, down: &[(usize, Waveform)]) -> Result<()> {
        let begin = self.start(down, 0.0)?;
        self.until(begin, "the stage to come to rest", REST_S, |s| state(s) == State::Hold)
    }

    fn ticks(&self, seconds: f64) -> u64 {
        (seconds * self.rate).round() as u64
    }

    fn unless_stopped(&self) -> Result<()> {
        if self.watching && self.stop.load(Ordering::Acquire) {
            return Err(Error::Stopped("the stage is returning to its safe voltage".into()));
        }
        Ok(())
    }

    /// Send a command unless there was a stop: that must not wait for staging, nor be followed by a start.
    fn command(&self, command: Command) -> Result<Reply> {
        self.unless_stopped()?;
        self.device.command(command)
    }

    /// Take what arrives next.
    fn pump(&mut self) -> Result<()> {
        self.unless_stopped()?;
        let batch = match self.stream.recv_timeout(SILENCE) {
            Ok(batch) => batch,
            Err(error) => {
                let reason = match error {
                    RecvTimeoutError::Timeout => {
                        format!("no samples for {} s", SILENCE.as_secs())
                    }
                    RecvTimeoutError::Disconnected => {
                        self.device.ended().unwrap_or_else(|| "the session ended".into())
                    }
                };
                return Err(Error::Lost { board: self.device.info().name.clone(), reason });
            }
        };
        if batch.restarted {
            return Err(Error::Lost {
                board: self.device.info().name.clone(),
                reason: "it restarted".into(),
            });
        }
        if let Some(captured) = &mut self.captured {
            captured.extend_from_slice(&batch.samples);
        }
        if let Some(last) = batch.samples.last() {
            self.last = Some(*last);
            if self.watching && state(last) == State::Fault {
                return Err(Error::Fault(fault_line(Flags(last.flags))));
            }
        }
        Ok(())
    }

    /// Newest tick.
    fn now(&mut self) -> Result<u64> {
        while self.last.is_none() {
            self.pump()?;
        }
        Ok(self.last.map_or(0, |s| s.tick))
    }

    fn until_tick(&mut self, tick: u64, first: u64, seconds: &mut dyn FnMut(f64)) -> Result<()> {
        while self.now()? < tick {
            self.pump()?;
            seconds((self.now()?.saturating_sub(first)) as f64 / self.rate);
        }
        Ok(())
    }

    /// Wait until a sample is so that is newer than `tick`, at which a command took effect. Samples from before it are still on their way
    /// (a simulated board is ahead of its host by many), and a stage that held still before the command looks like one that has obeyed.
    fn until(
        &mut self,
        tick: u64,
        what: &str,
        seconds: f64,
        done: impl Fn(&Sample) -> bool,
    ) -> Result<()> {
        let begin = tick.max(self.now()?) + self.ticks(0.02);
        loop {
            self.pump()?;
            let now = self.now()?;
            if now > begin && self.last.as_ref().is_some_and(&done) {
                return Ok(());
            }
            if now > begin + self.ticks(seconds) {
                let state = self.last.map_or("?", |s| state(&s).name());
                return Err(Error::Invalid(format!(
                    "waited {seconds} s for {what}, the controller is in state `{state}`"
                )));
            }
        }
    }

    /// Send a command; the tick from which it acts.
    fn order(&mut self, command: Command) -> Result<u64> {
        self.now()?;
        let reply = self.command(command)?;
        self.tick_of(&reply)
    }

    /// The tick from which a command acts, by the answer to it.
    fn tick_of(&mut self, reply: &Reply) -> Result<u64> {
        let now = self.now()?;
        let &Reply::Done { tick } = reply else {
            return Err(Error::Invalid(
                "the board did not say when the command takes effect".into(),
            ));
        };
        // Acknowledgements carry the lower half of the tick; the stream is never half a wrap behind.
        let late = u64::from(tick).wrapping_sub(now) & u64::from(u32::MAX);
        Ok(now.saturating_add_signed(i64::from(late as u32 as i32)))
    }

    /// Start waveforms together; the tick at which they begin. Waves end by themselves after `lasts_s` seconds.
    fn start(&mut self, moves: &[(usize, Waveform)], lasts_s: f64) -> Result<u64> {
        let mut mask = 0;
        for (axis, waveform) in moves {
            let (scale, origin) = match self.mode {
                Mode::OpenLoop => scale_um_per_v(&self.settings, *axis),
                Mode::ClosedLoop => (1.0, 0.0),
            };
            let generator = waveform.generator(scale, origin, lasts_s);
            self.command(Command::Stage { axis: *axis as u8, generator })?;
            mask |= 1 << axis;
        }
        if mask == 0 {
            return Ok(self.now()? + 1);
        }
        self.order(Command::Start { axes: mask })
    }

    fn arm(&mut self) -> Result<()> {
        self.now()?;
        if self.last.is_some_and(|s| matches!(state(&s), State::Hold | State::Run)) {
            return Ok(());
        }
        self.until(0, "the drives to be parked", REST_S, |s| Flags(s.flags).is_parked())?;
        let tick = self.order(Command::Arm)?;
        self.until(tick, "arming to complete", REST_S, |s| state(s) == State::Hold)
    }

    fn disarm(&mut self) -> Result<()> {
        // Without a look at the stream, which may be silent.
        let reply = self.command(Command::Disarm)?;
        let tick = self.tick_of(&reply)?;
        self.until(tick, "the drives to be parked", REST_S, |s| Flags(s.flags).is_parked())
    }

    /// Wait for the drives to be parked without a stream.
    fn poll_parked(&self) -> Result<()> {
        let deadline = Instant::now() + Duration::from_secs_f64(REST_S);
        loop {
            if let Reply::Status(status) = self.device.command(Command::Status)?
                && Flags(status.flags).is_parked()
            {
                return Ok(());
            }
            if Instant::now() > deadline {
                return Err(Error::Invalid(format!(
                    "waited {REST_S} s for the drives to be parked"
                )));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Tables are exchanged while the loop is open.
    fn load_table(&mut self, points: &[f32]) -> Result<()> {
        if self.table == points {
            return Ok(());
        }
        self.now()?;
        if self.last.is_some_and(|s| state(&s).is_active()) {
            self.disarm()?;
        }
        for (i, chunk) in points.chunks(TABLE_CHUNK).enumerate() {
            let offset = (i * TABLE_CHUNK) as u16;
            let points = chunk.iter().copied().collect();
            self.command(Command::WriteTable { offset, points })?;
        }
        self.command(Command::UseTable { len: points.len() as u16 })?;
        self.table = points.to_vec();
        Ok(())
    }

    /// Park, and put the settings from before back.
    fn restore(&mut self, before: &Settings) -> Result<()> {
        self.watching = false;
        self.captured = None;
        // Where the stream is silent the board may still take commands.
        let parked = self.disarm().or_else(|error| {
            self.device.command(Command::Disarm).map_err(|_| error)?;
            self.poll_parked()
        });
        if self.mode == Mode::ClosedLoop {
            return if self.device.is_connected() { parked } else { Ok(()) };
        }
        // Whether or not it is parked: nothing is lost by asking.
        match self.device.command(Command::SetSettings(before.clone())) {
            Ok(_) => parked,
            Err(error) => Err(Error::Invalid(format!(
                "the board still has the probe's settings, until it restarts or gets others ({error})"
            ))),
        }
    }
}

fn state(sample: &Sample) -> State {
    Flags(sample.flags).state()
}
