//! `cargo xtask emulate`: boots the firmware image in the emulator, as a program of its own.
//!
//! The emulator links GPL-2.0 code (unicorn), so it is started, never linked.

use std::path::PathBuf;

use anyhow::Result;
use xshell::{Shell, cmd};

use crate::debian::{self, Need};
use crate::firmware;

/// Options of `cargo xtask emulate`.
#[derive(clap::Args)]
pub struct Args {
    /// Boot this image instead of building one.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Emulated time to run, s; default: 1, or with --listen until interrupted.
    #[arg(long)]
    seconds: Option<f64>,
    /// Serve the board's USB endpoints here (HOST:PORT or unix:/PATH) for `flexstage view | record | probe`.
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<String>,
    /// The rig on the board: a TOML file (with any effect in it that should be there) or the name of a built-in one.
    #[arg(long, value_name = "FILE", default_value = "handley")]
    rig: String,
    /// Emulated seconds in a second of wall clock, or "max".
    #[arg(long, default_value = "1")]
    speed: String,
    /// Seed of the rig's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Something that breaks, KIND:AXIS@FROM or KIND:AXIS@FROM-TO in emulated seconds, as gauge-open:2@20-25; a wrong kind
    /// gets the list. May be given several times.
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<String>,
}

/// Builds the image unless one is given, then runs the emulator.
///
/// # Errors
/// Something cannot be built or installed, or the emulation failed.
pub fn run(args: &Args) -> Result<()> {
    let elf = match &args.elf {
        Some(elf) => std::path::absolute(elf)?,
        None => firmware::build(None)?,
    };
    let shell = Shell::new()?;
    shell.change_dir(crate::workspace());
    let libclang = tools(&shell)?;
    let mut run = cmd!(shell, "cargo run --release --quiet --package emulator -- --elf {elf}");
    if let Some(folder) = libclang {
        run = run.env("LIBCLANG_PATH", folder);
    }
    // A file is named as seen from where the command was given, not from the workspace.
    let rig = match std::path::absolute(&args.rig) {
        Ok(path) if path.is_file() => path.into_os_string(),
        _ => args.rig.clone().into(),
    };
    let (speed, seed) = (&args.speed, args.seed.to_string());
    run = run.arg("--rig").arg(rig).args(["--speed", speed, "--seed", &seed]);
    if let Some(seconds) = args.seconds {
        run = run.arg("--seconds").arg(seconds.to_string());
    }
    if let Some(listen) = &args.listen {
        run = run.arg("--listen").arg(listen);
    }
    for fault in &args.faults {
        run = run.arg("--fault").arg(fault);
    }
    run.run()?;
    Ok(())
}

/// What building unicorn takes. Returns nothing to set where libclang is found by itself.
///
/// # Errors
/// Something is missing and cannot be installed.
pub fn tools(shell: &Shell) -> Result<Option<PathBuf>> {
    debian::ensure(
        shell,
        &[
            Need { program: "cmake", packages: &["cmake"] },
            Need { program: "make", packages: &["make"] },
            Need { program: "cc", packages: &["gcc", "libc6-dev"] },
        ],
    )?;
    if libclang_is_there() {
        return Ok(None);
    }
    // Debian 12's default; a newer release's own is found above once it is installed.
    debian::ensure(
        shell,
        &[Need {
            program: "/usr/lib/llvm-14/lib/libclang.so.1",
            packages: &["libclang1-14", "libclang-common-14-dev"],
        }],
    )?;
    Ok(Some("/usr/lib/llvm-14/lib".into()))
}

/// Where bindgen looks: `LIBCLANG_PATH`, the library folders, and every LLVM below /usr/lib.
fn libclang_is_there() -> bool {
    if std::env::var_os("LIBCLANG_PATH").is_some() {
        return true;
    }
    let has = |folder: PathBuf| {
        std::fs::read_dir(folder).is_ok_and(|entries| {
            entries.flatten().any(|entry| {
                let name = entry.file_name();
                let name = name.to_string_lossy();
                name.starts_with("libclang.so") || name.starts_with("libclang-1")
            })
        })
    };
    let llvms = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten();
    llvms
        .filter(|entry| entry.file_name().to_string_lossy().starts_with("llvm-"))
        .map(|entry| entry.path().join("lib"))
        .chain(["/usr/lib/x86_64-linux-gnu".into(), "/usr/lib64".into(), "/usr/local/lib".into()])
        .any(has)
}
