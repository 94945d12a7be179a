//! `flexstage measure`: frequency response with margins, step response, noise floor; figures and a page of plots.

use std::path::PathBuf;

use anyhow::Context;
use report::plot::{Bode, LinePlot, Series};
use report::{Report, Table};
use serde_json::json;
use telemetry::measure::campaign::{
    Excitation, closed_loop_response, frequency_response, noise_floor, step_response,
};
use telemetry::measure::{Frf, margins::Margins};

use crate::board::{BoardArgs, beyond, on_interrupt, seconds_bar};
use crate::number::{axis, number};
use crate::say::say;

/// Options of `flexstage measure`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    board: BoardArgs,
    /// Machine-readable output.
    #[arg(long, global = true)]
    json: bool,
    /// Page with the plots.
    #[arg(long, global = true, value_name = "FILE.html")]
    out: Option<PathBuf>,
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Drive to position, open loop; margins with the feedback on the board.
    Response {
        /// What the stage is driven with.
        #[arg(long, value_enum, default_value_t)]
        excitation: ExcitationArg,
        /// Axis, from 1.
        #[arg(long, default_value_t = 1, value_parser = axis)]
        axis: usize,
        /// Voltage around which is measured.
        #[arg(long, default_value_t = 45.0, value_parser = volts())]
        bias_v: f64,
        /// Peak of the excitation, V.
        #[arg(long, default_value_t = 8.0, value_parser = peak_volts())]
        amplitude_v: f64,
    },
    /// Reference to position in closed loop with the settings on the board.
    Closed {
        /// What the stage is driven with.
        #[arg(long, value_enum, default_value_t)]
        excitation: ExcitationArg,
        /// Axis, from 1.
        #[arg(long, default_value_t = 1, value_parser = axis)]
        axis: usize,
        /// Position around which is measured.
        #[arg(long, default_value_t = 6.0, value_parser = micrometres())]
        center_um: f64,
        /// Peak of the excitation, um.
        #[arg(long, default_value_t = 0.5, value_parser = number(0.001..=1000.0, " um"))]
        amplitude_um: f64,
    },
    /// Step of the reference in closed loop.
    Step {
        /// Axis, from 1.
        #[arg(long, default_value_t = 1, value_parser = axis)]
        axis: usize,
        /// From, um.
        #[arg(long, default_value_t = 5.0, value_parser = micrometres())]
        from_um: f64,
        /// To, um.
        #[arg(long, default_value_t = 6.0, value_parser = micrometres())]
        to_um: f64,
    },
    /// Position noise of all axes as the stage stands.
    Noise {
        /// Length, s.
        #[arg(long, default_value_t = 5.0, value_parser = number(0.1..=3600.0, " s"))]
        seconds: f64,
    },
}

/// Voltages around which is measured; the limits of the board narrow them.
pub fn volts() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    number(-1000.0..=1000.0, " V")
}

/// Peaks of an excitation that moves something.
pub fn peak_volts() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    number(0.01..=1000.0, " V")
}

fn micrometres() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    number(-1000.0..=1000.0, " um")
}

#[derive(clap::ValueEnum, Clone, Copy, Default)]
enum ExcitationArg {
    /// Random-phase multisine: lines every 9.8 Hz to 2.5 kHz.
    #[default]
    Multisine,
    /// Swept sine, twice, 4 Hz to 2 kHz.
    Sweep,
}

impl From<ExcitationArg> for Excitation {
    fn from(arg: ExcitationArg) -> Self {
        match arg {
            ExcitationArg::Multisine => Self::Multisine,
            ExcitationArg::Sweep => Self::Sweep,
        }
    }
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    if let What::Step { from_um, to_um, .. } = args.what {
        anyhow::ensure!(
            from_um != to_um,
            "--from-um {from_um}, --to-um {to_um}: expected two positions, found one"
        );
    }
    args.out.iter().try_for_each(|path| crate::output::file(path))?;
    let device = args.board.open()?;
    let stop = on_interrupt()?;
    let bar = seconds_bar(0.0);
    let mut progress = |p: &telemetry::probe::Progress| {
        bar.set_length((p.total_s * 10.0) as u64);
        bar.set_position((p.done_s * 10.0) as u64);
        bar.set_message(p.name.clone());
    };
    let (json, lines, page) = match args.what {
        What::Response { excitation, axis, bias_v, amplitude_v } => {
            let settings = crate::config::read(&device)?;
            let index = axis - 1;
            let r = frequency_response(
                &device,
                index,
                excitation.into(),
                (bias_v, amplitude_v),
                &settings,
                &stop,
                &mut progress,
            )
            .map_err(|error| beyond(error, "--bias-v, --amplitude-v"))?;
            let title = format!("Frequency response of axis {axis}");
            let mut lines = response_lines(&r.plant, "um/V");
            lines.extend(margin_lines(&r.margins));
            let page = Report::new(title)
                .verdict(lines.join("; "))
                .figure(
                    &bode("Drive to position (dB of um/V)", &r.plant, "measured"),
                    "Measured around the bias, open loop.",
                )
                .figure(
                    &bode("Loop gain", &r.loop_gain, "measured plant, feedback of the board"),
                    "Measured plant times the feedback on the board.",
                );
            (json!({"axis": axis, "plant": frf_json(&r.plant), "margins": r.margins}), lines, page)
        }
        What::Closed { excitation, axis, center_um, amplitude_um } => {
            let index = axis - 1;
            let t = closed_loop_response(
                &device,
                index,
                excitation.into(),
                (center_um, amplitude_um),
                &stop,
                &mut progress,
            )?;
            let lines = response_lines(&t, "um/um");
            let page = Report::new(format!("Closed loop of axis {axis}"))
                .verdict(lines.join("; "))
                .figure(
                    &bode("Reference to position", &t, "measured"),
                    "With the settings on the board.",
                );
            (json!({"axis": axis, "closed_loop": frf_json(&t)}), lines, page)
        }
        What::Step { axis, from_um, to_um } => {
            let index = axis - 1;
            let (m, curve) = step_response(&device, index, (from_um, to_um), &stop, &mut progress)?;
            let settle =
                m.settling_s.map_or("not settled".into(), |s| format!("{:.2} ms", s * 1e3));
            let lines = vec![
                format!("rise 10-90 % {:.2} ms", m.rise_s * 1e3),
                format!("delay to 10 % {:.2} ms", m.delay_s * 1e3),
                format!("overshoot {:.1} %", m.overshoot_percent),
                format!("settling to {:.0} nm: {settle}", m.band_nm),
                format!("steady error {:.1} nm", m.steady_error_nm.unwrap_or(f64::NAN)),
            ];
            let near: Vec<&[f64; 3]> = curve.iter().filter(|p| p[0] < 0.1).collect();
            let plot = LinePlot::new("Step response")
                .x("time (ms)")
                .y("position (um)")
                .series(Series::dashed(
                    "reference",
                    near.iter().map(|p| (p[0] * 1e3, p[2])).collect(),
                ))
                .series(Series::line(
                    "position",
                    near.iter().map(|p| (p[0] * 1e3, p[1])).collect(),
                ));
            let page = Report::new(format!("Step response of axis {axis}"))
                .verdict(lines.join("; "))
                .figure(&plot, "Closed loop with the settings on the board.");
            (json!({"axis": axis, "step": m}), lines, page)
        }
        What::Noise { seconds } => {
            let all = noise_floor(&device, seconds, &stop, &mut progress)?;
            let mut table = Table::new(["axis", "rms (nm)", "above 100 Hz (nm)", "lines"]);
            let mut plot = LinePlot::new("Position noise")
                .x("frequency (Hz)")
                .y("nm/sqrt(Hz)")
                .log_x()
                .log_y();
            let mut lines = Vec::new();
            for n in &all {
                let marks: Vec<String> =
                    n.lines.iter().map(|(f, a)| format!("{f:.1} Hz {a:.2} nm")).collect();
                table = table.row([
                    n.axis.to_string(),
                    format!("{:.2}", n.rms_nm),
                    format!("{:.2}", n.above_100hz_nm),
                    marks.join(", "),
                ]);
                lines.push(format!(
                    "axis {}: {:.2} nm rms{}",
                    n.axis,
                    n.rms_nm,
                    if marks.is_empty() {
                        String::new()
                    } else {
                        format!(", lines {}", marks.join(", "))
                    }
                ));
                let density = n.psd.density.iter().map(|d| d.sqrt() * 1e3);
                let points = n.psd.frequency_hz.iter().copied().zip(density).collect();
                plot = plot.series(Series::line(format!("axis {}", n.axis), points));
            }
            let page = Report::new("Noise floor")
                .verdict(lines.join("; "))
                .table(table)
                .figure(&plot, "Welch, Hann windows.");
            (json!({"noise": all}), lines, page)
        }
    };
    bar.finish_and_clear();
    if args.json {
        say!("{}", serde_json::to_string_pretty(&json)?)?;
    } else {
        lines.iter().try_for_each(|line| say!("{line}"))?;
    }
    if let Some(path) = &args.out {
        page.write(path).with_context(|| format!("{}: cannot write", path.display()))?;
        if !args.json {
            say!("{}", path.display())?;
        }
    }
    Ok(())
}

/// Bode plot of a response with its coherence.
pub fn bode(title: &str, frf: &Frf, name: &str) -> Bode {
    let frequency: Vec<f64> = frf.points.iter().map(|p| p.frequency_hz).collect();
    let coherence: Vec<f64> = frf.points.iter().map(|p| p.coherence).collect();
    trace(Bode::new(title), name, frf).coherence(&frequency, &coherence)
}

/// Another response in the same plot; one of nothing at all (a loop that is open) is left out.
pub fn trace(plot: Bode, name: &str, frf: &Frf) -> Bode {
    let (frequency, magnitude) = magnitudes(frf);
    if magnitude.iter().all(|db| !db.is_finite()) {
        return plot;
    }
    plot.trace(name, &frequency, &magnitude, &frf.phase_deg())
}

/// A predicted response in the same plot, dashed.
pub fn prediction(plot: Bode, frf: &Frf) -> Bode {
    let (frequency, magnitude) = magnitudes(frf);
    plot.dashed("predicted", &frequency, &magnitude, &frf.phase_deg())
}

/// Frequencies, Hz, and magnitudes, dB.
fn magnitudes(frf: &Frf) -> (Vec<f64>, Vec<f64>) {
    frf.points.iter().map(|p| (p.frequency_hz, p.magnitude_db())).unzip()
}

fn response_lines(frf: &Frf, unit: &str) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(gain) = frf.static_gain() {
        out.push(format!("static gain {gain:.4} {unit}"));
    }
    match frf.bandwidth_hz() {
        Some(f) => out.push(format!("-3 dB at {f:.0} Hz")),
        None => out.push("-3 dB outside the measured band".into()),
    }
    if let Some((f, _)) = frf.resonance() {
        out.push(format!("resonance at {f:.0} Hz"));
    }
    out
}

/// Margins in words.
pub fn margin_lines(m: &Margins) -> Vec<String> {
    let or = |value: Option<f64>, unit: &str, at: Option<f64>| match (value, at) {
        (Some(v), Some(f)) => format!("{v:.1} {unit} at {f:.0} Hz"),
        _ => "not reached in the measured band".into(),
    };
    vec![
        format!("phase margin {}", or(m.phase_margin_deg, "degrees", m.crossover_hz)),
        format!("gain margin {}", or(m.gain_margin_db, "dB", m.phase_crossover_hz)),
        m.modulus_margin.map_or(String::new(), |v| format!("modulus margin {v:.2}")),
    ]
}

/// A response as JSON.
pub fn frf_json(frf: &Frf) -> serde_json::Value {
    let phase = frf.phase_deg();
    frf.points
        .iter()
        .zip(phase)
        .map(|(p, phase_deg)| {
            json!({"frequency_hz": p.frequency_hz, "magnitude_db": p.magnitude_db(), "phase_deg": phase_deg, "coherence": p.coherence})
        })
        .collect()
}
