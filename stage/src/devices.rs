//! `flexstage devices`: boards on USB.

use telemetry::transport::list_usb;

use crate::say::say;

/// Options of `flexstage devices`.
#[derive(clap::Args)]
pub struct Args {
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let boards = list_usb()?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&boards)?)?;
    } else if boards.is_empty() {
        say!("no board on USB; `--virtual` and `--connect ADDR` need none")?;
    } else {
        for b in boards {
            say!("{}  {}  bus {} address {}", b.serial, b.product, b.bus, b.address)?;
        }
    }
    Ok(())
}
