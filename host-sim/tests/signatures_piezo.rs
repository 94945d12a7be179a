//! Signatures of the effects of the stack: loops, creep, gain.

mod common;

use common::{ONE, STAGE_N_PER_M, loop_area, one_axis, over_branch, run, single, triangle};
use host_sim::rig::Rig;

#[test]
fn loops_have_the_area_of_their_elements_and_a_skewed_one_is_lopsided() {
    // At rest at every point x = T v_z/(k_p + k), so that the charge is a straight line in x, and element i encloses
    // 4 L_i (A - D_i) once half the travel A is beyond its slip charge D_i.
    let c_per_m = 7.10 + 1.063e-6 * STAGE_N_PER_M / 7.10;
    let check = |name: &str, value: f64, weight: &dyn Fn(f64) -> f64, slip: f64| {
        let rig = single("hysteresis-shape", &[(name, value)]);
        [20.0, 90.0].map(|peak| {
            let output = run(&rig, 1e4, 2.0, triangle(peak, 1.0));
            let x = &output.position_m[0][10_000..];
            let area = loop_area(&output.monitor_v[0][10_000..], x);
            let half = 0.5 * c_per_m * (x[5_000] - x[0]);
            let expected: f64 = (1..=8)
                .map(|i| slip * 12.5e-6 * f64::from(i))
                .map(|d| 4.0 * weight(d) * d / 33.6e-6 * (half - d).max(0.0) / c_per_m)
                .sum();
            (area, expected)
        })
    };
    let tilt = |d: f64| (d / 100e-6 - 0.5).exp();
    let bend = |d: f64| (2.0 * ((d / 100e-6 - 0.5).powi(2) - 1.0 / 12.0)).exp();
    for (name, value, weight, slip) in [
        ("strength", 1.0, &(|_| 1.0) as &dyn Fn(f64) -> f64, 1.0),
        ("strength", 1.2, &|_| 1.2, 1.0),
        ("tilt", 1.0, &tilt, 1.0),
        ("bend", 2.0, &bend, 1.0),
        ("slip", 1.5, &|_| 1.0, 1.5),
    ] {
        let [small, large] = check(name, value, weight, slip);
        // A small loop is a difference of nearly equal charges: its error is that of a large one, not its own share.
        for (area, expected) in [small, large] {
            assert!(
                (area - expected).abs() < 0.02 * expected + 0.002 * large.1,
                "{name} {value}: {area:e} {expected:e}"
            );
        }
    }
    // A loop of Maxwell elements is symmetric about its centre; a skewed one is not.
    let lopsided = |rig: &Rig| {
        let x = run(rig, 1e4, 2.0, triangle(90.0, 1.0)).position_m.remove(0);
        let ends = x[10_000] + x[15_000];
        (0..5000).map(|i| (x[10_000 + i] + x[15_000 + i] - ends).abs()).fold(0.0, f64::max)
    };
    let skewed = single("hysteresis-shape", &[("skew", 0.3)]);
    let (skewed, plain) = (lopsided(&skewed), lopsided(&one_axis()));
    assert!(skewed > 5.0 * plain && skewed > 2.0e-8, "{:.1} {:.1} nm", skewed * 1e9, plain * 1e9);
}

#[test]
fn elements_that_yield_close_the_loops_of_dahl_and_of_bouc_and_wen() {
    let c_per_m = 7.10 + 1.063e-6 * STAGE_N_PER_M / 7.10;
    let share = 0.7;
    let of_dahl = single("hysteresis-shape", &[("yield", share)]);
    let with = |recoil| single("hysteresis-shape", &[("yield", share), ("recoil", recoil)]);
    for (rig, recoil) in [(of_dahl.clone(), 1.0), (with(0.4), 0.4), (with(0.0), 0.0)] {
        for (peak, cycles) in [(20.0, 40), (90.0, 4)] {
            let output = run(&rig, 1e4, f64::from(cycles), triangle(peak, 1.0));
            // The virgin curve is forgotten over many cycles if they are small.
            let last = 10_000 * (cycles as usize - 1);
            let x = &output.position_m[0][last..];
            let area = loop_area(&output.monitor_v[0][last..], x);
            let half = 0.5 * c_per_m * (x[5_000] - x[0]);
            // Element i on its way up from -z0. Back to zero |z| = (b + z0) e^(-q/b) - b with b = D / (recoil share), at q0 = b ln(1 + z0/b);
            // from there z = a (1 - e^(-(q - q0)/a)) with a = D / share, at most D. The way down is the same turned over, so the loop
            // is twice the integral of the way up.
            let expected: f64 = (1..=8)
                .map(|i| 12.5e-6 * f64::from(i))
                .map(|slip: f64| {
                    let (a, b) = (slip / share, slip / (recoil * share).max(1.0e-6));
                    let up = |z0: f64, q: f64| {
                        let at_zero = b * (z0 / b).ln_1p();
                        if q < at_zero {
                            b - (b + z0) * (-q / b).exp()
                        } else {
                            (a * -(-(q - at_zero) / a).exp_m1()).min(slip)
                        }
                    };
                    let settled = (0..400).fold(0.0, |z0, _| up(z0, 2.0 * half));
                    let steps = 20_000;
                    let way = 2.0 * half / f64::from(steps);
                    let z = |step: i32| up(settled, (f64::from(step) + 0.5) * way);
                    let integral: f64 = (0..steps).map(|step| z(step) * way).sum();
                    2.0 * integral / 33.6e-6 / c_per_m
                })
                .sum();
            let error = area / expected - 1.0;
            assert!(error.abs() < 0.03, "{peak} V, recoil {recoil}: {area:e} {expected:e}");
        }
    }
    // Up to 90 V, back to 45 V, then cycles of 10 V about it: where slip elements stay put, these come back towards the middle.
    let drive = |t: f64| match t {
        t if t < 1.0 => 90.0 * t,
        t if t < 1.5 => 90.0 - 90.0 * (t - 1.0),
        t => 45.0 + 10.0 * (std::f64::consts::TAU * 10.0 * t).sin(),
    };
    let wandered = |rig: &Rig| {
        let x = run(rig, 1e4, 4.0, drive).position_m.remove(0);
        let mean = |from: usize| x[from..from + 1000].iter().sum::<f64>() / 1000.0;
        (mean(38_000) - mean(17_000)) * 1e9
    };
    let (yielding, holding) = (wandered(&of_dahl), wandered(&one_axis()));
    assert!(holding.abs() < 1.0 && yielding < -20.0, "{holding:.1} {yielding:.1} nm");
}

#[test]
fn loops_lie_about_their_imprint_and_a_spread_one_opens_where_it_is_small() {
    // A bias moves all of the motion as the same voltage at the input would, and no loop.
    let drive = triangle(60.0, 1.0);
    let biased = run(&single("hysteresis-shape", &[("imprint_v", 2.0)]), 1e4, 2.0, drive);
    let pushed = run(&one_axis(), 1e4, 2.0, |t| triangle(60.0, 1.0)(t) - 2.0);
    for i in (12_000..20_000).step_by(500) {
        let (a, b) = (biased.position_m[0][i], pushed.position_m[0][i]);
        assert!((a - b).abs() < 1.0e-9, "{i}: {a:e} {b:e}");
    }
    // At 10 V no element of the nominal stack slips on the way back; a continuum has some that do.
    let loop_of = |rig: &Rig, peak: f64| {
        let output = run(rig, 1e4, 4.0, triangle(peak, 1.0));
        loop_area(&output.monitor_v[0][30_000..], &output.position_m[0][30_000..])
    };
    let (plain, spread) = (one_axis(), single("hysteresis-shape", &[("spread", 1.0)]));
    // The amplifier's lag alone makes the nominal one's.
    let [small, large] = [10.0, 90.0].map(|peak| loop_of(&spread, peak) / loop_of(&plain, peak));
    assert!(small > 1.5 && (large - 1.0).abs() < 0.05, "{small:.2} {large:.3}");
}

#[test]
fn a_linear_rig_can_get_hysteresis() {
    let mut rig = Rig::named("micromanipulator").unwrap();
    rig.set("hysteresis-shape", ONE, "strength", 1.5).unwrap();
    let linear = Rig::named("micromanipulator").unwrap();
    // Falling above rising at half the voltage, over the stroke.
    let gap = |rig: &Rig| {
        let x = run(rig, 200.0, 4.0, triangle(3.6, 1.0)).position_m.remove(0);
        // A position is sampled before the voltage of its tick acts: one tick later.
        (x[751] - x[651]) / (x[701] - x[601])
    };
    // A stack without elements has the lag of its amplifier alone.
    let (with, without) = (gap(&rig), gap(&linear));
    assert!(with > 0.0 && without.abs() < 0.1 * with, "{with} {without}");
}

/// Area of the third loop of a 60 V triangle.
fn area(rig: &Rig, hz: f64) -> f64 {
    let output = run(rig, 1e4, 3.0 / hz, triangle(60.0, hz));
    let n = (1e4 / hz) as usize;
    loop_area(&output.monitor_v[0][2 * n..], &output.position_m[0][2 * n..])
}

#[test]
fn rate_dependence_widens_the_fast_loop_and_leaves_the_slow_one() {
    let growth = single("hysteresis-rate", &[("per_decade", 0.3), ("reference_a", 1e-3)]);
    let loss = single("hysteresis-rate", &[("resistance_ohm", 300.0)]);
    for rig in [growth, loss] {
        let slow = area(&rig, 0.5) / area(&one_axis(), 0.5);
        let fast = area(&rig, 50.0) / area(&one_axis(), 50.0);
        // At 0.5 Hz 0.12 mA flow, a tenth of the reference: limits 1.5 % wider, or 36 mV of loss in a loop of some 2 V. At 50 Hz
        // it is 12 mA: limits 33 % wider, or 3.6 V of loss. The fast loop has to gain more than the slow one may.
        assert!((slow - 1.0).abs() < 0.05 && fast > 1.05, "{slow} {fast}");
    }
}

#[test]
fn a_series_loss_goes_with_the_stated_power_of_the_current() {
    let lost = |rig: &Rig, hz: f64| area(rig, hz) - area(&one_axis(), hz);
    for exponent in [0.3, 0.5, 1.0] {
        let rig =
            single("hysteresis-rate", &[("resistance_ohm", 100.0), ("loss_exponent", exponent)]);
        let decade = lost(&rig, 20.0) / lost(&rig, 2.0);
        let expected = 10.0_f64.powf(exponent);
        assert!((decade / expected - 1.0).abs() < 0.1, "{exponent}: {decade} {expected}");
    }
}

#[test]
fn a_loss_between_charge_and_strain_goes_with_the_logarithm_of_the_current() {
    // 60 V and back: half a milliampere at 2 Hz.
    const AT_2_HZ_A: f64 = 0.5e-3;
    let lost = |current_a: f64, onset: f64, hz: f64| {
        // Beside next to no loss, not none: that goes in leaps, and these are picometres.
        let of = |loss_v: f64| {
            let settings =
                [("strain_loss_v", loss_v), ("strain_loss_a", current_a), ("strain_onset", onset)];
            area(&single("hysteresis-rate", &settings), hz)
        };
        of(0.05) - of(1.0e-12)
    };
    let decade =
        |current_a: f64, onset: f64| lost(current_a, onset, 20.0) / lost(current_a, onset, 2.0);
    let (found, u) = (decade(1.0e-6, 1.0), AT_2_HZ_A / 1.0e-6);
    let expected = (10.0 * u).ln() / u.ln();
    assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    // Far below the current that it is stated for it goes with a power.
    for onset in [1.0, 2.0] {
        let (found, expected) = (decade(0.05, onset), 10.0_f64.powf(onset));
        assert!((found / expected - 1.0).abs() < 0.1, "{onset}: {found} {expected}");
    }
}

/// By the voltage of the loss times what a volt moves, give or take the stiffening by what the stage lacks.
#[test]
fn strain_that_comes_late_does_so_in_both_directions() {
    let settings = [("strain_loss_v", 0.1), ("strain_loss_a", 1.0e-4)];
    let late = single("hysteresis-rate", &settings);
    let of = |rig: &Rig| run(rig, 1e4, 0.15, triangle(60.0, 20.0)).position_m.remove(0);
    let (plain, lossy) = (of(&one_axis()), of(&late));
    // 0.1 V for each factor of e between 0.1 and 5 mA: 0.39 V, at some 0.1 um/V.
    let expected = 0.1 * 50.0_f64.ln() * 0.1e-6;
    for (quarter, sign) in [(1125, 1.0), (1375, -1.0)] {
        let behind = sign * (plain[quarter] - lossy[quarter]);
        assert!((0.6 * expected..1.3 * expected).contains(&behind), "{quarter}: {behind}");
    }
}

#[test]
fn creep_goes_with_the_logarithm_of_time_and_with_the_step() {
    let rig = single("creep", &[("per_decade", 0.015)]);
    let grown = |height: f64| {
        let x =
            run(&rig, 1e3, 120.0, move |t| if t < 1.0 { 0.0 } else { height }).position_m.remove(0);
        [1.1, 2.0, 11.0, 101.0].map(|t| x[(t * 1e3) as usize])
    };
    let [a, b, c, d] = grown(60.0);
    // A decade, whichever it is, adds the same: 1.5 % of the stroke, less behind the charge branch. From 0.1 s on, lg(1 + t/0.02)
    // grows by 0.93 in the first decade.
    let expected = over_branch(|branch| 0.015 * STAGE_N_PER_M / (STAGE_N_PER_M + branch));
    for (step, decade) in [(b - a, 0.926), (c - b, 0.995), (d - c, 1.0)] {
        let found = step / decade / a;
        assert!(
            (0.95 * expected.start..1.05 * expected.end).contains(&found),
            "{found} {expected:?}"
        );
    }
    let half = grown(30.0);
    let share = (half[3] - half[0]) / (d - a);
    // Half the step moves less than half as far: the gain for small signals over that for large ones is 0.81.
    assert!((0.81 * 0.5..0.5).contains(&share), "{share}");
}

#[test]
fn creep_may_grow_with_the_level_and_from_decade_to_decade() {
    // Growth over two decades from 0.1 s and one second after a step.
    let grown = |settings: &[(&str, f64)], height: f64| {
        let all = [&[("per_decade", 0.015)], settings].concat();
        let x = run(&single("creep", &all), 1e3, 12.0, move |t| if t < 1.0 { 0.0 } else { height })
            .position_m
            .remove(0);
        let at = |t: f64| x[(t * 1e3) as usize];
        [at(2.0) - at(1.1), at(11.0) - at(2.0)]
    };
    for height in [30.0, 60.0] {
        let plain = grown(&[], height);
        // What creeps is the transducer voltage, less than the step by what the slip elements hold: 13 V at most.
        let levelled = grown(&[("level", 0.4)], height);
        for (more, less) in levelled.iter().zip(plain) {
            let most = 1.0 + 0.4 * height / 100.0;
            let least = 1.0 + 0.4 * (height - 14.0) / 100.0;
            assert!((least..most).contains(&(more / less)), "{height} V: {}", more / less);
        }
        // A decade about one second is as it was, the next one more by its time to this power.
        let tilted = grown(&[("tilt", 0.1)], height);
        let steeper = (tilted[1] / tilted[0]) / (plain[1] / plain[0]);
        assert!((steeper / 10.0f64.powf(0.1) - 1.0).abs() < 0.04, "{height} V: {steeper}");
    }
}

/// From one moment to a later one it grows as its chain of strains does, two a decade from the onset on, and not as the logarithm.
#[test]
fn creep_may_begin_sharply() {
    const MOMENTS_S: [f64; 4] = [0.01, 0.05, 0.5, 5.0];
    let settings = [("per_decade", 0.015), ("onset_s", 0.05), ("sharp", 1.0)];
    let x = run(&single("creep", &settings), 1e3, 12.0, |t| if t < 1.0 { 0.0 } else { 60.0 })
        .position_m
        .remove(0);
    let grown =
        |from: f64, to: f64| x[((1.0 + to) * 1e3) as usize] - x[((1.0 + from) * 1e3) as usize];
    let of_chain = |t: f64| -> f64 {
        (0..11).map(|j| -(-t / (0.05 * 10f64.powf(0.5 * f64::from(j)))).exp_m1()).sum()
    };
    let of_logarithm = |t: f64| (t / 0.05).ln_1p();
    let shares = |grown: &dyn Fn(f64, f64) -> f64| {
        MOMENTS_S
            .windows(2)
            .map(|w| grown(w[0], w[1]) / grown(MOMENTS_S[0], MOMENTS_S[3]))
            .collect()
    };
    let found: Vec<f64> = shares(&grown);
    let chain: Vec<f64> = shares(&|from, to| of_chain(to) - of_chain(from));
    let logarithm: Vec<f64> = shares(&|from, to| of_logarithm(to) - of_logarithm(from));
    for ((found, chain), logarithm) in found.iter().zip(&chain).zip(&logarithm) {
        assert!((found / chain - 1.0).abs() < 0.02, "{found} {chain}");
        assert!((logarithm / chain - 1.0).abs() > 0.03, "{logarithm} {chain}");
    }
}

#[test]
fn piezo_gain_changes_stroke_and_loop() {
    let rig = single("piezo-gain", &[("ratio", 1.05)]);
    let stroke = |rig: &Rig| {
        let x = run(rig, 1e4, 2.0, triangle(90.0, 1.0)).position_m.remove(0);
        (x[15_000] - x[10_000], x[17_500] - x[12_500])
    };
    let (more, plain) = (stroke(&rig), stroke(&one_axis()));
    // 5 % more force a volt, less what the charge that goes with it costs in the elements: T^2 over the whole stiffness is a fifth
    // to a third of the capacitance that draws it.
    let by = more.0 / plain.0;
    assert!((1.03..1.05).contains(&by), "{by}");
    assert!(more.1 / plain.1 > more.0 / plain.0, "more charge, wider loop");
}
