//! What lies outside the catalogue does what its description says.

use std::f64::consts::TAU;

use host_sim::rig::Rig;
use host_sim::{Axes, Input, Place, simulate};

const RATE_HZ: f64 = 10_000.0;

/// Reading of the first axis, m, under a drive of it (V), without noise.
fn reading(settings: &[(&str, &str, f64)], samples: usize, volts: impl Fn(f64) -> f64) -> Vec<f64> {
    let mut rig = Rig::named("handley").expect("library rig");
    for (effect, parameter, value) in settings {
        rig.set(effect, Place::Axis(0), parameter, *value).expect("known parameter");
    }
    let driven: Vec<f64> = (0..samples).map(|n| volts(n as f64 / RATE_HZ)).collect();
    let rest = vec![0.0; samples];
    let drive: Vec<&[f64]> =
        (0..rig.axes.len()).map(|axis| if axis == 0 { &driven[..] } else { &rest[..] }).collect();
    let input = Input {
        sample_rate_hz: RATE_HZ,
        start_s: 100.0,
        ticks: None,
        drive_v: &drive,
        monitor_v: None,
        initial: &[],
    };
    simulate(&rig, &input, Axes::Only(1)).expect("simulation").position_m.swap_remove(0)
}

#[test]
fn a_shaken_stage_moves_as_its_stiffness_lets_it() {
    let force_n = 11.0;
    let shaken = [("floor-hum", "cos_n", force_n), ("floor-hum", "frequency_hz", 31.3)];
    let position = reading(&shaken, 20_000, |_| 0.0);
    let part = |f: fn(f64) -> f64| {
        let sum: f64 = position
            .iter()
            .enumerate()
            .map(|(n, x)| x * f(TAU * 31.3 * (100.0 + n as f64 / RATE_HZ)))
            .sum();
        2.0 * sum / position.len() as f64
    };
    let (cos, sin) = (part(f64::cos), part(f64::sin));
    let axis = &Rig::named("handley").expect("library rig").axes[0];
    let soft = axis.piezo.stiffness_n_per_m + axis.mechanism.stiffness_n_per_m;
    let slopes: f64 = axis.piezo.hysteresis.slopes().sum();
    let held =
        axis.piezo.transformer_n_per_v.powi(2) * slopes / (1.0 + axis.piezo.capacitance_f * slopes);
    // Between a stack whose slip elements all slip and one where all of them hold.
    assert!(cos < force_n / soft && cos > force_n / (soft + held), "{cos} m");
    assert!(sin.abs() < 0.01 * cos, "{sin} m of {cos} m");
}

#[test]
fn a_gauge_with_play_stands_still_at_a_reversal() {
    let width_m = 2.0e-7;
    let triangle = |t: f64| 40.0 * (1.0 - (2.0 * t - 1.0).abs());
    let position = reading(&[], 10_000, triangle);
    let read = reading(&[("gauge-play", "width_m", width_m)], 10_000, triangle);
    let top = position.iter().copied().fold(0.0, f64::max);
    for (position, read) in position.iter().zip(&read).skip(1000) {
        assert!((position - read).abs() < 0.5 * width_m + 1.0e-12);
    }
    let back = (5_100..10_000).find(|&n| read[n] < top - 0.5 * width_m - 1.0e-12);
    let back = back.expect("the reading follows in the end");
    assert!((top - position[back] - width_m).abs() < 0.1 * width_m);
}

#[test]
fn a_gauge_that_warms_up_reads_more_later() {
    let warming = [("gauge-warming", "growth", 0.02), ("gauge-warming", "time_constant_s", 50.0)];
    let held = |_: f64| 50.0;
    let (cold, warm) = (reading(&[], 2_000, held), reading(&warming, 2_000, held));
    // The recording starts 100 s into the session.
    let expected = 1.0 + 0.02 * (1.0 - (-100.1_f64 / 50.0).exp());
    assert!((warm[1_000] / cold[1_000] - expected).abs() < 1.0e-9);
}
