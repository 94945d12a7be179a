//! Every effect: at zero it is not there, it grows from there without a jump, no value inside its bounds breaks the
//! simulation, and it shows the signature that its description claims.

mod common;

use std::f64::consts::TAU;

use common::{loop_area, one_axis, rms, run, run_from, triangle, worst};
use host_sim::effects::{self, Effect, Role, Scope};
use host_sim::rig::{Rig, Setting};
use host_sim::{Axes, Input, Output, Place, simulate};

/// Fast and slow, large and small, all axes differently.
fn probe(axis: usize, t: f64) -> f64 {
    let k = axis as f64;
    let slow = triangle(50.0 + 10.0 * k, 4.0 + k)(t);
    let step = if (0.15..0.3).contains(&t) { 60.0 } else { 0.0 };
    slow + step + 3.0 * (TAU * (90.0 + 20.0 * k) * t).sin()
}

fn probed(rig: &Rig) -> Output {
    run_from(rig, 1e4, 3.0, 0.5, probe)
}

fn place_of(effect: &dyn Effect) -> Place {
    match effect.info().scope {
        Scope::Axis => Place::Axis(1),
        Scope::Pair | Scope::ReciprocalPair => Place::Pair { on: 1, from: 2 },
    }
}

/// The nominal rig with an effect at `share` of its typical sizes.
fn with(effect: &'static dyn Effect, share: f64) -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    let setting = rig.setting_mut(effect, place_of(effect));
    for (value, parameter) in setting.values.iter_mut().zip(effect.info().parameters) {
        if parameter.role == Role::Size {
            *value = if parameter.log && parameter.zero != 0.0 {
                parameter.zero * (parameter.typical / parameter.zero).powf(share)
            } else {
                parameter.zero + share * (parameter.typical - parameter.zero)
            };
        }
    }
    rig
}

fn set(name: &str, place: Place, values: &[(&str, f64)]) -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    for (parameter, value) in values {
        rig.set(name, place, parameter, *value).unwrap();
    }
    rig.validate().unwrap();
    rig
}

#[test]
fn the_catalogue_is_that_of_the_contract() {
    let Some(path) = shared_data::find("contract.md") else { return };
    let text = std::fs::read_to_string(path).unwrap();
    let start = text.find("Effects (stage):").unwrap();
    let listed = &text[start..start + text[start..].find("The project may").unwrap()];
    // `name` `name` (stage) · ...
    let mut count = 0;
    for group in listed.split('·') {
        let stage = group[group.rfind('(').unwrap() + 1..].split(')').next().unwrap();
        for name in group.split('`').skip(1).step_by(2) {
            let effect = effects::find(name).unwrap_or_else(|| panic!("{name} is missing"));
            assert_eq!(effect.info().stage.name(), stage, "{name}");
            count += 1;
        }
    }
    assert_eq!(count, 27);
    assert_eq!(effects::catalogue().len(), 27);
}

#[test]
fn descriptions_are_complete() {
    for effect in effects::catalogue() {
        let info = effect.info();
        let name = info.name;
        for text in [info.physics, info.source, info.revealed_by] {
            assert!(text.len() > 10, "{name}");
        }
        for other in info.confused_with {
            assert!(effects::find(other).is_some(), "{name} is confused with unknown {other}");
        }
        assert!(info.parameters.iter().any(|p| p.role == Role::Size), "{name}");
        for p in info.parameters {
            assert!(p.min < p.max && (p.min..=p.max).contains(&p.zero), "{name}.{}", p.name);
            assert!((p.min..=p.max).contains(&p.typical), "{name}.{}", p.name);
            assert!(p.role == Role::Shape || p.typical != p.zero, "{name}.{}", p.name);
            assert!(!p.log || p.min > 0.0, "{name}.{}", p.name);
        }
    }
}

#[test]
fn at_zero_the_nominal_rig_is_left_bit_identical() {
    let nominal = probed(&Rig::named("handley").unwrap());
    for effect in effects::catalogue() {
        let mut rig = Rig::named("handley").unwrap();
        for place in Place::all(effect.info().scope, 3) {
            let mut setting = Setting::at_zero(*effect, place);
            for (value, parameter) in setting.values.iter_mut().zip(effect.info().parameters) {
                if parameter.role == Role::Shape {
                    *value = 0.5 * (parameter.min + parameter.max);
                }
            }
            *rig.setting_mut(*effect, place) = setting;
        }
        let output = probed(&rig);
        assert_eq!(output.position_m, nominal.position_m, "{}", effect.info().name);
        assert_eq!(output.monitor_v, nominal.monitor_v, "{}", effect.info().name);
    }
}

#[test]
fn effects_grow_from_zero_without_a_jump() {
    let nominal = probed(&Rig::named("handley").unwrap());
    for effect in effects::catalogue() {
        let name = effect.info().name;
        let change = |share: f64| {
            let output = probed(&with(*effect, share));
            rms(&output.position_m[1], &nominal.position_m[1])
        };
        let (full, half, tiny) = (change(1.0), change(0.5), change(1.0e-6));
        assert!(full > 0.2e-9, "{name} at its typical size does {:.3} nm", full * 1e9);
        // A swinging mass switches sub-steps on: that is the only jump, of the size of the integration error.
        let jump = if name == "second-mass" { 2.0e-11 } else { 1.0e-13 };
        assert!(tiny < 1.0e-4 * full + jump, "{name} jumps by {:.6} nm", tiny * 1e9);
        if !effect.info().threshold {
            assert!((0.1..0.9).contains(&(half / full)), "{name}: half gives {:.3}", half / full);
        }
    }
}

#[test]
fn only_the_axes_it_acts_on_move() {
    let nominal = probed(&Rig::named("handley").unwrap());
    for effect in effects::catalogue() {
        let output = probed(&with(*effect, 1.0));
        let name = effect.info().name;
        assert_eq!(output.position_m[0], nominal.position_m[0], "{name}");
        let other = output.position_m[2] != nominal.position_m[2];
        assert_eq!(other, effect.info().scope == Scope::ReciprocalPair, "{name}");
        // Only what happens in front of the monitor shows in it.
        let electrical = matches!(effect.info().stage.name(), "drive" | "amplifier");
        let shows = worst(&output.monitor_v[1], &nominal.monitor_v[1]) > 1e-9;
        assert_eq!(shows, electrical, "{name}");
    }
}

#[test]
fn no_value_inside_the_bounds_breaks_the_simulation() {
    for effect in effects::catalogue() {
        let info = effect.info();
        for index in 0..info.parameters.len() {
            for extreme in [info.parameters[index].min, info.parameters[index].max] {
                let mut rig = with(*effect, 1.0);
                rig.setting_mut(*effect, place_of(*effect)).values[index] = extreme;
                rig.validate().unwrap();
                let output = run_from(&rig, 1e4, 3.0, 0.05, probe);
                let finite = output.position_m.iter().flatten().all(|x| x.is_finite());
                assert!(finite, "{}.{} = {extreme}", info.name, info.parameters[index].name);
            }
        }
    }
}

#[test]
fn axes_wanted_alone_read_the_same() {
    for effect in effects::catalogue() {
        let rig = with(*effect, 1.0);
        let channels: Vec<Vec<f64>> = (0..3)
            .map(|axis| (0..2000).map(|i| probe(axis, f64::from(i) * 1e-4)).collect())
            .collect();
        let channels: Vec<&[f64]> = channels.iter().map(Vec::as_slice).collect();
        let input = Input {
            sample_rate_hz: 1e4,
            start_s: 3.0,
            ticks: None,
            drive_v: &channels,
            monitor_v: None,
            initial: &[],
        };
        let all = simulate(&rig, &input, Axes::All).unwrap();
        let one = simulate(&rig, &input, Axes::Only(0b010)).unwrap();
        assert_eq!(one.position_m[1], all.position_m[1], "{}", effect.info().name);
        assert!(one.position_m[0].is_empty() && one.position_m[2].is_empty());
    }
}

// ---- signatures ----

const ONE: Place = Place::Axis(0);

fn single(name: &str, values: &[(&str, f64)]) -> Rig {
    let mut rig = set(name, ONE, values);
    rig.axes.truncate(1);
    rig
}

/// Response at `hz` to a sine of `amplitude` volts on `bias`: (gain m/V, phase rad).
fn response(rig: &Rig, bias: f64, amplitude: f64, hz: f64) -> (f64, f64) {
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
    let difference = rms(&half.position_m[0], &every);
    assert!(difference < 0.3e-9, "{:.3} nm", difference * 1e9);
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
        // The charge branch of the neighbour holds back a little.
        let ratio = -moved / by * 53.4e6 / 1.4e5;
        assert!((0.75..1.01).contains(&ratio), "{ratio}");
    }
}

#[test]
fn amplifier_bandwidth_scales_the_time_constant() {
    let rig = single("amplifier-bandwidth", &[("ratio", 2.0)]);
    let v = run(&rig, 1e4, 0.1, |t| if t < 0.05 { 0.0 } else { 10.0 }).monitor_v.remove(0);
    assert!((v[508] - 10.0 * (1.0 - (-1.0f64).exp())).abs() < 1e-9);
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
fn clipping_stands_at_one_voltage() {
    let rig = single("amplifier-clipping", &[("max_v", 70.0), ("softness_v", 0.01)]);
    let output = run(&rig, 1e4, 1.0, triangle(90.0, 2.0));
    let top = output.monitor_v[0].iter().copied().fold(0.0, f64::max);
    assert!((top - 70.0).abs() < 0.02);
    let plain = run(&one_axis(), 1e4, 0.15, triangle(90.0, 2.0));
    assert!(worst(&output.monitor_v[0][..1500], &plain.monitor_v[0]) < 1e-6);
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
    // Hum of the amplifier moves the stack, with hysteresis; hum of the sensor does not.
    let rig = single("amplifier-hum", &[("sin_v", 1.0)]);
    assert!(run(&rig, 1e4, 0.1, |_| 40.0).position_m[0][550..].iter().any(|x| *x > 3e-6));
}

#[test]
fn a_stronger_hysteresis_widens_the_loop_and_a_longer_slip_moves_it_to_large_strokes() {
    let cycle = |rig: &Rig, peak: f64| {
        let output = run(rig, 1e4, 2.0, triangle(peak, 1.0));
        loop_area(&output.monitor_v[0][10_000..], &output.position_m[0][10_000..])
    };
    let nominal = [cycle(&one_axis(), 20.0), cycle(&one_axis(), 90.0)];
    let strong = single("hysteresis-shape", &[("strength", 1.2)]);
    // Less charge flows through stronger elements: the loop is wider for its stroke.
    let stroke = |rig: &Rig| run(rig, 1e4, 0.6, triangle(90.0, 1.0)).position_m[0][5000];
    let per_stroke = |rig: &Rig| cycle(rig, 90.0) / stroke(rig).powi(2);
    let wider = per_stroke(&strong) / per_stroke(&one_axis());
    assert!((1.05..1.3).contains(&wider), "{wider}");
    let tilted = single("hysteresis-shape", &[("tilt", 1.0)]);
    let by = [cycle(&tilted, 20.0) / nominal[0], cycle(&tilted, 90.0) / nominal[1]];
    assert!(by[0] < 0.8 && by[1] > by[0] + 0.1, "{by:?}");
    let long = single("hysteresis-shape", &[("slip", 1.5)]);
    assert!(cycle(&long, 20.0) < 0.8 * nominal[0]);
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
fn a_linear_rig_can_get_hysteresis() {
    let mut rig = Rig::named("micromanipulator").unwrap();
    rig.set("hysteresis-shape", ONE, "strength", 1.5).unwrap();
    let x = run(&rig, 200.0, 4.0, triangle(3.6, 1.0)).position_m.remove(0);
    let gap = x[700 - 50] - x[600 + 50 - 50 + 50 - 50];
    assert!(gap > 0.5e-6, "{gap}");
}

#[test]
fn rate_dependence_widens_the_fast_loop_and_leaves_the_slow_one() {
    let area = |rig: &Rig, hz: f64| {
        let output = run(rig, 1e4, 3.0 / hz, triangle(60.0, hz));
        let n = (1e4 / hz) as usize;
        loop_area(&output.monitor_v[0][2 * n..], &output.position_m[0][2 * n..])
    };
    let growth = single("hysteresis-rate", &[("per_decade", 0.3), ("reference_a", 1e-3)]);
    let loss = single("hysteresis-rate", &[("resistance_ohm", 300.0)]);
    for rig in [growth, loss] {
        let slow = area(&rig, 0.5) / area(&one_axis(), 0.5);
        let fast = area(&rig, 50.0) / area(&one_axis(), 50.0);
        assert!((slow - 1.0).abs() < 0.05 && fast > 1.05, "{slow} {fast}");
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
    // A decade, whichever it is, adds about the same: 1.5 % of the stroke, a little less behind the charge branch.
    for step in [b - a, c - b, d - c] {
        assert!((0.011..0.0165).contains(&(step / a)), "{:?}", [b / a, c / b, d / c]);
    }
    let half = grown(30.0);
    let share = (half[3] - half[0]) / (d - a);
    assert!((0.4..0.55).contains(&share), "{share}");
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
    assert!(x[7999] > 1.02 * nominal.position_m[0][7999]);
}

#[test]
fn stiffness_lowers_the_stroke_by_the_ratio_of_springs() {
    let softer = |change: f64| {
        let rig = single("stiffness", &[("change_n_per_m", change)]);
        response(&rig, 40.0, 0.05, 5.0).0
    };
    let ratio = softer(5e6) / response(&one_axis(), 40.0, 0.05, 5.0).0;
    // (k_p + k + T^2 S/(1 + C S)) over the same with 5e6 more: all elements hold at 50 mV.
    let held = 53.4e6 + 7.1f64.powi(2) * 238.1e3 / (1.0 + 1.063e-6 * 238.1e3);
    assert!((ratio - held / (held + 5e6)).abs() < 2e-3, "{ratio}");
}

#[test]
fn hardening_shifts_the_gain_with_bias_and_bending_sensors_do_too_but_not_the_resonance() {
    let gain = |rig: &Rig, bias: f64, hz: f64| response(rig, bias, 0.2, hz).0;
    let drop = |rig: &Rig| gain(rig, 80.0, 20.0) / gain(rig, 10.0, 20.0);
    let plain = drop(&one_axis());
    let mut hard = single("stiffness-hardening", &[("cubic_n_per_m3", 3e16)]);
    assert!(drop(&hard) < 0.93 * plain, "{} {plain}", drop(&hard));
    let mut bent = single("sensor-nonlinearity", &[("cubic_per_m2", -3e8)]);
    assert!(drop(&bent) < 0.95 * plain);
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
    for (rig, kink, expected) in [(open, 3e-6, 48.6 / 53.4), (stop, 5e-6, 53.4 / 73.4)] {
        let output = run(&rig, 1e4, 0.5, triangle(90.0, 1.0));
        let (x, v) = (&output.position_m[0], &output.monitor_v[0]);
        let slope = |at: f64| {
            let i = x.iter().position(|x| *x > at).unwrap();
            (x[i + 20] - x[i]) / (v[i + 20] - v[i])
        };
        let ratio = slope(kink + 0.05e-6) / slope(kink - 0.15e-6);
        // The charge branch adds up to 9.6e6 N/m on both sides.
        assert!((ratio - expected).abs() < 0.06, "{ratio} instead of {expected}");
    }
}

#[test]
fn inertia_rings_at_the_root_of_stiffness_over_mass() {
    let rig = single("inertia", &[("added_kg", 0.3), ("added_damping_n_s_per_m", 100.0)]);
    // All elements hold at this amplitude: the charge branch stiffens the mode.
    let held = 53.4e6 + 7.1f64.powi(2) * 238.1e3 / (1.0 + 1.063e-6 * 238.1e3);
    let expected = (held / 0.3013).sqrt() / TAU;
    let peak = (0..40)
        .map(|i| expected - 400.0 + 20.0 * f64::from(i))
        .max_by(|a, b| {
            response(&rig, 40.0, 0.02, *a).0.total_cmp(&response(&rig, 40.0, 0.02, *b).0)
        })
        .unwrap();
    assert!((peak - expected).abs() < 50.0, "{peak} {expected}");
}

#[test]
fn a_second_mass_makes_a_dip_at_its_own_frequency_and_a_peak_below() {
    let rig = single(
        "second-mass",
        &[("mass_kg", 0.2), ("frequency_hz", 800.0), ("damping_ratio", 0.005)],
    );
    let change = |hz: f64| response(&rig, 40.0, 0.1, hz).0 / response(&one_axis(), 40.0, 0.1, hz).0;
    assert!((change(5.0) - 1.0).abs() < 1e-3, "static gain: {}", change(5.0));
    assert!(change(800.0) < 0.7, "dip: {}", change(800.0));
    // Its spring in series with the stage: 800 Hz * sqrt(K/(K + k2)), K from 53.4e6 to 63e6 N/m.
    let peak = (0..12).map(|i| change(745.0 + 4.0 * f64::from(i))).fold(0.0, f64::max);
    assert!(peak > 1.2, "peak: {peak}");
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
        let extra = gap(&rig) - gap(&one_axis());
        assert!((extra / (10.0 / 53.4e6) - 1.0).abs() < 0.35, "{peak} V: {:.1} nm", extra * 1e9);
    }
    // Whatever the speed.
    let gap = |hz: f64, rate: f64| {
        let n = (rate / hz) as usize;
        let x = run(&rig, rate, 2.0 / hz, triangle(60.0, hz)).position_m.remove(0);
        x[n + 3 * n / 4] - x[n + n / 4]
    };
    assert!((gap(1.0, 1e4) / gap(0.2, 2e3) - 1.0).abs() < 0.02);
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
    // On a ramp a low-pass lags by its time constant.
    let slow = read("sensor-bandwidth", &[("time_constant_s", 3e-4)]);
    let lag = (x[1000] - slow[1000]) / (x[1001] - x[1000]) * 1e-4;
    assert!((lag - 3e-4).abs() < 2e-5, "{lag}");
    let values = [("rate_m_per_s", 1e-9), ("settling_m", 5e-8), ("settling_s", 60.0)];
    let drift = run_from(&single("sensor-drift", &values), 1e3, 600.0, 1.0, |_, _| 0.0);
    assert!((drift.position_m[0][500] - 600.5e-9 - 5e-8).abs() < 1e-11);
}

#[test]
fn piezo_gain_changes_stroke_and_loop() {
    let rig = single("piezo-gain", &[("ratio", 1.05)]);
    let stroke = |rig: &Rig| {
        let x = run(rig, 1e4, 2.0, triangle(90.0, 1.0)).position_m.remove(0);
        (x[15_000] - x[10_000], x[17_500] - x[12_500])
    };
    let (more, plain) = (stroke(&rig), stroke(&one_axis()));
    assert!((1.03..1.05).contains(&(more.0 / plain.0)));
    assert!(more.1 / plain.1 > more.0 / plain.0, "more charge, wider loop");
}
