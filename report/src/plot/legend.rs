//! Where a legend stands: in the corner, or between two, where it hides least of what is drawn.

use plotters::prelude::SeriesLabelPosition;

/// Points of a straight line between two neighbours that count as well: few points far apart are drawn as long lines.
const BETWEEN: usize = 8;
/// Size of a letter and of a line of text, and what a legend has around them, in pixels.
const LETTER: f64 = 7.0;
const LINE: f64 = 18.0;
const AROUND: f64 = 18.0;

/// Corner of a plot of `size` pixels for a legend with these names; `lines` are in shares of the plot's width and height, from the lower
/// left. Of equal corners the upper right one.
pub(super) fn corner(
    names: &[&str],
    sample: f64,
    size: (f64, f64),
    lines: &[Vec<(f64, f64)>],
) -> SeriesLabelPosition {
    let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(0) as f64;
    let width = (longest * LETTER + sample + 2.0 * AROUND) / size.0;
    let height = (names.len() as f64 * LINE + AROUND) / size.1;
    // Left edge of the legend, and whether it stands at the top.
    let hidden = |left: f64, upper: bool| {
        let hides = |&(x, y): &(f64, f64)| {
            (left..=left + width).contains(&x)
                && (if upper { y > 1.0 - height } else { y < height })
        };
        lines.iter().flat_map(|line| dense(line)).filter(hides).count()
    };
    let (right, middle) = (1.0 - width, (1.0 - width) / 2.0);
    let corners = [
        (SeriesLabelPosition::UpperRight, hidden(right, true)),
        (SeriesLabelPosition::UpperLeft, hidden(0.0, true)),
        (SeriesLabelPosition::LowerRight, hidden(right, false)),
        (SeriesLabelPosition::LowerLeft, hidden(0.0, false)),
        (SeriesLabelPosition::UpperMiddle, hidden(middle, true)),
        (SeriesLabelPosition::LowerMiddle, hidden(middle, false)),
    ];
    let best = corners.into_iter().min_by_key(|(_, hidden)| *hidden);
    best.map_or(SeriesLabelPosition::UpperRight, |(corner, _)| corner)
}

/// The points and some between each two.
fn dense(line: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> {
    let between = line.windows(2).flat_map(|pair| {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        (1..BETWEEN).map(move |k| {
            let share = k as f64 / BETWEEN as f64;
            (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
        })
    });
    line.iter().copied().chain(between)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_in_a_corner_is_not_hidden() {
        let place = |lines: &[Vec<(f64, f64)>]| {
            let corner = corner(&["axis 1", "axis 2"], 19.0, (600.0, 320.0), lines);
            format!("{corner:?}")
        };
        assert_eq!(place(&[]), "UpperRight");
        // Two points: what lies between them is drawn too.
        let rising = vec![(0.0, 0.0), (1.0, 1.0)];
        assert_eq!(place(std::slice::from_ref(&rising)), "UpperLeft");
        let flat = vec![(0.0, 0.95), (0.5, 0.95)];
        assert_eq!(place(&[rising, flat]), "LowerRight");
    }
}
