//! `cargo xtask test`: what has to pass before a change lands; with `--long` everything.
//!
//! Steps run in order and all of them run, so that one run shows all that is wrong. A step whose tools are missing on
//! this machine is skipped with one line that says why, but not where `CI=true`.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use xshell::{Shell, cmd};

use crate::debian::{self, Need};
use crate::{emulate, firmware};

/// Options of `cargo xtask test`.
#[derive(clap::Args)]
pub struct Args {
    /// Only the steps whose name contains this.
    #[arg(long)]
    only: Option<String>,
    /// Diagnose the sessions as well that are left out to keep a usual run within three quarters of an hour: about half an hour more.
    #[arg(long)]
    long: bool,
}

/// How a step ended, other than with an error.
enum Outcome {
    Passed,
    Skipped(String),
}

struct Step {
    name: &'static str,
    run: fn(&Shell) -> Result<Outcome>,
}

/// The tests that are ignored otherwise: further sessions of the kinds that the host tests have, each of which was once called something else.
const LONG: Step = Step { name: "long sessions", run: long_sessions };

const STEPS: &[Step] = &[
    Step { name: "format", run: format },
    Step { name: "lints", run: lints },
    Step { name: "host tests", run: host_tests },
    Step { name: "overflow checks", run: overflow_checks },
    Step { name: "documentation", run: documentation },
    Step { name: "firmware", run: firmware },
    Step { name: "emulation", run: emulation },
];

/// Run all steps, then print how each ended.
///
/// # Errors
/// When a step failed, was skipped where `CI=true`, or none has the name that was asked for.
pub fn run(args: &Args) -> Result<()> {
    let shell = Shell::new()?;
    shell.change_dir(crate::workspace());
    let in_ci = std::env::var("CI").is_ok_and(|value| value == "true");
    let wanted =
        |step: &&Step| args.only.as_ref().is_none_or(|only| step.name.contains(only.as_str()));
    let mut lines = Vec::new();
    let (mut passed, mut failed, mut skipped) = (0, 0, 0);
    let long = args.long.then_some(&LONG);
    for step in STEPS.iter().chain(long).filter(wanted) {
        println!("== {} ==", step.name);
        let start = Instant::now();
        let outcome = (step.run)(&shell);
        let how = match outcome {
            Ok(Outcome::Passed) => {
                passed += 1;
                "passed".to_string()
            }
            Ok(Outcome::Skipped(why)) if !in_ci => {
                skipped += 1;
                format!("SKIPPED: {why}")
            }
            Ok(Outcome::Skipped(why)) => {
                failed += 1;
                format!("FAILED: not to be skipped in CI: {why}")
            }
            Err(error) => {
                failed += 1;
                format!("FAILED: {error:#}")
            }
        };
        lines.push(format!("{:<14} {:>7}  {how}", step.name, clock(start.elapsed())));
    }
    println!("\n{}\nsteps: {passed} passed, {failed} failed, {skipped} skipped", lines.join("\n"));
    if !args.long && args.only.is_none() {
        println!("left to `cargo xtask test --long`: the longest of the sessions to diagnose");
    }
    if lines.is_empty() {
        let names: Vec<&str> = STEPS.iter().chain(long).map(|step| step.name).collect();
        let only = args.only.as_deref().unwrap_or_default();
        bail!("no step has `{only}` in its name; there are: {}", names.join(", "));
    }
    if failed > 0 {
        bail!("{failed} of the steps failed");
    }
    Ok(())
}

fn clock(time: Duration) -> String {
    format!("{}:{:02}", time.as_secs() / 60, time.as_secs() % 60)
}

fn format(shell: &Shell) -> Result<Outcome> {
    cmd!(shell, "cargo fmt --all --check").run()?;
    Ok(Outcome::Passed)
}

fn lints(shell: &Shell) -> Result<Outcome> {
    cmd!(
        shell,
        "cargo clippy --release --workspace --exclude emulator --all-targets -- -D warnings"
    )
    .run()?;
    Ok(Outcome::Passed)
}

/// All crates that need neither an Arm target nor unicorn, with the browser that looks at the reports.
fn host_tests(shell: &Shell) -> Result<Outcome> {
    if let Err(error) =
        debian::ensure(shell, &[Need { program: "chromium", packages: &["chromium"] }])
    {
        println!("{error:#}; tests that render a report say that they skip");
    }
    cmd!(shell, "cargo test --release --workspace --exclude emulator").run()?;
    Ok(Outcome::Passed)
}

fn long_sessions(shell: &Shell) -> Result<Outcome> {
    cmd!(shell, "cargo test --release --package gap --tests -- --ignored").run()?;
    Ok(Outcome::Passed)
}

/// The core's tests once more, in a build that panics where an integer operation wraps unless it says that it may.
fn overflow_checks(shell: &Shell) -> Result<Outcome> {
    let checks = "profile.release.package.flexstage.overflow-checks=true";
    cmd!(shell, "cargo test --release --package flexstage --config {checks}").run()?;
    Ok(Outcome::Passed)
}

/// Builds the board's image and checks it. A machine that cannot build for the board skips this.
fn firmware(_shell: &Shell) -> Result<Outcome> {
    match firmware::toolchain() {
        Ok(()) => firmware::run(&firmware::Args::default()).map(|()| Outcome::Passed),
        Err(error) => Ok(Outcome::Skipped(format!("{error:#}"))),
    }
}

fn documentation(shell: &Shell) -> Result<Outcome> {
    cmd!(shell, "cargo doc --release --workspace --exclude emulator --no-deps").run()?;
    Ok(Outcome::Passed)
}

/// The image in the emulator: everything that would be tried on the board.
fn emulation(shell: &Shell) -> Result<Outcome> {
    if let Err(why) = firmware::toolchain() {
        return Ok(Outcome::Skipped(format!("{why:#}")));
    }
    let libclang = match emulate::tools(shell) {
        Ok(libclang) => libclang,
        Err(why) => return Ok(Outcome::Skipped(format!("{why:#}"))),
    };
    let elf = firmware::build(None)?;
    let mut run = cmd!(shell, "cargo test --release --package emulator -- --nocapture")
        .env("FLEXSTAGE_FIRMWARE_ELF", elf)
        .env("RUST_BACKTRACE", "0");
    // Here and not among the lints: it needs what unicorn's build leaves behind.
    let mut lint =
        cmd!(shell, "cargo clippy --release --package emulator --all-targets -- -D warnings");
    if let Some(folder) = libclang {
        run = run.env("LIBCLANG_PATH", &folder);
        lint = lint.env("LIBCLANG_PATH", folder);
    }
    run.run()?;
    lint.run()?;
    Ok(Outcome::Passed)
}
