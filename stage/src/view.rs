//! `flexstage view`: the window.

use std::path::PathBuf;

use viewer::{Options, Source};

use crate::board::BoardArgs;
use crate::number::number;

/// Options of `flexstage view`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Show a recording (Parquet or CSV) instead of a board.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["serial", "connect", "virtual_board"])]
    replay: Option<PathBuf>,
    /// Sample rate of a CSV recording, Hz.
    #[arg(long, value_parser = crate::number::rate())]
    sample_rate: Option<f64>,
    /// Seconds of full-rate samples kept in memory.
    #[arg(long, default_value_t = 620.0, value_parser = number(1.0..=36_000.0, " s"))]
    history: f64,
    /// Folder for recordings and probe sessions.
    #[arg(long, default_value = "recordings")]
    folder: PathBuf,
    /// Rig file that a diagnosis starts from.
    #[arg(long)]
    rig: Option<PathBuf>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let source = match args.replay {
        Some(path) => Source::Recording { path, sample_rate_hz: args.sample_rate },
        None => Source::Board(args.board.target()?),
    };
    viewer::run(Options { source, history_s: args.history, folder: args.folder, rig: args.rig })
}
