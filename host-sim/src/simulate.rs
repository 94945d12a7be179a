//! Whole recordings, without noise and rounding: what fits and replays run.
//!
//! Only the axes that the wanted readings depend on are simulated. Lost ticks hold the drive.

use crate::rig::Rig;
use crate::stages::group::Group;
use crate::stages::model::Model;
use crate::stages::sensor::SensorSim;
use crate::start::Initial;

/// Most ticks in one recording, lost ones included.
pub const MAX_TICKS: u64 = 400_000_000;

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
    let samples = check(rig, input)?;
    match input.ticks.filter(|ticks| !is_contiguous(ticks)) {
        None => run(rig, input, wanted, samples),
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
            let mut output = run(rig, &whole, wanted, drive[0].len())?;
            for axis in 0..n {
                keep(&mut output.position_m[axis], ticks);
                keep(&mut output.monitor_v[axis], ticks);
            }
            Ok(output)
        }
    }
}

fn check(rig: &Rig, input: &Input) -> Result<usize, SimError> {
    let n = rig.axes.len();
    let fail = |message: String| Err(SimError(message));
    if !(1.0..=1.0e6).contains(&input.sample_rate_hz) {
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
        if let Some(at) = channel.iter().position(|v| !v.is_finite()) {
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
    Ok(samples)
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

fn run(rig: &Rig, input: &Input, wanted: Axes, samples: usize) -> Result<Output, SimError> {
    let n = rig.axes.len();
    let step_s = 1.0 / input.sample_rate_hz;
    let mut model = Model::new(rig, step_s);
    let mut sensors = SensorSim::new(&mut model.axes, model.output_map.take());
    let mut needed = vec![false; n];
    for sensor in (0..n).filter(|&sensor| wanted.contains(sensor)) {
        needed[sensor] = true;
        sensors.axes_of(sensor).into_iter().for_each(|axis| needed[axis] = true);
    }
    let groups = Group::split(model.axes, &model.springs, step_s);
    let mut output = Output {
        position_m: vec![Vec::new(); n],
        monitor_v: vec![Vec::new(); n],
        end: vec![Initial::default(); n],
    };
    let mut displacement_m = vec![Vec::new(); n];
    for mut group in groups {
        if group.members.iter().any(|&axis| needed[axis]) {
            run_group(&mut group, input, samples, &mut displacement_m, &mut output);
        }
    }
    let wanted_sensors = || (0..n).filter(|&sensor| wanted.contains(sensor));
    if wanted_sensors().all(|sensor| sensors.is_bare(sensor)) {
        for sensor in wanted_sensors() {
            output.position_m[sensor] = sensors.bare_readings(sensor, &mut displacement_m, samples);
        }
    } else {
        let mut readings = vec![0.0; n];
        for sensor in wanted_sensors() {
            output.position_m[sensor].reserve_exact(samples);
        }
        for sample in 0..samples {
            let time_s = input.start_s + sample as f64 * step_s;
            let displacement =
                |axis: usize| displacement_m[axis].get(sample).copied().unwrap_or(0.0);
            sensors.read(displacement, time_s, |sensor| wanted.contains(sensor), &mut readings);
            for sensor in wanted_sensors() {
                output.position_m[sensor].push(readings[sensor]);
            }
        }
    }
    for axis in (0..n).filter(|&axis| !wanted.contains(axis)) {
        output.monitor_v[axis] = Vec::new();
    }
    Ok(output)
}

fn run_group(
    group: &mut Group,
    input: &Input,
    samples: usize,
    displacement_m: &mut [Vec<f64>],
    output: &mut Output,
) {
    let step_s = 1.0 / input.sample_rate_hz;
    let rested = Initial::default();
    let monitor = |axis: usize, sample: usize| input.monitor_v.map(|all| all[axis][sample]);
    group.start(
        |axis| input.drive_v[axis][0],
        |axis| input.initial.get(axis).unwrap_or(&rested),
        |axis| monitor(axis, 0),
        input.start_s,
    );
    let members = group.members.clone();
    let mut x: Vec<Vec<f64>> = members.iter().map(|_| Vec::with_capacity(samples)).collect();
    let mut v: Vec<Vec<f64>> = members.iter().map(|_| Vec::with_capacity(samples)).collect();
    let time_s = |sample: usize| input.start_s + (sample + 1) as f64 * step_s;
    if group.is_alone() {
        let (x, v) = (&mut x[0], &mut v[0]);
        x.push(group.axes()[0].position_m());
        v.push(group.axes()[0].output_v());
        group.follow(
            samples - 1,
            |sample, axis| input.drive_v[axis][sample],
            |sample, axis| monitor(axis, sample + 1),
            time_s,
            |_, position_m, output_v| {
                x.push(position_m);
                v.push(output_v);
            },
        );
    } else {
        for sample in 0..samples {
            for (slot, axis) in group.axes().iter().enumerate() {
                x[slot].push(axis.position_m());
                v[slot].push(axis.output_v());
            }
            if sample + 1 < samples {
                group.advance(
                    |axis| input.drive_v[axis][sample],
                    |axis| monitor(axis, sample + 1),
                    time_s(sample),
                );
            }
        }
    }
    for (slot, &member) in members.iter().enumerate() {
        output.end[member] = group.axes()[slot].state();
        displacement_m[member] = std::mem::take(&mut x[slot]);
        output.monitor_v[member] = std::mem::take(&mut v[slot]);
    }
}
