//! Logarithmic axes for `egui_plot`, which has linear ones only: data are plotted as log10, grid and labels are those of the value.

use egui_plot::{GridInput, GridMark, Plot};

/// Grid lines at 1 to 9 times every power of ten in sight.
fn decades(input: GridInput) -> Vec<GridMark> {
    let (low, high) = input.bounds;
    if !(low.is_finite() && high.is_finite()) || high - low > 30.0 {
        return Vec::new();
    }
    let mut marks = Vec::new();
    for decade in low.floor() as i32..=high.ceil() as i32 {
        for step in 1..10 {
            let value = f64::from(decade) + f64::from(step).log10();
            if (low..=high).contains(&value) {
                // A full decade is the thickest line.
                let step_size = if step == 1 { 1.0 } else { 0.1 };
                marks.push(GridMark { value, step_size });
            }
        }
    }
    marks
}

/// The value at a mark as a person writes it; nothing between the decades when many are in sight.
fn label(mark: GridMark, range: &std::ops::RangeInclusive<f64>) -> String {
    let span = range.end() - range.start();
    let value = 10f64.powf(mark.value);
    let lead = value / 10f64.powf(mark.value.floor() + 1e-9).max(1e-300);
    let is_decade = mark.step_size >= 1.0;
    let is_wanted = is_decade
        || (span < 2.6 && ((lead - 2.0).abs() < 0.01 || (lead - 5.0).abs() < 0.01))
        || span < 0.8;
    if is_wanted { number(value) } else { String::new() }
}

/// Shortest usual writing of a value on an axis.
pub fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e5).contains(&value.abs()) {
        let digits = (3 - value.abs().max(1e-3).log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{value:.digits$}");
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text
        }
    } else {
        format!("{value:.0e}")
    }
}

/// Frequency axis: data as log10 of hertz.
pub fn frequency(plot: Plot<'_>) -> Plot<'_> {
    plot.x_grid_spacer(decades).x_axis_formatter(label).x_axis_label("frequency (Hz)")
}

/// Logarithmic value axis: data as log10.
pub fn log_y(plot: Plot<'_>) -> Plot<'_> {
    plot.y_grid_spacer(decades).y_axis_formatter(label)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_values() {
        let mark = |value: f64, step_size| GridMark { value, step_size };
        assert_eq!(label(mark(2.0, 1.0), &(0.0..=4.0)), "100");
        assert_eq!(label(mark(-2.0, 1.0), &(-3.0..=4.0)), "0.01");
        assert_eq!(label(mark(1.0 + 5f64.log10(), 0.1), &(1.0..=3.0)), "50");
        assert_eq!(label(mark(1.0 + 7f64.log10(), 0.1), &(1.0..=3.0)), "");
        assert_eq!(label(mark(1.0 + 5f64.log10(), 0.1), &(0.0..=4.0)), "");
        assert_eq!(number(0.25), "0.25");
        assert_eq!(number(1e-6), "1e-6");
    }
}
