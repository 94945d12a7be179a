//! Bars with error bars, and the waterfall from a nominal gap to the noise floor.

use plotters::prelude::*;

use super::{Figure, GRID, TEXT, colour, draw, font, label, padded};

/// One bar.
#[derive(Clone)]
pub struct Bar {
    name: String,
    from: f64,
    to: f64,
    error: Option<(f64, f64)>,
    colour: usize,
    /// Text over the bar; the value when none is given.
    note: Option<String>,
}

impl Bar {
    /// A bar from zero to `value`.
    pub fn new(name: impl Into<String>, value: f64) -> Self {
        Self { name: name.into(), from: 0.0, to: value, error: None, colour: 0, note: None }
    }

    /// Whisker between two values, e.g. a 95 % confidence interval.
    #[must_use]
    pub fn error(mut self, low: f64, high: f64) -> Self {
        self.error = Some((low, high));
        self
    }

    /// Palette entry.
    #[must_use]
    pub fn color(mut self, index: usize) -> Self {
        self.colour = index;
        self
    }
}

/// Bars side by side.
#[derive(Clone)]
pub struct BarPlot {
    title: String,
    y: String,
    bars: Vec<Bar>,
    size: (u32, u32),
}

impl BarPlot {
    /// An empty plot.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), y: String::new(), bars: Vec::new(), size: (720, 360) }
    }

    /// Title of the vertical axis, with its unit.
    #[must_use]
    pub fn y(mut self, title: impl Into<String>) -> Self {
        self.y = title.into();
        self
    }

    /// Add a bar.
    #[must_use]
    pub fn bar(mut self, bar: Bar) -> Self {
        self.bars.push(bar);
        self
    }

    fn paint(
        &self,
        area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    ) -> Result<(), String> {
        let text = |error: DrawingAreaErrorKind<std::io::Error>| error.to_string();
        let ends = self.bars.iter().flat_map(|b| {
            let (low, high) = b.error.unwrap_or((b.to, b.to));
            [b.from, b.to, low, high, 0.0]
        });
        let (mut low, high) = padded(ends, 0.1);
        if self.bars.iter().all(|b| b.from >= 0.0 && b.to >= 0.0) {
            low = 0.0;
        }
        let count = self.bars.len().max(1) as f64;
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .caption(&self.title, font(17))
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..count, low..high)
            .map_err(text)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(0)
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(TEXT)
            .label_style(font(13))
            .axis_desc_style(font(14))
            .y_desc(&self.y)
            .y_label_formatter(&|v| label(*v))
            .draw()
            .map_err(text)?;
        for (index, bar) in self.bars.iter().enumerate() {
            let left = index as f64;
            let corners = [(left + 0.18, bar.from), (left + 0.82, bar.to)];
            chart
                .draw_series([Rectangle::new(corners, colour(bar.colour).filled())])
                .map_err(text)?;
            if let Some((a, b)) = bar.error {
                let middle = left + 0.5;
                let whisker =
                    |y| PathElement::new(vec![(middle - 0.06, y), (middle + 0.06, y)], TEXT);
                chart
                    .draw_series([
                        PathElement::new(vec![(middle, a), (middle, b)], TEXT),
                        whisker(a),
                        whisker(b),
                    ])
                    .map_err(text)?;
            }
            let top = bar.from.max(bar.to).max(bar.error.map_or(f64::NEG_INFINITY, |e| e.1));
            let note = bar.note.clone().unwrap_or_else(|| short(bar.to));
            let style = font(13).pos(text_anchor(true));
            chart
                .draw_series([Text::new(note, (left + 0.5, top + 0.015 * (high - low)), style)])
                .map_err(text)?;
            // Names below the axis, drawn on the sheet because the axis has no categories.
            let foot = chart.backend_coord(&(left + 0.5, low));
            for (line, words) in bar.name.lines().enumerate() {
                let below = foot.1 + 8 + 16 * line as i32;
                let style = font(13).pos(text_anchor(false));
                area.draw(&Text::new(words.to_owned(), (foot.0, below), style)).map_err(text)?;
            }
        }
        Ok(())
    }
}

/// Text centred on its point, above or below it.
fn text_anchor(above: bool) -> plotters::style::text_anchor::Pos {
    use plotters::style::text_anchor::{HPos, Pos, VPos};
    Pos::new(HPos::Center, if above { VPos::Bottom } else { VPos::Top })
}

/// Three significant digits.
fn short(value: f64) -> String {
    let size = value.abs();
    let digits = if size >= 100.0 || size == 0.0 {
        0
    } else if size >= 10.0 {
        1
    } else {
        2
    };
    format!("{value:.digits$}")
}

impl Figure for BarPlot {
    fn svg(&self) -> String {
        draw(self.size, |area| self.paint(area))
    }
}

/// From a first value down (or up) to a last one, step by step.
#[derive(Clone)]
pub struct Waterfall {
    plot: BarPlot,
    level: f64,
}

impl Waterfall {
    /// An empty waterfall; `unit` becomes the title of the vertical axis.
    pub fn new(title: impl Into<String>, unit: impl Into<String>) -> Self {
        Self { plot: BarPlot::new(title).y(unit), level: 0.0 }
    }

    /// The bar that all begins with.
    #[must_use]
    pub fn start(mut self, name: impl Into<String>, value: f64) -> Self {
        self.level = value;
        self.plot.bars.push(Bar::new(name, value).color(6));
        self
    }

    /// One step: the level after it.
    #[must_use]
    pub fn step(mut self, name: impl Into<String>, after: f64) -> Self {
        let change = after - self.level;
        let sign = if change > 0.0 { "+" } else { "−" };
        let bar = Bar {
            name: name.into(),
            from: self.level,
            to: after,
            error: None,
            colour: if change > 0.0 { 1 } else { 2 },
            note: Some(format!("{sign}{}", short(change.abs()))),
        };
        self.plot.bars.push(bar);
        self.level = after;
        self
    }

    /// A bar from zero to close with: what is left, or the noise floor.
    #[must_use]
    pub fn end(mut self, name: impl Into<String>, value: f64) -> Self {
        self.plot.bars.push(Bar::new(name, value));
        self
    }
}

impl Figure for Waterfall {
    fn svg(&self) -> String {
        self.plot.svg()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_waterfall_names_its_steps() {
        let svg = Waterfall::new("gap", "nm")
            .start("nominal", 80.0)
            .step("creep", 20.0)
            .end("floor", 4.0)
            .svg();
        for word in ["nominal", "creep", "floor", "−60.0", "80.0"] {
            assert!(svg.contains(word), "{word}");
        }
    }

    #[test]
    fn bars_with_errors_and_none_at_all() {
        assert!(
            BarPlot::new("a").bar(Bar::new("x", -2.0).error(-3.0, -1.0)).svg().contains("-2.00")
        );
        assert!(BarPlot::new("none").svg().contains("<svg"));
    }
}
