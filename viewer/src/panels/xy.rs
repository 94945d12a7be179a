//! Voltage-displacement loop of one axis: the picture of hysteresis.

use eframe::egui::Ui;
use egui_plot::{Legend, Line, Plot};
use telemetry::{AXES, Channel, History};

use super::axis_color;
use crate::view::TimeView;

/// Most points of a loop: drawing a closed curve needs no extremes.
const POINTS: u64 = 2000;

/// The loop over the time on screen.
pub fn show(ui: &mut Ui, view: &TimeView, axes: [bool; AXES], history: &History) {
    let (from, to) = (history.tick_at(view.range_s.0), history.tick_at(view.range_s.1) + 1);
    let stride = ((to - from) / POINTS).max(1);
    Plot::new("xy")
        .legend(Legend::default())
        .x_axis_label("drive (V)")
        .y_axis_label("position (µm)")
        .show(ui, |plot| {
            for axis in (0..AXES).filter(|&axis| axes[axis]) {
                let x = history.every(Channel::Drive, axis, (from, to), stride);
                let y = history.every(Channel::Position, axis, (from, to), stride);
                let points: Vec<[f64; 2]> = x
                    .iter()
                    .zip(&y)
                    .filter(|(x, y)| x.is_finite() && y.is_finite())
                    .map(|(&x, &y)| [f64::from(x), f64::from(y)])
                    .collect();
                let name = format!("axis {}", axis + 1);
                plot.line(Line::new(name, points).color(axis_color(axis, false)).width(1.2));
            }
        });
}
