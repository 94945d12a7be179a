//! `flexstage blind`: tests the diagnosis on recordings whose effects it is not told.
//!
//! Draws cases, writes their recordings and seals the key by its hash; runs `flexstage diagnose` as a process that gets
//! nothing but a rig file and a folder of recordings; replays recordings that it never saw with the rig that it wrote; then
//! opens the key and counts. Interrupted, it goes on where it was when started again with the same options.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, bail};
use host_sim::Rig;
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use recording::{Recording, Session};
use truth::case::{Case, Draw, Label, Sessions, key, seal};
use truth::effects::EFFECTS;
use truth::faults::Kind;
use truth::score::{Answer, Judged, Outcome, score, summarise};

use crate::number::{number, whole};
use crate::say::say;

mod options;

/// Options of `flexstage blind`.
#[derive(clap::Args)]
pub struct Args {
    /// Number of cases (with --leave-one-out: of each effect).
    #[arg(long, default_value_t = 20, value_parser = whole(0..=1_000_000))]
    cases: u64,
    /// Seed: the same seed draws the same cases.
    #[arg(long, default_value_t = 1, value_parser = whole(0..=u64::MAX))]
    seed: u64,
    /// Number of the first case (to look at one).
    #[arg(long, default_value_t = 0, value_parser = whole(0..=1_000_000_000_000))]
    first: u64,
    /// Smallest gap, in multiples of the gauges' noise (rms over axes).
    #[arg(long, default_value_t = 3.0, value_parser = number(0.001..=1.0e6, ""))]
    min_ratio: f64,
    /// Largest gap, in multiples of the gauges' noise.
    #[arg(long, default_value_t = 60.0, value_parser = number(0.001..=1.0e6, ""))]
    max_ratio: f64,
    /// Kinds of sessions.
    #[arg(long, value_enum, default_value_t = SessionKind::Mixed)]
    sessions: SessionKind,
    /// Draw the nominal rig as well, instead of always the first paper's.
    #[arg(long)]
    other_rigs: bool,
    /// Record no monitor outputs of the amplifiers: what the diagnosis can tell without them.
    #[arg(long)]
    without_monitor: bool,
    /// Weights of nulls, single effects, pairs and out-of-catalogue faults.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "0.2,0.45,0.2,0.15",
        allow_hyphen_values = true,
        value_parser = number(0.0..=1.0e9, "")
    )]
    weights: Vec<f64>,
    /// Draw only these effects (comma separated).
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Draw effects in further forms: a slew limit for a current limit, few relaxations for a law of creep, and so on.
    #[arg(long)]
    further_forms: bool,
    /// Faults outside the catalogue: what breaks, or physics or electronics of a healthy rig that nobody thought of.
    #[arg(long, value_enum, default_value_t = Faults::Broken)]
    faults: Faults,
    /// Take each effect out of the catalogue in turn and draw cases of it: the tool must say that it cannot explain them.
    #[arg(long)]
    leave_one_out: bool,
    /// Only write the cases and their key to this folder.
    #[arg(long, value_name = "DIR")]
    write_only: Option<PathBuf>,
    /// Folder for recordings, key, answers and blind.json.
    #[arg(long, default_value = "blind")]
    out: PathBuf,
    /// Keep the recordings after their diagnosis.
    #[arg(long)]
    keep: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum SessionKind {
    Probe,
    Random,
    Mixed,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Faults {
    Broken,
    Physics,
    Electronics,
}

/// A case to be drawn.
struct Planned {
    id: String,
    number: u64,
    draw: Draw,
    /// Effect that the diagnosis has to do without.
    without: Option<&'static str>,
}

impl Args {
    fn draw(&self) -> anyhow::Result<Draw> {
        let &[null, single, pair, unknown] = self.weights.as_slice() else {
            bail!("--weights: expected four numbers, found {}", self.weights.len());
        };
        let weights = [null, single, pair, unknown];
        if weights.iter().sum::<f64>() == 0.0 {
            bail!("--weights: expected numbers that are not all zero, found {weights:?}");
        }
        if self.max_ratio <= self.min_ratio {
            bail!(
                "--min-ratio {}: expected less than --max-ratio, found {} for that",
                self.min_ratio,
                self.max_ratio
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
            further_forms: self.further_forms,
            faults: match self.faults {
                Faults::Broken => &Kind::BROKEN,
                Faults::Physics => &Kind::PHYSICS,
                Faults::Electronics => &Kind::ELECTRONICS,
            },
        })
    }

    /// What is to be drawn.
    fn plan(&self) -> anyhow::Result<Vec<Planned>> {
        let draw = self.draw()?;
        let numbers = self.first..self.first + self.cases;
        if !self.leave_one_out {
            let plain = |number| Planned {
                id: format!("case-{number:04}"),
                number,
                draw: draw.clone(),
                without: None,
            };
            return Ok(numbers.map(plain).collect());
        }
        let mut plan = Vec::new();
        for effect in
            EFFECTS.iter().filter(|e| self.only.is_empty() || self.only.iter().any(|n| n == e.name))
        {
            let draw = Draw {
                weights: [0.0, 1.0, 0.0, 0.0],
                only: vec![effect.name.into()],
                ..draw.clone()
            };
            plan.extend(numbers.clone().map(|number| Planned {
                id: format!("{}-{number:04}", effect.name),
                number,
                draw: draw.clone(),
                without: Some(effect.name),
            }));
        }
        Ok(plan)
    }
}

fn progress(count: usize, what: &'static str) -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new(count as u64).with_message(what);
    bar.set_style(ProgressStyle::with_template("{msg} {pos}/{len} {wide_bar} {eta}")?);
    Ok(bar)
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let plan = args.plan()?;
    let folder = args.write_only.as_ref().unwrap_or(&args.out).clone();
    fs::create_dir_all(&folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    args.keep(&folder)?;
    let answers = folder.join("answers");
    let bar = progress(plan.len(), "drawing")?;
    let draw = |planned: Planned| -> anyhow::Result<(Label, Option<&'static str>)> {
        let Planned { id, number, draw, without } = planned;
        // A case that was answered before is drawn from its label; the others are drawn anew, the same for the same seed.
        let label = folder.join(".labels").join(format!("{id}.json"));
        let drawn: Option<Label> =
            fs::read(&label).ok().and_then(|text| serde_json::from_slice(&text).ok());
        let there =
            folder.join(&id).join("rig.toml").is_file() || outcome_file(&answers, &id).is_file();
        let drawn = match (drawn, there, args.write_only.is_some()) {
            (Some(drawn), true, false) => drawn,
            _ => {
                let mut case = Case::draw(args.seed, number, &draw);
                case.label.id = id;
                if args.without_monitor {
                    case.drop_monitor();
                }
                case.write(&folder)
                    .with_context(|| format!("{}: cannot write", folder.display()))?;
                fs::create_dir_all(folder.join(".labels"))?;
                fs::write(&label, serde_json::to_vec(&case.label)?)?;
                case.label
            }
        };
        bar.inc(1);
        Ok((drawn, without))
    };
    // Every case has a generator of its own: the order in which they are drawn does not matter.
    let drawn: Vec<(Label, Option<&'static str>)> =
        plan.into_par_iter().map(draw).collect::<anyhow::Result<_>>()?;
    let (labels, excluded): (Vec<Label>, Vec<Option<&str>>) = drawn.into_iter().unzip();
    bar.finish_and_clear();
    let sealed = key(&labels);
    say!("{} cases in {}; SHA-256 of the key: {}", labels.len(), folder.display(), seal(&sealed))?;
    write(&folder.join("key.sha256"), format!("{}\n", seal(&sealed)).as_bytes())?;
    if args.write_only.is_some() {
        return write(&folder.join("key.json"), sealed.as_bytes());
    }

    fs::create_dir_all(&answers)?;
    let bar = progress(labels.len(), "diagnosing")?;
    let mut outcomes: Vec<Outcome> = Vec::new();
    for (label, without) in labels.iter().zip(excluded) {
        let file = outcome_file(&answers, &label.id);
        let done = fs::read(&file).ok().and_then(|text| serde_json::from_slice(&text).ok());
        let outcome = match done {
            Some(outcome) => outcome,
            None => {
                let mut outcome = examine(&folder, &answers, label, without)?;
                if without.is_some() {
                    // What was left out of the catalogue is outside of it.
                    outcome.right = outcome.named.is_empty() && outcome.verdict == "unexplained";
                }
                write(&file, &serde_json::to_vec_pretty(&outcome)?)?;
                if !args.keep {
                    fs::remove_dir_all(folder.join(&label.id))?;
                }
                outcome
            }
        };
        let truth: Vec<String> =
            label.truth.iter().map(|t| format!("{}{:?}", t.effect, t.axes)).collect();
        let mark = if outcome.right { "right" } else { "WRONG" };
        let (truth, named) = (truth.join(" + "), outcome.named.join(" + "));
        bar.suspend(|| {
            say!(
                "{mark} {}: {truth} -> {} {named} ({:.1} s)",
                label.id,
                outcome.verdict,
                outcome.seconds
            )
        })?;
        outcomes.push(outcome);
        bar.inc(1);
    }
    bar.finish_and_clear();
    write(&folder.join("key.json"), sealed.as_bytes())?;
    let summary = summarise(&outcomes);
    let json = serde_json::json!({ "seed": args.seed, "summary": summary, "cases": outcomes });
    write(&folder.join("blind.json"), serde_json::to_string_pretty(&json)?.as_bytes())?;
    if args.leave_one_out {
        let right = outcomes.iter().filter(|outcome| outcome.right).count();
        let share = truth::score::Share::of(right, outcomes.len());
        say!(
            "effect taken out of the catalogue, and nothing else blamed: {right} of {}",
            outcomes.len()
        )?;
        say!("95 % interval: {:.1} to {:.1} %", 100.0 * share.ci95.0, 100.0 * share.ci95.1)?;
        let blamed = outcomes.iter().filter(|outcome| !outcome.right);
        let alike = blamed.filter(|outcome| outcome.left_in_noise().is_some_and(|left| left < 0.5));
        say!(
            "of the other {}, {} leave less than half the noise on recordings that were not diagnosed: what is named does the same there",
            outcomes.len() - right,
            alike.count()
        )?;
    } else {
        crate::say::text(format_args!("{}", summary.text()))?;
    }
    say!("{}", folder.join("blind.json").display())?;
    Ok(())
}

fn outcome_file(answers: &Path, id: &str) -> PathBuf {
    answers.join(id).join("outcome.json")
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(path, bytes).with_context(|| format!("{}: cannot write", path.display()))
}

/// Diagnoses one case with the command that users have, and judges what it wrote.
fn examine(
    folder: &Path,
    answers: &Path,
    label: &Label,
    without: Option<&str>,
) -> anyhow::Result<Outcome> {
    let case = folder.join(&label.id);
    let out = answers.join(&label.id);
    let mut command = Command::new(std::env::current_exe()?);
    command.arg("diagnose").arg("--rig").arg(case.join("rig.toml")).arg(case.join("session"));
    command.arg("--out").arg(&out).stdout(Stdio::null()).stderr(Stdio::piped());
    if let Some(effect) = without {
        command.arg("--exclude").arg(effect);
    }
    let started = Instant::now();
    let process = command.output().context("cannot start the diagnosis")?;
    let seconds = started.elapsed().as_secs_f64();
    fs::create_dir_all(&out)?;
    if !process.status.success() {
        write(&out.join("failed.txt"), &process.stderr)?;
        return Ok(score(label, None, None, seconds));
    }
    let path = out.join("diagnosis.json");
    let text = fs::read(&path).with_context(|| format!("{}: cannot read", path.display()))?;
    let answer: Answer =
        serde_json::from_slice(&text).with_context(|| path.display().to_string())?;
    let before = Rig::load(&case.join("rig.toml"))?;
    let after = Rig::load(&out.join("rig.toml"))?;
    let judging = Session::read(case.join("judging"), None)?;
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for entry in &judging.recordings {
        for (sum, rig) in sums.iter_mut().zip([&before, &after]) {
            let predicted = crate::replay::predict(rig, &entry.recording, &entry.path)?;
            *sum += square_error(&entry.recording, &predicted);
        }
        count += ((entry.recording.len() - entry.recording.settle_rows()) * entry.recording.axes())
            as f64;
    }
    let [before_nm, after_nm] = sums.map(|sum| 1e3 * (sum / count).sqrt());
    Ok(score(label, Some(&answer), Some(Judged { before_nm, after_nm }), seconds))
}

/// Sum of squared differences of positions (um^2) after settling.
fn square_error(measured: &Recording, predicted: &Recording) -> f64 {
    let from = measured.settle_rows();
    let pairs = measured.position_um.iter().zip(&predicted.position_um);
    pairs
        .filter_map(|(measured, predicted)| Some((measured.as_ref()?, predicted.as_ref()?)))
        .flat_map(|(measured, predicted)| measured[from..].iter().zip(&predicted[from..]))
        .map(|(a, b)| f64::from(a - b).powi(2))
        .sum()
}
