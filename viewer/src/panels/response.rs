//! Plots of the last measurement: Bode plot with coherence, step, noise spectrum, tuning before, predicted and measured.

use eframe::egui::{Color32, Ui};
use egui_plot::{HLine, Legend, Line, LineStyle, Plot};
use telemetry::measure::Frf;
use telemetry::measure::campaign::with_controller;

use super::{AXIS_COLORS, log_axis};
use crate::link::Measured;

/// Coherence below which a point is drawn no more: its magnitude and phase are noise.
const COHERENT: f64 = 0.3;

/// One curve of a Bode plot.
struct Curve<'a> {
    name: &'a str,
    frf: &'a Frf,
    color: Color32,
    style: LineStyle,
}

impl<'a> Curve<'a> {
    fn solid(name: &'a str, frf: &'a Frf, color: Color32) -> Self {
        Self { name, frf, color, style: LineStyle::Solid }
    }
}

/// The plots.
pub fn show(ui: &mut Ui, measured: Option<&Measured>) {
    match measured {
        None => {
            ui.label("Nothing measured yet: choose a measurement under Measure, on the left.");
        }
        Some(Measured::Response { axis, response }) => {
            let color = AXIS_COLORS[axis % 3];
            let half = ui.available_height() * 0.62;
            let curves = [Curve::solid("drive to position", &response.plant, color)];
            bode(ui, "plant", "dB of µm/V", &curves, true, half);
            if response.margins.crossover_hz.is_some() {
                let curves = [Curve::solid("loop gain", &response.loop_gain, color)];
                bode(ui, "loop", "dB", &curves, false, ui.available_height());
            } else {
                ui.label("The feedback on the board is off or too weak to cross 0 dB: no margins.");
            }
        }
        Some(Measured::Closed { axis, closed }) => {
            let curves = [Curve::solid("reference to position", closed, AXIS_COLORS[axis % 3])];
            bode(ui, "closed", "dB", &curves, true, ui.available_height());
        }
        Some(Measured::Step { axis, curve, .. }) => step(ui, *axis, curve),
        Some(Measured::Noise(noise)) => {
            let plot = Plot::new("noise floor").legend(Legend::default()).y_axis_label("nm/√Hz");
            log_axis::log_y(log_axis::frequency(plot)).show(ui, |plot| {
                for n in noise {
                    let points: Vec<[f64; 2]> = n
                        .psd
                        .frequency_hz
                        .iter()
                        .zip(&n.psd.density)
                        .filter(|(_, d)| **d > 0.0)
                        .map(|(f, d)| [f.log10(), (d.sqrt() * 1e3).log10()])
                        .collect();
                    let color = AXIS_COLORS[(n.axis - 1) % 3];
                    plot.line(Line::new(format!("axis {}", n.axis), points).color(color));
                }
            });
        }
        Some(Measured::Tuning { study, applied }) => {
            let color = AXIS_COLORS[study.axis % 3];
            let predicted = Curve {
                style: LineStyle::dashed_loose(),
                ..Curve::solid("predicted", &study.closed_predicted, Color32::WHITE)
            };
            let mut curves =
                vec![Curve::solid("before", &study.closed_before, Color32::GRAY), predicted];
            if let Some(applied) = applied {
                curves.push(Curve::solid("measured", &applied.closed, color));
            }
            ui.label("reference to position");
            let half = ui.available_height() * 0.55;
            bode(ui, "tuned closed loop", "dB", &curves, false, half);
            let next =
                with_controller(study.before.plant.clone(), &study.proposal.settings, study.axis);
            let predicted = Curve {
                style: LineStyle::dashed_loose(),
                ..Curve::solid("predicted", &next.loop_gain, Color32::WHITE)
            };
            let mut curves =
                vec![Curve::solid("before", &study.before.loop_gain, Color32::GRAY), predicted];
            if let Some(applied) = applied {
                curves.push(Curve::solid("measured", &applied.after.loop_gain, color));
            }
            ui.label("loop gain");
            bode(ui, "tuned loop gain", "dB", &curves, false, ui.available_height());
        }
    }
}

/// Magnitude above phase, with coherence below when asked for, frequencies linked.
fn bode(ui: &mut Ui, id: &str, unit: &str, curves: &[Curve<'_>], coherence: bool, height: f32) {
    let gap = ui.spacing().item_spacing.y;
    let (magnitude_share, phase_share) = if coherence { (0.42, 0.36) } else { (0.55, 0.45) };
    let link = eframe::egui::Id::unique(("bode", id));
    let plot = |name: &str, label: String, share: f32, is_last: bool| {
        let plot = Plot::new((id.to_owned(), name.to_owned()))
            .height((height * share - gap).max(60.0))
            .link_axis(link, [true, false])
            .y_axis_label(label)
            .y_axis_min_width(52.0)
            .show_axes([is_last, true])
            .label_formatter(|at| {
                let (name, p) = match at {
                    egui_plot::HoverPosition::NearDataPoint { plot_name, position, .. } => {
                        (*plot_name, *position)
                    }
                    egui_plot::HoverPosition::Elsewhere { position } => ("", *position),
                };
                Some(format!("{name}\n{} Hz\n{:.2}", log_axis::number(10f64.powf(p.x)), p.y))
            });
        let plot = log_axis::frequency(plot);
        if is_last { plot } else { plot.x_axis_label("") }
    };
    let line = |curve: &Curve<'_>, value: &dyn Fn(usize) -> f64| {
        let points: Vec<[f64; 2]> = curve
            .frf
            .points
            .iter()
            .enumerate()
            .filter(|(_, p)| p.coherence >= COHERENT && p.frequency_hz > 0.0)
            .map(|(i, p)| [p.frequency_hz.log10(), value(i)])
            .filter(|p| p[1].is_finite())
            .collect();
        Line::new(curve.name.to_owned(), points).color(curve.color).style(curve.style).width(1.5)
    };
    plot("magnitude", format!("magnitude ({unit})"), magnitude_share, false)
        .legend(Legend::default())
        .show(ui, |plot| {
            plot.hline(HLine::new("", 0.0).color(Color32::DARK_GRAY).width(0.5));
            for curve in curves {
                plot.line(line(curve, &|i| curve.frf.points[i].magnitude_db()));
            }
        });
    plot("phase", "phase (°)".into(), phase_share, !coherence).show(ui, |plot| {
        for curve in curves {
            let phase = curve.frf.phase_deg();
            plot.line(line(curve, &|i| phase[i]));
        }
    });
    if coherence {
        plot("coherence", "coherence".into(), 1.0 - magnitude_share - phase_share, true)
            .include_y(0.0)
            .include_y(1.05)
            .show(ui, |plot| {
                for curve in curves {
                    let points: Vec<[f64; 2]> = curve
                        .frf
                        .points
                        .iter()
                        .map(|p| [p.frequency_hz.log10(), p.coherence])
                        .collect();
                    plot.line(Line::new(curve.name.to_owned(), points).color(curve.color));
                }
            });
    }
}

fn step(ui: &mut Ui, axis: usize, curve: &[[f64; 3]]) {
    Plot::new("step response")
        .legend(Legend::default())
        .x_axis_label("time after the step (ms)")
        .y_axis_label("position (µm)")
        .show(ui, |plot| {
            let points = |column: usize| -> Vec<[f64; 2]> {
                curve
                    .iter()
                    .filter(|p| (-0.005..0.05).contains(&p[0]))
                    .map(|p| [p[0] * 1e3, p[column]])
                    .collect()
            };
            plot.line(Line::new("reference", points(2)).color(Color32::GRAY));
            let color = AXIS_COLORS[axis % 3];
            plot.line(Line::new("position", points(1)).color(color).width(1.5));
        });
}
