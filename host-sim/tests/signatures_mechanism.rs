//! Signatures of the effects of the mechanism. Where the stack's charge branch stiffens the stage by an amount that depends
//! on how many elements slip, expected values are the interval between none and all of them.

mod common;

use std::f64::consts::TAU;

use common::{
    STAGE_N_PER_M, branch_n_per_m, one_axis, over_branch, response, run, run_from, set, single,
    triangle,
};
use host_sim::Place;
use host_sim::rig::Rig;

#[test]
fn coupling_stiffness_moves_the_neighbour_by_its_ratio() {
    // notes/physics.md, section 5: -k_ij/(k_p + k), other sign, also while the neighbour is at 90 V.
    let rig =
        set("stiffness-coupling", Place::Pair { on: 1, from: 2 }, &[("stiffness_n_per_m", 1.4e5)]);
    for bias in [0.0, 90.0] {
        let output = run_from(&rig, 1e4, 0.0, 1.5, |axis, t| match axis {
            1 => bias * (t * 10.0).min(1.0),
            2 if t > 0.5 => triangle(90.0, 1.0)(t - 0.5),
            _ => 0.0,
        });
        let moved = output.position_m[1][10_000] - output.position_m[1][5_000];
        let by = output.position_m[2][10_000] - output.position_m[2][5_000];
        let expected = over_branch(|branch| 1.4e5 / (STAGE_N_PER_M + branch));
        assert!(expected.contains(&(-moved / by)), "{} of {expected:?}", -moved / by);
    }
}

#[test]
fn viscoelasticity_is_one_exponential() {
    let rig = single("viscoelasticity", &[("branch_n_per_m", 2e6), ("time_constant_s", 0.3)]);
    let x = run(&rig, 1e3, 8.0, |t| if t < 1.0 { 0.0 } else { 60.0 }).position_m.remove(0);
    let left = |t: f64| x[7999] - x[(t * 1e3) as usize];
    // Equal ratios over equal times.
    let ratios = [left(1.3) / left(1.1), left(1.5) / left(1.3), left(1.7) / left(1.5)];
    assert!(ratios.iter().all(|r| (r - ratios[0]).abs() < 0.02), "{ratios:?}");
    assert!((ratios[0].ln() + 0.2 / 0.3).abs() < 0.1, "{ratios:?}");
    // Relaxed it is the nominal stage, unless the rig's stiffness is the one before relaxing.
    let nominal = run(&one_axis(), 1e3, 8.0, |t| if t < 1.0 { 0.0 } else { 60.0 });
    assert!((x[7999] / nominal.position_m[0][7999] - 1.0).abs() < 1e-3);
    let unrelaxed = single(
        "viscoelasticity",
        &[("branch_n_per_m", 2e6), ("time_constant_s", 0.3), ("relaxed_share", 1.0)],
    );
    let x = run(&unrelaxed, 1e3, 8.0, |t| if t < 1.0 { 0.0 } else { 60.0 }).position_m.remove(0);
    // Softer by the branch in the end, in series with the charge branch.
    let expected = over_branch(|branch| (STAGE_N_PER_M + branch) / (STAGE_N_PER_M - 2e6 + branch));
    let found = x[7999] / nominal.position_m[0][7999];
    assert!(expected.contains(&found), "{found} {expected:?}");
}

/// What is left of a step's relaxation is the mean of exponentials whose times spread over a range, alike in all decades of it or by a power.
#[test]
fn relaxation_times_spread_by_decades() {
    for (spread, power) in [(0.4, 0.0), (0.7, -0.3), (0.5, 0.5)] {
        let branch = [
            ("branch_n_per_m", 2e5),
            ("time_constant_s", 0.3),
            ("spread_decades", spread),
            ("power", power),
        ];
        let rig = single("viscoelasticity", &branch);
        let x = run(&rig, 1e3, 31.0, |t| if t < 1.0 { 0.0 } else { 60.0 }).position_m.remove(0);
        let left = |after_s: f64| x[30_999] - x[((1.0 + after_s) * 1e3) as usize];
        // Its ends are the root of three standard deviations from its middle.
        let mean = |after_s: f64| -> f64 {
            let steps = (-400..=400).map(|n| f64::from(n) / 400.0 * 3_f64.sqrt() * spread);
            let (sum, weights) = steps.fold((0.0, 0.0), |s, decades| {
                let weight = 10_f64.powf(power * decades);
                let left = (-after_s / (0.3 * 10_f64.powf(decades))).exp();
                (s.0 + weight * left, s.1 + weight)
            });
            sum / weights
        };
        for after_s in [0.1, 0.2, 0.4, 0.8, 1.5] {
            let (found, expected) = (left(after_s) / left(0.05), mean(after_s) / mean(0.05));
            let at = format!("{spread} decades, {power}, {after_s} s");
            assert!((found / expected - 1.0).abs() < 0.06, "{at}: {found} for {expected}");
            // One exponential is far off.
            let single = (-(after_s - 0.05) / 0.3_f64).exp();
            assert!(after_s < 0.8 || (single / found - 1.0).abs() > 0.1, "{at}: {single}");
        }
    }
}

#[test]
fn stiffness_lowers_the_stroke_by_the_ratio_of_springs() {
    let softer = |change: f64| {
        let rig = single("stiffness", &[("change_n_per_m", change)]);
        response(&rig, 40.0, 0.05, 5.0).0
    };
    let ratio = softer(5e6) / response(&one_axis(), 40.0, 0.05, 5.0).0;
    // All elements hold at 50 mV.
    let held = STAGE_N_PER_M + branch_n_per_m();
    assert!((ratio - held / (held + 5e6)).abs() < 2e-3, "{ratio}");
}

#[test]
fn hardening_shifts_the_gain_with_bias_and_bending_sensors_do_too_but_not_the_resonance() {
    let gain = |rig: &Rig, bias: f64, hz: f64| response(rig, bias, 0.2, hz).0;
    let drop = |rig: &Rig| gain(rig, 80.0, 20.0) / gain(rig, 10.0, 20.0);
    let plain = drop(&one_axis());
    let mut hard = single("stiffness-hardening", &[("cubic_n_per_m3", 3e16)]);
    // F = c x^3 stiffens by 3 c x^2, the reading x + b x^3 gains 1 + 3 b x^2, at the place where either bias holds the stage; all
    // elements hold at 0.2 V.
    let at = |rig: &Rig, bias: f64| run(rig, 1e4, 0.1, move |_| bias).position_m[0][999].powi(2);
    let held = STAGE_N_PER_M + branch_n_per_m();
    let expected = (held + 9e16 * at(&hard, 10.0)) / (held + 9e16 * at(&hard, 80.0));
    let found = drop(&hard) / plain;
    assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
    let mut bent = single("sensor-nonlinearity", &[("cubic_per_m2", -3e8)]);
    let (low, high) = (at(&one_axis(), 10.0), at(&one_axis(), 80.0));
    let expected = (1.0 - 9e8 * high) / (1.0 - 9e8 * low);
    let found = drop(&bent) / plain;
    assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
    // With a mass: the resonance of the hardening mechanism rises with bias.
    let peak = |rig: &mut Rig, bias: f64| {
        rig.axes[0].mechanism.mass_kg = 0.5;
        rig.axes[0].mechanism.damping_n_s_per_m = 150.0;
        let at = |hz: f64| gain(rig, bias, hz);
        (0..30)
            .map(|i| 1500.0 + 20.0 * f64::from(i))
            .max_by(|a, b| at(*a).total_cmp(&at(*b)))
            .unwrap()
    };
    assert!(peak(&mut hard, 80.0) > peak(&mut hard, 10.0) + 50.0);
    assert!((peak(&mut bent, 80.0) - peak(&mut bent, 10.0)).abs() < 30.0);
}

#[test]
fn a_kink_stands_at_one_displacement() {
    let open =
        single("preload-loss", &[("lost_share", 1.0), ("contact_m", 3e-6), ("softness_m", 1e-9)]);
    let stop = single("stiffness-hardening", &[("extra_n_per_m", 2e7), ("kink_m", 5e-6)]);
    // Beyond the kink the charge branch is as stiff as before it, or softer by an element that starts to slip on the way.
    let element = 7.10f64.powi(2) / 33.6e-6;
    let change = |before: f64, after: f64| {
        let same = over_branch(|branch| (before + branch) / (after + branch));
        let one_less = over_branch(|branch| (before + branch) / (after + branch - element));
        same.start.min(one_less.start)..same.end.max(one_less.end)
    };
    let lost = change(48.6e6, STAGE_N_PER_M);
    let hit = change(STAGE_N_PER_M, 73.4e6);
    for (rig, kink, expected) in [(open, 3e-6, lost), (stop, 5e-6, hit)] {
        let output = run(&rig, 1e4, 0.5, triangle(90.0, 1.0));
        let (x, v) = (&output.position_m[0], &output.monitor_v[0]);
        let slope = |at: f64| {
            let i = x.iter().position(|x| *x > at).unwrap();
            (x[i + 20] - x[i]) / (v[i + 20] - v[i])
        };
        let ratio = slope(kink + 0.05e-6) / slope(kink - 0.15e-6);
        assert!(expected.contains(&ratio), "{ratio} outside {expected:?}");
    }
}

#[test]
fn a_gauge_that_was_zeroed_before_the_preload_went_shows_it_at_rest() {
    let open = |since_zero: f64| {
        let values = [
            ("lost_share", 1.0),
            ("contact_m", 3e-6),
            ("softness_m", 1e-9),
            ("since_zero", since_zero),
        ];
        run(&single("preload-loss", &values), 1e4, 0.5, triangle(90.0, 1.0)).position_m.remove(0)
    };
    let closed = run(&one_axis(), 1e4, 0.5, triangle(90.0, 1.0)).position_m.remove(0);
    let [after, before] = [0.0, 1.0].map(open);
    assert!(after[0].abs() < 1e-12, "{}", after[0]);
    // The lost spring of 4.8e6 N/m pushed it 3 um up; now the stack alone holds it, and a virgin one has no charge branch at rest.
    let expected = -4.8e6 * 3e-6 / 48.6e6;
    assert!((before[0] - expected).abs() < 1e-12, "{} {expected}", before[0]);
    // Closed, it is as it always was; zeroed after, all of the opening is missing.
    let top = |x: &[f64]| x[4990];
    assert!((top(&before) - top(&closed)).abs() < 2e-8, "{} {}", top(&before), top(&closed));
    assert!(top(&after) - top(&closed) > 1e-7, "{} {}", top(&after), top(&closed));
}

#[test]
fn inertia_rings_at_the_root_of_stiffness_over_mass() {
    let rig = single("inertia", &[("added_kg", 0.3), ("added_damping_n_s_per_m", 100.0)]);
    // All elements hold at this amplitude: the charge branch stiffens the mode.
    let held = STAGE_N_PER_M + branch_n_per_m();
    let expected = (held / 0.3013).sqrt() / TAU;
    let peak = (0..40)
        .map(|i| expected - 400.0 + 20.0 * f64::from(i))
        .max_by(|a, b| {
            response(&rig, 40.0, 0.02, *a).0.total_cmp(&response(&rig, 40.0, 0.02, *b).0)
        })
        .unwrap();
    // On a grid of 20 Hz; the peak of a mode of this damping (2 %) lies within 0.1 % of the root, the top is 1 % wide.
    assert!((peak - expected).abs() <= 30.0, "{peak} {expected}");
}

#[test]
fn a_second_mass_makes_a_dip_at_its_own_frequency_and_a_peak_below() {
    let rig = single(
        "second-mass",
        &[("mass_kg", 0.2), ("frequency_hz", 800.0), ("damping_ratio", 0.005)],
    );
    let change = |hz: f64| response(&rig, 40.0, 0.1, hz).0 / response(&one_axis(), 40.0, 0.1, hz).0;
    assert!((change(5.0) - 1.0).abs() < 1e-3, "static gain: {}", change(5.0));
    // At its own frequency a swinging mass pushes back with m w^2/(2 zeta), a quarter of a period late.
    let pushes = 0.2 * (TAU * 800.0f64).powi(2) / 0.01;
    let expected = over_branch(|branch| 1.0 / (pushes / (STAGE_N_PER_M + branch)).hypot(1.0));
    // Held voltages move it by a few parts in a hundred at 12 samples a period.
    let dip = change(800.0);
    assert!(dip > 0.9 * expected.start && dip < 1.1 * expected.end, "dip: {dip} {expected:?}");
    // Its spring in series with the stage: 800 Hz * sqrt(K/(K + k2)), K from 53.4e6 to 63e6 N/m.
    let peak = (0..12).map(|i| change(745.0 + 4.0 * f64::from(i))).fold(0.0, f64::max);
    assert!(peak > 1.2, "peak: {peak}");
}

#[test]
fn a_further_part_dips_at_its_own_frequency_beside_the_first() {
    let two = [
        ("mass_kg", 0.2),
        ("frequency_hz", 800.0),
        ("damping_ratio", 0.005),
        ("further_kg", 0.05),
        ("further_hz", 1700.0),
        ("further_damping", 0.01),
    ];
    let (first, two) = (single("second-mass", &two[..3]), single("second-mass", &two));
    let gain = |rig: &Rig, hz: f64| response(rig, 40.0, 0.1, hz).0;
    assert!((gain(&two, 5.0) / gain(&one_axis(), 5.0) - 1.0).abs() < 1e-3, "static gain");
    // At its own frequency each pushes back with m w^2/(2 zeta); the other one, more than an octave away, hardly matters there.
    let pushes = 0.05 * (TAU * 1700.0f64).powi(2) / 0.02;
    let expected = over_branch(|branch| 1.0 / (pushes / (STAGE_N_PER_M + branch)).hypot(1.0));
    let dip = gain(&two, 1700.0) / gain(&first, 1700.0);
    // Held voltages move it by more at 6 samples a period.
    assert!(dip > 0.8 * expected.start && dip < 1.25 * expected.end, "dip: {dip} {expected:?}");
    let same = gain(&two, 800.0) / gain(&first, 800.0);
    assert!((same - 1.0).abs() < 0.1, "the first one's dip: {same}");
}

#[test]
fn friction_steps_by_the_same_force_at_every_reversal() {
    let rig = single("friction", &[("coulomb_n", 5.0), ("presliding_m", 2e-8)]);
    // The nominal loop, moved by 2 * 5 N / (k_p + k) between up and down, at every stroke.
    for peak in [30.0, 90.0] {
        let gap = |rig: &Rig| {
            let x = run(rig, 1e4, 2.0, triangle(peak, 1.0)).position_m.remove(0);
            x[17_500] - x[12_500]
        };
        let plain = gap(&one_axis());
        let extra = gap(&rig) - plain;
        let expected = over_branch(|branch| 10.0 / (STAGE_N_PER_M + branch));
        // The stroke is shorter by as much, and the stack's own loop goes with its cube (Rayleigh).
        let stroke = peak * 7.10 / (STAGE_N_PER_M + branch_n_per_m());
        let narrower = 3.0 * plain * expected.end / stroke;
        assert!(
            (expected.start - narrower..expected.end).contains(&extra),
            "{peak} V: {:.1} nm, {expected:?}",
            extra * 1e9
        );
    }
    // Whatever the speed.
    let gap = |hz: f64, rate: f64| {
        let n = (rate / hz) as usize;
        let x = run(&rig, rate, 2.0 / hz, triangle(60.0, hz)).position_m.remove(0);
        x[n + 3 * n / 4] - x[n + n / 4]
    };
    assert!((gap(1.0, 1e4) / gap(0.2, 2e3) - 1.0).abs() < 0.02);
}

/// With a corner it is a spring until it slips, and a constant force from there.
#[test]
fn friction_with_a_corner_is_a_spring_until_it_slips() {
    let settings = [("coulomb_n", 5.0), ("presliding_m", 1e-6), ("corner", 1.0)];
    let rig = single("friction", &settings);
    // 5 N a micrometre beside the mechanism's 4.8.
    let spring = single("stiffness", &[("change_n_per_m", 5.0e6)]);
    let rise = |rig: &Rig, volts: f64| {
        run(rig, 1e4, 1.0, |t| volts * (2.0 * t).min(1.0)).position_m.remove(0)
    };
    let (held, stiff) = (rise(&rig, 8.0), rise(&spring, 8.0));
    let reach = held[9_999];
    assert!((0.5e-6..1e-6).contains(&reach), "{reach}");
    let off = held.iter().zip(&stiff).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()));
    assert!(off < 1e-12, "{off}");
    // Once it slips the stage stays behind by 5 N over its stiffness.
    let behind = rise(&one_axis(), 60.0)[9_999] - rise(&rig, 60.0)[9_999];
    let expected = over_branch(|branch| 5.0 / (STAGE_N_PER_M + branch));
    assert!(
        (0.98 * expected.start..1.02 * expected.end).contains(&behind),
        "{behind} {expected:?}"
    );
}

/// Contacts that slip one after the other: the chord of the force over the way is what the sum of springs and sliders says.
#[test]
fn friction_slips_part_after_part() {
    let settings = |spread| {
        [("coulomb_n", 8.0), ("presliding_m", 5e-7), ("corner", 1.0), ("spread_decades", spread)]
    };
    let rise = |rig: &Rig, volts: f64| {
        *run(rig, 1e4, 1.0, |t| volts * (2.0 * t).min(1.0)).position_m[0].last().unwrap()
    };
    // A way of 0.5 to 0.6 um, between the shortest and the longest: the force is that which bends a spring of the same chord to the same place.
    let rig = single("friction", &settings(2.0));
    let reach = rise(&rig, 8.0);
    let slip_m = |part: usize| 5e-7 * 10f64.powf(2.0 * ((part as f64 + 0.5) / 8.0 - 0.5));
    let force_n: f64 = (0..8).map(|part| (reach / slip_m(part)).min(1.0)).sum();
    assert!((3.0..7.0).contains(&force_n), "{force_n} N at {reach} m");
    let chord = single("stiffness", &[("change_n_per_m", force_n / reach)]);
    assert!((rise(&chord, 8.0) / reach - 1.0).abs() < 1e-3, "{} {reach}", rise(&chord, 8.0));
    // Without a spread they all slip at once, and with the smallest one nearly so.
    let (none, least) = (single("friction", &settings(0.0)), single("friction", &settings(1e-9)));
    for volts in [8.0, 60.0] {
        assert!((rise(&none, volts) / rise(&least, volts) - 1.0).abs() < 1e-9, "{volts} V");
    }
}

/// What breaks loose at creeping speeds is more than what slides at fast ones, by the share that is asked for.
#[test]
fn friction_takes_more_to_break_loose_than_to_slide() {
    // Height of the loop halfway up and down, and the mean speed there.
    let loop_of = |rig: &Rig, hz: f64| {
        let n = (1e4 / hz) as usize;
        let x = run(rig, 1e4, 2.0 / hz, triangle(60.0, hz)).position_m.remove(0);
        let [up, down] = [n + n / 4, n + 3 * n / 4];
        let speed = |at: usize| (x[at + 1] - x[at - 1]).abs() / 2e-4;
        (x[down] - x[up], 0.5 * (speed(up) + speed(down)))
    };
    let rubs = |stribeck: f64| {
        let settings = [
            ("coulomb_n", 5.0),
            ("presliding_m", 2e-8),
            ("stribeck", stribeck),
            ("stribeck_m_per_s", 3e-4),
        ];
        single("friction", &settings)
    };
    for hz in [1.0, 20.0, 100.0] {
        let bare = loop_of(&one_axis(), hz).0;
        let (rests, speed) = loop_of(&rubs(0.4), hz);
        let found = (rests - bare) / (loop_of(&rubs(0.0), hz).0 - bare);
        let expected = 1.0 + 0.4 * (-(speed / 3e-4).powi(2)).exp();
        assert!((found / expected - 1.0).abs() < 0.02, "{hz} Hz: {found} for {expected}");
    }
}

/// A spring from axis to axis holds each of them as well; a base that both stand on gives way under each.
#[test]
fn a_spring_between_axes_may_hold_each_of_them() {
    let travel = |settings: &[(&str, f64)], stiffer: f64| {
        let mut rig = Rig::named("handley").unwrap();
        let place = Place::Pair { on: 1, from: 2 };
        for &(name, value) in settings {
            rig.set("stiffness-coupling", place, name, value).unwrap();
        }
        for axis in [1, 2] {
            rig.set("stiffness", Place::Axis(axis), "change_n_per_m", stiffer).unwrap();
        }
        run_from(&rig, 1e4, 0.0, 0.05, |axis, _| if axis == 1 { 40.0 } else { 0.0 }).position_m
    };
    for own in [-1.0, 1.0] {
        let with = travel(&[("stiffness_n_per_m", 2e5), ("own", own)], 0.0);
        let apart = travel(&[("stiffness_n_per_m", 2e5)], own * 2e5);
        let off = with.iter().flatten().zip(apart.iter().flatten());
        let off = off.fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()));
        assert!(off < 1e-14, "{own}: {off} m");
    }
}

/// A stage that starts away from zero rests where friction caught it on its way there.
#[test]
fn friction_holds_a_stage_where_it_starts() {
    for presliding_m in [1e-9, 1e-7] {
        let rig = single("friction", &[("coulomb_n", 5.0), ("presliding_m", presliding_m)]);
        let rest = |rig: &Rig| run(rig, 1e4, 0.05, |_| 60.0).position_m.remove(0);
        let (plain, held) = (rest(&one_axis()), rest(&rig));
        let short = plain[0] - held[0];
        let most = over_branch(|branch| 5.0 / (STAGE_N_PER_M + branch)).end;
        // It was let go there at no more than the friction's reach, and stays.
        assert!((0.0..1.05 * most).contains(&short), "{presliding_m}: {short} of {most}");
        let moved = (held[499] - held[0]).abs();
        assert!(moved < 0.02 * most, "{presliding_m}: {moved} of {most}");
    }
}

/// Below its creeping speed a guide rubs in proportion to the speed, far above it as it does without one.
#[test]
fn friction_falls_at_creeping_speeds() {
    let half_opened = |creeping: f64, hz: f64| {
        let settings = [("coulomb_n", 5.0), ("presliding_m", 1e-9), ("creeping_m_per_s", creeping)];
        let loop_of = |rig: &Rig| {
            let n = (1e4 / hz) as usize;
            let x = run(rig, 1e4, 2.0 / hz, triangle(60.0, hz)).position_m.remove(0);
            x[n + 3 * n / 4] - x[n + n / 4]
        };
        loop_of(&single("friction", &settings)) - loop_of(&one_axis())
    };
    // 60 V and back at 5 Hz: 7 um a tenth of a second.
    let at_all_speeds = half_opened(1e-8, 5.0);
    assert!((half_opened(7e-7, 5.0) / at_all_speeds - 1.0).abs() < 0.02);
    let slow = [2.5, 5.0].map(|hz| half_opened(7e-4, hz));
    assert!((slow[1] / slow[0] - 2.0).abs() < 0.05, "{slow:?}");
    assert!((slow[1] / at_all_speeds - 0.1).abs() < 0.02, "{slow:?} {at_all_speeds}");
}
