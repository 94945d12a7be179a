//! `flexstage flash`: put firmware on a board through the microcontroller's own USB loader.

use std::path::PathBuf;
use std::process::Command as Process;

use anyhow::{Context, bail};
use flexstage::link::message::Command;

use crate::board::BoardArgs;
use crate::say::say;

/// Options of `flexstage flash`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Firmware image: .dfu or .bin from `cargo xtask firmware`.
    image: PathBuf,
    /// The board is in its loader already (BOOT0 held at power-on).
    #[arg(long)]
    in_loader: bool,
}

/// Start of flash, for plain images.
const FLASH: &str = "0x08000000:leave";

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let name = args.image.display();
    let image =
        std::fs::read(&args.image).with_context(|| format!("{name}: expected a firmware image"))?;
    let is_dfu = image.starts_with(b"DfuSe");
    if !is_dfu {
        // First words: initial stack pointer in RAM (96 KiB SRAM or 32 KiB CCM), reset vector in flash, odd for Thumb.
        let word =
            |i: usize| image.get(i..i + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
        let is_image = word(0).is_some_and(|sp| (0x1000_0000..=0x2002_0000).contains(&sp))
            && word(4).is_some_and(|pc| (0x0800_0000..0x0808_0000).contains(&pc) && pc & 1 == 1);
        if !is_image {
            bail!(
                "{name}: expected a .dfu or .bin image for the STM32G474, found something else; build one with `cargo xtask firmware`"
            );
        }
    }
    if args.board.virtual_board || args.board.connect.is_some() {
        bail!(
            "a virtual or emulated board has no loader; the emulator is given its firmware with `--elf`"
        );
    }
    if Process::new("dfu-util").arg("--version").output().is_err() {
        bail!(
            "dfu-util is not installed: it writes the image (Debian: apt install dfu-util; macOS: brew install dfu-util)"
        );
    }
    if !args.in_loader {
        let device = args.board.open()?;
        say!("{}: firmware {} goes into its loader", device.info().name, device.info().firmware)?;
        device.command(Command::RebootToDfu)?;
        device.close();
        std::thread::sleep(std::time::Duration::from_secs(2));
    }
    let mut write = Process::new("dfu-util");
    // STMicroelectronics' ROM loader, internal flash.
    write.args(["-d", "0483:df11", "-a", "0"]);
    if is_dfu {
        write.arg("-D").arg(&args.image);
    } else {
        write.args(["-s", FLASH, "-D"]).arg(&args.image);
    }
    let status = write.status().context("dfu-util cannot be started")?;
    if !status.success() {
        bail!("dfu-util failed: the board stays in its loader; try again with --in-loader");
    }
    Ok(())
}
