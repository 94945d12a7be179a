//! What runs for a while on the board: the probe suite with its diagnosis, measurements, tuning. One at a time, each on a thread of its
//! own, ended by a stop.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use flexstage::Settings;
use flexstage::link::message::{Command, Reply};
use host_sim::Rig;
use telemetry::measure::Frf;
use telemetry::measure::campaign::{
    Excitation, Noise, Response, closed_loop_response, frequency_response, noise_floor,
    step_response,
};
use telemetry::measure::step::StepMetrics;
use telemetry::tune::study::{Applied, Level, Study, apply, study, study_model};
use telemetry::{Device, Error, Result, probe};

use super::Link;
use super::shared::{Shared, lock};

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

/// Where a measurement stands.
#[derive(Clone, Debug, PartialEq)]
pub enum MeasureState {
    /// None was started.
    Idle,
    /// It runs.
    Running(probe::Progress),
    /// It ended: see [`Link::measured`].
    Done,
    /// It failed or was stopped.
    Failed(String),
}

/// What is to be measured. Axes from 0.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// Drive to position, open loop.
    Response {
        /// Axis.
        axis: usize,
        /// Excitation.
        excitation: Excitation,
        /// Bias and peak, V.
        level: Level,
    },
    /// Reference to position, closed loop.
    Closed {
        /// Axis.
        axis: usize,
        /// Excitation.
        excitation: Excitation,
        /// Centre and peak, um.
        level_um: (f64, f64),
    },
    /// Step of the reference.
    Step {
        /// Axis.
        axis: usize,
        /// From and to, um.
        from_to_um: (f64, f64),
    },
    /// Noise of all axes at rest.
    Noise {
        /// Length, s.
        seconds: f64,
    },
    /// Measure an axis, propose settings.
    Tune {
        /// Axis.
        axis: usize,
        /// Bias and peak, V.
        level: Level,
        /// Rig file to tune on instead of the stage.
        model: Option<PathBuf>,
    },
    /// Put the last proposal into effect and measure again.
    Apply,
}

/// What was measured.
#[derive(Clone, Debug)]
pub enum Measured {
    /// Drive to position and the loop.
    Response {
        /// Axis, from 0.
        axis: usize,
        /// The responses.
        response: Response,
    },
    /// Reference to position.
    Closed {
        /// Axis, from 0.
        axis: usize,
        /// The response.
        closed: Frf,
    },
    /// A step.
    Step {
        /// Axis, from 0.
        axis: usize,
        /// Its figures.
        metrics: StepMetrics,
        /// Time (s from the step), position (um), reference (um).
        curve: Vec<[f64; 3]>,
    },
    /// Noise of all axes.
    Noise(Vec<Noise>),
    /// A tuning, proposed or applied.
    Tuning {
        /// What was measured and is proposed.
        study: Box<Study>,
        /// What it did.
        applied: Option<Box<Applied>>,
    },
}

impl Link {
    /// Whether a probe run or a measurement drives the board.
    pub fn is_busy(&self) -> bool {
        self.shared.run_active.load(Ordering::Acquire)
    }

    /// Where the probe run stands.
    pub fn probe_state(&self) -> ProbeState {
        lock(&self.shared.probe).clone()
    }

    /// Where the measurement stands.
    pub fn measure_state(&self) -> MeasureState {
        lock(&self.shared.measure).clone()
    }

    /// The last measurement.
    pub fn measured(&self) -> Option<Arc<Measured>> {
        lock(&self.shared.measured).clone()
    }

    /// Run the probe suite into a folder, then diagnose it against a rig file when there is one, and show the report.
    pub fn probe(&self, options: probe::Options, folder: PathBuf, diagnose: Option<PathBuf>) {
        let plan = probe::plan(&options);
        let total_s = plan.iter().map(probe::Experiment::total_s).sum();
        let first = preparing(plan.len(), total_s);
        self.run(move |shared| {
            *lock(&shared.probe) = ProbeState::Running(first);
            let rig = diagnose.as_deref().and_then(Path::file_stem).unwrap_or_default();
            let rig = rig.to_string_lossy().into_owned();
            let result = shared.with_device(|device| {
                let axes = &options.axes;
                let mut show = |p: &probe::Progress| {
                    *lock(&shared.probe) = ProbeState::Running(p.clone());
                };
                probe::run(device, &plan, axes, &rig, &folder, &shared.run_stop, &mut show)
            });
            // The board is free again; what follows is computing.
            shared.run_active.store(false, Ordering::Release);
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
                    if let Some(report) = &report
                        && let Err(error) = show_file(report)
                    {
                        shared.note(format!("{}: {error}", report.display()), true);
                    }
                    ProbeState::Done { folder, report, verdict }
                }
                Err(error) => {
                    shared.note(format!("diagnosis: {error}"), true);
                    ProbeState::Failed(error)
                }
            };
        });
    }

    /// Measure.
    pub fn measure(&self, what: Measurement) {
        self.run(move |shared| {
            *lock(&shared.measure) = MeasureState::Running(preparing(1, 1.0));
            let result = shared.with_device(|device| shared.measure(device, what));
            *lock(&shared.measure) = match result {
                Ok(measured) => {
                    *lock(&shared.measured) = Some(Arc::new(measured));
                    MeasureState::Done
                }
                Err(error) => {
                    shared.note(format!("measure: {error}"), true);
                    MeasureState::Failed(error.to_string())
                }
            };
        });
    }

    /// Something that drives the board for a while, unless something does already.
    fn run(&self, act: impl FnOnce(&Shared) + Send + 'static) {
        if self.shared.run_active.swap(true, Ordering::AcqRel) {
            self.note("a probe run or a measurement is going on: stop it first", true);
            return;
        }
        self.shared.run_stop.store(false, Ordering::Release);
        let shared = self.shared.clone();
        std::thread::spawn(move || {
            act(&shared);
            shared.run_active.store(false, Ordering::Release);
        });
    }
}

fn preparing(count: usize, total_s: f64) -> probe::Progress {
    probe::Progress { index: 0, count, name: "preparing".into(), done_s: 0.0, total_s }
}

impl Shared {
    fn measure(&self, device: &Device, what: Measurement) -> Result<Measured> {
        let mut show = |p: &probe::Progress| {
            *lock(&self.measure) = MeasureState::Running(p.clone());
        };
        let stop = &self.run_stop;
        match what {
            Measurement::Response { axis, excitation, level } => {
                let settings = settings_of(device)?;
                let volts = (level.bias_v, level.amplitude_v);
                let response = frequency_response(
                    device, axis, excitation, volts, &settings, stop, &mut show,
                )?;
                Ok(Measured::Response { axis, response })
            }
            Measurement::Closed { axis, excitation, level_um } => {
                let closed =
                    closed_loop_response(device, axis, excitation, level_um, stop, &mut show)?;
                Ok(Measured::Closed { axis, closed })
            }
            Measurement::Step { axis, from_to_um } => {
                let (metrics, curve) = step_response(device, axis, from_to_um, stop, &mut show)?;
                Ok(Measured::Step { axis, metrics, curve })
            }
            Measurement::Noise { seconds } => {
                Ok(Measured::Noise(noise_floor(device, seconds, stop, &mut show)?))
            }
            Measurement::Tune { axis, level, model } => {
                let study = match model {
                    Some(path) => {
                        let rig = Rig::load(&path).map_err(|e| Error::Rig(e.to_string()))?;
                        let settings = settings_of(device)?;
                        study_model(&rig, &settings, axis, level, stop, &mut show)?
                    }
                    None => study(device, axis, level, stop, &mut show)?,
                };
                Ok(Measured::Tuning { study: Box::new(study), applied: None })
            }
            Measurement::Apply => {
                let last = lock(&self.measured).clone();
                let Some(Measured::Tuning { study, .. }) = last.as_deref() else {
                    return Err(Error::Invalid("nothing is proposed: tune first".into()));
                };
                let applied = apply(device, study, stop, &mut show);
                // The settings changed even when the measurement after it was stopped.
                self.read_settings(device)?;
                let applied = applied?;
                self.note(
                    format!(
                        "settings {:08x} act from tick {}; not saved yet",
                        applied.digest, applied.tick
                    ),
                    false,
                );
                Ok(Measured::Tuning { study: study.clone(), applied: Some(Box::new(applied)) })
            }
        }
    }
}

fn settings_of(device: &Device) -> Result<Settings> {
    match device.command(Command::ReadSettings)? {
        Reply::Settings(settings) => Ok(settings),
        _ => Err(Error::Invalid("the board did not answer with its settings".into())),
    }
}

/// Show a file with the program that the desktop has for it.
pub fn show_file(path: &Path) -> std::io::Result<()> {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(target_os = "windows") {
        "explorer"
    } else {
        "xdg-open"
    };
    std::process::Command::new(program)
        .arg(path)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .map(|_| ())
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
