//! What several tests need: drives, a rig of one axis, short ways to simulate.
#![allow(dead_code, reason = "every test file uses its own part")]

use host_sim::rig::Rig;
use host_sim::{Axes, Input, Output, simulate};

/// The nominal rig with one axis.
pub fn one_axis() -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    rig.axes.truncate(1);
    rig
}

/// One axis driven by a function of time.
pub fn run(rig: &Rig, rate_hz: f64, seconds: f64, drive: impl Fn(f64) -> f64) -> Output {
    run_from(rig, rate_hz, 0.0, seconds, |axis, t| if axis == 0 { drive(t) } else { 0.0 })
}

/// All axes driven by a function of axis and time, from `start_s` on the session's clock.
pub fn run_from(
    rig: &Rig,
    rate_hz: f64,
    start_s: f64,
    seconds: f64,
    drive: impl Fn(usize, f64) -> f64,
) -> Output {
    let samples = (seconds * rate_hz).round() as usize;
    let channels: Vec<Vec<f64>> = (0..rig.axes.len())
        .map(|axis| (0..samples).map(|i| drive(axis, i as f64 / rate_hz)).collect())
        .collect();
    let channels: Vec<&[f64]> = channels.iter().map(Vec::as_slice).collect();
    let input = Input {
        sample_rate_hz: rate_hz,
        start_s,
        ticks: None,
        drive_v: &channels,
        monitor_v: None,
        initial: &[],
    };
    simulate(rig, &input, Axes::All).unwrap()
}

/// Triangle from 0 to `peak`, starting at 0 and rising.
pub fn triangle(peak: f64, hz: f64) -> impl Fn(f64) -> f64 {
    move |t| {
        let phase = (t * hz).rem_euclid(1.0);
        peak * if phase < 0.5 { 2.0 * phase } else { 2.0 - 2.0 * phase }
    }
}

/// Largest absolute difference.
pub fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Root mean square difference.
pub fn rms(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

/// Area enclosed by a loop over a whole period (m V).
pub fn loop_area(x: &[f64], y: &[f64]) -> f64 {
    let n = x.len();
    (0..n).map(|i| 0.5 * (x[(i + 1) % n] + x[i]) * (y[(i + 1) % n] - y[i])).sum::<f64>().abs()
}
