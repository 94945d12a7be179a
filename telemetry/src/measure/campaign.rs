//! Measurements on a board: what is driven, what is computed, in one call each.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use flexstage::{Flags, Settings, State};
use recording::Recording;
use serde::Serialize;

use super::margins::{Margins, margins};
use super::psd::{Psd, welch};
use super::step::{StepMetrics, step_metrics};
use super::{Frf, frf};
use crate::device::Device;
use crate::probe::plan::Phase;
use crate::probe::waveform::{Waveform, odd_multisine};
use crate::probe::{Experiment, Mode, Progress, capture};
use crate::sample::AXES;
use crate::tune::loop_gain;
use crate::{Error, Result};

/// Period of the multisine in ticks: one table point a tick, lines every 9.77 Hz.
const PERIOD: usize = flexstage::TABLE_POINTS;
/// Highest line: 2.5 kHz.
const HIGHEST: usize = 255;
/// Periods measured after the first two.
const PERIODS: usize = 40;
/// Coherence below which a line says nothing.
const COHERENT: f64 = 0.8;

/// Swept sine: length of one sweep, s, and its ends, Hz.
const SWEEP_S: f64 = 4.0;
const SWEEP_HZ: (f64, f64) = (4.0, 2000.0);
/// Segment of its averaged spectra, samples (0.82 s), and points a decade.
const SWEEP_SEGMENT: usize = 8192;
const SWEEP_PER_DECADE: usize = 40;

/// Silence of the stream after which the board counts as stuck.
const SILENCE: Duration = Duration::from_secs(3);

/// What a frequency response is measured with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Excitation {
    /// Random-phase multisine, lines every 9.8 Hz to 2.5 kHz: exact, no leakage; coherence from the scatter of 40 periods.
    #[default]
    Multisine,
    /// Swept sine, twice, 4 Hz to 2 kHz: lower frequencies and more amplitude at each; coherence by averaged spectra.
    Sweep,
}

/// A frequency response and what follows from it.
#[derive(Clone, Debug)]
pub struct Response {
    /// Drive to position, um/V.
    pub plant: Frf,
    /// Loop gain with the settings on the board.
    pub loop_gain: Frf,
    /// Its margins.
    pub margins: Margins,
}

/// One recording of a plan with a single experiment.
fn one(
    device: &Device,
    experiment: Experiment,
    axis: usize,
    mode: Mode,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Recording> {
    let mut out = None;
    capture(device, &[experiment], &[axis], mode, stop, progress, &mut |_, recording| {
        out = Some(recording);
        Ok(())
    })?;
    out.ok_or_else(|| Error::Invalid("nothing was recorded".into()))
}

/// A recording of one axis around a bias: a ramp to it, then the excitations, each at its time (s).
fn around(
    name: &str,
    axis: usize,
    center: f64,
    excitations: impl IntoIterator<Item = (f64, Waveform)>,
    duration_s: f64,
) -> Experiment {
    let ramp = Waveform::Ramp { to_v: center, duration_s: 0.2 };
    let phase = |(at_s, waveform)| Phase { at_s, moves: vec![(axis, waveform)] };
    let phases = std::iter::once((0.0, ramp)).chain(excitations).map(phase).collect();
    Experiment::new(name, 0.0, duration_s, phases)
}

fn multisine(name: &str, (center_v, amplitude_v): (f64, f64), axis: usize) -> Experiment {
    let frequency_hz = f64::from(flexstage::TICK_HZ) / PERIOD as f64;
    let wave = Waveform::Table { center_v, amplitude_v, frequency_hz, phase_turns: 0.0 };
    let duration_s = 0.35 + (PERIODS + 3) as f64 / frequency_hz;
    Experiment {
        period_s: Some(1.0 / frequency_hz),
        table: Some(odd_multisine(HIGHEST, 5)),
        ..around(name, axis, center_v, [(0.25, wave)], duration_s)
    }
}

fn sweep(name: &str, (center_v, amplitude_v): (f64, f64), axis: usize) -> Experiment {
    let (from_hz, to_hz) = SWEEP_HZ;
    // Twice upwards, each from rest: begun at its high end a sweep would overshoot by tens of volts.
    let wave = Waveform::Sweep { center_v, amplitude_v, from_hz, to_hz, duration_s: SWEEP_S };
    let twice = [(0.25, wave.clone()), (0.7 + SWEEP_S, wave)];
    around(name, axis, center_v, twice, 0.9 + 2.0 * SWEEP_S)
}

fn excite(excitation: Excitation, name: &str, level: (f64, f64), axis: usize) -> Experiment {
    match excitation {
        Excitation::Multisine => multisine(name, level, axis),
        Excitation::Sweep => sweep(name, level, axis),
    }
}

/// Response of one recorded column to another.
fn respond(
    excitation: Excitation,
    recording: &Recording,
    input: &[f32],
    output: &[f32],
) -> Result<Frf> {
    let rate = recording.meta.sample_rate_hz;
    let (input, output) = (on_ticks(recording, input), on_ticks(recording, output));
    let out = match excitation {
        Excitation::Multisine => {
            // Whole periods at the end: the first ones hold the transient.
            let start = input.len() - (PERIODS * PERIOD).min(input.len());
            frf::periodic(&input[start..], &output[start..], rate, PERIOD)
        }
        Excitation::Sweep => {
            // After the ramp to the bias.
            let start = ((0.3 * rate) as usize).min(input.len());
            let (input, output) = (&input[start..], &output[start..]);
            frf::swept(input, output, rate, SWEEP_SEGMENT, SWEEP_HZ, SWEEP_PER_DECADE)
        }
    };
    if out.points.is_empty() {
        return Err(Error::Invalid(
            "no stretch without a lost tick is long enough for a response: is this computer too busy to read the stream?"
                .into(),
        ));
    }
    Ok(out)
}

/// A recorded column with lost ticks as NaN.
fn on_ticks(recording: &Recording, column: &[f32]) -> Vec<f32> {
    let mut out = Vec::with_capacity(column.len());
    let mut expected = recording.tick.first().copied().unwrap_or(0);
    for (&tick, &value) in recording.tick.iter().zip(column) {
        while expected < tick {
            out.push(f32::NAN);
            expected += 1;
        }
        out.push(value);
        expected += 1;
    }
    out
}

fn column(column: &Option<Vec<f32>>, what: &str) -> Result<Vec<f32>> {
    column.clone().ok_or_else(|| Error::Invalid(format!("the board streams no {what}")))
}

/// Drive to position, measured open loop around a bias.
pub fn frequency_response(
    device: &Device,
    axis: usize,
    excitation: Excitation,
    level_v: (f64, f64),
    settings: &Settings,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Response> {
    let experiment = excite(excitation, "frequency response", level_v, axis);
    let recording = one(device, experiment, axis, Mode::OpenLoop, stop, progress)?;
    let position = column(&recording.position_um[axis], "position")?;
    let plant = respond(excitation, &recording, &recording.drive_v[axis], &position)?;
    Ok(with_controller(plant, settings, axis))
}

/// The loop that a measured plant makes with a board's feedback.
pub fn with_controller(plant: Frf, settings: &Settings, axis: usize) -> Response {
    let feedback = &settings.axes[axis].feedback;
    let loop_gain = loop_gain(&plant.coherent(COHERENT), feedback);
    let margins = margins(&loop_gain);
    Response { plant, loop_gain, margins }
}

/// Reference to position in closed loop with the settings on the board, feedforward included.
pub fn closed_loop_response(
    device: &Device,
    axis: usize,
    excitation: Excitation,
    level_um: (f64, f64),
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Frf> {
    let experiment = excite(excitation, "closed loop", level_um, axis);
    let recording = one(device, experiment, axis, Mode::ClosedLoop, stop, progress)?;
    let reference = column(&recording.reference_um[axis], "reference")?;
    let position = column(&recording.position_um[axis], "position")?;
    respond(excitation, &recording, &reference, &position)
}

/// Step response in closed loop with the settings on the board: figures, time (s from the step), position and reference (um).
pub fn step_response(
    device: &Device,
    axis: usize,
    (from_um, to_um): (f64, f64),
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<(StepMetrics, Vec<[f64; 3]>)> {
    let step = Waveform::Ramp { to_v: to_um, duration_s: 1e-4 };
    let experiment = around("step", axis, from_um, [(0.7, step)], 1.2);
    let recording = one(device, experiment, axis, Mode::ClosedLoop, stop, progress)?;
    let rate = recording.meta.sample_rate_hz;
    let reference = column(&recording.reference_um[axis], "reference")?;
    let position = column(&recording.position_um[axis], "position")?;
    // The host's commands are late by some ticks: the step is where the reference leaves its first level.
    let begin = (0.4 * rate) as usize;
    let from = reference.get(begin).copied().unwrap_or(0.0);
    let at = (begin..reference.len())
        .find(|&i| (reference[i] - from).abs() > 0.02 * (to_um - from_um).abs() as f32)
        .ok_or_else(|| {
            Error::Invalid("the reference did not step: check the travel limits".into())
        })?;
    let start = at - (0.05 * rate) as usize;
    let curve = (start..position.len())
        .map(|i| {
            let t = (i as f64 - at as f64) / rate;
            [t, f64::from(position[i]), f64::from(reference[i])]
        })
        .collect();
    let metrics =
        step_metrics(&position[start..], at - start, rate, Some(to_um)).ok_or_else(|| {
            Error::Invalid(
                "no step above the noise was seen in the position: check the wiring".into(),
            )
        })?;
    Ok((metrics, curve))
}

/// Noise of one axis.
#[derive(Clone, Debug, Serialize)]
pub struct Noise {
    /// Axis, from 1.
    pub axis: usize,
    /// Root mean square of the position about its mean, nm.
    pub rms_nm: f64,
    /// Root mean square above 100 Hz, nm.
    pub above_100hz_nm: f64,
    /// Strongest lines: Hz, nm rms.
    pub lines: Vec<(f64, f64)>,
    /// The spectrum, um^2/Hz.
    #[serde(skip)]
    pub psd: Psd,
}

/// Noise floor from a stretch of positions in which nothing was driven.
pub fn noise(axis: usize, position_um: &[f32], sample_rate_hz: f64) -> Noise {
    let segment = (position_um.len() / 4).next_power_of_two().clamp(64, 16_384);
    let psd = welch(position_um, sample_rate_hz, segment.min(position_um.len()));
    let above = psd.frequency_hz.iter().position(|f| *f >= 100.0);
    let above_100hz = above.and_then(|i| psd.rms_above().get(i).copied()).unwrap_or(0.0);
    let lines = psd.lines(5.0).into_iter().take(5).map(|(f, a)| (f, a * 1e3)).collect();
    Noise { axis: axis + 1, rms_nm: psd.rms() * 1e3, above_100hz_nm: above_100hz * 1e3, lines, psd }
}

/// Noise of all axes while nothing is driven. The stage stays as it is: parked or holding.
pub fn noise_floor(
    device: &Device,
    seconds: f64,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Vec<Noise>> {
    device.stream()?;
    let stream = device.subscribe();
    let rate = device.info().sample_rate_hz;
    let total_s = seconds.clamp(0.1, 3600.0);
    let wanted = (total_s * rate) as u64;
    let mut positions = vec![Vec::new(); AXES];
    let mut first = None;
    let mut done = 0;
    while done < wanted {
        if stop.load(Ordering::Acquire) {
            return Err(Error::Stopped("nothing was driven".into()));
        }
        let batch = stream.recv_timeout(SILENCE).map_err(|_| Error::Lost {
            board: device.info().name.clone(),
            reason: device
                .ended()
                .unwrap_or_else(|| format!("no samples for {} s", SILENCE.as_secs())),
        })?;
        if batch.restarted {
            let board = device.info().name.clone();
            return Err(Error::Lost { board, reason: "it restarted".into() });
        }
        for sample in batch.samples.iter() {
            if Flags(sample.flags).state() == State::Run {
                return Err(Error::Invalid(
                    "the noise floor is measured at rest, a waveform runs: hold or stop it first"
                        .into(),
                ));
            }
            done = sample.tick - *first.get_or_insert(sample.tick);
            for (column, value) in positions.iter_mut().zip(sample.position_um) {
                column.resize(done as usize, f32::NAN);
                column.push(value);
            }
        }
        let done_s = (done as f64 / rate).min(total_s);
        progress(&Progress { index: 0, count: 1, name: "noise floor".into(), done_s, total_s });
    }
    Ok(positions.iter().enumerate().map(|(axis, p)| noise(axis, p, rate)).collect())
}
