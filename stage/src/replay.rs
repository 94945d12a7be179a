//! `flexstage replay`: simulate a rig under a recorded drive and write what its sensors and monitors would have read.
//!
//! In: a rig file and a recording. Out: the recording with the simulated `position_um_K`, and `monitor_v_K` for the
//! axes whose rig has a monitor; drive, ticks and metadata are those recorded. No noise and no rounding are added. The
//! electrical memory before the first sample is unknown: a stack that has never been driven is assumed. Creep of what was done to it before
//! is estimated from the measured positions before `settle_s` (`gap::session::lead_in`); the scored ones are never looked at.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use host_sim::{AnyRig, Axes, Input, Rig};
use recording::Recording;

/// Beyond a metre and a megavolt no stage or platform goes, um and V.
const FARTHEST: f32 = 1.0e6;

/// Options of `flexstage replay`.
#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    #[arg(long)]
    rig: PathBuf,
    /// Recording: Parquet, or CSV with --sample-rate.
    recording: PathBuf,
    /// Where the simulated recording goes.
    #[arg(long)]
    out: PathBuf,
    /// Rate of a CSV recording, Hz.
    #[arg(long, value_parser = crate::number::rate())]
    sample_rate: Option<f64>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let rig = AnyRig::load(&args.rig)?;
    // Before the work, not after it.
    recording::check_name(&args.out)?;
    crate::output::file(&args.out)?;
    crate::diagnose::no_input(&args.out, [args.rig.as_path(), &args.recording])?;
    let recording = match args.sample_rate {
        Some(rate) => Recording::read_csv(&args.recording, rate)?,
        None => Recording::read(&args.recording)?,
    };
    let predicted = match rig {
        AnyRig::Stage(rig) => {
            crate::platform::refuse_free_return(&recording, &args.recording)?;
            predict(&rig, &recording, &args.recording)?
        }
        AnyRig::Platform(rig) => gap::platform::replay(&rig, &recording, &args.recording)?,
    };
    stays_in_bounds(&predicted, &args)?;
    predicted.write(&args.out).context("the simulated recording was not written")
}

/// What leaves all bounds in a simulation is the fault of its rig, and no recording.
fn stays_in_bounds(predicted: &Recording, args: &Args) -> anyhow::Result<()> {
    let channels =
        [(&predicted.position_um, "position", "um"), (&predicted.monitor_v, "monitor", "V")];
    for (channels, what, unit) in channels {
        for (axis, channel) in channels.iter().enumerate() {
            let out = |value: &f32| !value.is_finite() || value.abs() > FARTHEST;
            let channel = channel.as_deref().unwrap_or(&[]);
            if let Some(row) = channel.iter().position(out) {
                bail!(
                    "{}: its simulation leaves all bounds: {what} of axis {} at {:e} {unit}, {:.4} s into {}, expected up to {FARTHEST:e} \
                     {unit}: check the numbers in the rig file",
                    args.rig.display(),
                    axis + 1,
                    channel[row],
                    predicted.time_s(row) - predicted.time_s(0),
                    args.recording.display()
                );
            }
        }
    }
    Ok(())
}

/// The recording that the rig would have made; `name` is the file, for errors.
pub fn predict(rig: &Rig, recording: &Recording, name: &Path) -> anyhow::Result<Recording> {
    let axes = rig.axes.len();
    if recording.axes() > axes {
        bail!(
            "{}: expected the {axes} axes of rig {}, found {}",
            name.display(),
            rig.name,
            recording.axes()
        );
    }
    let samples = recording.len();
    let mut drive: Vec<Vec<f64>> = recording
        .drive_v
        .iter()
        .map(|channel| channel.iter().map(|v| f64::from(*v)).collect())
        .collect();
    drive.resize(axes, vec![0.0; samples]);
    let drive: Vec<&[f64]> = drive.iter().map(Vec::as_slice).collect();
    let input = Input {
        sample_rate_hz: recording.meta.sample_rate_hz,
        start_s: recording.meta.start_s,
        ticks: Some(&recording.tick),
        drive_v: &drive,
        monitor_v: None,
        initial: &[],
    };
    let measured_m = |axis: usize, row: usize| {
        Some(f64::from(recording.position_um.get(axis)?.as_ref()?[row]) * 1.0e-6)
    };
    // Where ticks were lost the simulation holds a drive that was none.
    let settle = recording.settle_rows();
    let settle = if settle as u64 == recording.settle_ticks() { settle } else { 0 };
    let initial = gap::session::lead_in::initial(rig, &input, settle, measured_m)
        .with_context(|| name.display().to_string())?;
    let input = Input { initial: &initial, ..input };
    let output =
        host_sim::simulate(rig, &input, Axes::All).with_context(|| name.display().to_string())?;
    let mut predicted = recording.clone();
    predicted.drive_v.resize(axes, vec![0.0; samples]);
    predicted.monitor_v.resize(axes, None);
    predicted.position_um.resize(axes, None);
    predicted.reference_um.resize(axes, None);
    for axis in 0..axes {
        let positions = output.position_m[axis].iter().map(|x| (x * 1.0e6) as f32);
        predicted.position_um[axis] = Some(positions.collect());
        predicted.monitor_v[axis] = rig.axes[axis]
            .monitor
            .as_ref()
            .map(|_| output.monitor_v[axis].iter().map(|v| *v as f32).collect());
    }
    Ok(predicted)
}
