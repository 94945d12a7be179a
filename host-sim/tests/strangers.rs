//! What lies outside the catalogue does what its description says.

use std::f64::consts::TAU;

use host_sim::rig::Rig;
use host_sim::{Axes, Input, Output, Place, simulate};

const RATE_HZ: f64 = 10_000.0;

/// Reading of the first axis, m, under a drive of it (V), without noise.
fn reading(settings: &[(&str, &str, f64)], samples: usize, volts: impl Fn(f64) -> f64) -> Vec<f64> {
    simulated(settings, samples, volts).position_m.swap_remove(0)
}

fn simulated(settings: &[(&str, &str, f64)], samples: usize, volts: impl Fn(f64) -> f64) -> Output {
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
    simulate(&rig, &input, Axes::Only(1)).expect("simulation")
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

/// By how much drag opens the loop of a triangle of 60 V at the middle of its branches, m.
fn opened(settings: &[(&str, &str, f64)], hz: f64) -> f64 {
    let triangle = |t: f64| 60.0 * (1.0 - (2.0 * (t * hz).fract() - 1.0).abs());
    let period = (RATE_HZ / hz) as usize;
    let open = |settings: &[(&str, &str, f64)]| {
        let x = reading(settings, 2 * period, triangle);
        x[period + 3 * period / 4] - x[period + period / 4]
    };
    open(settings) - open(&[])
}

#[test]
fn a_brake_lets_go_and_a_fluid_does_not() {
    // 5.6 um in half a period: 0.225 mm/s at 20 Hz. Where the brake lets go a triangle's speed is not steady.
    let brake = [("stage-drag", "brake_n", 4.0), ("stage-drag", "speed_m_per_s", 2.25e-4)];
    let at = [5.0, 10.0, 20.0].map(|hz| opened(&brake, hz));
    let law = |u: f64| 2.0 * u / (1.0 + u * u);
    assert!((at[0] / at[2] - law(0.25)).abs() < 0.03, "{at:?}");
    assert!((at[1] / at[2] - law(0.5)).abs() < 0.03, "{at:?}");
    assert!(opened(&brake, 80.0) < 0.8 * at[2], "{at:?}");
    let fluid = [("stage-drag", "fluid_n", 20.0)];
    let ratio = opened(&fluid, 40.0) / opened(&fluid, 20.0);
    assert!((ratio - 4.0).abs() < 0.2, "{ratio}");
}

#[test]
fn what_lasts_fades_from_a_gauge_with_a_high_pass() {
    let fading = 0.1;
    let settings =
        [("gauge-high-pass", "fading", fading), ("gauge-high-pass", "time_constant_s", 0.05)];
    let step = |t: f64| if t < 0.5 { 50.0 } else { 0.0 };
    let (held, read) = (reading(&[], 6_000, step), reading(&settings, 6_000, step));
    assert!((read[4_999] / held[4_999] - (1.0 - fading)).abs() < 1.0e-3);
    // A tenth of what was held is read the other way once it is gone, and fades in turn.
    let left = |n: usize| (held[n] - read[n]) / held[4_999];
    for n in [5_100, 5_300, 5_900] {
        let faded = (-((n - 5_000) as f64 / RATE_HZ) / 0.05).exp();
        // The loop of the stack keeps a little.
        let kept = held[n] / held[4_999];
        let expected = fading * (faded + kept * (1.0 - faded));
        assert!((left(n) - expected).abs() < 0.02 * fading, "{n}: {} {expected}", left(n));
    }
}

#[test]
fn a_bent_drive_is_off_its_line_as_its_numbers_say() {
    let stairs = |t: f64| 25.0 * (t / 0.1).floor();
    let held = |settings: &[(&str, &str, f64)]| {
        let monitor = simulated(settings, 5_000, stairs).monitor_v.swap_remove(0);
        // 0, 25, 50, 75, 100 V, each at its end.
        [999, 1_999, 2_999, 3_999, 4_999].map(|n| monitor[n])
    };
    let straight = held(&[]);
    let off = |settings: &[(&str, &str, f64)]| {
        let bent = held(settings);
        [0, 1, 2, 3, 4].map(|step| bent[step] - straight[step])
    };
    // At a quarter of the way a bow is three quarters of what it is in the middle, and an ess nearly all.
    let ess = 36.0 / 3.0_f64.sqrt() * 0.25 * 0.25 * 0.75;
    let expected = [
        ([("drive-bend", "bow_v", 0.4), ("drive-bend", "kink_v", 50.0)], [0.0, 0.3, 0.4, 0.3, 0.0]),
        (
            [("drive-bend", "ess_v", 0.4), ("drive-bend", "kink_v", 50.0)],
            [0.0, 0.4 * ess, 0.0, -0.4 * ess, 0.0],
        ),
        ([("drive-bend", "kink", 0.02), ("drive-bend", "kink_v", 60.0)], [0.0, 0.0, 0.0, 0.3, 0.8]),
    ];
    for (settings, expected) in expected {
        for (found, expected) in off(&settings).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1.0e-3, "{settings:?}: {found} V, {expected} V");
        }
    }
}
