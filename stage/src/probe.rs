//! `flexstage probe`: the probe suite into a session folder, and on request straight into the diagnosis.

use std::path::PathBuf;

use serde_json::json;
use telemetry::probe::{Experiment, LOWEST_MAX_V, Length, Options, plan};

use crate::board::{BoardArgs, beyond, on_interrupt, seconds_bar};
use crate::number::{axis, number};
use crate::say::say;

/// Options of `flexstage probe`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Folder for the recordings; new or empty.
    session: PathBuf,
    /// How long the suite may take.
    #[arg(long, value_enum, default_value_t = LengthArg::Standard)]
    length: LengthArg,
    /// Axes to probe, from 1.
    #[arg(long, value_delimiter = ',', default_value = "1,2,3", value_parser = axis)]
    axes: Vec<usize>,
    /// Highest voltage that is ever commanded, V. Every recording begins with a conditioning up to it; all else stays a tenth of it below:
    /// up to 90 V of the 99 V that are the default.
    #[arg(
        long,
        default_value_t = 99.0,
        value_parser = number(LOWEST_MAX_V..=1000.0, " V")
    )]
    max_v: f64,
    /// Seed of phases and of the typical motion.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Name of the rig, stored with the recordings.
    #[arg(long, default_value = "")]
    rig: String,
    /// Only say what would be driven.
    #[arg(long)]
    dry_run: bool,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

#[derive(clap::ValueEnum, Clone, Copy)]
enum LengthArg {
    Quick,
    Standard,
    Long,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let length = match args.length {
        LengthArg::Quick => Length::Quick,
        LengthArg::Standard => Length::Standard,
        LengthArg::Long => Length::Long,
    };
    let mut axes: Vec<usize> = args.axes.iter().map(|axis| axis - 1).collect();
    axes.sort_unstable();
    axes.dedup();
    let options = Options { axes, max_v: args.max_v, length, seed: args.seed };
    let experiments = plan(&options);
    let total_s: f64 = experiments.iter().map(Experiment::total_s).sum();
    if args.dry_run {
        if args.json {
            let list: Vec<_> = experiments
                .iter()
                .map(|e| {
                    let (low, high) = e.range_v();
                    json!({"name": e.name, "seconds": e.total_s(), "low_v": low, "high_v": high})
                })
                .collect();
            say!("{}", serde_json::to_string_pretty(&list)?)?;
        } else {
            for e in &experiments {
                let (low, high) = e.range_v();
                say!("{:<28} {:6.1} s  {low:6.1} to {high:5.1} V", e.name, e.total_s())?;
            }
            say!("{} recordings, {total_s:.0} s", experiments.len())?;
        }
        return Ok(());
    }
    let device = args.board.open()?;
    let stop = on_interrupt()?;
    let bar = seconds_bar(total_s);
    let report = telemetry::probe::run(
        &device,
        &experiments,
        &options.axes,
        &args.rig,
        &args.session,
        &stop,
        &mut |p| {
            bar.set_position((p.done_s * 10.0) as u64);
            bar.set_message(format!(
                "{}/{} {}, {:.0} s left",
                (p.index + 1).min(p.count),
                p.count,
                p.name,
                (p.total_s - p.done_s).max(0.0)
            ));
        },
    );
    bar.finish_and_clear();
    let report = report.map_err(|error| beyond(error, "--max-v"))?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        say!(
            "{}: {} recordings, {} ticks lost",
            report.folder.display(),
            report.files.len(),
            report.lost_ticks
        )?;
        say!("next: flexstage diagnose --rig RIG.toml {} --out OUT", report.folder.display())?;
    }
    Ok(())
}
