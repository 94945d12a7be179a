//! `flexstage diagnose`: why the rig and its simulation disagree.

use std::fs;
use std::path::{Path, PathBuf};

use anstream::println;
use anyhow::{Context, bail};
use host_sim::AnyRig;
use recording::Session;

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
    #[arg(long)]
    sample_rate: Option<f64>,
    /// Leave an effect out of the catalogue (may be given several times).
    #[arg(long)]
    exclude: Vec<String>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let rig = AnyRig::load(&args.rig)?;
    let session = Session::read(&args.session, args.sample_rate)?;
    for name in &args.exclude {
        if host_sim::effects::find(name).is_none() {
            let known: Vec<&str> =
                host_sim::effects::catalogue().iter().map(|e| e.info().name).collect();
            bail!("--exclude {name}: no such effect; the catalogue has {}", known.join(", "));
        }
    }
    if args.out.exists() && !args.out.is_dir() {
        bail!("{}: expected a folder for the answer, found a file", args.out.display());
    }
    let rig = match rig {
        AnyRig::Stage(rig) => rig,
        AnyRig::Platform(rig) => return crate::platform::diagnose(&rig, &session, &args.out),
    };
    for entry in &session.recordings {
        crate::platform::refuse_free_return(&entry.recording, &entry.path)?;
    }
    let options = gap::Options { exclude: args.exclude, progress: true };
    let outcome = gap::diagnose(&rig, &session, &options)?;
    let mut json = serde_json::to_string_pretty(&outcome.diagnosis)?;
    json.push('\n');
    write_all(
        &args.out,
        &[
            ("diagnosis.json", json),
            ("rig.toml", outcome.rig.to_toml()),
            ("report.html", outcome.report.to_html()),
        ],
    )?;
    println!("{}", gap::sentence(&outcome.diagnosis));
    println!("{}", args.out.join("report.html").display());
    Ok(())
}

/// Write files into a folder, all of them or none: each goes to a temporary name first.
pub(crate) fn write_all(folder: &Path, files: &[(&str, String)]) -> anyhow::Result<()> {
    fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    let mut made = Vec::new();
    for (name, text) in files {
        let temporary = folder.join(format!(".{name}.part"));
        if let Err(error) = fs::write(&temporary, text) {
            for file in &made {
                let _ = fs::remove_file(file);
            }
            let _ = fs::remove_file(&temporary);
            return Err(error).with_context(|| format!("{}: cannot write", temporary.display()));
        }
        made.push(temporary);
    }
    for ((name, _), temporary) in files.iter().zip(&made) {
        let target = folder.join(name);
        fs::rename(temporary, &target)
            .with_context(|| format!("{}: cannot write", target.display()))?;
    }
    Ok(())
}
