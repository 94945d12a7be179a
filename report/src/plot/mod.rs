//! Figures as inline SVG.
//!
//! All figures share one look: the colour-blind safe palette of Okabe and Ito (2008), light grid, SI units in the axis
//! titles, a legend only where there is more than one series.

use plotters::prelude::*;

mod bars;
mod bode;
mod heat_map;
mod legend;
mod line;
mod series;

pub use bars::{Bar, BarPlot, Waterfall};
pub use bode::Bode;
pub use heat_map::HeatMap;
pub use line::LinePlot;
pub use series::Series;

/// Anything that draws itself as an SVG element.
pub trait Figure {
    /// One `<svg>` element with a fixed view box and no outside references.
    fn svg(&self) -> String;
}

/// Okabe-Ito palette, ordered so that the first two stay apart in print.
const PALETTE: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(60, 60, 60),
];

const TEXT: RGBColor = RGBColor(27, 31, 36);
const GRID: RGBColor = RGBColor(216, 222, 228);
const FONT: &str = "sans-serif";

fn colour(index: usize) -> RGBColor {
    PALETTE[index % PALETTE.len()]
}

fn font(size: u32) -> TextStyle<'static> {
    TextStyle::from((FONT, size).into_font()).color(&TEXT)
}

/// Draw into a string of `size` pixels. Drawing into memory cannot fail for want of a device; an error of the plotting
/// library becomes a figure that says so rather than a lost report.
fn draw<F>(size: (u32, u32), paint: F) -> String
where
    F: FnOnce(&DrawingArea<SVGBackend<'_>, plotters::coord::Shift>) -> Result<(), String>,
{
    let mut text = String::new();
    let result = {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        paint(&area).and_then(|()| area.present().map_err(|error| error.to_string()))
    };
    match result {
        // The backend states a size in pixels; the page decides the size, so only the view box stays.
        Ok(()) => {
            let sized = format!("width=\"{}\" height=\"{}\" ", size.0, size.1);
            text.replacen(&sized, "", 1)
        }
        Err(error) => format!(
            "<svg viewBox=\"0 0 {} 40\" xmlns=\"http://www.w3.org/2000/svg\"><text x=\"8\" y=\"24\">figure not drawn: {}</text></svg>",
            size.0,
            error.replace(['<', '>', '&'], " ")
        ),
    }
}

/// Range of the finite values, padded by `pad` of its width; a single value gets room on both sides.
fn padded(values: impl Iterator<Item = f64>, pad: f64) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let width = high - low;
    let room = if width > 0.0 { width * pad } else { low.abs().max(1.0) * 0.1 };
    (low - room, high + room)
}

/// A tick label with as many digits as it needs and no more.
fn label(value: f64) -> String {
    let size = value.abs();
    // What sums of steps leave of a zero between -0.1 and 0.1.
    if size < 1e-15 {
        "0".into()
    } else if (1e-3..1e5).contains(&size) {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        format!("{value:.0e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short() {
        assert_eq!(label(0.25), "0.25");
        assert_eq!(label(100.0), "100");
        assert_eq!(label(1e-6), "1e-6");
        assert_eq!(label(-0.1 + 2.0 * 0.05 - 1e-17), "0");
    }

    #[test]
    fn an_empty_or_constant_range_has_width() {
        assert_eq!(padded([].into_iter(), 0.1), (0.0, 1.0));
        let (low, high) = padded([f64::NAN, 3.0].into_iter(), 0.1);
        assert!(low < 3.0 && high > 3.0);
    }
}
