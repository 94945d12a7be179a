//! Figure 4 of the first paper: 1 Hz triangles to 30, 60 and 90 V, with the stack alone and in the mechanism.

use host_sim::{Axes, Input, Rig, simulate};
use report::plot::{LinePlot, Series};

use super::book::Book;

const TICKS: usize = 10_000;
const PERIODS: usize = 3;

/// Displacement under a 1 Hz triangle from 0 V to `peak_v`, from the depoled state: um against V, all periods.
pub(super) fn triangle(rig: &Rig, peak_v: f64) -> anyhow::Result<(Vec<f64>, Vec<f64>)> {
    let volts: Vec<f64> = (0..TICKS * PERIODS)
        .map(|n| peak_v * (1.0 - (2.0 * (n % TICKS) as f64 / TICKS as f64 - 1.0).abs()))
        .collect();
    let rest = vec![0.0; volts.len()];
    let drives: Vec<&[f64]> =
        (0..rig.axes.len()).map(|axis| if axis == 0 { &volts[..] } else { &rest[..] }).collect();
    let input = Input {
        sample_rate_hz: rig.sample_rate_hz,
        start_s: 0.0,
        ticks: None,
        drive_v: &drives,
        monitor_v: None,
        initial: &[],
    };
    let output = simulate(rig, &input, Axes::Only(1))?;
    Ok((volts, output.position_m[0].iter().map(|x| x * 1.0e6).collect()))
}

struct Loop {
    first_rise_um: f64,
    stroke_um: f64,
    width_um: f64,
    curve: Vec<(f64, f64)>,
}

fn measure(rig: &Rig, peak_v: f64) -> anyhow::Result<Loop> {
    let (volts, um) = triangle(rig, peak_v)?;
    let first = &um[..TICKS];
    let last = &um[TICKS * (PERIODS - 1)..];
    let max = |x: &[f64]| x.iter().copied().fold(f64::MIN, f64::max);
    let min = |x: &[f64]| x.iter().copied().fold(f64::MAX, f64::min);
    // At equal voltage, way up against way down.
    let width_um = (1..TICKS / 2).map(|n| last[TICKS - n] - last[n]).fold(0.0, f64::max);
    Ok(Loop {
        first_rise_um: max(first) - first[0],
        stroke_um: max(last) - min(last),
        width_um,
        curve: volts.iter().copied().zip(um.iter().copied()).step_by(20).collect(),
    })
}

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    let assembled = Rig::named("handley").expect("an embedded rig");
    let mut alone = assembled.clone();
    for axis in &mut alone.axes {
        axis.mechanism.stiffness_n_per_m = 0.0;
    }
    book.section("Hysteresis (first paper, figure 4)");
    book.paragraph(
        "Axis 1 follows 1 Hz triangles from 0 V to 30, 60 and 90 V, three periods from the depoled state. The first rise \
         is larger than the settled stroke: part of the charge stays in the stack.",
    );
    loops(book, &[("stack alone", &alone), ("in the mechanism", &assembled)], 90.0)
}

/// The same of a rig of somebody's own, up to `peak_v`.
pub fn of_rig(book: &mut Book, rigs: &[(&str, &Rig)], peak_v: f64) -> anyhow::Result<()> {
    book.section("Hysteresis");
    book.paragraph(&format!(
        "Axis 1 follows 1 Hz triangles from 0 V to a third, two thirds and all of {peak_v:.0} V, three periods from the depoled state."
    ));
    loops(book, rigs, peak_v)
}

/// Loops of axis 1 of each rig: a table and a figure each.
fn loops(book: &mut Book, rigs: &[(&str, &Rig)], peak_v: f64) -> anyhow::Result<()> {
    let mut rows = Vec::new();
    let mut figures: Vec<(Box<dyn report::plot::Figure>, String)> = Vec::new();
    for &(name, rig) in rigs {
        let mut plot =
            LinePlot::new(format!("Axis 1, {name}")).x("drive (V)").y("displacement (um)");
        for (i, share) in [1.0, 2.0, 3.0].into_iter().enumerate() {
            let peak_v = peak_v * share / 3.0;
            let l = measure(rig, peak_v)?;
            rows.push(vec![
                name.to_string(),
                format!("{peak_v:.0}"),
                format!("{:.2}", l.first_rise_um),
                format!("{:.2}", l.stroke_um),
                format!("{:.3}", l.width_um),
                format!("{:.1}", 100.0 * l.width_um / l.stroke_um),
            ]);
            plot = plot.series(Series::line(format!("{peak_v:.0} V"), l.curve).color(i));
        }
        figures.push((Box::new(plot), format!("Displacement against voltage, {name}.")));
    }
    book.table(
        &[
            "axis 1",
            "peak (V)",
            "first rise (um)",
            "settled stroke (um)",
            "loop width (um)",
            "width (% of stroke)",
        ],
        &rows,
    );
    book.figures(figures);
    Ok(())
}
