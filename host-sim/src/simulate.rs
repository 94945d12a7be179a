//! Whole recordings, without noise and rounding: what fits and replays run.
//!
//! Only the axes that the wanted readings depend on are simulated. Lost ticks hold the drive.

use crate::motion::{move_axes, needed, read};
use crate::rig::Rig;
use crate::start::Initial;

/// Most ticks in one recording, lost ones included.
pub const MAX_TICKS: u64 = 400_000_000;
/// Sample rates that are simulated, Hz.
pub const RATES_HZ: std::ops::RangeInclusive<f64> = 1.0..=1.0e6;

/// Why a simulation cannot run: one line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SimError(pub String);

/// What drives a simulation. Voltages in V, one slice an axis.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// Rate of the samples, Hz.
    pub sample_rate_hz: f64,
    /// Start on the session's clock, s.
    pub start_s: f64,
    /// Numbers of the samples, rising; `None`: 0, 1, 2, ...
    pub ticks: Option<&'a [u64]>,
    /// Commanded voltages, held from each sample to the next.
    pub drive_v: &'a [&'a [f64]],
    /// Measured amplifier outputs: used instead of drive and amplifier.
    pub monitor_v: Option<&'a [&'a [f64]]>,
    /// State before the first sample, an entry an axis; axes beyond the slice start from `Initial::default()`.
    pub initial: &'a [Initial],
}

/// Axes whose readings are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axes {
    /// All.
    All,
    /// Bit k set: axis k (counted from 0).
    Only(u32),
}

impl Axes {
    /// Whether an axis is wanted.
    pub fn contains(self, axis: usize) -> bool {
        match self {
            Axes::All => true,
            Axes::Only(mask) => mask >> axis & 1 == 1,
        }
    }
}

/// What a simulation gives at each sample; a vector is empty for an axis that was not wanted.
#[derive(Debug, Clone, Default)]
pub struct Output {
    /// What the sensor reads, m, before this sample's drive acts.
    pub position_m: Vec<Vec<f64>>,
    /// Amplifier output, V.
    pub monitor_v: Vec<Vec<f64>>,
    /// State after the last sample, to start the next simulation from; default for axes that were not simulated.
    pub end: Vec<Initial>,
}

/// Simulate a rig under a recorded drive.
pub fn simulate(rig: &Rig, input: &Input, wanted: Axes) -> Result<Output, SimError> {
    let n = rig.axes.len();
    check(rig, input)?;
    match input.ticks.filter(|ticks| !is_contiguous(ticks)) {
        None => run(rig, input, wanted),
        Some(ticks) => {
            let spread = |channels: &[&[f64]]| -> Vec<Vec<f64>> {
                channels.iter().map(|channel| hold(channel, ticks)).collect()
            };
            let drive = spread(input.drive_v);
            let drive: Vec<&[f64]> = drive.iter().map(Vec::as_slice).collect();
            let monitor = input.monitor_v.map(spread);
            let monitor: Option<Vec<&[f64]>> =
                monitor.as_ref().map(|all| all.iter().map(Vec::as_slice).collect());
            let whole =
                Input { ticks: None, drive_v: &drive, monitor_v: monitor.as_deref(), ..*input };
            let mut output = run(rig, &whole, wanted)?;
            for axis in 0..n {
                keep(&mut output.position_m[axis], ticks);
                keep(&mut output.monitor_v[axis], ticks);
            }
            Ok(output)
        }
    }
}

pub(crate) fn check(rig: &Rig, input: &Input) -> Result<(), SimError> {
    let n = rig.axes.len();
    let fail = |message: String| Err(SimError(message));
    if !RATES_HZ.contains(&input.sample_rate_hz) {
        return fail(format!(
            "sample_rate_hz: expected 1 to 1000000, found {}",
            input.sample_rate_hz
        ));
    }
    if !input.start_s.is_finite() {
        return fail(format!("start_s: expected a number, found {}", input.start_s));
    }
    if input.drive_v.len() != n {
        return fail(format!(
            "expected a drive for each of the {n} axes of {}, found {}",
            rig.name,
            input.drive_v.len()
        ));
    }
    let samples = input.drive_v[0].len();
    if samples == 0 {
        return fail("expected samples, found none".into());
    }
    let monitors = input.monitor_v.unwrap_or(&[]);
    if input.monitor_v.is_some() && monitors.len() != n {
        return fail(format!(
            "expected a monitor for each of the {n} axes, found {}",
            monitors.len()
        ));
    }
    for channel in input.drive_v.iter().chain(monitors) {
        if channel.len() != samples {
            return fail(format!("expected {samples} samples a channel, found {}", channel.len()));
        }
        // A loop that does not end early vectorises, and fits pass here for every simulation.
        if !channel.iter().fold(true, |all, v| all & v.is_finite())
            && let Some(at) = channel.iter().position(|v| !v.is_finite())
        {
            return fail(format!("sample {at}: expected a voltage, found {}", channel[at]));
        }
    }
    if let Some(ticks) = input.ticks {
        if ticks.len() != samples {
            return fail(format!("expected {samples} ticks, found {}", ticks.len()));
        }
        if let Some(at) = ticks.windows(2).position(|pair| pair[0] >= pair[1]) {
            return fail(format!(
                "tick {}: expected rising ticks, found {} next",
                ticks[at],
                ticks[at + 1]
            ));
        }
        if ticks[samples - 1] - ticks[0] >= MAX_TICKS {
            return fail(format!("expected at most {MAX_TICKS} ticks from first to last"));
        }
    }
    Ok(())
}

fn is_contiguous(ticks: &[u64]) -> bool {
    ticks
        .last()
        .zip(ticks.first())
        .is_none_or(|(last, first)| last - first + 1 == ticks.len() as u64)
}

fn hold(channel: &[f64], ticks: &[u64]) -> Vec<f64> {
    let mut held = Vec::with_capacity((ticks[ticks.len() - 1] - ticks[0] + 1) as usize);
    for (at, &value) in channel.iter().enumerate() {
        let next = ticks.get(at + 1).copied().unwrap_or(ticks[at] + 1);
        held.extend(std::iter::repeat_n(value, (next - ticks[at]) as usize));
    }
    held
}

fn keep(channel: &mut Vec<f64>, ticks: &[u64]) {
    if !channel.is_empty() {
        *channel = ticks.iter().map(|tick| channel[(tick - ticks[0]) as usize]).collect();
    }
}

fn run(rig: &Rig, input: &Input, wanted: Axes) -> Result<Output, SimError> {
    let motion = move_axes(rig, input, needed(rig, wanted))?;
    read(rig, input, motion, wanted)
}
