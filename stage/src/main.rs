//! The `flexstage` program: everything that runs on the host.
//!
//! One module a command. A command either answers (exit status 0) or says in one line on standard error why its
//! input cannot be used (exit status 2); see `contract.md` of the project.

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

mod bench;
mod blind;
mod board;
mod config;
mod devices;
mod diagnose;
mod export;
mod flash;
mod identify;
mod import;
mod measure;
mod number;
mod output;
mod platform;
mod probe;
mod record;
mod replay;
mod say;
mod serve;
mod status;
mod tune;
#[cfg(feature = "window")]
mod view;

/// Drive, watch and understand a piezo-driven flexure stage.
#[derive(Parser)]
#[command(name = "flexstage", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// See, drive, record and probe the stage in a window.
    #[cfg(feature = "window")]
    View(view::Args),
    /// List the boards that are connected.
    Devices(devices::Args),
    /// Say how a board is doing.
    Status(status::Args),
    /// Record the telemetry to a Parquet file.
    Record(record::Args),
    /// Write a recording as CSV, or a CSV as Parquet.
    Export(export::Args),
    /// Run the probe suite that tells the effects apart.
    Probe(probe::Args),
    /// Measure frequency response, loop margins, step response or noise.
    Measure(measure::Args),
    /// Propose gains and feedforward from a measurement.
    Tune(tune::Args),
    /// Read, change and save the settings of a board.
    Config(config::Args),
    /// Put firmware on a board.
    Flash(flash::Args),
    /// Offer a board (virtual or on USB) on a local socket.
    Serve(serve::Args),
    /// Run the papers' experiments and the controller in simulation.
    Bench(bench::Args),
    /// Simulate a rig under a recorded drive.
    Replay(replay::Args),
    /// Refit the nominal parameters of a rig to a session.
    Identify(identify::Args),
    /// Say why a rig and its simulation disagree.
    Diagnose(diagnose::Args),
    /// Test the diagnosis on recordings whose effects it is not told.
    Blind(blind::Args),
    /// Turn public data files (npy, text columns, CSV) into recordings.
    Import(import::Args),
    /// Print completions for a shell.
    Completions {
        /// Which shell.
        shell: clap_complete::Shell,
    },
}

fn main() -> ExitCode {
    let parsed = number::take_negative(Cli::command())
        .try_get_matches()
        .and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => match number::line(&error) {
            Some(line) => {
                eprintln!("flexstage: {line}");
                return ExitCode::from(2);
            }
            // Help and version as well: they end with status 0.
            None => error.exit(),
        },
    };
    let result = match cli.command {
        #[cfg(feature = "window")]
        Command::View(args) => view::run(args),
        Command::Devices(args) => devices::run(args),
        Command::Status(args) => status::run(args),
        Command::Record(args) => record::run(args),
        Command::Export(args) => export::run(args),
        Command::Probe(args) => probe::run(args),
        Command::Measure(args) => measure::run(args),
        Command::Tune(args) => tune::run(args),
        Command::Config(args) => config::run(args),
        Command::Flash(args) => flash::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Completions { shell } => {
            // Into memory first: the generator panics where it cannot write.
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "flexstage", &mut text);
            say::text(format_args!("{}", String::from_utf8_lossy(&text)))
        }
        Command::Bench(args) => bench::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Identify(args) => identify::run(args),
        Command::Diagnose(args) => diagnose::run(args),
        Command::Blind(args) => blind::run(args),
        Command::Import(args) => import::run(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("flexstage: {error:#}");
            ExitCode::from(2)
        }
    }
}
