//! The `flexstage` program: everything that runs on the host.
//!
//! One module a command. A command either answers (exit status 0) or says in one line on standard error why its
//! input cannot be used (exit status 2); see `contract.md` of the project.

use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod bench;
mod blind;
mod diagnose;
mod identify;
mod import;
mod platform;
mod replay;

/// Drive, watch and understand a piezo-driven flexure stage.
#[derive(Parser)]
#[command(name = "flexstage", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
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
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
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
