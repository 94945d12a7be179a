//! `flexstage record`: the stream into a Parquet file, until a time, ctrl-C or the end of the connection.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use telemetry::recorder::{Ended, Recorder};

use crate::board::{BoardArgs, on_interrupt, seconds_bar};
use crate::number::number;
use crate::say::say;

/// Options of `flexstage record`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// File to write; never overwritten.
    #[arg(required_unless_present = "recover")]
    file: Option<PathBuf>,
    /// Length on the sample clock, s; without it until ctrl-C.
    #[arg(long, value_parser = number(0.001..=1.0e7, " s"))]
    seconds: Option<f64>,
    /// Free text stored with the recording.
    #[arg(long, default_value = "recording")]
    experiment: String,
    /// Name of the rig, stored with the recording.
    #[arg(long, default_value = "")]
    rig: String,
    /// Finish a recording that was interrupted by a crash or a full disk.
    #[arg(long, value_name = "FILE")]
    recover: Option<PathBuf>,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    if let Some(path) = &args.recover {
        let kept = recording::recover(path)?;
        say!(
            "{}: {:.1} s recovered",
            path.display(),
            kept.span_ticks() as f64 / kept.meta.sample_rate_hz
        )?;
        return Ok(());
    }
    let file = args.file.as_deref().unwrap_or_else(|| unreachable!("clap asks for it"));
    let device = args.board.open()?;
    let stop = on_interrupt()?;
    device.stream()?;
    let recorder = Recorder::start_for(&device, file, &args.experiment, &args.rig, args.seconds)?;
    let bar = seconds_bar(args.seconds.unwrap_or(0.0));
    let progress = loop {
        std::thread::sleep(Duration::from_millis(20));
        let progress = recorder.progress();
        bar.set_position((progress.seconds * 10.0) as u64);
        bar.set_message(format!("{:.1} s, {} ticks lost", progress.seconds, progress.lost_ticks));
        if progress.ended.is_some() || stop.load(Ordering::Acquire) {
            break recorder.stop();
        }
    };
    bar.finish_and_clear();
    if args.json {
        say!("{}", serde_json::to_string_pretty(&progress)?)?;
    } else {
        say!(
            "{}: {:.1} s, {} samples, {} ticks lost",
            progress.path.display(),
            progress.seconds,
            progress.rows,
            progress.lost_ticks
        )?;
    }
    match progress.ended {
        Some(Ended::Stopped) | None => Ok(()),
        Some(Ended::BoardGone { reason } | Ended::CannotWrite { reason }) => {
            anyhow::bail!("the recording ended early: {reason}")
        }
    }
}
