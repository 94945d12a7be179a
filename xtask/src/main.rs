//! What a person or CI runs: `cargo xtask test`, `cargo xtask firmware`, `cargo xtask emulate`.
//!
//! One module a command. All of them work from any folder of the checkout.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Parser, Subcommand};

mod debian;
mod emulate;
mod firmware;
mod test;

#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Everything that has to pass: format, lints, tests, firmware, emulation.
    Test(test::Args),
    /// Build the board's image, measure it, and prove what its control tick calls.
    Firmware(firmware::Args),
    /// Boot the image in the emulator against a rig; serve its USB endpoints on a socket.
    Emulate(emulate::Args),
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Test(args) => test::run(&args),
        Command::Firmware(args) => firmware::run(&args),
        Command::Emulate(args) => emulate::run(&args),
    }
}

/// The checkout that `cargo xtask` was called in; of a binary called by itself, the one it was built from. (Two checkouts that share a
/// target folder share this binary too, and cargo does not build it again for the second.)
pub fn workspace() -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    package.parent().map_or_else(PathBuf::new, Path::to_path_buf)
}
