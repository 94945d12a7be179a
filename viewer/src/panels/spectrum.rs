//! Power spectral density of position or error, with the rms integrated from the top.

use eframe::egui::{RichText, Ui};
use egui_plot::{Legend, Line, Plot};
use telemetry::measure::psd::{Psd, welch};
use telemetry::{AXES, Channel, History};

use super::{axis_color, log_axis};
use crate::view::TimeView;

/// Most samples that are transformed a time.
const SAMPLES: u64 = 131_072;
/// Frames between two computations while live: the eye needs no sixty spectra a second.
const EVERY: u32 = 20;

/// What the panel remembers between frames.
#[derive(Default)]
pub struct Spectrum {
    channel: Option<Channel>,
    integrated: bool,
    age: u32,
    spectra: Vec<(usize, Psd)>,
}

impl Spectrum {
    /// The panel.
    pub fn show(&mut self, ui: &mut Ui, view: &TimeView, axes: [bool; AXES], history: &History) {
        let mut channel = self.channel.unwrap_or(Channel::Position);
        ui.horizontal(|ui| {
            for choice in [Channel::Position, Channel::Error, Channel::Monitor] {
                if ui.selectable_label(channel == choice, choice.name()).clicked() {
                    channel = choice;
                    self.age = 0;
                }
            }
            ui.separator();
            ui.toggle_value(&mut self.integrated, "integrated rms")
                .on_hover_text("Root mean square of everything above each frequency");
        });
        self.channel = Some(channel);
        if self.age == 0 {
            let to = history.tick_at(view.range_s.1) + 1;
            let from = history.tick_at(view.range_s.0).max(to.saturating_sub(SAMPLES));
            let n = (to - from) as usize;
            // At least eight half-overlapping segments, at most 8192 points each.
            let segment = (n / 4).next_power_of_two().clamp(64, 8192).min(n.max(1));
            self.spectra = (0..AXES)
                .filter(|&axis| axes[axis])
                .map(|axis| {
                    let signal = history.slice(channel, axis, from, to);
                    (axis, welch(&signal, history.sample_rate_hz(), segment))
                })
                .collect();
        }
        self.age = (self.age + 1) % EVERY;
        let (factor, unit) = if channel.unit() == "um" { (1e3, "nm") } else { (1e3, "mV") };
        for (axis, psd) in &self.spectra {
            let lines: Vec<String> = psd
                .lines(6.0)
                .iter()
                .take(3)
                .map(|(f, a)| format!("{f:.1} Hz {:.2} {unit}", a * factor))
                .collect();
            let text = format!(
                "axis {}: rms {:.2} {unit}{}",
                axis + 1,
                psd.rms() * factor,
                if lines.is_empty() {
                    String::new()
                } else {
                    format!("; lines: {}", lines.join(", "))
                }
            );
            ui.label(RichText::new(text).color(axis_color(*axis, false)));
        }
        let is_integrated = self.integrated;
        let label = if is_integrated {
            format!("rms above the frequency ({unit})")
        } else {
            format!("density ({unit}/√Hz)")
        };
        let plot = Plot::new("spectrum")
            .legend(Legend::default())
            .y_axis_label(label)
            .label_formatter(move |at| {
                let p = match at {
                    egui_plot::HoverPosition::NearDataPoint { position, .. }
                    | egui_plot::HoverPosition::Elsewhere { position } => *position,
                };
                let (f, v) = (10f64.powf(p.x), 10f64.powf(p.y));
                Some(format!("{} Hz\n{} {unit}", log_axis::number(f), log_axis::number(v)))
            });
        log_axis::log_y(log_axis::frequency(plot)).show(ui, |plot| {
            for (axis, psd) in &self.spectra {
                let values = if is_integrated {
                    psd.rms_above()
                } else {
                    psd.density.iter().map(|d| d.sqrt()).collect()
                };
                let points: Vec<[f64; 2]> = psd
                    .frequency_hz
                    .iter()
                    .zip(values)
                    .filter(|(_, v)| *v > 0.0)
                    .map(|(f, v)| [f.log10(), (v * factor).log10()])
                    .collect();
                let name = format!("axis {}", axis + 1);
                plot.line(Line::new(name, points).color(axis_color(*axis, false)).width(1.2));
            }
        });
    }
}
