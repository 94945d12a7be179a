//! Figure 3 of the first paper: each axis driven alone to 90 V at 1 Hz, the others resting at 0 V and at 90 V.
//!
//! The paper saw 0.03 um, 0.27 % of the driven motion, and called the mechanism uncoupled. A rig of three independent
//! springs moves its neighbours by nothing at all; with the off-diagonal stiffness of a 3-RRR mechanism between stacks
//! of 48.6 N/um the simulated neighbours move by the paper's share.

use host_sim::{Axes, Input, Place, Rig, simulate};
use report::plot::{LinePlot, Series};

use super::book::{Book, Outcome};

/// Off-diagonal stiffness of a 3-RRR mechanism from hinge geometry, N/m (notes/physics.md, section 5, example A).
const OFF_DIAGONAL_N_PER_M: f64 = 0.1405e6;
const PERIODS: usize = 3;
const TICKS: usize = 10_000;

struct Motion {
    driven_um: f64,
    /// Largest motion of an undriven axis, um.
    neighbour_um: f64,
    traces_um: Vec<Vec<f64>>,
}

fn drive(rig: &Rig, driven: usize, others_v: f64) -> anyhow::Result<Motion> {
    let wave = |n: usize| {
        let phase = (n % TICKS) as f64 / TICKS as f64;
        90.0 * (1.0 - (2.0 * phase - 1.0).abs())
    };
    let volts: Vec<Vec<f64>> = (0..rig.axes.len())
        .map(|axis| {
            (0..TICKS * PERIODS).map(|n| if axis == driven { wave(n) } else { others_v }).collect()
        })
        .collect();
    let slices: Vec<&[f64]> = volts.iter().map(Vec::as_slice).collect();
    let input = Input {
        sample_rate_hz: rig.sample_rate_hz,
        start_s: 0.0,
        ticks: None,
        drive_v: &slices,
        monitor_v: None,
        initial: &[],
    };
    let output = simulate(rig, &input, Axes::All)?;
    // The last period: the first one rises from the depoled state.
    let last: Vec<Vec<f64>> = output
        .position_m
        .iter()
        .map(|axis| axis[TICKS * (PERIODS - 1)..].iter().map(|x| x * 1.0e6).collect())
        .collect();
    let span = |x: &Vec<f64>| {
        let (low, high) = x.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        high - low
    };
    let neighbour_um = last
        .iter()
        .enumerate()
        .filter(|(axis, _)| *axis != driven)
        .map(|(_, x)| span(x))
        .fold(0.0, f64::max);
    Ok(Motion { driven_um: span(&last[driven]), neighbour_um, traces_um: last })
}

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    let springs = Rig::named("handley").expect("an embedded rig");
    let mut mechanism = springs.clone();
    for (on, from) in [(0, 1), (0, 2), (1, 2)] {
        mechanism.set(
            "stiffness-coupling",
            Place::Pair { on, from },
            "stiffness_n_per_m",
            OFF_DIAGONAL_N_PER_M,
        )?;
    }
    book.section("Coupling between axes (first paper, figure 3)");
    book.paragraph(
        "One axis follows a 1 Hz triangle to 90 V, the others rest at 0 V or at 90 V. The paper measured at most 0.03 um \
         on a resting axis, 0.27 % of the driven one's motion. Last of three periods, without gauge noise.",
    );
    let mut rows = Vec::new();
    let mut worst: f64 = 0.0;
    for (name, rig) in [("three springs", &springs), ("3-RRR stiffness", &mechanism)] {
        for driven in 0..3 {
            for others_v in [0.0, 90.0] {
                let motion = drive(rig, driven, others_v)?;
                let percent = 100.0 * motion.neighbour_um / motion.driven_um;
                worst = worst.max(percent);
                rows.push(vec![
                    name.to_string(),
                    format!("{}", driven + 1),
                    format!("{others_v:.0}"),
                    format!("{:.2}", motion.driven_um),
                    format!("{:.4}", motion.neighbour_um),
                    format!("{percent:.3}"),
                ]);
                book.outcome(Outcome::new(
                    format!("coupling/{name}/others-{others_v:.0}v"),
                    driven,
                    motion.driven_um,
                    motion.neighbour_um * 1.0e3 / 12f64.sqrt(),
                    motion.neighbour_um * 1.0e3,
                ));
                if name == "3-RRR stiffness" && driven == 0 {
                    figure(book, &motion, others_v);
                }
            }
        }
    }
    book.table(
        &[
            "model",
            "driven axis",
            "others (V)",
            "driven (um)",
            "largest undriven (um)",
            "share (%)",
        ],
        &rows,
    );
    book.finding(&format!(
        "Largest motion of an undriven axis: {worst:.3} % of the driven one (paper: 0.27 %)."
    ));
    Ok(())
}

fn figure(book: &mut Book, motion: &Motion, others_v: f64) {
    let mut all = LinePlot::new(format!("Axis 1 driven, others at {others_v:.0} V"))
        .x("time (s)")
        .y("position (um)");
    let mut close =
        LinePlot::new("The undriven axes, enlarged").x("time (s)").y("change of position (nm)");
    for (axis, trace) in motion.traces_um.iter().enumerate() {
        let name = format!("axis {}", axis + 1);
        let time = |n: usize| n as f64 / TICKS as f64;
        let points = trace.iter().enumerate().map(|(n, x)| (time(n), *x)).collect();
        all = all.series(Series::line(name.clone(), points).color(axis));
        if axis > 0 {
            let start = trace[0];
            let points =
                trace.iter().enumerate().map(|(n, x)| (time(n), (x - start) * 1.0e3)).collect();
            let series =
                if axis == 1 { Series::line(name, points) } else { Series::dashed(name, points) };
            close = close.series(series.color(axis));
        }
    }
    book.figures(vec![
        (Box::new(all), "Positions over one period.".to_string()),
        (
            Box::new(close),
            "They move against the driven axis, by a few hundredths of a micrometre.".to_string(),
        ),
    ]);
}
