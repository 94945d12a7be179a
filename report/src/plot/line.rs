//! Lines and points over linear or logarithmic axes.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::legend::corner;
use super::series::Series;
use super::series::{COLUMNS, Mark, thin};
use super::{FONT, Figure, GRID, TEXT, colour, draw, font, label, padded};

/// Dash and gap of a dashed line, in pixels of the drawing.
const DASH: (i32, i32) = (7, 5);
/// Length of the piece of line in a legend: two dashes and the gap between them.
const SAMPLE: i32 = 2 * DASH.0 + DASH.1;

/// Lines and points in one pair of axes.
#[derive(Clone)]
pub struct LinePlot {
    title: String,
    x: String,
    y: String,
    x_log: bool,
    y_log: bool,
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
    size: (u32, u32),
    series: Vec<Series>,
    bands: Vec<(f64, f64)>,
    x_marks: Vec<(f64, String)>,
    y_marks: Vec<(f64, String)>,
    legend: Legend,
}

/// Where the legend stands.
#[derive(Clone)]
enum Legend {
    /// Where it hides least.
    Free,
    /// There, if anywhere.
    Fixed(Option<SeriesLabelPosition>),
}

impl LinePlot {
    /// An empty plot.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            x: String::new(),
            y: String::new(),
            x_log: false,
            y_log: false,
            x_range: None,
            y_range: None,
            size: (720, 400),
            series: Vec::new(),
            bands: Vec::new(),
            x_marks: Vec::new(),
            y_marks: Vec::new(),
            legend: Legend::Free,
        }
    }

    /// Where the legend stands, if anywhere; where it hides least if nothing is said.
    #[must_use]
    pub(super) fn legend(mut self, position: Option<SeriesLabelPosition>) -> Self {
        self.legend = Legend::Fixed(position);
        self
    }

    /// Title of the horizontal axis, with its unit.
    #[must_use]
    pub fn x(mut self, title: impl Into<String>) -> Self {
        self.x = title.into();
        self
    }

    /// Title of the vertical axis, with its unit.
    #[must_use]
    pub fn y(mut self, title: impl Into<String>) -> Self {
        self.y = title.into();
        self
    }

    /// Logarithmic horizontal axis; points at or below zero are left out.
    #[must_use]
    pub fn log_x(mut self) -> Self {
        self.x_log = true;
        self
    }

    /// Logarithmic vertical axis; points at or below zero are left out.
    #[must_use]
    pub fn log_y(mut self) -> Self {
        self.y_log = true;
        self
    }

    /// Fixed horizontal range instead of that of the points.
    #[must_use]
    pub fn x_range(mut self, low: f64, high: f64) -> Self {
        self.x_range = Some((low, high));
        self
    }

    /// Fixed vertical range instead of that of the points.
    #[must_use]
    pub fn y_range(mut self, low: f64, high: f64) -> Self {
        self.y_range = Some((low, high));
        self
    }

    /// Size of the drawing in its own pixels; the page scales it. Default 720 x 400.
    #[must_use]
    pub fn aspect(mut self, width: u32, height: u32) -> Self {
        self.size = (width, height);
        self
    }

    /// Add a series; each takes the next colour of the palette unless it names one.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Shade the rows between two values, e.g. the noise floor.
    #[must_use]
    pub fn band(mut self, low: f64, high: f64) -> Self {
        self.bands.push((low, high));
        self
    }

    /// A thin vertical line with a label.
    #[must_use]
    pub fn vline(mut self, x: f64, label: impl Into<String>) -> Self {
        self.x_marks.push((x, label.into()));
        self
    }

    /// A thin horizontal line with a label.
    #[must_use]
    pub fn hline(mut self, y: f64, label: impl Into<String>) -> Self {
        self.y_marks.push((y, label.into()));
        self
    }

    /// Whether an axis can show the point.
    fn shows(&self, &(x, y): &(f64, f64)) -> bool {
        x.is_finite() && y.is_finite() && (!self.x_log || x > 0.0) && (!self.y_log || y > 0.0)
    }

    fn ranges(&self) -> ((f64, f64), (f64, f64)) {
        let seen = || self.series.iter().flat_map(|s| &s.points).filter(|p| self.shows(p));
        let axis = |values: Vec<f64>, log: bool, fixed: Option<(f64, f64)>, pad: f64| {
            let fixed = fixed.filter(|(a, b)| a < b && (!log || *a > 0.0));
            fixed.unwrap_or_else(|| {
                if log {
                    let (a, b) = padded(values.iter().map(|v| v.log10()), pad);
                    (10f64.powf(a), 10f64.powf(b))
                } else {
                    padded(values.into_iter(), pad)
                }
            })
        };
        let x = axis(seen().map(|p| p.0).collect(), self.x_log, self.x_range, 0.0);
        let mut ys: Vec<f64> = seen().filter(|p| p.0 >= x.0 && p.0 <= x.1).map(|p| p.1).collect();
        ys.extend(self.y_marks.iter().map(|m| m.0).filter(|y| !self.y_log || *y > 0.0));
        let stems = self.series.iter().any(|s| s.mark == Mark::Stems);
        if stems && !self.y_log {
            ys.push(0.0);
        }
        (x, axis(ys, self.y_log, self.y_range, 0.05))
    }

    pub(super) fn paint(&self, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<(), String> {
        let ((x0, x1), (y0, y1)) = self.ranges();
        match (self.x_log, self.y_log) {
            (false, false) => self.chart(area, x0..x1, y0..y1, (x0, x1, y0, y1)),
            (true, false) => self.chart(area, (x0..x1).log_scale(), y0..y1, (x0, x1, y0, y1)),
            (false, true) => self.chart(area, x0..x1, (y0..y1).log_scale(), (x0, x1, y0, y1)),
            (true, true) => {
                self.chart(area, (x0..x1).log_scale(), (y0..y1).log_scale(), (x0, x1, y0, y1))
            }
        }
    }

    fn chart<X, Y>(
        &self,
        area: &DrawingArea<SVGBackend<'_>, Shift>,
        x: X,
        y: Y,
        (x0, x1, y0, y1): (f64, f64, f64, f64),
    ) -> Result<(), String>
    where
        X: AsRangedCoord<Value = f64>,
        Y: AsRangedCoord<Value = f64>,
        X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let text = |error: DrawingAreaErrorKind<_>| -> String {
            let error: DrawingAreaErrorKind<std::io::Error> = error;
            error.to_string()
        };
        let mut builder = ChartBuilder::on(area);
        builder.margin(8).margin_right(18).x_label_area_size(44).y_label_area_size(64);
        if !self.title.is_empty() {
            builder.caption(&self.title, font(17));
        }
        let mut chart = builder.build_cartesian_2d(x, y).map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(TEXT)
            .label_style(font(13))
            .axis_desc_style(font(14))
            .x_desc(&self.x)
            .y_desc(&self.y)
            .x_labels(8)
            .y_labels(7)
            .x_label_formatter(&|v| label(*v))
            .y_label_formatter(&|v| label(*v))
            .draw()
            .map_err(text)?;
        let inside_y = |v: f64| v.clamp(y0, y1);
        for &(low, high) in &self.bands {
            let corners = [(x0, inside_y(low)), (x1, inside_y(high))];
            chart.draw_series([Rectangle::new(corners, GRID.mix(0.5).filled())]).map_err(text)?;
        }
        for (at, name) in &self.x_marks {
            if (x0..=x1).contains(at) {
                chart
                    .draw_series([PathElement::new(vec![(*at, y0), (*at, y1)], TEXT.mix(0.5))])
                    .map_err(text)?;
                chart.draw_series([Text::new(name.clone(), (*at, y1), font(12))]).map_err(text)?;
            }
        }
        for (at, name) in &self.y_marks {
            if (y0..=y1).contains(at) {
                chart
                    .draw_series([PathElement::new(vec![(x0, *at), (x1, *at)], TEXT.mix(0.5))])
                    .map_err(text)?;
                chart
                    .draw_series([Text::new(format!(" {name}"), (x0, *at), font(12))])
                    .map_err(text)?;
            }
        }
        for (index, series) in self.series.iter().enumerate() {
            let ink = colour(series.colour.unwrap_or(index));
            let style = ink.stroke_width(2);
            // A cloud of points is a pale band, on which a line of another series is still seen.
            let cloud = series.points.len() > COLUMNS / 4;
            let (radius, fill) = if cloud { (2, ink.mix(0.35)) } else { (3, ink.mix(1.0)) };
            let inside = |p: &(f64, f64)| self.shows(p) && p.0 >= x0 && p.0 <= x1;
            let drawn = match series.mark {
                Mark::Line | Mark::Dashed => {
                    let mut first = None;
                    for run in series.points.split(|p| !inside(p)).filter(|run| !run.is_empty()) {
                        let run: Vec<_> =
                            thin(run).into_iter().map(|(x, y)| (x, inside_y(y))).collect();
                        let drawn = if series.mark == Mark::Line {
                            chart.draw_series(LineSeries::new(run, style)).map_err(text)?
                        } else {
                            let (dash, gap) = DASH;
                            chart
                                .draw_series(DashedLineSeries::new(run, dash, gap, style))
                                .map_err(text)?
                        };
                        // Only one legend entry, whatever the number of runs.
                        if first.is_none() {
                            first = Some(());
                            let drawn = drawn.label(series.name.clone());
                            if series.mark == Mark::Line {
                                drawn.legend(move |(x, y)| {
                                    PathElement::new([(x, y), (x + SAMPLE, y)], style)
                                });
                            } else {
                                drawn.legend(move |(x, y)| {
                                    let (dash, gap) = DASH;
                                    DashedPathElement::new(
                                        [(x, y), (x + SAMPLE, y)],
                                        dash,
                                        gap,
                                        style,
                                    )
                                });
                            }
                        }
                    }
                    continue;
                }
                Mark::Points => {
                    let dots = series
                        .points
                        .iter()
                        .filter(|p| inside(p))
                        .map(|&(x, y)| Circle::new((x, inside_y(y)), radius, fill.filled()));
                    chart.draw_series(dots).map_err(text)?
                }
                Mark::Stems => {
                    let foot = if self.y_log { y0 } else { inside_y(0.0) };
                    let stems =
                        series.points.iter().filter(|p| inside(p)).map(|&(x, y)| {
                            PathElement::new(vec![(x, foot), (x, inside_y(y))], style)
                        });
                    chart.draw_series(stems).map_err(text)?
                }
            };
            drawn
                .label(series.name.clone())
                .legend(move |(x, y)| Circle::new((x + 9, y), 4, fill.filled()));
        }
        let position = match &self.legend {
            Legend::Fixed(position) => position.clone(),
            Legend::Free => {
                Some(self.free_corner(chart.plotting_area().dim_in_pixel(), (x0, x1, y0, y1)))
            }
        };
        if let Some(position) = position
            && self.series.len() > 1
        {
            chart
                .configure_series_labels()
                .position(position)
                .background_style(WHITE.mix(0.8))
                .border_style(GRID)
                .label_font((FONT, 13).into_font())
                .draw()
                .map_err(text)?;
        }
        Ok(())
    }
}

impl LinePlot {
    fn free_corner(
        &self,
        (width, height): (u32, u32),
        (x0, x1, y0, y1): (f64, f64, f64, f64),
    ) -> SeriesLabelPosition {
        let share = |v: f64, (low, high): (f64, f64), log: bool| match log {
            true => (v / low).ln() / (high / low).ln(),
            false => (v - low) / (high - low),
        };
        let place = |&(x, y): &(f64, f64)| {
            (share(x, (x0, x1), self.x_log), share(y.clamp(y0, y1), (y0, y1), self.y_log))
        };
        let mut lines: Vec<Vec<_>> = Vec::new();
        for series in &self.series {
            let inside = |p: &(f64, f64)| self.shows(p) && p.0 >= x0 && p.0 <= x1;
            let runs = series.points.split(|p| !inside(p)).filter(|run| !run.is_empty());
            lines.extend(runs.map(|run| thin(run).iter().map(place).collect()));
        }
        let names: Vec<&str> = self.series.iter().map(|series| series.name.as_str()).collect();
        corner(&names, f64::from(SAMPLE), (f64::from(width), f64::from(height)), &lines)
    }
}

impl Figure for LinePlot {
    fn svg(&self) -> String {
        draw(self.size, |area| self.paint(area))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_every_kind_of_axis_and_mark() {
        let points: Vec<(f64, f64)> =
            (0..50).map(|i| (f64::from(i), f64::from(i * i) - 5.0)).collect();
        for (x_log, y_log) in [(false, false), (true, false), (false, true), (true, true)] {
            let mut plot = LinePlot::new("t")
                .x("a (s)")
                .y("b (um)")
                .vline(3.0, "v")
                .hline(9.0, "h")
                .band(1.0, 2.0);
            plot.x_log = x_log;
            plot.y_log = y_log;
            let plot = plot
                .series(Series::line("one", points.clone()))
                .series(Series::dashed("two", points.clone()))
                .series(Series::points("three", points.clone()))
                .series(Series::stems("four", points.clone()));
            let svg = plot.svg();
            assert!(
                svg.contains("<svg") && svg.contains("four") && !svg.contains("not drawn"),
                "{svg}"
            );
        }
    }

    /// A solid and a dashed line of one colour must be told apart in the legend too.
    #[test]
    fn the_legend_shows_dashes() {
        let points = vec![(0.0, 0.0), (1.0, 1.0)];
        let legend = |series: Series| {
            // A name of its own colour, so that what is counted is the legend's and not a line's of the other series.
            let plot = LinePlot::new("t")
                .series(Series::points("dots", points.clone()))
                .series(series.color(3));
            let svg = plot.svg();
            let ink = colour(3);
            let ink = format!("#{:02X}{:02X}{:02X}", ink.0, ink.1, ink.2);
            // Lines as long as the dashes of a legend or shorter, level.
            svg.lines()
                .filter(|line| line.starts_with("<polyline") && line.contains(&ink))
                .filter_map(|line| {
                    let points = line.split("points=\"").nth(1)?.split('"').next()?;
                    let at: Vec<(f64, f64)> = points
                        .split_whitespace()
                        .filter_map(|p| p.split_once(','))
                        .map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap()))
                        .collect();
                    let (first, last) = (at.first()?, at.last()?);
                    (first.1 == last.1).then_some(last.0 - first.0)
                })
                .collect::<Vec<f64>>()
        };
        assert_eq!(legend(Series::line("one", points.clone())), [f64::from(SAMPLE)]);
        assert_eq!(legend(Series::dashed("two", points.clone())), [7.0, 7.0]);
    }

    #[test]
    fn nothing_to_draw_is_still_a_figure() {
        assert!(!LinePlot::new("empty").log_x().log_y().svg().contains("not drawn"));
        let nan = Series::line("nan", vec![(f64::NAN, 1.0), (0.0, f64::NAN)]);
        assert!(!LinePlot::new("nan").series(nan).svg().contains("not drawn"));
    }
}
