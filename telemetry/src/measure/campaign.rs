//! Measurements on a board: what is driven, what is computed, in one call each.

use std::sync::atomic::AtomicBool;

use flexstage::Settings;
use recording::Recording;
use serde::Serialize;

use super::margins::{Margins, margins};
use super::psd::{Psd, welch};
use super::step::{StepMetrics, step_metrics};
use super::{Frf, frf};
use crate::device::Device;
use crate::probe::plan::{Phase, Waveform, odd_multisine};
use crate::probe::{Experiment, Mode, Progress, capture};
use crate::tune::controller_response;
use crate::{Error, Result};

/// Period of the multisine in ticks: one table point a tick, lines every 9.77 Hz.
const PERIOD: usize = flexstage::TABLE_POINTS;
/// Highest line: 2.5 kHz.
const HIGHEST: usize = 255;
/// Periods measured after the first two.
const PERIODS: usize = 40;
/// Coherence below which a line says nothing.
const COHERENT: f64 = 0.8;

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

fn multisine(name: &str, center: f64, amplitude: f64, axis: usize) -> Experiment {
    let rate = f64::from(flexstage::TICK_HZ);
    let hz = rate / PERIOD as f64;
    let wave = Waveform::Table {
        center_v: center,
        amplitude_v: amplitude,
        frequency_hz: hz,
        phase_turns: 0.0,
    };
    let ramp = Waveform::Ramp { to_v: center, duration_s: 0.2 };
    Experiment {
        name: name.to_owned(),
        condition_v: 0.0,
        phases: vec![
            Phase { at_s: 0.0, moves: vec![(axis, ramp)] },
            Phase { at_s: 0.25, moves: vec![(axis, wave)] },
        ],
        duration_s: 0.35 + (PERIODS + 3) as f64 / hz,
        period_s: Some(1.0 / hz),
        table: Some(odd_multisine(HIGHEST, 5)),
    }
}

/// Whole periods at the end of a recording, lost ticks as NaN.
fn last_periods(recording: &Recording, column: &[f32]) -> Vec<f32> {
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
    let keep = (PERIODS * PERIOD).min(out.len());
    out.split_off(out.len() - keep)
}

fn column(column: &Option<Vec<f32>>, what: &str) -> Result<Vec<f32>> {
    column.clone().ok_or_else(|| Error::Invalid(format!("the board streams no {what}")))
}

/// Drive to position, measured open loop around a bias.
pub fn frequency_response(
    device: &Device,
    axis: usize,
    (bias_v, amplitude_v): (f64, f64),
    settings: &Settings,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Response> {
    let experiment = multisine("frequency response", bias_v, amplitude_v, axis);
    let recording = one(device, experiment, axis, Mode::OpenLoop, stop, progress)?;
    let rate = recording.meta.sample_rate_hz;
    let drive = last_periods(&recording, &recording.drive_v[axis]);
    let position = last_periods(&recording, &column(&recording.position_um[axis], "position")?);
    let plant = frf::periodic(&drive, &position, rate, PERIOD);
    if plant.points.is_empty() {
        return Err(Error::Invalid(
            "no whole period without a lost tick was recorded: is the board streaming at full rate?".into(),
        ));
    }
    Ok(with_controller(plant, settings, axis))
}

/// The loop that a measured plant makes with a board's feedback.
pub fn with_controller(plant: Frf, settings: &Settings, axis: usize) -> Response {
    let feedback = &settings.axes[axis].feedback;
    let loop_gain = plant.coherent(COHERENT).map(|f| controller_response(feedback, f));
    let margins = margins(&loop_gain);
    Response { plant, loop_gain, margins }
}

/// Reference to position in closed loop with the settings on the board, feedforward included.
pub fn closed_loop_response(
    device: &Device,
    axis: usize,
    (center_um, amplitude_um): (f64, f64),
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Frf> {
    let experiment = multisine("closed loop", center_um, amplitude_um, axis);
    let recording = one(device, experiment, axis, Mode::ClosedLoop, stop, progress)?;
    let rate = recording.meta.sample_rate_hz;
    let reference = last_periods(&recording, &column(&recording.reference_um[axis], "reference")?);
    let position = last_periods(&recording, &column(&recording.position_um[axis], "position")?);
    Ok(frf::periodic(&reference, &position, rate, PERIOD))
}

/// Step response in closed loop with the settings on the board: figures, time (s from the step), position and reference (um).
pub fn step_response(
    device: &Device,
    axis: usize,
    (from_um, to_um): (f64, f64),
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<(StepMetrics, Vec<[f64; 3]>)> {
    let ramp = |to_v: f64, duration_s: f64| vec![(axis, Waveform::Ramp { to_v, duration_s })];
    let experiment = Experiment {
        name: "step".into(),
        condition_v: 0.0,
        phases: vec![
            Phase { at_s: 0.0, moves: ramp(from_um, 0.2) },
            Phase { at_s: 0.7, moves: ramp(to_um, 1e-4) },
        ],
        duration_s: 1.2,
        period_s: None,
        table: None,
    };
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
