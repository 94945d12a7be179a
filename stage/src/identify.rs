//! `flexstage identify`: refit the nominal parameters of a rig to a session, or identify what a controller needs.

use std::path::{Path, PathBuf};

use anyhow::bail;
use host_sim::{AnyRig, Rig};
use recording::Session;

use crate::diagnose::{inputs, no_input};
use crate::say::say;

/// Options of `flexstage identify`.
#[derive(clap::Args)]
pub struct Args {
    /// Rig file: the model as it is known.
    #[arg(long)]
    rig: PathBuf,
    /// Folder of recordings of that rig.
    session: PathBuf,
    /// Calibrated rig file to write.
    #[arg(long)]
    out: PathBuf,
    /// Identify what a controller needs instead, for `tune --model`: gain and slip elements from slow motion, amplifier and
    /// resonance from fast excitation, creep from a held step.
    #[arg(long)]
    for_control: bool,
    /// Sample rate of CSV recordings, Hz.
    #[arg(long, value_parser = crate::number::rate())]
    sample_rate: Option<f64>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    // Before the work, not after it.
    crate::output::file_in_new_folders(&args.out)?;
    let Some(name) = args.out.file_name().and_then(|n| n.to_str()) else {
        bail!("{}: expected a file name for the calibrated rig", args.out.display());
    };
    let parent = crate::output::parent(&args.out);
    let rig = AnyRig::load(&args.rig)?;
    if args.for_control && matches!(rig, AnyRig::Platform(_)) {
        bail!(
            "{}: --for-control: expected a stage driven by stacks, found a platform",
            args.rig.display()
        );
    }
    let session = Session::read(&args.session, args.sample_rate)?;
    no_input(&args.out, inputs(&args.rig, &session))?;
    match rig {
        AnyRig::Platform(rig) => crate::platform::identify(&rig, &session, parent, name)?,
        AnyRig::Stage(rig) => stage(&rig, &session, args.for_control, (parent, name))?,
    }
    for note in &session.notes {
        say!("{note}")?;
    }
    Ok(())
}

fn stage(
    rig: &Rig,
    session: &Session,
    for_control: bool,
    (parent, name): (&Path, &str),
) -> anyhow::Result<()> {
    for entry in &session.recordings {
        crate::platform::refuse_free_return(&entry.recording, &entry.path)?;
    }
    if for_control {
        let bar = indicatif::ProgressBar::new_spinner().with_message(format!(
            "fitting creep, hysteresis and lag of {} axes to {} recordings",
            rig.axes.len(),
            session.recordings.len()
        ));
        bar.enable_steady_tick(std::time::Duration::from_millis(100));
        let found = gap::for_control(rig, session);
        bar.finish_and_clear();
        let found = found?;
        crate::diagnose::write_all(parent, &[(name, found.rig.to_toml())])?;
        for (axis, findings) in found.axes.iter().enumerate() {
            if let Some(findings) = findings {
                say!("axis {}: {}", axis + 1, findings.line())?;
            }
        }
        for note in &found.notes {
            say!("{note}")?;
        }
        return Ok(());
    }
    let options = gap::Options { progress: true, ..gap::Options::default() };
    let found = gap::identify(rig, session, &options)?;
    crate::diagnose::write_all(parent, &[(name, found.rig.to_toml())])?;
    for line in &found.lines {
        say!("{line}")?;
    }
    say!(
        "last third of every recording, not fitted: {:.2} nm -> {:.2} nm; everything: {:.2} nm -> \
         {:.2} nm; noise {:.2} nm",
        found.held_out_before_nm,
        found.held_out_after_nm,
        found.before_nm,
        found.after_nm,
        found.floor_nm
    )?;
    if let Some(band) = &found.band {
        say!(
            "this model follows the recordings below {:.0} Hz only, and was fitted there; the last third below {:.0} Hz: {:.2} nm -> \
             {:.2} nm; noise {:.2} nm",
            band.below_hz,
            band.below_hz,
            band.before_nm,
            band.after_nm,
            band.floor_nm
        )?;
    }
    if let Some(linear_nm) = found.held_out_linear_nm {
        say!(
            "the same third with gains, offsets and lags alone, without slip elements: {linear_nm:.2} nm"
        )?;
    }
    Ok(())
}
