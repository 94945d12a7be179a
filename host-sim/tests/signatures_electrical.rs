//! Signatures of the effects of drive, amplifier and sensor: what their descriptions claim, from closed forms.

mod common;

use std::f64::consts::TAU;

use common::{ONE, one_axis, rms, run, run_from, set, single, triangle, worst};
use host_sim::{Output, Place};

#[test]
fn drive_gain_and_offset_show_in_the_monitor() {
    let plain = run(&one_axis(), 1e4, 0.5, triangle(80.0, 4.0));
    let scaled = run(&single("drive-gain", &[("ratio", 1.02)]), 1e4, 0.5, triangle(80.0, 4.0));
    let shifted = run(&single("drive-offset", &[("offset_v", 0.5)]), 1e4, 0.5, triangle(80.0, 4.0));
    for i in 0..5000 {
        assert!((scaled.monitor_v[0][i] - 1.02 * plain.monitor_v[0][i]).abs() < 1e-9);
        assert!((shifted.monitor_v[0][i] - 0.5 - plain.monitor_v[0][i]).abs() < 1e-9);
    }
}

#[test]
fn drive_delay_is_exact_in_whole_and_broken_ticks() {
    let drive = |t: f64| 40.0 + 30.0 * (TAU * 60.0 * t).sin();
    let plain = run(&one_axis(), 1e4, 0.2, drive).monitor_v.remove(0);
    let whole = run(&single("drive-delay", &[("delay_s", 3e-4)]), 1e4, 0.2, drive);
    assert!(worst(&whole.monitor_v[0][500..], &plain[497..1997]) < 1e-9);
    // Half a tick late at 10 kHz is one tick late at 20 kHz with the same held voltages.
    let held = |t: f64| drive(((t + 1e-9) * 1e4).floor() / 1e4);
    let half = run(&single("drive-delay", &[("delay_s", 5e-5)]), 1e4, 0.2, held);
    let fine = run(&single("drive-delay", &[("delay_s", 5e-5)]), 2e4, 0.2, held);
    let every: Vec<f64> = fine.monitor_v[0].iter().step_by(2).copied().collect();
    assert!(worst(&half.monitor_v[0], &every) < 1e-9);
    let every: Vec<f64> = fine.position_m[0].iter().step_by(2).copied().collect();
    // The voltages agree to rounding; what is left is the shape of the force inside a tick, and that has to stay below a
    // tenth of the gauge's 4 nm.
    let difference = rms(&half.position_m[0], &every);
    assert!(difference < 0.4e-9, "{:.3} nm", difference * 1e9);
}

#[test]
fn crosstalk_of_the_drive_reaches_the_monitor_of_the_sensor_only_the_reading() {
    let alone = |axis: usize, t: f64| if axis == 2 { triangle(90.0, 4.0)(t) } else { 0.0 };
    let pair = Place::Pair { on: 1, from: 2 };
    let drive = run_from(&set("drive-crosstalk", pair, &[("share", 0.01)]), 1e4, 0.0, 0.5, alone);
    for (here, there) in drive.monitor_v[1].iter().zip(&drive.monitor_v[2]) {
        assert!((here - 0.01 * there).abs() < 1e-12);
    }
    let sensor = run_from(&set("sensor-crosstalk", pair, &[("share", 0.01)]), 1e4, 0.0, 0.5, alone);
    assert!(sensor.monitor_v[1].iter().all(|v| *v == 0.0));
    for (here, there) in sensor.position_m[1].iter().zip(&sensor.position_m[2]) {
        assert!((here - 0.01 * there).abs() < 1e-18);
    }
}

#[test]
fn amplifier_bandwidth_scales_the_time_constant() {
    let rig = single("amplifier-bandwidth", &[("ratio", 2.0)]);
    let v = run(&rig, 1e4, 0.1, |t| if t < 0.05 { 0.0 } else { 10.0 }).monitor_v.remove(0);
    assert!((v[508] - 10.0 * (1.0 - (-1.0f64).exp())).abs() < 1e-9);
}

#[test]
fn a_further_pole_is_a_second_exponential() {
    let step = |rate_hz: f64, effects: &[(&str, &[(&str, f64)])]| {
        let mut rig = one_axis();
        for (effect, values) in effects {
            for (parameter, value) in *values {
                rig.set(effect, ONE, parameter, *value).unwrap();
            }
        }
        run(&rig, rate_hz, 0.1, |t| if t < 0.05 { 0.0 } else { 100.0 }).monitor_v.remove(0)
    };
    let poles: (&str, &[(&str, f64)]) =
        ("amplifier-bandwidth", &[("ratio", 1.5), ("further_pole", 0.4)]);
    let first_s = 1.5 * one_axis().axes[0].amplifier.time_constant_s;
    let second_s = 0.4 * first_s;
    for (i, v) in step(1.0e4, &[poles]).iter().enumerate().skip(500) {
        let t = (i - 500) as f64 * 1.0e-4;
        let left = (first_s * (-t / first_s).exp() - second_s * (-t / second_s).exp())
            / (first_s - second_s);
        assert!((v - 100.0 * (1.0 - left)).abs() < 1.0e-9, "after {t} s: {v} V");
    }
    // Two equal ones: t e^-t.
    let equal = step(1.0e4, &[("amplifier-bandwidth", &[("further_pole", 1.0)])]);
    let turns = 1.0e-3 / one_axis().axes[0].amplifier.time_constant_s;
    let expected = 100.0 * (1.0 - (1.0 + turns) * (-turns).exp());
    assert!((equal[510] - expected).abs() < 1.0e-3, "{} V, expected {expected}", equal[510]);
    // Behind a slew limit too, ticks of any length give the same.
    let limited = [poles, ("amplifier-current-limit", &[("current_a", 0.2)][..])];
    let (coarse, fine) = (step(1.0e4, &limited), step(1.0e5, &limited));
    for (i, v) in coarse.iter().enumerate().skip(500) {
        assert!((v - fine[10 * i]).abs() < 1.0e-9, "sample {i}: {v} V, {} V", fine[10 * i]);
    }
}

#[test]
fn two_poles_that_ring_overshoot_as_their_damping_ratio_says() {
    let step = |rate_hz: f64, further_pole: f64, current_a: Option<f64>| {
        let mut rig = single("amplifier-bandwidth", &[("further_pole", further_pole)]);
        if let Some(current_a) = current_a {
            rig.set("amplifier-current-limit", ONE, "current_a", current_a).unwrap();
        }
        run(&rig, rate_hz, 0.1, |t| if t < 0.05 { 0.0 } else { 80.0 }).monitor_v.remove(0)
    };
    let tau = one_axis().axes[0].amplifier.time_constant_s;
    // further_pole 4 is a damping ratio of 1/2: 16.3 % over, at pi/omega_d.
    let v = step(1.0e5, 4.0, None);
    let highest = v.iter().copied().fold(0.0, f64::max);
    assert!((highest / 80.0 - 1.163).abs() < 1.0e-3, "{highest} V");
    let at_s = std::f64::consts::PI * 4.0 * tau / 3.0f64.sqrt();
    let when = v.iter().position(|v| *v == highest).unwrap() as f64 * 1.0e-5 - 0.05;
    assert!((when - at_s).abs() < 2.0e-5, "{when} s, expected {at_s}");
    // Ticks of any length give the same, and just above two equal poles it is what they are.
    for (i, coarse) in step(1.0e4, 4.0, None).iter().enumerate().skip(500) {
        assert!((coarse - v[10 * i]).abs() < 1.0e-9, "sample {i}: {coarse} V, {} V", v[10 * i]);
    }
    let near = step(1.0e4, 1.0 + 1.0e-6, None);
    for (equal, near) in step(1.0e4, 1.0, None).iter().zip(near) {
        assert!((equal - near).abs() < 1.0e-3, "{equal} V, {near} V");
    }
    // Behind a slew limit it goes no faster than that, and comes to the same end.
    let limited = step(1.0e4, 4.0, Some(0.2));
    let fastest = |v: &[f64]| v.windows(2).map(|w| (w[1] - w[0]) * 1.0e4).fold(0.0, f64::max);
    let most_v_per_s = fastest(&step(1.0e4, 0.0, Some(0.2)));
    assert!(fastest(&limited) < 1.001 * most_v_per_s, "{} V/s", fastest(&limited));
    assert!((limited.last().unwrap() - 80.0).abs() < 1.0e-6);
}

#[test]
fn current_limit_makes_ramps_of_current_over_capacitance() {
    let rig = single("amplifier-current-limit", &[("current_a", 0.2)]);
    let step = |height: f64| {
        run(&rig, 1e4, 0.1, move |t| if t < 0.05 { 0.0 } else { height }).monitor_v.remove(0)
    };
    let large = step(100.0);
    // Small-signal capacitance of the nominal stack in the mechanism.
    let free = 1.063e-6 + 7.10f64.powi(2) / 53.4e6;
    let load = 1.0 / (1.0 / free + 8.0 / 33.6e-6);
    for i in 500..502 {
        let slope = (large[i + 1] - large[i]) * 1e4;
        assert!((slope - 0.2 / load).abs() < 1e-6 * slope, "{slope} V/s");
    }
    let plain = run(&one_axis(), 1e4, 0.1, |t| if t < 0.05 { 0.0 } else { 10.0 });
    assert!(worst(&step(10.0), &plain.monitor_v[0]) < 1e-12, "small steps stay exponential");
}

#[test]
fn a_knee_bends_the_ramp_into_the_exponential() {
    let step = |rate: f64, height: f64, knee: f64| {
        let values = [("current_a", 0.2), ("knee", knee)];
        let rig = single("amplifier-current-limit", &values);
        run(&rig, rate, 0.1, move |t| if t < 0.05 { 0.0 } else { height }).monitor_v.remove(0)
    };
    let free = 1.063e-6 + 7.10f64.powi(2) / 53.4e6;
    let limit_v_per_s = 0.2 * (1.0 / free + 8.0 / 33.6e-6);
    let tau_s = one_axis().axes[0].amplifier.time_constant_s;
    // The law, in small steps of its own.
    for (height, knee) in [(20.0, 0.2), (100.0, 0.4), (60.0, 1.0)] {
        let mut expected = 0.0;
        let simulated = step(1e4, height, knee);
        for (tick, v) in simulated.iter().skip(500).enumerate().take(60) {
            assert!(
                (v - expected).abs() < 2e-3,
                "{height} V, knee {knee}, tick {tick}: {v} V, {expected} V"
            );
            for _ in 0..200 {
                let slope = |v: f64| {
                    let asked = (height - v) / tau_s / limit_v_per_s;
                    asked * (1.0 + asked.powf(1.0 / knee)).powf(-knee) * limit_v_per_s
                };
                expected += 5e-7 * slope(expected + 2.5e-7 * slope(expected));
            }
        }
    }
    let (soft, sharp) = (step(1e4, 100.0, 1e-3), step(1e4, 100.0, 0.0));
    assert!(worst(&soft, &sharp) < 0.05, "hardly any knee is a corner");
    let plain = run(&one_axis(), 1e4, 0.1, |t| if t < 0.05 { 0.0 } else { 0.1 });
    assert!(
        worst(&step(1e4, 0.1, 0.3), &plain.monitor_v[0]) < 1e-5,
        "small steps stay exponential"
    );
}

#[test]
fn clipping_stands_at_one_voltage() {
    let rig = single("amplifier-clipping", &[("max_v", 70.0), ("softness_v", 0.01)]);
    let output = run(&rig, 1e4, 1.0, triangle(90.0, 2.0));
    let top = output.monitor_v[0].iter().copied().fold(0.0, f64::max);
    assert!((top - 70.0).abs() < 0.02);
    let plain = run(&one_axis(), 1e4, 0.15, triangle(90.0, 2.0));
    assert!(worst(&output.monitor_v[0][..1500], &plain.monitor_v[0]) < 1e-6);
}

#[test]
fn clipping_ahead_of_the_lag_is_what_the_output_tends_to() {
    // A step to 90 V, one time constant (0.8 ms) after it: 70 V is all that is aimed at, or all that comes out.
    let step = |t: f64| if t < 0.05 { 0.0 } else { 90.0 };
    let clip = [("max_v", 70.0), ("softness_v", 1e-3)];
    let after = |ahead: f64, ticks: usize| {
        let rig = single("amplifier-clipping", &[clip[0], clip[1], ("ahead", ahead)]);
        run(&rig, 1e4, 0.1, step).monitor_v[0][500 + ticks]
    };
    let plain = |ticks: usize| run(&one_axis(), 1e4, 0.1, step).monitor_v[0][500 + ticks] / 90.0;
    for ticks in [2, 8, 14] {
        assert!((after(1.0, ticks) - 70.0 * plain(ticks)).abs() < 1e-6, "before the lag");
        let out = (90.0 * plain(ticks)).min(70.0);
        assert!((after(0.0, ticks) - out).abs() < 1e-3, "behind the lag");
    }
    assert!((after(1.0, 300) - 70.0).abs() < 1e-3 && (after(0.0, 300) - 70.0).abs() < 1e-3);
}

#[test]
fn hum_follows_the_clock_of_the_session() {
    for (name, amplitude) in [("amplifier-hum", 0.5), ("sensor-hum", 2e-8)] {
        let unit = if name == "sensor-hum" { "m" } else { "v" };
        let rig = single(name, &[(&format!("cos_{unit}"), amplitude), ("frequency_hz", 60.0)]);
        let still = |_, _| 0.0;
        let early = run_from(&rig, 1e4, 0.0, 0.5, still);
        let late = run_from(&rig, 1e4, 100.0 + 0.5 / 60.0, 0.5, still);
        let signal =
            |o: &Output| if unit == "m" { o.position_m[0][300] } else { o.monitor_v[0][300] };
        let expected = amplitude * (TAU * 60.0 * 0.03).cos();
        assert!((signal(&early) - expected).abs() < 1e-9 * amplitude, "{name}");
        assert!((signal(&late) + expected).abs() < 1e-9 * amplitude, "{name}");
    }
    // A grid that is a quarter of a turn ahead after a third of 900 s, where its first part has made a third of a quarter turn: sin(30 degrees).
    let values = [("cos_m", 2e-8), ("ahead_1_turns", 0.5), ("wander_s", 900.0)];
    let ahead = run_from(&single("sensor-hum", &values), 1e3, 299.5, 1.0, |_, _| 0.0);
    assert!(ahead.position_m[0][500].abs() < 1e-11, "{}", ahead.position_m[0][500]);
    assert!((ahead.position_m[0][515].abs() - 2e-8).abs() < 1e-11, "{}", ahead.position_m[0][515]);
    // Hum of the amplifier moves the stack, with hysteresis; hum of the sensor does not.
    let rig = single("amplifier-hum", &[("sin_v", 1.0)]);
    assert!(run(&rig, 1e4, 0.1, |_| 40.0).position_m[0][550..].iter().any(|x| *x > 3e-6));
}

#[test]
fn sensor_effects_act_on_the_reading() {
    let x = run(&one_axis(), 1e4, 0.5, triangle(80.0, 4.0)).position_m.remove(0);
    let read = |name, values: &[(&str, f64)]| {
        run(&single(name, values), 1e4, 0.5, triangle(80.0, 4.0)).position_m.remove(0)
    };
    let scaled: Vec<f64> = x.iter().map(|x| 1.01 * x).collect();
    assert!(worst(&read("sensor-gain", &[("ratio", 1.01)]), &scaled) < 1e-18);
    let shifted: Vec<f64> = x.iter().map(|x| x + 3e-8).collect();
    assert!(worst(&read("sensor-offset", &[("offset_m", 3e-8)]), &shifted) < 1e-18);
    let bent: Vec<f64> = x.iter().map(|x| x + 1e3 * x * x - 2e8 * x * x * x).collect();
    let values = [("quadratic_per_m", 1e3), ("cubic_per_m2", -2e8)];
    assert!(worst(&read("sensor-nonlinearity", &values), &bent) < 1e-18);
    // Calibrated by a line from 0 to 9 um: right at both ends, and a cubic at the middle too.
    let values = [("quadratic_per_m", 1e3), ("cubic_per_m2", -2e8), ("zero_m", 9e-6)];
    let bowed: Vec<f64> =
        x.iter().map(|x| x + x * (x - 9e-6) * 1e3 - 2e8 * x * (x - 4.5e-6) * (x - 9e-6)).collect();
    assert!(worst(&read("sensor-nonlinearity", &values), &bowed) < 1e-18);
    // An error that repeats, and is none at zero.
    let values = [("ripple_sine_m", 2e-8), ("ripple_cosine_m", -1e-8), ("ripple_period_m", 3e-6)];
    let phase = |x: f64| std::f64::consts::TAU * x / 3e-6;
    let rippled: Vec<f64> =
        x.iter().map(|&x| x + 2e-8 * phase(x).sin() - 1e-8 * (1.0 - phase(x).cos())).collect();
    assert!(worst(&read("sensor-nonlinearity", &values), &rippled) < 1e-18);
    // On a ramp a low-pass lags by its time constant.
    let slow = read("sensor-bandwidth", &[("time_constant_s", 3e-4)]);
    let lag = (x[1000] - slow[1000]) / (x[1001] - x[1000]) * 1e-4;
    assert!((lag - 3e-4).abs() < 2e-5, "{lag}");
    let values = [("rate_m_per_s", 1e-9), ("settling_m", 5e-8), ("settling_s", 60.0)];
    let drift = run_from(&single("sensor-drift", &values), 1e3, 600.0, 1.0, |_, _| 0.0);
    assert!((drift.position_m[0][500] - 600.5e-9 - 5e-8).abs() < 1e-11);
    // To and fro: 601 s are a quarter turn beyond two whole ones of 267.111 s, where the sine is at its crest and the cosine half way down.
    let cycle_s = 601.0 / 2.25;
    let values = [("swing_sin_m", 3e-8), ("swing_cos_m", 2e-8), ("cycle_s", cycle_s)];
    let swing = run_from(&single("sensor-drift", &values), 1e3, 600.0, 2.0, |_, _| 0.0);
    assert!((swing.position_m[0][1000] - 3e-8 + 2e-8).abs() < 1e-13);
    // Without a period: over 900 s, the third part has made 5/3 quarter turns after 300 s. It stays where it is from the end on.
    let values = [("wander_1_m", 4e-8), ("wander_3_m", 3e-8), ("wander_s", 900.0)];
    for (start_s, expected_m) in [(299.0, 0.5 * 4e-8 + 0.5 * 3e-8), (899.0, 7e-8), (2000.0, 7e-8)] {
        let walk = run_from(&single("sensor-drift", &values), 1e3, start_s, 2.0, |_, _| 0.0);
        let off_m = walk.position_m[0][1000] - expected_m;
        assert!(off_m.abs() < 1e-13, "after {start_s} s and one more: {off_m} m");
    }
}

#[test]
fn a_limited_amplifier_meets_a_stack_whose_elements_hold_after_a_turn() {
    // What was last drawn went the other way than the next edge, or either way by rounding.
    let squares = |t: f64| if (t * 16.0).floor() % 2.0 < 1.0 { 1.0 } else { 101.0 };
    let held = |t: f64| squares(((t + 1.0e-9) * 1.0e4).floor() / 1.0e4);
    let limit = [("current_a", 0.127), ("stack_share", 1.0)];
    let rig = single("amplifier-current-limit", &limit);
    let mut parts: Vec<Vec<f64>> =
        [1.0, 20.0].map(|parts| run(&rig, 1.0e4 * parts, 0.5, held).position_m.remove(0)).to_vec();
    parts[1] = parts[1].iter().step_by(20).copied().collect();
    let unlimited = run(&one_axis(), 1.0e4, 0.5, held).position_m.remove(0);
    let (off, effect) = (rms(&parts[0], &parts[1]), rms(&unlimited, &parts[1]));
    assert!(effect > 1.0e-7 && off < 0.005 * effect, "{off:e} m of {effect:e} m");
}
