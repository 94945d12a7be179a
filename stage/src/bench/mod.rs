//! `flexstage bench`: the papers' experiments and the controller, in simulation, without hardware; with `--rig` on a rig of one's own.
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
mod own;
mod platform;
mod speed;
mod stiffness_match;
mod tracking;

use book::Book;

use crate::say::say;

/// Options of `flexstage bench`.
#[derive(clap::Args)]
pub struct Args {
    /// Rig file of a stage of three axes: its loops, its coupling, and the controller on it, designed without the effects in the file and
    /// retuned for them. Without it the papers' rigs are simulated.
    #[arg(long)]
    rig: Option<PathBuf>,
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

type Run<'a> = Box<dyn Fn(&mut Book) -> anyhow::Result<()> + 'a>;

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let rig = args.rig.as_deref().map(own::load).transpose()?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("{}: cannot create the output folder", args.out.display()))?;
    let own = rig.iter().flat_map(|rig| {
        own::EXPERIMENTS
            .map(|(name, run)| (name, Box::new(move |book: &mut Book| run(book, rig)) as Run))
    });
    let of_the_papers = EXPERIMENTS.iter().filter(|_| rig.is_none());
    let of_the_papers = of_the_papers.map(|&(name, run)| (name, Box::new(run) as Run));
    let experiments: Vec<(&str, Run)> = own.chain(of_the_papers).collect();
    let bar = ProgressBar::new(experiments.len() as u64);
    bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} {msg}")?);
    let mut book = Book::new(bar.clone());
    let start = Instant::now();
    for (name, experiment) in experiments {
        bar.set_message(name);
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
