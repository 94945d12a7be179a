//! Distribution of the error with its mean and rms in nanometres.

use eframe::egui::{RichText, Ui};
use egui_plot::{Bar, BarChart, Legend, Plot};
use telemetry::{AXES, Channel, History};

use super::axis_color;
use crate::view::TimeView;

/// Bins between the extremes.
const BINS: usize = 81;
/// Most samples that are looked at a frame.
const SAMPLES: u64 = 400_000;

/// Frames between two computations while live.
const EVERY: u32 = 6;

/// Mean, rms and largest magnitude, all in nm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorFigures {
    /// Mean, nm.
    pub mean_nm: f64,
    /// Root mean square, nm.
    pub rms_nm: f64,
    /// Largest magnitude, nm.
    pub peak_nm: f64,
}

/// Figures of an error in micrometres; lost samples (NaN) do not count.
pub fn figures(error_um: &[f32]) -> ErrorFigures {
    let finite = error_um.iter().filter(|e| e.is_finite()).map(|&e| f64::from(e) * 1e3);
    let (mut n, mut sum, mut square, mut peak) = (0.0f64, 0.0, 0.0, 0.0f64);
    for e in finite {
        n += 1.0;
        sum += e;
        square += e * e;
        peak = peak.max(e.abs());
    }
    if n == 0.0 {
        return ErrorFigures::default();
    }
    ErrorFigures { mean_nm: sum / n, rms_nm: (square / n).sqrt(), peak_nm: peak }
}

/// One axis as it is drawn.
struct Shape {
    axis: usize,
    figures: ErrorFigures,
    /// Middle of a bin (nm) and its share of the samples (%).
    bins: Vec<(f64, f64)>,
    width_nm: f64,
}

impl Shape {
    fn of(axis: usize, error_um: &[f32]) -> Self {
        let figures = figures(error_um);
        let peak = figures.peak_nm.max(1e-3);
        let width_nm = 2.0 * peak / BINS as f64;
        let mut counts = [0u32; BINS];
        for e in error_um.iter().filter(|e| e.is_finite()) {
            let bin = ((f64::from(*e) * 1e3 + peak) / width_nm) as usize;
            counts[bin.min(BINS - 1)] += 1;
        }
        let total = f64::from(counts.iter().sum::<u32>().max(1));
        let bins = counts
            .iter()
            .enumerate()
            .map(|(i, &n)| (-peak + (i as f64 + 0.5) * width_nm, 100.0 * f64::from(n) / total))
            .collect();
        Self { axis, figures, bins, width_nm }
    }
}

/// What the panel remembers between frames.
#[derive(Default)]
pub struct Histogram {
    age: u32,
    shapes: Vec<Shape>,
}

impl Histogram {
    /// Histogram of the time on screen.
    pub fn show(&mut self, ui: &mut Ui, view: &TimeView, axes: [bool; AXES], history: &History) {
        if self.age == 0 {
            let to = history.tick_at(view.range_s.1) + 1;
            let from = history.tick_at(view.range_s.0).max(to.saturating_sub(SAMPLES));
            self.shapes = (0..AXES)
                .filter(|&axis| axes[axis])
                .map(|axis| Shape::of(axis, &history.slice(Channel::Error, axis, from, to)))
                .collect();
        }
        self.age = (self.age + 1) % EVERY;
        ui.label("error = reference - position, over the time on screen (at most the last 40 s)");
        for shape in &self.shapes {
            let f = shape.figures;
            ui.label(
                RichText::new(format!(
                    "axis {}: rms {:.2} nm, mean {:+.2} nm, peak {:.1} nm",
                    shape.axis + 1,
                    f.rms_nm,
                    f.mean_nm,
                    f.peak_nm
                ))
                .color(axis_color(shape.axis, false)),
            );
        }
        Plot::new("error histogram")
            .legend(Legend::default())
            .x_axis_label("error (nm)")
            .y_axis_label("share of samples (%)")
            .show(ui, |plot| {
                for shape in &self.shapes {
                    let bars = shape
                        .bins
                        .iter()
                        .map(|&(at, share)| Bar::new(at, share).width(shape.width_nm))
                        .collect();
                    let color = axis_color(shape.axis, false).gamma_multiply(0.6);
                    let name = format!("axis {}", shape.axis + 1);
                    plot.bar_chart(BarChart::new(name, bars).color(color));
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_error() {
        let f = figures(&[0.003, -0.004, f32::NAN]);
        assert!((f.rms_nm - 12.5f64.sqrt()).abs() < 1e-5);
        assert!((f.mean_nm + 0.5).abs() < 1e-5 && (f.peak_nm - 4.0).abs() < 1e-5);
        assert_eq!(figures(&[]), ErrorFigures::default());
    }
}
