//! What runs for a while on the board: the probe suite with its diagnosis, measurements, tuning. One at a time, each on a thread of its
//! own, ended by a stop.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

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
use super::diagnosis::{diagnose_session, show_file};
use super::shared::{Shared, lock};

/// Where a probe run stands.
#[derive(Clone, Debug, PartialEq)]
pub enum ProbeState {
    /// None was started.
    Idle,
    /// It runs.
    Running(probe::Progress),
    /// Its recordings are being diagnosed.
    Diagnosing {
        /// Since when.
        since: Instant,
    },
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
        let rig = diagnose.clone();
        let session = folder.clone();
        let drive = move |shared: &Shared| {
            *lock(&shared.probe) = ProbeState::Running(first);
            // Recordings carry the rig's own name, not that of the file.
            let rig = rig.as_deref().map(Rig::load).transpose();
            let rig = rig.map_err(|e| Error::Rig(e.to_string()))?;
            let rig = rig.map(|rig| rig.name).unwrap_or_default();
            shared.with_device(|device| {
                let axes = &options.axes;
                let mut show = |p: &probe::Progress| {
                    *lock(&shared.probe) = ProbeState::Running(p.clone());
                };
                probe::run(device, &plan, axes, &rig, &session, &shared.run_stop, &mut show)
            })
        };
        // The board is free again; what follows is computing.
        let then = move |shared: &Shared, result: Result<probe::Report>| {
            let end = result.map_err(|error| format!("probe: {error}")).and_then(|report| {
                let (files, lost) = (report.files.len(), report.lost_ticks);
                let place = folder.display();
                shared.note(
                    format!("probe: {files} recordings in {place}, {lost} ticks lost"),
                    lost > 0,
                );
                let Some(rig) = diagnose else {
                    return Ok((None, "recorded; not diagnosed".to_owned()));
                };
                shared.diagnosis_stop.store(false, Ordering::Release);
                *lock(&shared.probe) = ProbeState::Diagnosing { since: Instant::now() };
                let (report, verdict) = diagnose_session(&rig, &folder, &shared.diagnosis_stop)
                    .map_err(|error| format!("diagnosis: {error}"))?;
                shared.note(format!("diagnosis: {verdict}"), false);
                if let Err(error) = show_file(&report) {
                    shared.note(format!("{}: {error}", report.display()), true);
                }
                Ok((Some(report), verdict))
            });
            *lock(&shared.probe) = match end {
                Ok((report, verdict)) => ProbeState::Done { folder, report, verdict },
                Err(error) => {
                    shared.note(&error, true);
                    ProbeState::Failed(error)
                }
            };
        };
        self.run(drive, then);
    }

    /// Give up the diagnosis that runs; its recordings stay.
    pub fn stop_diagnosis(&self) {
        self.shared.diagnosis_stop.store(true, Ordering::Release);
    }

    /// Measure.
    pub fn measure(&self, what: Measurement) {
        let drive = move |shared: &Shared| {
            *lock(&shared.measure) = MeasureState::Running(preparing(1, 1.0));
            shared.with_device(|device| shared.measure(device, what))
        };
        let then = |shared: &Shared, result: Result<Measured>| {
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
        };
        self.run(drive, then);
    }

    /// Something that drives the board for a while, unless something does already, and what follows when the board is free again.
    fn run<T>(
        &self,
        drive: impl FnOnce(&Shared) -> T + Send + 'static,
        then: impl FnOnce(&Shared, T) + Send + 'static,
    ) {
        if self.shared.run_active.swap(true, Ordering::AcqRel) {
            self.note("a probe run or a measurement is going on: stop it first", true);
            return;
        }
        self.shared.run_stop.store(false, Ordering::Release);
        let shared = self.shared.clone();
        std::thread::spawn(move || {
            let result = drive(&shared);
            shared.run_active.store(false, Ordering::Release);
            then(&shared, result);
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
