//! `flexstage tune`: measure, propose, show predicted beside measured, apply on confirmation.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;

use flexstage::link::message::{Command, Reply};
use report::{Report, Table};
use serde_json::json;
use telemetry::measure::campaign::frequency_response;
use telemetry::tune::{LoopFigures, propose};

use crate::board::{BoardArgs, axis_index, on_interrupt, seconds_bar};
use crate::measure::{bode, margin_lines};

/// Options of `flexstage tune`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Axis, from 1.
    #[arg(long, default_value_t = 1)]
    axis: usize,
    /// Voltage around which is measured.
    #[arg(long, default_value_t = 45.0)]
    bias_v: f64,
    /// Peak of the multisine, V.
    #[arg(long, default_value_t = 8.0)]
    amplitude_v: f64,
    /// Apply without asking.
    #[arg(long)]
    apply: bool,
    /// Machine-readable output; applies nothing unless --apply is given.
    #[arg(long)]
    json: bool,
    /// Write the proposed settings to a TOML file.
    #[arg(long, value_name = "FILE.toml")]
    write: Option<PathBuf>,
    /// Page with the plots.
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let index = axis_index(args.axis)?;
    let device = args.board.open()?;
    let stop = on_interrupt()?;
    let settings = crate::config::read(&device)?;
    let bar = seconds_bar(0.0);
    let level = (args.bias_v, args.amplitude_v);
    let mut progress = |p: &telemetry::probe::Progress| {
        bar.set_length((p.total_s * 10.0) as u64);
        bar.set_position((p.done_s * 10.0) as u64);
        bar.set_message(p.name.clone());
    };
    let before = frequency_response(&device, index, level, &settings, &stop, &mut progress)?;
    let proposal = propose(&before.plant, &settings, index).ok_or_else(|| {
        anyhow::anyhow!(
            "the response of axis {} is too noisy, or no gains keep the margins: measure with a larger --amplitude-v, \
             look at `flexstage measure response`",
            args.axis
        )
    })?;
    bar.finish_and_clear();
    if !args.json {
        println!("axis {}: {}", args.axis, proposal.changes.join("\n        "));
        println!("now        {}", figures(&proposal.before));
        println!("predicted  {}", figures(&proposal.predicted));
    }
    if let Some(path) = &args.write {
        std::fs::write(path, toml::to_string_pretty(&proposal.settings)?)?;
    }
    let is_wanted = args.apply || (!args.json && confirm()?);
    let mut measured = None;
    if is_wanted {
        let Reply::Configured { tick, digest } =
            device.command(Command::SetSettings(proposal.settings.clone()))?
        else {
            anyhow::bail!("the board did not say what took effect");
        };
        let after =
            frequency_response(&device, index, level, &proposal.settings, &stop, &mut progress)?;
        bar.finish_and_clear();
        if !args.json {
            println!(
                "applied    settings {digest:08x} from tick {tick}, not saved (`flexstage config save`)"
            );
            println!("measured   {}", margin_lines(&after.margins).join("; "));
        }
        measured = Some(after);
    }
    if args.json {
        let out = json!({
            "axis": args.axis,
            "changes": proposal.changes,
            "plant": proposal.plant,
            "before": proposal.before,
            "predicted": proposal.predicted,
            "measured": measured.as_ref().map(|m| m.margins),
            "applied": is_wanted,
        });
        println!("{}", serde_json::to_string_pretty(&out)?);
    }
    if let Some(path) = &args.out {
        let mut table = Table::new(["", "loop"])
            .row(["now".to_owned(), figures(&proposal.before)])
            .row(["predicted".to_owned(), figures(&proposal.predicted)]);
        if let Some(after) = &measured {
            table = table.row(["measured".to_owned(), margin_lines(&after.margins).join("; ")]);
        }
        let mut page = Report::new(format!("Tuning of axis {}", args.axis))
            .verdict(proposal.changes.join("; "))
            .table(table)
            .figure(&bode("Drive to position", &before.plant), "Measured open loop.")
            .figure(&bode("Loop gain now", &before.loop_gain), "Before.");
        if let Some(after) = &measured {
            page = page.figure(
                &bode("Loop gain after", &after.loop_gain),
                "Measured again with the proposal.",
            );
        }
        page.write(path)?;
    }
    Ok(())
}

fn figures(f: &LoopFigures) -> String {
    format!(
        "{}; {:.0} % of a disturbance below 100 Hz is left",
        margin_lines(&f.margins).join("; "),
        100.0 * f.left_of_disturbance
    )
}

fn confirm() -> anyhow::Result<bool> {
    if !std::io::stdin().is_terminal() {
        println!("not applied: no terminal to confirm at (use --apply)");
        return Ok(false);
    }
    print!("apply? [y/N] ");
    std::io::stdout().flush()?;
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    Ok(answer.trim().eq_ignore_ascii_case("y"))
}
