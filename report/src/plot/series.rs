//! What a plot of lines shows: named sets of points, and how they are drawn.

/// Points that a line keeps at most: two (minimum and maximum) for each of this many columns.
pub(super) const COLUMNS: usize = 900;

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Mark {
    Line,
    Dashed,
    Points,
    Stems,
}

/// One named set of points.
#[derive(Clone)]
pub struct Series {
    pub(super) name: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) mark: Mark,
    pub(super) colour: Option<usize>,
}

impl Series {
    fn with(name: impl Into<String>, points: Vec<(f64, f64)>, mark: Mark) -> Self {
        Self { name: name.into(), points, mark, colour: None }
    }

    /// A solid line; long records are thinned to their minimum and maximum per column, so peaks stay.
    pub fn line(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self::with(name, points, Mark::Line)
    }

    /// A dashed line.
    pub fn dashed(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self::with(name, points, Mark::Dashed)
    }

    /// Points without a line.
    pub fn points(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self::with(name, points, Mark::Points)
    }

    /// Vertical stems from zero: spectra of a few lines.
    pub fn stems(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self::with(name, points, Mark::Stems)
    }

    /// Take palette entry `index` instead of the next free one.
    #[must_use]
    pub fn color(mut self, index: usize) -> Self {
        self.colour = Some(index);
        self
    }
}

/// Keep the minimum and the maximum of each of [`COLUMNS`] stretches, in their order.
pub(super) fn thin(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= 2 * COLUMNS {
        return points.to_vec();
    }
    let width = points.len().div_ceil(COLUMNS);
    let mut kept = Vec::with_capacity(2 * COLUMNS + 2);
    for stretch in points.chunks(width) {
        let by_y = |a: &usize, b: &usize| stretch[*a].1.total_cmp(&stretch[*b].1);
        let low = (0..stretch.len()).min_by(by_y).unwrap_or(0);
        let high = (0..stretch.len()).max_by(by_y).unwrap_or(0);
        kept.push(stretch[low.min(high)]);
        if low != high {
            kept.push(stretch[low.max(high)]);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_peaks() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        points[54_321].1 = 7.0;
        points[77_777].1 = -3.0;
        let kept = thin(&points);
        assert!(kept.len() <= 2 * COLUMNS + 2);
        assert!(kept.contains(&(54_321.0, 7.0)) && kept.contains(&(77_777.0, -3.0)));
    }
}
