//! The paper's k_1: the stiffness of the mechanism at axis 1, found by varying the simulation until it matches a recording.
//!
//! The recording is made here, with gauge noise. As in the paper, the stack's own model is known from the stand-alone
//! experiment, and the spring is the only unknown.

use host_sim::{Options, Plant, Rig};
use report::plot::{LinePlot, Series};

use super::book::Book;
use super::hysteresis;

const TRUE_N_PER_M: f64 = 4.8e6;

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    let rig = Rig::named("handley").expect("an embedded rig");
    book.section("Stiffness k_1 by matching (first paper, section 3.4)");
    // What the gauge of axis 1 reads under the figure's 90 V triangle.
    let mut plant = Plant::new(&rig, Options { seed: 11, ..Options::default() })?;
    let (volts, _) = hysteresis::triangle(&rig, 90.0)?;
    let measured: Vec<f64> =
        volts.iter().map(|v| plant.step(&[*v, 0.0, 0.0])[0].sensed_m * 1.0e6).collect();
    // `step` reads before the drive acts, as `simulate` does: the same tick, the same index.
    let misfit = |n_per_m: f64| -> anyhow::Result<f64> {
        let mut trial = rig.clone();
        trial.axes[0].mechanism.stiffness_n_per_m = n_per_m;
        let (_, um) = hysteresis::triangle(&trial, 90.0)?;
        let sum: f64 = um.iter().zip(&measured).map(|(a, b)| (a - b).powi(2)).sum();
        Ok((sum / um.len() as f64).sqrt() * 1.0e3)
    };
    let mut curve = Vec::new();
    for i in 0..=12 {
        let n_per_m = 0.8e6 * i as f64;
        curve.push((n_per_m / 1.0e6, misfit(n_per_m)?));
    }
    let found = minimum(1.0e6, 9.0e6, misfit)?;
    let floor = misfit(found)?;
    book.finding(&format!(
        "k_1 = {:.3}e6 N/m by matching to a recording of a rig with {:.1}e6 N/m (paper: 4.8e6); misfit {floor:.2} nm, the \
         gauge's noise.",
        found / 1.0e6,
        TRUE_N_PER_M / 1.0e6
    ));
    let plot = LinePlot::new("Misfit of the simulation")
        .x("k_1 (N/um)")
        .y("rms misfit (nm)")
        .series(Series::line("90 V triangle, 1 Hz", curve))
        .vline(found / 1.0e6, "match");
    book.figure(
        &plot,
        "The simulation was repeated with other springs; where it fits best is k_1.",
    );
    Ok(())
}

/// Golden-section search: the misfit has one minimum, and every evaluation is a simulation.
fn minimum(
    mut low: f64,
    mut high: f64,
    f: impl Fn(f64) -> anyhow::Result<f64>,
) -> anyhow::Result<f64> {
    let ratio = (5f64.sqrt() - 1.0) / 2.0;
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut fa, mut fb) = (f(a)?, f(b)?);
    while high - low > 1.0e3 {
        if fa < fb {
            (high, b, fb) = (b, a, fa);
            a = high - ratio * (high - low);
            fa = f(a)?;
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + ratio * (high - low);
            fb = f(b)?;
        }
    }
    Ok((low + high) / 2.0)
}
