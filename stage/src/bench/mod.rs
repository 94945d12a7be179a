//! `flexstage bench`: the papers' experiments and the controller, in simulation, without hardware or options.
//!
//! One file an experiment; each takes the [`Book`], adds its table, its figures and its results, and knows nothing of the
//! others. Everything printed was simulated in the same run; errors are of the true position, not of the gauge's reading.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};

mod book;
mod coupling;
mod hysteresis;
mod identification;
mod platform;
mod speed;
mod stiffness_match;
mod tracking;

use book::Book;

use crate::say::say;

/// Options of `flexstage bench`.
#[derive(clap::Args)]
pub struct Args {
    /// Folder for report.html and bench.json.
    #[arg(long, default_value = "bench-report")]
    out: PathBuf,
}

/// An experiment: what the progress line says, and what runs.
type Experiment = (&'static str, fn(&mut Book) -> anyhow::Result<()>);

const EXPERIMENTS: &[Experiment] = &[
    ("coupling between axes (figure 3)", coupling::run),
    ("hysteresis, alone and in the mechanism (figure 4)", hysteresis::run),
    ("stiffness k_1 by matching", stiffness_match::run),
    ("tracking", tracking::run),
    ("return of a compliant platform (second paper, figures 6 and 7)", platform::run),
    ("speed", speed::run),
];

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("{}: cannot create the output folder", args.out.display()))?;
    let bar = ProgressBar::new(EXPERIMENTS.len() as u64);
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} {msg}")?);
    let mut book = Book::new(bar.clone());
    let start = Instant::now();
    for (name, experiment) in EXPERIMENTS {
        bar.set_message(*name);
        if !std::io::stderr().is_terminal() {
            eprintln!("bench: {name}");
        }
        experiment(&mut book).with_context(|| format!("bench: {name}"))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let (report, results, printed) = book.finish();
    let page = args.out.join("report.html");
    report.write(&page).with_context(|| format!("{}: cannot write", page.display()))?;
    write_whole(&args.out.join("bench.json"), &results)?;
    printed?;
    say!(
        "{:.1} s; {} has the plots, bench.json beside it the numbers",
        start.elapsed().as_secs_f64(),
        page.display()
    )
}

/// Write a file under another name first: either the old one or the new one is there, whole.
fn write_whole(path: &Path, text: &str) -> anyhow::Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut file = tempfile::NamedTempFile::new_in(folder)
        .with_context(|| format!("{}: cannot write", folder.display()))?;
    file.write_all(text.as_bytes())?;
    file.persist(path).with_context(|| format!("{}: cannot write", path.display()))?;
    Ok(())
}
