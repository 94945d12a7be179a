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

/// Mean, standard deviation, rms and largest magnitude, all in nm.
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

/// Histogram of the time on screen.
pub fn show(ui: &mut Ui, view: &TimeView, axes: [bool; AXES], history: &History) {
    let to = history.tick_at(view.range_s.1) + 1;
    let from = history.tick_at(view.range_s.0).max(to.saturating_sub(SAMPLES));
    let errors: Vec<(usize, Vec<f32>)> = (0..AXES)
        .filter(|&axis| axes[axis])
        .map(|axis| (axis, history.slice(Channel::Error, axis, from, to)))
        .collect();
    for (axis, error) in &errors {
        let f = figures(error);
        ui.label(
            RichText::new(format!(
                "axis {}: rms {:.2} nm, mean {:+.2} nm, peak {:.1} nm",
                axis + 1,
                f.rms_nm,
                f.mean_nm,
                f.peak_nm
            ))
            .color(axis_color(*axis, false)),
        );
    }
    Plot::new("error histogram")
        .legend(Legend::default())
        .x_axis_label("error (nm)")
        .y_axis_label("share of samples (%)")
        .show(ui, |plot| {
            for (axis, error) in &errors {
                let peak = figures(error).peak_nm.max(1e-3);
                let width = 2.0 * peak / BINS as f64;
                let mut counts = [0u32; BINS];
                for e in error.iter().filter(|e| e.is_finite()) {
                    let bin = ((f64::from(*e) * 1e3 + peak) / width) as usize;
                    counts[bin.min(BINS - 1)] += 1;
                }
                let total = f64::from(counts.iter().sum::<u32>().max(1));
                let bars = counts
                    .iter()
                    .enumerate()
                    .map(|(i, &n)| {
                        let at = -peak + (i as f64 + 0.5) * width;
                        Bar::new(at, 100.0 * f64::from(n) / total).width(width)
                    })
                    .collect();
                let color = axis_color(*axis, false).gamma_multiply(0.6);
                plot.bar_chart(BarChart::new(format!("axis {}", axis + 1), bars).color(color));
            }
        });
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
