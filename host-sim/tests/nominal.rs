//! The nominal plant against figures, against a general ODE solver, and against itself at other steps.

mod common;

use common::{one_axis, rms, run, run_from, triangle, worst};
use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Memory, Options, Plant, simulate};
use ode_solvers::{DVector, Rk4, System};

/// Continuous-time Goldfarb-Celanovic stack with amplifier, from its equations alone. State: amplifier V, x m,
/// velocity m/s, element voltages V.
struct Continuous {
    rig: Rig,
    target_v: f64,
}

impl System<f64, DVector<f64>> for Continuous {
    fn system(&self, _t: f64, y: &DVector<f64>, dy: &mut DVector<f64>) {
        let axis = &self.rig.axes[0];
        let piezo = &axis.piezo;
        let amplifier_rate = (self.target_v - y[0]) / axis.amplifier.time_constant_s;
        let elements = &y.as_slice()[3..];
        let transducer = y[0] - elements.iter().sum::<f64>();
        // q = T x + C v_z and v_z' = v' - sum k_i q' over the elements that do not slip. Which slip depends on the sign
        // of q', which is that of T w + C v' since the slopes are positive.
        let push = piezo.transformer_n_per_v * y[2] + piezo.capacitance_f * amplifier_rate;
        let held = |i: usize| {
            !(elements[i].abs() >= piezo.hysteresis.limit_v[i] && elements[i] * push > 0.0)
        };
        let slopes: f64 = (0..elements.len())
            .filter(|&i| held(i))
            .map(|i| 1.0 / piezo.hysteresis.capacitance_f[i])
            .sum();
        let current = push / (1.0 + piezo.capacitance_f * slopes);
        dy[0] = amplifier_rate;
        dy[1] = y[2];
        let stiffness = piezo.stiffness_n_per_m + axis.mechanism.stiffness_n_per_m;
        dy[2] = (piezo.transformer_n_per_v * transducer
            - piezo.damping_n_s_per_m * y[2]
            - stiffness * y[1])
            / piezo.mass_kg;
        for i in 0..elements.len() {
            dy[3 + i] = if held(i) { current / piezo.hysteresis.capacitance_f[i] } else { 0.0 };
        }
    }
}

#[test]
fn agrees_with_an_ode_solver() {
    // A thousandth of a tick a step: slipping starts and ends inside steps, which an adaptive solver does not survive.
    // 20 ms of held voltages that go up and down, as a converter gives them.
    let rate = 10_000.0;
    let drive = |t: f64| {
        40.0 + 40.0 * (2.0 * std::f64::consts::PI * 70.0 * t).sin() - 40.0 * (-t * 300.0).exp()
    };
    let rig = one_axis();
    let ours = run(&rig, rate, 0.02, drive);
    let mut state = DVector::zeros(11);
    state[0] = drive(0.0);
    // At rest at the first drive, elements without voltage.
    let piezo = &rig.axes[0].piezo;
    state[1] = piezo.transformer_n_per_v * state[0] / (piezo.stiffness_n_per_m + 4.8e6);
    let mut theirs = Vec::new();
    for tick in 0..ours.position_m[0].len() {
        theirs.push(state[1]);
        let system = Continuous { rig: rig.clone(), target_v: drive(tick as f64 / rate) };
        // The solver rounds the number of steps up: half a step less than a tick is a thousand steps.
        let mut solver = Rk4::new(system, 0.0, state, 0.9995 / rate, 1.0e-3 / rate);
        solver.integrate().unwrap();
        state = solver.y_out().last().unwrap().clone();
        // The solver steps a little beyond a limit before it sees it.
        for (i, limit) in piezo.hysteresis.limit_v.iter().enumerate() {
            state[3 + i] = state[3 + i].clamp(-limit, *limit);
        }
    }
    let (rms, worst) = (rms(&theirs, &ours.position_m[0]), worst(&theirs, &ours.position_m[0]));
    assert!(rms < 0.1e-9 && worst < 0.6e-9, "{:.3} nm rms, {:.3} nm worst", rms * 1e9, worst * 1e9);
}

#[test]
fn does_not_depend_on_the_step() {
    // The same held voltages at 10 kHz, with ticks of 100 us and of 25 us.
    let rig = one_axis();
    let held = |t: f64| {
        let t = ((t + 1e-9) * 10_000.0).floor() / 10_000.0;
        triangle(90.0, 20.0)(t) + 5.0 * (2.0 * std::f64::consts::PI * 333.0 * t).sin()
    };
    let coarse = run(&rig, 10_000.0, 0.3, held);
    let fine = run(&rig, 40_000.0, 0.3, held);
    let every: Vec<f64> = fine.position_m[0].iter().step_by(4).copied().collect();
    // What is left is the 32 kHz ring inside the tick in which an element starts to slip.
    let (rms, worst) = (rms(&coarse.position_m[0], &every), worst(&coarse.position_m[0], &every));
    assert!(
        rms < 0.05e-9 && worst < 0.5e-9,
        "{:.3} nm rms, {:.3} nm worst",
        rms * 1e9,
        worst * 1e9
    );
}

#[test]
fn a_heavy_mechanism_does_not_depend_on_the_step() {
    // 0.5 kg at the stack: a 1.6 kHz mode rings for tens of ticks after each edge, a radian a tick.
    let mut rig = one_axis();
    rig.axes[0].mechanism.mass_kg = 0.5;
    rig.axes[0].mechanism.damping_n_s_per_m = 200.0;
    let held = |t: f64| if ((t + 1e-9) * 40.0).floor() as i64 % 2 == 0 { 0.0 } else { 80.0 };
    let coarse = run(&rig, 10_000.0, 0.2, held);
    let fine = run(&rig, 80_000.0, 0.2, held);
    let every: Vec<f64> = fine.position_m[0].iter().step_by(8).copied().collect();
    let (rms, worst) = (rms(&coarse.position_m[0], &every), worst(&coarse.position_m[0], &every));
    assert!(rms < 0.6e-9 && worst < 4.0e-9, "{:.3} nm rms, {:.3} nm worst", rms * 1e9, worst * 1e9);
}

#[test]
fn gives_the_strokes_worked_out_for_this_rig() {
    // notes/physics.md, section 1: 90 V, first rise 10.19 um and settled loop 8.89 um in the mechanism, 11.19 um first
    // rise and 6.3 % loop stand-alone.
    let mounted = run(&one_axis(), 10_000.0, 2.0, triangle(90.0, 1.0));
    let x = &mounted.position_m[0];
    assert!((x[5000] - 10.19e-6).abs() < 0.02e-6, "first rise {}", x[5000]);
    assert!((x[15000] - x[10000] - 8.89e-6).abs() < 0.02e-6, "settled {}", x[15000] - x[10000]);
    let mut alone = one_axis();
    alone.axes[0].mechanism.stiffness_n_per_m = 0.0;
    let x = run(&alone, 10_000.0, 2.0, triangle(90.0, 1.0)).position_m.remove(0);
    assert!((x[5000] - 11.19e-6).abs() < 0.02e-6, "first rise {}", x[5000]);
    let stroke = x[15000] - x[10000];
    let widest = (1..5000).map(|i| x[20000 - i] - x[10000 + i]).fold(0.0, f64::max);
    assert!((widest / stroke - 0.063).abs() < 0.004, "width {:.4}", widest / stroke);
}

#[test]
fn lost_ticks_hold_the_drive() {
    let rig = one_axis();
    let drive: Vec<f64> = (0..2000).map(|i| triangle(60.0, 20.0)(f64::from(i) / 1e4)).collect();
    let keep = |i: &usize| !(700..900).contains(i);
    let ticks: Vec<u64> = (0..2000).filter(keep).map(|i| i as u64 + 50).collect();
    let kept: Vec<f64> = (0..2000).filter(keep).map(|i| drive[i]).collect();
    let mut held = drive.clone();
    held[700..900].fill(drive[699]);
    let input = |drive_v: &[&[f64]], ticks: Option<&[u64]>| {
        let input = Input {
            sample_rate_hz: 1e4,
            start_s: 0.0,
            ticks,
            drive_v,
            monitor_v: None,
            initial: &[],
        };
        simulate(&rig, &input, Axes::All).unwrap().position_m.remove(0)
    };
    let whole = input(&[&held], None);
    let lossy = input(&[&kept], Some(&ticks));
    let expected: Vec<f64> = (0..2000).filter(keep).map(|i| whole[i]).collect();
    assert_eq!(lossy, expected);
}

#[test]
fn a_state_carries_on_where_it_was_taken() {
    let rig = one_axis();
    let drive = |t: f64| triangle(80.0, 3.0)(t);
    let whole = run(&rig, 1e4, 1.0, drive);
    let first = run(&rig, 1e4, 0.5001, drive);
    // At rest at its end: held for long enough that nothing moves.
    let rest = run(&rig, 1e4, 0.5, |t| if t < 0.4 { drive(t) } else { 10.0 });
    let rest_of: Vec<f64> = (0..1000).map(|i| 10.0 + f64::from(i) * 0.01).collect();
    let initial = [rest.end[0].clone()];
    let input = Input {
        sample_rate_hz: 1e4,
        start_s: 0.0,
        ticks: None,
        drive_v: &[&rest_of],
        monitor_v: None,
        initial: &initial,
    };
    let carried = simulate(&rig, &input, Axes::All).unwrap();
    assert!((carried.position_m[0][0] - rest.position_m[0][4999]).abs() < 1e-13);
    assert!(worst(&whole.position_m[0][..5001], &first.position_m[0]) == 0.0);
}

/// A recording that begins 20 s after another one still creeps from it: told the past, a fresh start agrees with a run that
/// never stopped, to what hysteresis makes of the drive.
#[test]
fn creep_runs_on_from_what_went_before() {
    let mut rig = one_axis();
    rig.set("creep", host_sim::effects::Place::Axis(0), "per_decade", 0.02).unwrap();
    let rate = 1.0e3;
    let held: Vec<f64> = vec![80.0; 30_000];
    let idle: Vec<f64> = vec![0.0; 20_000];
    let later: Vec<f64> = (0..5_000).map(|i| 35.0 * (1.0 - (f64::from(i) * 0.02).cos())).collect();
    let whole: Vec<f64> = held.iter().chain(&idle).chain(&later).copied().collect();
    let simulated = |drive: &[f64], initial: &[Initial]| {
        let input = Input {
            sample_rate_hz: rate,
            start_s: 0.0,
            ticks: None,
            drive_v: &[drive],
            monitor_v: None,
            initial,
        };
        simulate(&rig, &input, Axes::All).unwrap()
    };
    let truth = simulated(&whole, &[]);
    let before = simulated(&whole[..50_000], &[]);
    // At rest T v = K x, but for the creep itself.
    let volts_per_m = (rig.axes[0].piezo.stiffness_n_per_m
        + rig.axes[0].mechanism.stiffness_n_per_m)
        / rig.axes[0].piezo.transformer_n_per_v;
    let past: Vec<host_sim::Stretch> = before.position_m[0]
        .chunks(100)
        .map(|block| host_sim::Stretch {
            lasted_s: block.len() as f64 / rate,
            transducer_v: block.iter().sum::<f64>() / block.len() as f64 * volts_per_m,
        })
        .collect();
    let state =
        |past| [Initial { memory: before.end[0].memory.clone(), past, ..Initial::default() }];
    let error = |initial: &[Initial]| {
        let fresh = simulated(&later, initial);
        let differs = fresh.position_m[0].iter().zip(&truth.position_m[0][50_000..]);
        differs.skip(100).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()))
    };
    let (blank, told) = (error(&state(None)), error(&state(Some(past.into()))));
    println!("creep of the past: {:.1} nm untold, {:.1} nm told", blank * 1e9, told * 1e9);
    assert!(blank > 2.0e-8 && told < 0.12 * blank, "{blank} {told}");
}

#[test]
fn a_measured_monitor_replaces_drive_and_amplifier() {
    let rig = one_axis();
    let drive = triangle(80.0, 3.0);
    let simulated = run(&rig, 1e4, 0.5, &drive);
    let nothing = vec![0.0; 5000];
    let initial = [Initial { memory: Memory::Virgin, ..Initial::default() }];
    let input = Input {
        sample_rate_hz: 1e4,
        start_s: 0.0,
        ticks: None,
        drive_v: &[&nothing],
        monitor_v: Some(&[&simulated.monitor_v[0]]),
        initial: &initial,
    };
    let driven = simulate(&rig, &input, Axes::All).unwrap();
    assert_eq!(driven.position_m, simulated.position_m);
}

#[test]
fn other_rates_and_other_axes() {
    for rate in [200.0, 1000.0, 6400.0, 50_000.0] {
        let x = run(&one_axis(), rate, 2.0, triangle(90.0, 1.0)).position_m.remove(0);
        let cycle = &x[rate as usize..];
        let stroke =
            cycle.iter().copied().fold(0.0, f64::max) - cycle.iter().copied().fold(1.0, f64::min);
        // At 200 Hz the held triangle tops out at 89.1 V.
        assert!((stroke - 8.89e-6).abs() < 0.12e-6, "{rate} Hz: {stroke}");
    }
    let rig = Rig::named("handley").unwrap();
    let only: Vec<f64> = (0..100).map(f64::from).collect();
    let input = Input {
        sample_rate_hz: 1e4,
        start_s: 0.0,
        ticks: None,
        drive_v: &[&only, &only, &only],
        monitor_v: None,
        initial: &[],
    };
    let output = simulate(&rig, &input, Axes::Only(0b010)).unwrap();
    assert!(output.position_m[0].is_empty() && output.position_m[2].is_empty());
    assert_eq!(output.position_m[1].len(), 100);
    let all = simulate(&rig, &input, Axes::All).unwrap();
    assert_eq!(all.position_m[1], output.position_m[1]);
}

#[test]
fn inputs_that_cannot_be_are_refused() {
    let rig = one_axis();
    let good = [0.0, 1.0];
    let base = Input {
        sample_rate_hz: 1e4,
        start_s: 0.0,
        ticks: None,
        drive_v: &[&good],
        monitor_v: None,
        initial: &[],
    };
    let refused = |input: Input| simulate(&rig, &input, Axes::All).unwrap_err().to_string();
    assert!(refused(Input { sample_rate_hz: f64::NAN, ..base }).contains("sample_rate_hz"));
    assert!(refused(Input { drive_v: &[], ..base }).contains("expected a drive for each of the 1"));
    assert!(refused(Input { drive_v: &[&[]], ..base }).contains("found none"));
    assert!(refused(Input { drive_v: &[&[0.0, f64::NAN]], ..base }).contains("sample 1"));
    assert!(refused(Input { ticks: Some(&[3, 3]), ..base }).contains("rising"));
    assert!(refused(Input { ticks: Some(&[3]), ..base }).contains("expected 2 ticks"));
    assert!(refused(Input { ticks: Some(&[3, u64::MAX]), ..base }).contains("at most"));
}

#[test]
fn the_plant_is_the_batch_with_noise() {
    let rig = Rig::named("handley").unwrap();
    let drive = |axis: usize, t: f64| triangle(30.0 * (axis + 1) as f64, 20.0)(t);
    let batch = run_from(&rig, 1e4, 0.0, 0.2, drive);
    let mut quiet = Plant::new(&rig, Options { noise: false, ..Options::default() }).unwrap();
    let mut noisy = Plant::new(&rig, Options { seed: 7, ..Options::default() }).unwrap();
    let mut again = Plant::new(&rig, Options { seed: 7, ..Options::default() }).unwrap();
    let mut sums = [0.0; 2];
    for i in 0..2000 {
        let volts: Vec<f64> = (0..3).map(|axis| drive(axis, f64::from(i) / 1e4)).collect();
        let clean = quiet.step(&volts).to_vec();
        let sensed = noisy.step(&volts).to_vec();
        assert_eq!(sensed, again.step(&volts));
        for axis in 0..3 {
            assert_eq!(clean[axis].sensed_m, batch.position_m[axis][i as usize]);
            assert_eq!(clean[axis].monitor_v, batch.monitor_v[axis][i as usize]);
            assert_eq!(sensed[axis].true_m, clean[axis].true_m);
            sums[0] += (sensed[axis].sensed_m - clean[axis].sensed_m).powi(2) / 6000.0;
            sums[1] += (sensed[axis].monitor_v - clean[axis].monitor_v).powi(2) / 6000.0;
        }
    }
    assert!((sums[0].sqrt() - 4.0e-9).abs() < 0.15e-9, "{}", sums[0].sqrt());
    assert!((sums[1].sqrt() - 0.0202).abs() < 0.0007, "{}", sums[1].sqrt());
}
