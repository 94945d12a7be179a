//! `flexstage status`: state, faults and health of a board.

use flexstage::Flags;
use flexstage::link::message::{Command, Reply};
use serde_json::json;
use telemetry::words::{faults, state_words};

use crate::board::BoardArgs;
use crate::say::say;

/// Options of `flexstage status`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let device = args.board.open()?;
    let info = device.info();
    let (Reply::Status(status), Reply::Counters(counters)) =
        (device.command(Command::Status)?, device.command(Command::Counters)?)
    else {
        anyhow::bail!("{} answers with something else than its status", info.name);
    };
    let Reply::Crash(crash) = device.command(Command::Crash)? else {
        anyhow::bail!("{} answers with something else than its crash report", info.name);
    };
    let flags = Flags(status.flags);
    let limits: Vec<&str> = flags.limits().describe().collect();
    let max_us = f64::from(counters.cycles_max) / f64::from(info.core_hz) * 1e6;
    if args.json {
        let out = json!({
            "device": info,
            "state": flags.state().name(),
            "parked": flags.is_parked(),
            "faults": faults(flags),
            "limits": limits,
            "tick": status.tick,
            "uptime_ms": status.uptime_ms,
            "settings_digest": format!("{:08x}", status.digest),
            "settings_saved": status.is_stored,
            "tick_time_max_us": max_us,
            "overruns": counters.overruns,
            "dropped": counters.dropped,
            "malformed": counters.malformed,
            "usb_resets": counters.usb_resets,
            "stack_free_bytes": counters.stack_free,
            "crash": (!crash.message.is_empty()).then_some(crash.message.as_str()),
        });
        say!("{}", serde_json::to_string_pretty(&out)?)?;
        return Ok(());
    }
    say!("{}  firmware {}  serial {}", info.name, info.firmware, info.serial)?;
    say!("state      {}", state_words(flags))?;
    for fault in faults(flags) {
        say!("fault      {}: {}", fault.code, fault.words)?;
    }
    for limit in limits {
        say!("limited    {limit}")?;
    }
    say!(
        "uptime     {:.1} s, last restart: {}",
        f64::from(status.uptime_ms) / 1e3,
        info.reset_reason
    )?;
    say!(
        "settings   {:08x}, {}",
        status.digest,
        if status.is_stored { "saved" } else { "not saved: a restart forgets them" }
    )?;
    say!(
        "loop       longest tick {max_us:.1} us of {:.0} us, {} overruns",
        1e6 / info.sample_rate_hz,
        counters.overruns
    )?;
    say!(
        "link       {} samples dropped, {} malformed, {} USB resets",
        counters.dropped,
        counters.malformed,
        counters.usb_resets
    )?;
    if info.self_test != 0 {
        say!("self-test  failed, bits {:#06x}", info.self_test)?;
    }
    if !crash.message.is_empty() {
        say!("last run   ended badly: {}", crash.message)?;
    }
    Ok(())
}
