//! `cargo xtask firmware`: builds the board's image wherever it runs, measures it, and proves that the tick is alone in CCM RAM.
//!
//! The proof is from the image itself: see [`walk`]. It fails when the tick calls anything outside CCM RAM, anything that can
//! panic, copies or divides by a call, or when the image does not fit its budget.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

use crate::debian::{self, Need};

mod dfu;
mod image;
mod thumb;
mod walk;

const TARGET: &str = "thumbv7em-none-eabihf";
/// Oldest compiler that builds the workspace.
const OLDEST_MINOR: u32 = 95;

/// Options of `cargo xtask firmware`.
#[derive(clap::Args, Default)]
pub struct Args {
    /// Measure and check this image instead of building one.
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// Where to build; default: `firmware` in the target folder.
    #[arg(long, value_name = "FOLDER")]
    target_dir: Option<PathBuf>,
}

/// Builds, measures, checks, writes .bin and .dfu next to the image.
///
/// # Errors
/// No toolchain can build it, it does not build, or it fails a check.
pub fn run(args: &Args) -> Result<()> {
    let elf = match &args.elf {
        Some(elf) => elf.clone(),
        None => build(args.target_dir.as_deref())?,
    };
    check(&elf)
}

/// Measures and checks an image, and writes .bin and .dfu next to it.
fn check(elf: &Path) -> Result<()> {
    let bytes = std::fs::read(elf).with_context(|| format!("{}", elf.display()))?;
    let image = image::Image::parse(&bytes).with_context(|| format!("{}", elf.display()))?;
    println!("image {}", elf.display());
    let over = image.print_memory();
    let problems = walk::walk(&image)?;
    let bin = elf.with_extension("bin");
    let dfu = elf.with_extension("dfu");
    let (address, content) = image.flash_content()?;
    std::fs::write(&bin, &content).with_context(|| format!("{}", bin.display()))?;
    std::fs::write(&dfu, dfu::file(address, &content))
        .with_context(|| format!("{}", dfu.display()))?;
    println!("\nflash with a debug probe   probe-rs run --chip STM32G474RETx {}", elf.display());
    println!(
        "flash over USB (DFU mode)  dfu-util -d 0483:df11 -a 0 -s {address:#010x}:leave -D {}",
        bin.display()
    );
    println!("or as a DfuSe file         dfu-util -a 0 -D {}", dfu.display());
    let problems: Vec<String> = over.into_iter().chain(problems).collect();
    if !problems.is_empty() {
        bail!("the image fails {} checks:\n  {}", problems.len(), problems.join("\n  "));
    }
    println!("\nfirmware: all checks passed");
    Ok(())
}

/// Whether this machine can build for the board; installs a toolchain where that is allowed.
///
/// # Errors
/// Says what is missing.
pub fn toolchain() -> Result<()> {
    let shell = Shell::new()?;
    pick(&shell).map(|_| ())
}

/// A way to build for the board here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Toolchain {
    /// rustup with the target installed.
    RustupTarget,
    /// rustup with the library source, compiled along.
    RustupSource,
    /// Debian's compiler and library source, compiled along.
    Debian,
}

/// Builds the image with the best toolchain there is; its path.
///
/// # Errors
/// No toolchain can build it, or it does not build.
pub fn build(target_dir: Option<&Path>) -> Result<PathBuf> {
    let shell = Shell::new()?;
    shell.change_dir(crate::workspace());
    let folder = match target_dir {
        Some(folder) => std::path::absolute(folder)?,
        None => std::env::var_os("CARGO_TARGET_DIR")
            .map_or_else(|| crate::workspace().join("target"), PathBuf::from)
            .join("firmware"),
    };
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let common = ["--release", "--features", "board", "--bin", "firmware", "--target", TARGET];
    let build = cmd!(shell, "{cargo} build {common...} --target-dir {folder}");
    let source = ["-Z", "build-std=core"];
    match pick(&shell)? {
        Toolchain::RustupTarget => {
            println!("toolchain: rustup, with its {TARGET} target");
            build.run()?;
        }
        Toolchain::RustupSource => {
            println!("toolchain: rustup; no {TARGET} target, so core is compiled from rust-src");
            build.args(source).env("RUSTC_BOOTSTRAP", "1").run()?;
        }
        Toolchain::Debian => {
            println!(
                "toolchain: Debian's rustc; core is compiled from its rust-web-src, linked with lld"
            );
            // A compiler wrapper would look for the other compiler's sysroot.
            build
                .args(source)
                .env_remove("RUSTC_WRAPPER")
                .env_remove("RUSTUP_TOOLCHAIN")
                .env("RUSTC", "/usr/bin/rustc")
                .env("RUSTC_BOOTSTRAP", "1")
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld")
                .run()?;
        }
    }
    Ok(folder.join(TARGET).join("release/firmware"))
}

fn pick(shell: &Shell) -> Result<Toolchain> {
    let sysroot = cmd!(shell, "rustc --print sysroot").quiet().ignore_stderr().read();
    if let Some(found) = sysroot.ok().and_then(|sysroot| from_sysroot(Path::new(&sysroot))) {
        return Ok(found);
    }
    let needs = [
        Need { program: "/usr/bin/rustc", packages: &["rustc-web"] },
        Need { program: "/usr/bin/cargo", packages: &["cargo-web"] },
        Need {
            program: "/usr/lib/rustlib/src/rust/library/core/Cargo.toml",
            packages: &["rust-web-src"],
        },
        Need { program: "ld.lld", packages: &["lld", "libstd-rust-web-dev"] },
    ];
    debian::ensure(shell, &needs)
        .with_context(|| format!("neither rustup's target (`rustup target add {TARGET}`) nor"))?;
    let version = cmd!(shell, "/usr/bin/rustc --version").quiet().read()?;
    let minor = version.split('.').nth(1).and_then(|minor| minor.parse::<u32>().ok());
    if minor.is_none_or(|minor| minor < OLDEST_MINOR) {
        bail!(
            "/usr/bin/rustc is {version}, but 1.{OLDEST_MINOR} is needed: `rustup target add {TARGET}`, or install rustc-web"
        );
    }
    Ok(Toolchain::Debian)
}

/// What rustup has put into its toolchain that builds for the board. (`rustup target list` knows nothing of toolchains that were linked.)
fn from_sysroot(sysroot: &Path) -> Option<Toolchain> {
    let lib = sysroot.join("lib/rustlib");
    let files = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_core = |name: &str| name.starts_with("libcore-") && name.ends_with(".rlib");
    if files(&lib.join(TARGET).join("lib"))
        .any(|file| file.file_name().to_str().is_some_and(is_core))
    {
        return Some(Toolchain::RustupTarget);
    }
    // In the folder of the host, whichever that is.
    let has_linker = files(&lib).any(|host| {
        let bin = host.path().join("bin");
        bin.join("rust-lld").is_file() || bin.join("rust-lld.exe").is_file()
    });
    let has_source = lib.join("src/rust/library/core").is_dir();
    (has_source && has_linker).then_some(Toolchain::RustupSource)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// rustup's folders after `rustup target add` and `rustup component add rust-src`, as they are on a machine with a network.
    #[test]
    fn the_installed_target_comes_before_the_source() {
        let sysroot =
            std::env::temp_dir().join(format!("flexstage-sysroot-{}", std::process::id()));
        let rustlib = sysroot.join("lib/rustlib");
        let host = rustlib.join("aarch64-unknown-linux-gnu/bin");
        std::fs::create_dir_all(&host).unwrap();
        assert_eq!(from_sysroot(&sysroot), None, "a host toolchain only");
        std::fs::create_dir_all(rustlib.join("src/rust/library/core")).unwrap();
        assert_eq!(from_sysroot(&sysroot), None, "source without a linker");
        std::fs::write(host.join("rust-lld"), "").unwrap();
        assert_eq!(from_sysroot(&sysroot), Some(Toolchain::RustupSource));
        let target = rustlib.join(TARGET).join("lib");
        std::fs::create_dir_all(&target).unwrap();
        assert_eq!(from_sysroot(&sysroot), Some(Toolchain::RustupSource), "a target half removed");
        std::fs::write(target.join("libcore-0123456789abcdef.rlib"), "").unwrap();
        assert_eq!(from_sysroot(&sysroot), Some(Toolchain::RustupTarget));
        std::fs::remove_dir_all(&sysroot).unwrap();
    }
}
