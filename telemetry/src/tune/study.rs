//! Tuning on a board or on a model of the rig: measure, propose, predict; then apply, measure again, compare.

use std::sync::atomic::AtomicBool;

use flexstage::Settings;
use flexstage::link::message::{Command, Reply};
use host_sim::Rig;

use super::{Proposal, predict_closed_loop, propose};
use crate::device::Device;
use crate::measure::Frf;
use crate::measure::campaign::{Excitation, Response, closed_loop_response, frequency_response};
use crate::probe::Progress;
use crate::probe::limits::scale_um_per_v;
use crate::transport::Target;
use crate::virtual_board::{Options, Speed};
use crate::{Error, Result};

/// Where and how strongly is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Voltage around which is measured.
    pub bias_v: f64,
    /// Peak of the excitation, V.
    pub amplitude_v: f64,
}

impl Default for Level {
    fn default() -> Self {
        Self { bias_v: 45.0, amplitude_v: 8.0 }
    }
}

impl Level {
    /// The same place in micrometres of reference, half as strong: feedforward and feedback add up.
    fn in_um(self, settings: &Settings, axis: usize) -> (f64, f64) {
        let (scale, origin) = scale_um_per_v(settings, axis);
        (self.bias_v * scale + origin, 0.5 * self.amplitude_v * scale)
    }
}

/// What was measured, what is proposed, what it should give.
#[derive(Clone, Debug)]
pub struct Study {
    /// Axis, from 0.
    pub axis: usize,
    /// Where it was measured.
    pub level: Level,
    /// Settings in effect.
    pub in_effect: Settings,
    /// Drive to position, and the loop with the settings in effect.
    pub before: Response,
    /// Reference to position with the settings in effect.
    pub closed_before: Frf,
    /// The proposal.
    pub proposal: Proposal,
    /// Reference to position that it should give.
    pub closed_predicted: Frf,
}

/// What the proposal did.
#[derive(Clone, Debug)]
pub struct Applied {
    /// Tick from which the settings act.
    pub tick: u32,
    /// Their digest.
    pub digest: u32,
    /// Drive to position, and the loop with the new settings.
    pub after: Response,
    /// Reference to position, measured.
    pub closed: Frf,
}

fn settings_of(device: &Device) -> Result<Settings> {
    match device.command(Command::ReadSettings)? {
        Reply::Settings(settings) => Ok(settings),
        _ => Err(Error::Invalid("the board did not answer with its settings".into())),
    }
}

/// Progress over two measurements.
fn half(index: usize, progress: &mut dyn FnMut(&Progress)) -> impl FnMut(&Progress) + '_ {
    move |p: &Progress| {
        let done_s = p.done_s + index as f64 * p.total_s;
        progress(&Progress { index, count: 2, done_s, total_s: 2.0 * p.total_s, ..p.clone() });
    }
}

/// Measure an axis (from 0) on a board and propose settings for it. Leaves the board as it was.
pub fn study(
    device: &Device,
    axis: usize,
    level: Level,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Study> {
    let in_effect = settings_of(device)?;
    let (before, closed_before) = both(device, axis, level, &in_effect, stop, progress)?;
    let mut proposal = propose(&before.plant, &in_effect, axis).ok_or_else(|| {
        Error::Invalid(format!(
            "the response of axis {} is too noisy, or no gains keep the margins: measure with a larger amplitude than {} V and \
             look at the frequency response",
            axis + 1,
            level.amplitude_v
        ))
    })?;
    let notes = std::mem::take(&mut proposal.plant_notes);
    proposal.changes.extend(notes);
    let (old, new) = (&in_effect.axes[axis], &proposal.settings.axes[axis]);
    let closed_predicted = predict_closed_loop(&before.plant, &closed_before, old, new);
    Ok(Study { axis, level, in_effect, before, closed_before, proposal, closed_predicted })
}

/// Measure a model of the rig instead of the stage, and propose settings for a board that has `in_effect`: the feedforward (stack, hysteresis,
/// load, amplifier, creep, coupling) as the rig file knows it, the feedback tuned on its simulated response.
pub fn study_model(
    rig: &Rig,
    in_effect: &Settings,
    axis: usize,
    level: Level,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Study> {
    let modelled = with_model(rig, in_effect);
    let board = |settings: &Settings| {
        Device::open(&Target::Virtual(Options {
            rig: rig.clone(),
            speed: Speed::Max,
            settings: settings.clone(),
            ..Options::default()
        }))
    };
    let now = board(in_effect)?;
    let (before, closed_before) = both(&now, axis, level, in_effect, stop, progress)?;
    drop(now);
    let mut proposal = propose(&before.plant, &modelled, axis).ok_or_else(|| {
        Error::Invalid(format!("{}: no gains keep the margins on axis {}", rig.name, axis + 1))
    })?;
    proposal.before = super::figures(&before.plant.coherent(0.8), &in_effect.axes[axis].feedback);
    proposal.changes.splice(0..0, model_changes(in_effect, &modelled, axis));
    // The rig's own time constant and stiffness, not what could be read from its response.
    proposal.plant_notes.clear();
    proposal.settings.axes[axis].amplifier_time_constant_s =
        modelled.axes[axis].amplifier_time_constant_s;
    let tuned = board(&proposal.settings)?;
    let level_um = level.in_um(&proposal.settings, axis);
    let closed_predicted =
        closed_loop_response(&tuned, axis, Excitation::Multisine, level_um, stop, &mut |_| {})?;
    let in_effect = in_effect.clone();
    Ok(Study { axis, level, in_effect, before, closed_before, proposal, closed_predicted })
}

fn both(
    device: &Device,
    axis: usize,
    level: Level,
    settings: &Settings,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<(Response, Frf)> {
    let volts = (level.bias_v, level.amplitude_v);
    let kind = Excitation::Multisine;
    let open =
        frequency_response(device, axis, kind, volts, settings, stop, &mut half(0, progress))?;
    let level_um = level.in_um(settings, axis);
    let closed = closed_loop_response(device, axis, kind, level_um, stop, &mut half(1, progress))?;
    Ok((open, closed))
}

/// Put the proposal into effect (not into flash) and measure again.
pub fn apply(
    device: &Device,
    study: &Study,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&Progress),
) -> Result<Applied> {
    let settings = &study.proposal.settings;
    let Reply::Configured { tick, digest } =
        device.command(Command::SetSettings(settings.clone()))?
    else {
        return Err(Error::Invalid("the board did not say what took effect".into()));
    };
    let (after, closed) = both(device, study.axis, study.level, settings, stop, progress)?;
    Ok(Applied { tick, digest, after, closed })
}

/// Settings of a board with the feedforward of a rig file; limits, converters, feedback and guard stay the board's.
pub fn with_model(rig: &Rig, settings: &Settings) -> Settings {
    let model = host_sim::controller_settings(rig);
    let mut out = settings.clone();
    for (axis, model) in out.axes.iter_mut().zip(model.axes).take(rig.axes.len()) {
        axis.stack = model.stack;
        axis.mechanism = model.mechanism;
        axis.amplifier_time_constant_s = model.amplifier_time_constant_s;
        axis.feedforward.creep = model.feedforward.creep;
    }
    out.cross_stiffness_n_per_m = model.cross_stiffness_n_per_m;
    out
}

fn model_changes(old: &Settings, new: &Settings, axis: usize) -> Vec<String> {
    let (a, b) = (&old.axes[axis], &new.axes[axis]);
    let mut out = Vec::new();
    let mut change = |name: &str, old: f32, new: f32, unit: &str| {
        if old != new {
            out.push(format!("{name}: {old:.4} -> {new:.4} {unit}"));
        }
    };
    let mega = 1e-6;
    change(
        "load stiffness",
        a.mechanism.stiffness_n_per_m * mega,
        b.mechanism.stiffness_n_per_m * mega,
        "N/um",
    );
    change(
        "stack stiffness",
        a.stack.stiffness_n_per_m * mega,
        b.stack.stiffness_n_per_m * mega,
        "N/um",
    );
    change("force per volt", a.stack.transformer_n_per_v, b.stack.transformer_n_per_v, "N/V");
    change("moving mass", a.mechanism.mass_kg, b.mechanism.mass_kg, "kg");
    change(
        "amplifier time constant",
        a.amplifier_time_constant_s * 1e3,
        b.amplifier_time_constant_s * 1e3,
        "ms",
    );
    if a.stack.hysteresis != b.stack.hysteresis {
        out.push(format!("hysteresis: {} slip elements of the rig file", b.stack.hysteresis.len()));
    }
    if a.feedforward.creep != b.feedforward.creep {
        out.push(format!("creep: {} elements of the rig file", b.feedforward.creep.len()));
    }
    out
}

/// Root mean square distance of two responses up to a frequency, relative to the second: how well a prediction held.
pub fn distance(predicted: &Frf, measured: &Frf, to_hz: f64) -> Option<f64> {
    let squares: Vec<f64> = measured
        .points
        .iter()
        .filter(|m| m.frequency_hz <= to_hz)
        .filter_map(|m| {
            let near = |p: &&crate::measure::FrfPoint| {
                (p.frequency_hz - m.frequency_hz).abs() < 1e-3 * m.frequency_hz
            };
            let p = predicted.points.iter().find(near)?;
            Some((p.response / m.response - 1.0).norm_sqr())
        })
        .collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}
