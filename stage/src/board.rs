//! Which board a command talks to, and what all such commands share.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use host_sim::Rig;
use indicatif::{ProgressBar, ProgressStyle};
use telemetry::virtual_board::{Options, Speed};
use telemetry::{Device, Target};

/// Which board. Without any of these: the only one on USB.
#[derive(clap::Args, Clone, Debug)]
pub struct BoardArgs {
    /// Serial number of the board on USB (see `flexstage devices`).
    #[arg(long, global = true)]
    pub serial: Option<String>,
    /// Address of an emulated board: HOST:PORT or unix:PATH.
    #[arg(long, global = true, value_name = "ADDR", conflicts_with_all = ["serial", "virtual_board"])]
    pub connect: Option<String>,
    /// A board simulated in this program: the real control core against a plant model.
    #[arg(long = "virtual", global = true, conflicts_with = "serial")]
    pub virtual_board: bool,
    /// Rig file that the virtual board drives; the first paper's rig by default.
    #[arg(long, global = true, value_name = "RIG.toml", requires = "virtual_board")]
    pub virtual_rig: Option<PathBuf>,
    /// Seed of the virtual board's noise.
    #[arg(long, global = true, default_value_t = 1, requires = "virtual_board")]
    pub virtual_seed: u64,
    /// Let the virtual board run as fast as it can instead of in real time.
    #[arg(long, global = true, requires = "virtual_board")]
    pub fast: bool,
}

impl BoardArgs {
    /// The board that is meant.
    pub fn target(&self) -> anyhow::Result<Target> {
        if let Some(address) = &self.connect {
            return Ok(Target::Socket(address.clone()));
        }
        if !self.virtual_board {
            return Ok(Target::Usb { serial: self.serial.clone() });
        }
        let mut options = Options {
            seed: self.virtual_seed,
            speed: if self.fast { Speed::Max } else { Speed::RealTime },
            ..Options::default()
        };
        if let Some(path) = &self.virtual_rig {
            options.rig = Rig::load(path).map_err(|e| anyhow::anyhow!("{e}"))?;
        }
        Ok(Target::Virtual(options))
    }

    /// Connect to it.
    pub fn open(&self) -> anyhow::Result<Device> {
        Ok(Device::open(&self.target()?)?)
    }
}

/// A flag that ctrl-C sets instead of ending the program, so that stages are parked and files finished.
pub fn on_interrupt() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    ctrlc::set_handler(move || set.store(true, Ordering::Release))
        .context("ctrl-C cannot be watched")?;
    Ok(flag)
}

/// A bar over seconds, on standard error; hidden when that is no terminal.
pub fn seconds_bar(total_s: f64) -> ProgressBar {
    let bar = ProgressBar::new((total_s * 10.0) as u64);
    // The template is constant; indicatif's own style is as good should it ever be wrong.
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent:>3} %  {msg}") {
        bar.set_style(style);
    }
    bar
}

/// A level beyond the board's limits is said with the options that choose it.
pub fn beyond(error: telemetry::Error, options: &str) -> anyhow::Error {
    match error {
        telemetry::Error::Beyond(words) => anyhow::anyhow!("{options}: {words}"),
        other => other.into(),
    }
}
