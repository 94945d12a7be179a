//! `flexstage export`: a recording as CSV, or a CSV as Parquet.

use std::path::PathBuf;

use recording::Recording;

use crate::say::say;

/// Options of `flexstage export`.
#[derive(clap::Args)]
pub struct Args {
    /// Recording to read (Parquet or CSV).
    from: PathBuf,
    /// File to write (.csv or .parquet); never overwritten.
    to: PathBuf,
    /// Sample rate of a CSV that does not carry it, Hz.
    #[arg(long, value_parser = crate::number::rate())]
    sample_rate: Option<f64>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    anyhow::ensure!(
        !args.to.exists(),
        "{}: expected a new file, found one: it is not overwritten",
        args.to.display()
    );
    recording::check_name(&args.to)?;
    crate::output::file(&args.to)?;
    let recording = match args.sample_rate {
        Some(rate) => Recording::read_csv(&args.from, rate)?,
        None => Recording::read(&args.from)?,
    };
    recording.write(&args.to)?;
    say!("{}: {} samples", args.to.display(), recording.len())?;
    Ok(())
}
