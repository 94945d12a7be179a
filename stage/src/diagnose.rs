//! `flexstage diagnose`: why the rig and its simulation disagree.

use std::path::{Path, PathBuf};

use anyhow::bail;
use host_sim::AnyRig;
use recording::Session;

use crate::say::say;

/// Options of `flexstage diagnose`.
#[derive(clap::Args)]
pub struct Args {
    /// Rig file: the model as it is known.
    #[arg(long)]
    rig: PathBuf,
    /// Folder of recordings of that rig.
    session: PathBuf,
    /// Folder for diagnosis.json, rig.toml and report.html; made if it is missing.
    #[arg(long)]
    out: PathBuf,
    /// Sample rate of CSV recordings, Hz.
    #[arg(long, value_parser = crate::number::rate())]
    sample_rate: Option<f64>,
    /// Leave an effect out of the catalogue (may be given several times).
    #[arg(long)]
    exclude: Vec<String>,
}

/// Names of what is written.
const ANSWER: [&str; 3] = ["diagnosis.json", "rig.toml", "report.html"];

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let rig = AnyRig::load(&args.rig)?;
    check_excluded(&args.exclude, &rig)?;
    if args.out.exists() && !args.out.is_dir() {
        bail!("{}: expected a folder for the answer, found a file", args.out.display());
    }
    // Before the work, not after it.
    for name in ANSWER {
        crate::output::file_in_new_folders(&args.out.join(name))?;
    }
    let session = Session::read(&args.session, args.sample_rate)?;
    for name in ANSWER {
        no_input(&args.out.join(name), inputs(&args.rig, &session))?;
    }
    let options = gap::Options { exclude: args.exclude, progress: true };
    let (diagnosis, rig, report) = match rig {
        AnyRig::Stage(rig) => {
            for entry in &session.recordings {
                crate::platform::refuse_free_return(&entry.recording, &entry.path)?;
            }
            let outcome = gap::diagnose(&rig, &session, &options)?;
            (outcome.diagnosis, outcome.rig.to_toml(), outcome.report)
        }
        AnyRig::Platform(rig) => {
            let outcome = gap::platform::diagnose(&rig, &session, &options)?;
            (outcome.diagnosis, outcome.rig.to_toml(), outcome.report)
        }
    };
    let mut json = serde_json::to_string_pretty(&diagnosis)?;
    json.push('\n');
    let [json_name, rig_name, report_name] = ANSWER;
    write_all(&args.out, &[(json_name, json), (rig_name, rig), (report_name, report.to_html())])?;
    say!("{}", gap::sentence(&diagnosis))?;
    for note in &session.notes {
        say!("{note}")?;
    }
    say!("{}", args.out.join(report_name).display())?;
    Ok(())
}

/// What is taken out of a catalogue must be in it: in that of the rig's kind, or among what a stage is told from.
fn check_excluded(excluded: &[String], rig: &AnyRig) -> anyhow::Result<()> {
    use host_sim::effects::{catalogue, strangers};
    let (kind, known, beside): (_, Vec<&str>, Vec<&str>) = match rig {
        AnyRig::Stage(_) => {
            let names = |effects: &[&dyn host_sim::effects::Effect]| {
                effects.iter().map(|effect| effect.info().name).collect()
            };
            ("stages", names(catalogue()), names(strangers()))
        }
        AnyRig::Platform(_) => {
            let effects = gap::platform::catalogue::CATALOGUE;
            ("platforms", effects.iter().map(|effect| effect.name()).collect(), Vec::new())
        }
    };
    for name in excluded {
        if !known.contains(&name.as_str()) && !beside.contains(&name.as_str()) {
            let beside = match beside.as_slice() {
                [] => String::new(),
                list => format!("; what is told from it: {}", list.join(", ")),
            };
            bail!(
                "--exclude {name}: no such effect; the catalogue of {kind} has {}{beside}",
                known.join(", ")
            );
        }
    }
    Ok(())
}

/// Everything that a command reads.
pub(crate) fn inputs<'a>(rig: &'a Path, session: &'a Session) -> impl Iterator<Item = &'a Path> {
    std::iter::once(rig).chain(session.recordings.iter().map(|entry| entry.path.as_path()))
}

/// Refuse to write over what was read, by whatever name.
pub(crate) fn no_input<'a>(
    out: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
) -> anyhow::Result<()> {
    for input in inputs {
        if same_file::is_same_file(out, input).unwrap_or(false) {
            bail!(
                "{}: the answer would overwrite what it is made from, {}: give --out another name",
                out.display(),
                input.display()
            );
        }
    }
    Ok(())
}

/// Write files into a folder, all of them or none.
pub(crate) fn write_all(folder: &Path, files: &[(&str, String)]) -> anyhow::Result<()> {
    let mut together = recording::Together::default();
    together.folder(folder)?;
    for (name, text) in files {
        together.add_text(&folder.join(name), text)?;
    }
    Ok(together.publish()?)
}
