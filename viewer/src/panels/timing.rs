//! How long the control interrupt takes, against the 100 us that it has.

use eframe::egui::Ui;
use egui_plot::{Bar, BarChart, Plot, VLine};
use telemetry::History;

use super::{BAD, GOOD, log_axis};

/// Histogram of tick times since the connection.
pub fn show(ui: &mut Ui, history: &History) {
    let period_us = 1e6 / history.sample_rate_hz();
    ui.label(format!(
        "longest tick {:.1} µs of {period_us:.0} µs ({:.0} %)",
        history.tick_time_max_us(),
        100.0 * f64::from(history.tick_time_max_us()) / period_us
    ))
    .on_hover_text("On a virtual board these are the times of this computer's processor");
    let bars: Vec<Bar> = history
        .tick_time_histogram()
        .filter(|(_, n)| *n > 0)
        .map(|(us, n)| {
            Bar::new(f64::from(us) + 0.25, (n as f64).log10().max(0.05)).width(0.5).fill(GOOD)
        })
        .collect();
    let plot = Plot::new("tick times")
        .x_axis_label("time in the interrupt (µs)")
        .y_axis_label("number of ticks")
        .include_x(0.0)
        .include_y(0.0);
    log_axis::log_y(plot).show(ui, |plot| {
        plot.bar_chart(BarChart::new("ticks", bars));
        plot.vline(VLine::new("period", period_us).color(BAD));
    });
}
