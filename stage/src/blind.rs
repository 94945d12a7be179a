//! `flexstage blind`: tests the diagnosis on recordings whose effects it is not told.

use std::path::PathBuf;

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use truth::case::{Case, Draw, Sessions, key, seal};

/// Options of `flexstage blind`.
#[derive(clap::Args)]
pub struct Args {
    /// Number of cases.
    #[arg(long, default_value_t = 20)]
    cases: u64,
    /// Seed: the same seed draws the same cases.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of the first case (to continue, or to look at one).
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Smallest gap, in multiples of the gauges' noise (rms over axes).
    #[arg(long, default_value_t = 3.0)]
    min_ratio: f64,
    /// Largest gap, in multiples of the gauges' noise.
    #[arg(long, default_value_t = 60.0)]
    max_ratio: f64,
    /// Kinds of sessions.
    #[arg(long, value_enum, default_value_t = SessionKind::Mixed)]
    sessions: SessionKind,
    /// Draw the nominal rig as well, instead of always the first paper's.
    #[arg(long)]
    other_rigs: bool,
    /// Weights of nulls, single effects, pairs and out-of-catalogue faults.
    #[arg(long, value_delimiter = ',', default_value = "0.2,0.45,0.2,0.15")]
    weights: Vec<f64>,
    /// Draw only these effects (comma separated).
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Only write the cases and their key to this folder.
    #[arg(long, value_name = "DIR")]
    write_only: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum SessionKind {
    Probe,
    Random,
    Mixed,
}

impl Args {
    fn draw(&self) -> anyhow::Result<Draw> {
        let &[null, single, pair, unknown] = self.weights.as_slice() else {
            bail!("--weights: expected four numbers, found {}", self.weights.len());
        };
        let weights = [null, single, pair, unknown];
        if weights.iter().any(|weight| !(*weight >= 0.0)) || weights.iter().sum::<f64>() <= 0.0 {
            bail!("--weights: expected numbers of zero or more, not all zero, found {weights:?}");
        }
        if !(self.min_ratio > 0.0 && self.max_ratio > self.min_ratio) {
            bail!(
                "--min-ratio: expected more than 0 and less than --max-ratio, found {}",
                self.min_ratio
            );
        }
        for name in &self.only {
            if truth::effects::find(name).is_none() {
                bail!("--only: expected the name of an effect, found \"{name}\"");
            }
        }
        let sessions = match self.sessions {
            SessionKind::Probe => Sessions::Probe,
            SessionKind::Random => Sessions::Random,
            SessionKind::Mixed => Sessions::Mixed,
        };
        Ok(Draw {
            ratio: (self.min_ratio, self.max_ratio),
            sessions,
            other_rigs: self.other_rigs,
            weights,
            only: self.only.clone(),
        })
    }
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let draw = args.draw()?;
    let Some(folder) = &args.write_only else {
        bail!("blind without --write-only is not built yet");
    };
    std::fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot create", folder.display()))?;
    let bar = ProgressBar::new(args.cases);
    bar.set_style(ProgressStyle::with_template("{pos}/{len} cases {wide_bar} {eta}")?);
    let mut labels = Vec::new();
    for index in args.first..args.first + args.cases {
        let case = Case::draw(args.seed, index, &draw);
        case.write(folder).with_context(|| format!("{}: cannot write", folder.display()))?;
        labels.push(case.label);
        // Rewritten each time: an interruption leaves a key of what is there.
        let text = key(&labels);
        let path = folder.join("key.json");
        std::fs::write(&path, &text)
            .with_context(|| format!("{}: cannot write", path.display()))?;
        bar.inc(1);
    }
    bar.finish();
    println!(
        "{} cases in {}; SHA-256 of key.json: {}",
        labels.len(),
        folder.display(),
        seal(&key(&labels))
    );
    Ok(())
}
