//! `flexstage tune`: measure, propose, show predicted beside measured, apply on confirmation.

use std::io::IsTerminal;
use std::path::PathBuf;

use anyhow::Context;
use host_sim::Rig;
use report::{Report, Table};
use serde_json::json;
use telemetry::measure::Frf;
use telemetry::tune::LoopFigures;
use telemetry::tune::study::{Applied, Level, Study, apply, distance, study, study_model};

use crate::board::{BoardArgs, beyond, on_interrupt, seconds_bar};
use crate::measure::{bode, frf_json, margin_lines, peak_volts, prediction, trace, volts};
use crate::number::axis;
use crate::say::say;

/// Band in which prediction and measurement are compared, Hz.
const BAND_HZ: f64 = 500.0;

/// Options of `flexstage tune`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Axis, from 1.
    #[arg(long, default_value_t = 1, value_parser = axis)]
    axis: usize,
    /// Voltage around which is measured.
    #[arg(long, default_value_t = 45.0, value_parser = volts())]
    bias_v: f64,
    /// Peak of the excitation, V.
    #[arg(long, default_value_t = 8.0, value_parser = peak_volts())]
    amplitude_v: f64,
    /// Tune on a rig file (from `identify` or `diagnose`) instead of a measurement of the stage; the feedforward is then the rig's.
    #[arg(long, value_name = "RIG.toml")]
    model: Option<PathBuf>,
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
    let axis = args.axis - 1;
    let model = args.model.as_deref().map(Rig::load).transpose()?;
    args.write.iter().chain(&args.out).try_for_each(|path| crate::output::file(path))?;
    let device = args.board.open()?;
    let stop = on_interrupt()?;
    let bar = seconds_bar(0.0);
    let level = Level { bias_v: args.bias_v, amplitude_v: args.amplitude_v };
    let mut progress = |p: &telemetry::probe::Progress| {
        bar.set_length((p.total_s * 10.0) as u64);
        bar.set_position((p.done_s * 10.0) as u64);
        bar.set_message(p.name.clone());
    };
    let study = match &model {
        Some(rig) => {
            let in_effect = crate::config::read(&device)?;
            study_model(rig, &in_effect, axis, level, &stop, &mut progress)
        }
        None => study(&device, axis, level, &stop, &mut progress),
    };
    let study = study.map_err(|error| beyond(error, "--bias-v, --amplitude-v"))?;
    let proposal = &study.proposal;
    bar.finish_and_clear();
    if !args.json {
        say!("axis {}: {}", args.axis, proposal.changes.join("\n        "))?;
        say!("now        {}", figures(&proposal.before))?;
        say!("predicted  {}", figures(&proposal.predicted))?;
        say!("           {}", closed_words(&study.closed_predicted))?;
    }
    if let Some(path) = &args.write {
        std::fs::write(path, toml::to_string_pretty(&proposal.settings)?)
            .with_context(|| format!("{}: cannot write", path.display()))?;
    }
    let is_wanted = args.apply || (!args.json && confirm()?);
    let applied = if is_wanted {
        bar.reset();
        let applied = apply(&device, &study, &stop, &mut progress)?;
        bar.finish_and_clear();
        if !args.json {
            say!(
                "applied    settings {:08x} from tick {}, not saved (`flexstage config save`)",
                applied.digest,
                applied.tick
            )?;
            say!("measured   {}", margin_lines(&applied.after.margins).join("; "))?;
            say!("           {}", closed_words(&applied.closed))?;
            if let Some(words) = agreement(&study, &applied) {
                say!("           {words}")?;
            }
        }
        Some(applied)
    } else {
        None
    };
    if args.json {
        let out = json!({
            "axis": args.axis,
            "changes": proposal.changes,
            "plant": proposal.plant,
            "before": proposal.before,
            "predicted": proposal.predicted,
            "predicted_closed_loop": frf_json(&study.closed_predicted),
            "measured": applied.as_ref().map(|a| a.after.margins),
            "measured_closed_loop": applied.as_ref().map(|a| frf_json(&a.closed)),
            "prediction_off": applied.as_ref().and_then(|a| distance(&study.closed_predicted, &a.closed, BAND_HZ)),
            "applied": is_wanted,
        });
        say!("{}", serde_json::to_string_pretty(&out)?)?;
    }
    if let Some(path) = &args.out {
        page(&study, applied.as_ref())
            .write(path)
            .with_context(|| format!("{}: cannot write", path.display()))?;
    }
    Ok(())
}

/// Plots of before, prediction and measurement, side by side.
fn page(study: &Study, applied: Option<&Applied>) -> Report {
    let proposal = &study.proposal;
    let mut table = Table::new(["", "loop", "reference to position"])
        .row(["now".to_owned(), figures(&proposal.before), closed_words(&study.closed_before)])
        .row([
            "predicted".to_owned(),
            figures(&proposal.predicted),
            closed_words(&study.closed_predicted),
        ]);
    let gain = telemetry::measure::campaign::with_controller(
        study.before.plant.clone(),
        &proposal.settings,
        study.axis,
    );
    let mut closed = bode("Reference to position", &study.closed_before, "before");
    let mut loop_gain = bode("Loop gain", &study.before.loop_gain, "before");
    let mut verdict = "Proposed, not applied.".to_owned();
    if let Some(applied) = applied {
        let margins = margin_lines(&applied.after.margins).join("; ");
        table = table.row(["measured".to_owned(), margins, closed_words(&applied.closed)]);
        closed = trace(closed, "measured", &applied.closed);
        loop_gain = trace(loop_gain, "measured", &applied.after.loop_gain);
        verdict = match agreement(study, applied) {
            Some(words) => format!("Applied; {words}."),
            None => "Applied.".to_owned(),
        };
    }
    // Dashed and on top: where it holds, the measurement shows through it.
    closed = prediction(closed, &study.closed_predicted);
    loop_gain = prediction(loop_gain, &gain.loop_gain);
    Report::new(format!("Tuning of axis {}", study.axis + 1))
        .verdict(verdict)
        .paragraph(format!("Changed: {}.", proposal.changes.join("; ")))
        .table(table)
        .figure(
            &closed,
            "Closed loop: before, as predicted for the proposal, and as measured with it.",
        )
        .figure(&loop_gain, "Measured drive to position times the feedback.")
        .figure(
            &bode("Drive to position (dB of um/V)", &study.before.plant, "measured"),
            "Open loop, around the bias.",
        )
}

fn agreement(study: &Study, applied: &Applied) -> Option<String> {
    let off = distance(&study.closed_predicted, &applied.closed, BAND_HZ)?;
    Some(format!(
        "prediction and measurement differ by {:.1} % rms up to {BAND_HZ:.0} Hz",
        100.0 * off
    ))
}

/// Bandwidth and peak of a closed loop in words.
fn closed_words(t: &Frf) -> String {
    let bandwidth =
        t.bandwidth_hz().map_or("above the measured band".into(), |f| format!("at {f:.0} Hz"));
    let peak = t.coherent(0.8).points.iter().map(|p| p.magnitude_db()).fold(f64::MIN, f64::max);
    // No minus sign before a zero.
    let peak = (peak * 10.0).round() / 10.0 + 0.0;
    format!("closed loop -3 dB {bandwidth}, highest gain {peak:.1} dB")
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
        say!("not applied: no terminal to confirm at (use --apply)")?;
        return Ok(false);
    }
    crate::say::text(format_args!("apply? [y/N] "))?;
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    Ok(answer.trim().eq_ignore_ascii_case("y"))
}
