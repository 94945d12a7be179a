//! Live traces: position and reference, error, drive and monitor over sample time, with cursors and lost ticks.

use eframe::egui::{self, Button, Color32, Id, RichText, Ui, Vec2b};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoint, Span, Text, VLine};
use telemetry::{AXES, Channel, History};

use super::{BAD, axis_color};
use crate::view::TimeView;

/// Which traces are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Visible {
    /// Axes.
    pub axes: [bool; AXES],
    /// Rows: position, error, drive.
    pub rows: [bool; 3],
    /// Place cursors with clicks.
    pub cursors: bool,
}

impl Default for Visible {
    fn default() -> Self {
        Self { axes: [true; AXES], rows: [true; 3], cursors: false }
    }
}

/// Zoom of the time by the wheel: logarithm of the factor for each point that it scrolls. A notch is about 40 points.
const WHEEL: f32 = 0.006;

/// Width of the words beside lost ticks, as a share of the plot.
const LABEL: f64 = 0.15;

/// A row of traces: title, unit factor, channels in the order in which they are drawn, with their shade.
struct Row {
    name: &'static str,
    unit: &'static str,
    factor: f64,
    channels: &'static [(Channel, Shade)],
}

/// How a channel's colour follows from its axis.
#[derive(Clone, Copy)]
enum Shade {
    Plain,
    Dim,
    Bright,
}

impl Shade {
    fn of(self, axis: usize) -> Color32 {
        let color = axis_color(axis, false);
        match self {
            Shade::Plain => color,
            Shade::Dim => axis_color(axis, true),
            Shade::Bright => color.lerp_to_gamma(Color32::WHITE, 0.6),
        }
    }
}

const ROWS: [Row; 3] = [
    Row {
        name: "position",
        unit: "µm",
        factor: 1.0,
        // The wanted value on top: noise would hide it.
        channels: &[(Channel::Position, Shade::Plain), (Channel::Reference, Shade::Bright)],
    },
    Row { name: "error", unit: "nm", factor: 1e3, channels: &[(Channel::Error, Shade::Plain)] },
    Row {
        name: "drive",
        unit: "V",
        factor: 1.0,
        channels: &[(Channel::Monitor, Shade::Dim), (Channel::Drive, Shade::Plain)],
    },
];

/// Toolbar above the traces.
pub fn toolbar(ui: &mut Ui, view: &mut TimeView, visible: &mut Visible, history: &History) {
    ui.horizontal_wrapped(|ui| {
        let label = if view.is_paused { "Resume (P)" } else { "Pause (P)" };
        if ui
            .button(label)
            .on_hover_text("Recording goes on while the picture stands still")
            .clicked()
        {
            view.is_paused = !view.is_paused;
        }
        ui.separator();
        for (seconds, label) in [
            (0.1, "0.1 s"),
            (1.0, "1 s"),
            (5.0, "5 s"),
            (30.0, "30 s"),
            (120.0, "2 min"),
            (600.0, "10 min"),
        ] {
            if ui.selectable_label(view.window_s == seconds, label).clicked() {
                view.window_s = seconds;
                view.is_paused = false;
            }
        }
        if ui.button("All").on_hover_text("Everything in memory").clicked() {
            let (first, end) = history.ticks();
            view.show(history.time_s(first), history.time_s(end));
        }
        ui.separator();
        for (axis, on) in visible.axes.iter_mut().enumerate() {
            let text = RichText::new(format!("axis {}", axis + 1));
            let (ink, ground) = (Color32::BLACK, axis_color(axis, false));
            let button = if *on {
                Button::new(text.color(ink)).fill(ground)
            } else {
                Button::new(text.color(ground))
            };
            if ui.add(button).on_hover_text("Show or hide this axis everywhere").clicked() {
                *on = !*on;
            }
        }
        ui.separator();
        for (row, on) in ROWS.iter().zip(&mut visible.rows) {
            ui.toggle_value(on, row.name);
        }
        ui.separator();
        ui.toggle_value(&mut visible.cursors, "Cursors")
            .on_hover_text("Left click places A, right click places B");
        if ui.button("Clear cursors").clicked() {
            view.cursors = [None; 2];
        }
    });
}

/// The plots, filling what is left of the panel.
pub fn plots(ui: &mut Ui, view: &mut TimeView, visible: &Visible, history: &History) {
    let (_, end) = history.ticks();
    view.follow(history.time_s(end));
    let shown: Vec<&Row> =
        ROWS.iter().zip(visible.rows).filter(|(_, on)| *on).map(|(row, _)| row).collect();
    let table_height = if view.cursors.iter().any(Option::is_some) { 130.0 } else { 0.0 };
    let gap = ui.spacing().item_spacing.y;
    let height =
        ((ui.available_height() - table_height) / shown.len().max(1) as f32 - gap).max(60.0);
    for (i, row) in shown.iter().enumerate() {
        plot(ui, view, visible, history, row, height, i + 1 == shown.len());
    }
    view.jump_s = None;
    if table_height > 0.0 {
        cursor_table(ui, view, visible, history);
    }
}

fn plot(
    ui: &mut Ui,
    view: &mut TimeView,
    visible: &Visible,
    history: &History,
    row: &Row,
    height: f32,
    is_last: bool,
) {
    let columns = (ui.available_width() as usize).clamp(100, 4000);
    let follow = (!view.is_paused).then_some(view.range_s).or(view.jump_s);
    let (from, to) = view.range_s;
    let ticks = (history.tick_at(from), history.tick_at(to) + 1);
    let unit = row.unit;
    let turned = ui.input(|i| i.smooth_scroll_delta.y);
    let plot = Plot::new(("traces", row.name))
        .height(height)
        .link_axis(Id::unique("time"), Vec2b::new(true, false))
        .legend(Legend::default().position(Corner::LeftTop))
        .y_axis_label(format!("{} ({unit})", row.name))
        .y_axis_min_width(64.0)
        .show_axes([is_last, true])
        .allow_scroll(Vec2b::new(true, false))
        .allow_boxed_zoom(!visible.cursors)
        .auto_bounds(Vec2b::new(false, true))
        .label_formatter(move |at| {
            let (name, p) = match at {
                egui_plot::HoverPosition::NearDataPoint { plot_name, position, .. } => {
                    (*plot_name, *position)
                }
                egui_plot::HoverPosition::Elsewhere { position } => ("", *position),
            };
            Some(format!("{name}\n{:.4} s\n{:.4} {unit}", p.x, p.y))
        });
    let plot = if is_last { plot.x_axis_label("sample time (s)") } else { plot };
    let response = plot.show(ui, |plot| {
        if let Some((from, to)) = follow {
            plot.set_plot_bounds_x(from..=to);
        }
        let bounds = plot.plot_bounds();
        let mut labelled = f64::NEG_INFINITY;
        for lost in history.lost() {
            let (a, b) = (history.time_s(lost.tick), history.time_s(lost.tick + lost.count));
            if b < from || a > to {
                continue;
            }
            plot.span(Span::new("lost ticks", a..=b).fill(BAD.gamma_multiply(0.35)));
            // Words do not stand on each other.
            if is_last && a - labelled > LABEL * (to - from) {
                labelled = a;
                // Inside of what the traces fill: on the edge it would push the range on, picture by picture.
                let [low, high] = [bounds.min()[1], bounds.max()[1]];
                let at = PlotPoint::new(a, low + 0.85 * (high - low));
                let text = RichText::new(format!("{} ticks lost", lost.count)).color(BAD);
                plot.text(Text::new("lost ticks", at, text).anchor(egui::Align2::LEFT_TOP));
            }
        }
        for &(channel, shade) in row.channels {
            for axis in (0..AXES).filter(|&axis| visible.axes[axis]) {
                let name = format!("{} {}", channel.name(), axis + 1);
                let color = shade.of(axis);
                for points in envelope(history, channel, axis, ticks, columns, row.factor) {
                    plot.line(Line::new(name.clone(), points).color(color).width(1.2));
                }
            }
        }
        for (cursor, label) in view.cursors.iter().zip(["A", "B"]) {
            if let Some(at) = cursor {
                plot.vline(VLine::new(label, *at).color(Color32::LIGHT_GRAY).width(1.0));
            }
        }
        if plot.response().hovered() && turned != 0.0 {
            plot.zoom_bounds_around_hovered(egui::vec2((turned * WHEEL).exp(), 1.0));
        }
        plot.pointer_coordinate()
    });
    let pointer = response.inner;
    let touched = response.response.dragged()
        || (response.response.hovered()
            && ui.input(|i| i.smooth_scroll_delta != egui::Vec2::ZERO || i.zoom_delta() != 1.0));
    if touched {
        view.is_paused = true;
    }
    if view.is_paused && view.jump_s.is_none() {
        // Whatever moved it: a drag, the wheel, a box drawn with the right button.
        let bounds = response.transform.bounds();
        view.range_s = (bounds.min()[0], bounds.max()[0]);
    }
    if visible.cursors
        && let Some(at) = pointer
    {
        if response.response.clicked() {
            view.cursors[0] = Some(at.x);
        }
        if response.response.secondary_clicked() {
            view.cursors[1] = Some(at.x);
        }
    }
}

/// Lines through the extremes of each pixel column, broken where ticks were lost.
fn envelope(
    history: &History,
    channel: Channel,
    axis: usize,
    (from, to): (u64, u64),
    columns: usize,
    factor: f64,
) -> Vec<Vec<[f64; 2]>> {
    let mut lines = vec![Vec::new()];
    for column in history.columns(channel, axis, from, to, columns) {
        if column.extent.is_empty() {
            if lines.last().is_some_and(|line| !line.is_empty()) {
                lines.push(Vec::new());
            }
            continue;
        }
        let t = history.time_s(column.start);
        let (min, max) = (f64::from(column.extent.min), f64::from(column.extent.max));
        let Some(line) = lines.last_mut() else { continue };
        line.push([t, min * factor]);
        if column.len > 1 && max > min {
            let half = column.len as f64 / 2.0 / history.sample_rate_hz();
            line.push([t + half, max * factor]);
        }
    }
    lines.retain(|line| !line.is_empty());
    lines
}

fn cursor_table(ui: &mut Ui, view: &TimeView, visible: &Visible, history: &History) {
    let (first, end) = history.ticks();
    let at = view.cursors.map(|cursor| cursor.map(|t| (t, history.tick_at(t))));
    // Left and right of what is in memory there are no values.
    let is_known = |t: f64| t >= history.time_s(first) && t < history.time_s(end);
    egui::ScrollArea::horizontal().show(ui, |ui| {
        egui::Grid::new("cursor table").striped(true).num_columns(2 + 5 * AXES).show(ui, |ui| {
            ui.label("cursor");
            ui.label("time (s)");
            let traces: Vec<(Channel, usize)> = Channel::ALL
                .into_iter()
                .flat_map(|c| (0..AXES).map(move |axis| (c, axis)))
                .filter(|(_, axis)| visible.axes[*axis])
                .collect();
            for (channel, axis) in &traces {
                let text = format!("{} {} ({})", channel.name(), axis + 1, unit(*channel));
                ui.label(RichText::new(text).color(axis_color(*axis, false)).small());
            }
            ui.end_row();
            let value = |cursor: usize, (channel, axis): (Channel, usize)| {
                at[cursor]
                    .filter(|(t, _)| is_known(*t))
                    .map(|(_, tick)| history.value(channel, axis, tick))
            };
            for (cursor, name) in ["A", "B"].into_iter().enumerate() {
                ui.label(name);
                ui.label(at[cursor].map_or("-".into(), |(t, _)| format!("{t:.4}")));
                for trace in &traces {
                    ui.label(value(cursor, *trace).map_or("-".into(), |v| format!("{v:.4}")));
                }
                ui.end_row();
            }
            if let [Some((a, _)), Some((b, _))] = at {
                ui.label("B - A");
                ui.label(format!("{:.4} ({})", b - a, hertz(1.0 / (b - a).abs().max(1e-9))));
                for trace in &traces {
                    let difference = value(1, *trace).zip(value(0, *trace)).map(|(b, a)| b - a);
                    ui.label(difference.map_or("-".into(), |d| format!("{d:.4}")));
                }
                ui.end_row();
            }
        });
    });
}

/// A frequency with three digits.
fn hertz(hz: f64) -> String {
    if hz < 0.1 { format!("{:.2} mHz", hz * 1e3) } else { format!("{hz:.2} Hz") }
}

/// Unit of a channel as this window writes it.
fn unit(channel: Channel) -> &'static str {
    if channel.unit() == "um" { "µm" } else { channel.unit() }
}
