//! What several tests need: drives, a rig of one axis, short ways to simulate.
#![allow(dead_code, reason = "every test file uses its own part")]

use std::f64::consts::TAU;

use host_sim::rig::Rig;
use host_sim::{Axes, Input, Output, Place, simulate};

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

/// The nominal rig with an effect at a place.
pub fn set(name: &str, place: Place, values: &[(&str, f64)]) -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    for (parameter, value) in values {
        rig.set(name, place, parameter, *value).unwrap();
    }
    rig.validate().unwrap();
    rig
}

/// The first axis.
pub const ONE: Place = Place::Axis(0);

/// The nominal rig with one axis and an effect on it.
pub fn single(name: &str, values: &[(&str, f64)]) -> Rig {
    let mut rig = set(name, ONE, values);
    rig.axes.truncate(1);
    rig
}

/// Response at `hz` to a sine of `amplitude` volts on `bias`: (gain m/V, phase rad).
pub fn response(rig: &Rig, bias: f64, amplitude: f64, hz: f64) -> (f64, f64) {
    let rate = 1e4;
    let periods = (hz * 0.4).ceil();
    let start = 0.3;
    let seconds = start + periods / hz;
    let x =
        run(rig, rate, seconds, |t| bias + amplitude * (TAU * hz * t).sin()).position_m.remove(0);
    let from = (start * rate).round() as usize;
    let (mut re, mut im) = (0.0, 0.0);
    for (i, x) in x.iter().enumerate().skip(from) {
        let phase = TAU * hz * i as f64 / rate;
        re += x * phase.sin();
        im += x * phase.cos();
    }
    let n = (x.len() - from) as f64;
    (2.0 * re.hypot(im) / n / amplitude, im.atan2(re))
}

/// Stiffness of the nominal stage, N/m: stack and mechanism.
pub const STAGE_N_PER_M: f64 = 53.4e6;

/// Stiffness that the nominal stack's charge branch adds while every element holds, N/m: `T^2 S / (1 + C S)`. While some
/// slip it is less, so that the true stiffness lies between [`STAGE_N_PER_M`] and that plus this.
pub fn branch_n_per_m() -> f64 {
    let (transformer, capacitance, slope) = (7.10f64, 1.063e-6, 8.0 / 33.6e-6);
    transformer.powi(2) * slope / (1.0 + capacitance * slope)
}

/// Least and greatest value of something that falls or rises with the stiffness that the charge branch adds, with a
/// hundredth on both sides for what else moves.
pub fn over_branch(value: impl Fn(f64) -> f64) -> std::ops::Range<f64> {
    let (a, b) = (value(0.0), value(branch_n_per_m()));
    0.99 * a.min(b)..1.01 * a.max(b)
}
