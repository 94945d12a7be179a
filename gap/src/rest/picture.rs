//! What is left, in the report.

use report::plot::{Bar, BarPlot, Figure, LinePlot, Series};
use report::{Report, Table};

use super::{BandLeft, LagAtLevel, Rest};

/// Add figures and words to the section about what was not explained.
pub(crate) fn draw(mut page: Report, rest: &Rest) -> Report {
    for words in &rest.words {
        page = page.paragraph(format!("Left: {words}."));
    }
    let mut figures: Vec<(Box<dyn Figure>, &str)> = Vec::new();
    if !rest.linear.is_empty() {
        figures.push((
            Box::new(shares(rest)),
            "Share of the measured motion, octave by octave, on held-out recordings. `own` and `all`: after a frequency response of every \
             axis to its own drive, and to all drives, was taken off what the causes leave.",
        ));
    }
    if !rest.lag.is_empty() {
        figures.push((
            Box::new(lags(rest)),
            "Axis and drive: lag towards zero frequency beyond the simulation's. Dead times and poles have none; a loop has one that grows with \
             the stroke. Bars span two standard deviations to each side.",
        ));
    }
    page = page.figures(figures);
    if !rest.disturbed.is_empty() {
        let mut table =
            Table::new(["disturbed", "does not repeat (nm)", "usual (nm)", "above (Hz)"]);
        for d in &rest.disturbed {
            table = table.row([
                d.file.clone(),
                format!("{:.1}", d.unrepeatable_nm),
                format!("{:.1}", d.usual_nm),
                format!("{:.0}", d.above_hz),
            ]);
        }
        page = page.table(table);
    }
    page
}

/// Relative error against frequency, all levels together.
fn shares(rest: &Rest) -> LinePlot {
    let mut edges: Vec<[f64; 2]> = rest.linear.iter().map(|b| b.band_hz).collect();
    edges.sort_by(|a, b| a[0].total_cmp(&b[0]));
    edges.dedup();
    let curve = |of: &dyn Fn(&BandLeft) -> f64| -> Vec<(f64, f64)> {
        edges
            .iter()
            .map(|edge| {
                let sum = |of: &dyn Fn(&BandLeft) -> f64| -> f64 {
                    rest.linear.iter().filter(|b| b.band_hz == *edge).map(|b| of(b).powi(2)).sum()
                };
                let share = (sum(of) / sum(&|b| b.measured_nm).max(f64::MIN_POSITIVE)).sqrt();
                ((edge[0] * edge[1]).sqrt(), 100.0 * share)
            })
            .filter(|(_, share)| *share > 0.0)
            .collect()
    };
    let given = curve(&|b| b.before_nm);
    let causes = curve(&|b| b.after_nm);
    let floor = curve(&|b| b.floor_nm);
    let shares = || [&given, &causes, &floor].into_iter().flatten().map(|p| p.1);
    let lowest = shares().fold(f64::INFINITY, f64::min);
    // Room for the names above the curves.
    let highest = 30.0 * shares().fold(0.0, f64::max);
    let mut plot = LinePlot::new("What a linear model would leave")
        .x("frequency (Hz)")
        .y("error / motion (%)")
        .log_x()
        .log_y();
    if lowest < highest {
        plot = plot.y_range(0.5 * lowest, highest);
    }
    if causes != given {
        plot = plot.series(Series::line("with the causes", causes).color(2));
    }
    plot.series(Series::line("rig as given", given).color(1))
        .series(Series::line("own", curve(&|b| b.responses_nm.own)).color(0))
        .series(Series::line("all", curve(&|b| b.responses_nm.all)).color(3))
        .series(Series::dashed("does not repeat", floor).color(4))
}

fn lags(rest: &Rest) -> BarPlot {
    let mut bars: Vec<&LagAtLevel> = rest.lag.iter().collect();
    bars.sort_by_key(|l| l.axis);
    bars.into_iter().fold(BarPlot::new("Lag of slow motion").y("lag (degrees)"), |plot, l| {
        let name = format!("{}: {:.2} V", l.axis, l.level_v);
        let bar = Bar::new(name, l.lag_deg).color(l.axis - 1);
        plot.bar(bar.error(l.lag_deg - 2.0 * l.sd_deg, l.lag_deg + 2.0 * l.sd_deg))
    })
}
