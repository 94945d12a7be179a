//! The second paper's chains against solutions that share no code with them: closed forms, the massless limit, a
//! classical explicit Runge-Kutta with tiny steps in other coordinates, and the implicit solver.

use host_sim::platform::{
    Mass, PlatformRig, compliance_m_per_n, forced_response, free_return, integrate,
    modes::{self, Release},
    presets, rig,
    statics::{held_positions_m, static_test, stiffness_from_test},
    time_to_fraction_s,
};
use proptest::prelude::*;

fn chain(masses: &[(f64, f64, f64)]) -> PlatformRig {
    let mass = |(m, k, c): &(f64, f64, f64)| Mass {
        mass_kg: *m,
        stiffness_n_per_m: Some(*k),
        damping_n_s_per_m: *c,
        ..Mass::default()
    };
    PlatformRig::new("test", 200.0, masses.iter().map(mass).collect())
}

fn branch(stiffness: f64, damping: f64) -> Option<rig::Viscoelasticity> {
    Some(rig::Viscoelasticity {
        stiffness_n_per_m: vec![stiffness],
        damping_n_s_per_m: vec![damping],
    })
}

fn times(count: usize, period_s: f64) -> Vec<f64> {
    (0..count).map(|i| i as f64 * period_s).collect()
}

fn max_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The four real roots and the times of the derived planar platform (project notes on the second paper), and the massless
/// limit: under no force each spring with its damper returns on its own, x = sum (F/k_i) exp(-k_i t / c_i).
#[test]
fn planar_platform_has_four_real_roots_and_the_massless_limit() {
    let rig = presets::named("belfiore-planar-two-mass").unwrap();
    let release = Release::from_rest(&rig, presets::PLANAR_DEFLECTION_M).unwrap();
    let roots: Vec<f64> = release.modes().iter().map(|m| m.root_per_s.re).collect();
    assert!(release.modes().iter().all(|m| m.root_per_s.im == 0.0), "{roots:?}");
    for (root, expected) in roots.iter().zip([-0.625, -8.333, -4.12e4, -5.59e5]) {
        assert!((root / expected - 1.0).abs() < 2e-3, "{root} {expected}");
    }
    assert!(!release.uses_matrix_exponential());

    let times = times(1600, 0.005);
    let position = free_return(&rig, presets::PLANAR_DEFLECTION_M, &times, 0.0).unwrap();
    let force: f64 = presets::PLANAR_DEFLECTION_M * 4.0e3;
    let limit: Vec<f64> = times
        .iter()
        .map(|t| {
            force / 6.0e3 * (-6.0e3 / 9600.0 * t).exp()
                + force / 12.0e3 * (-12.0e3 / 1440.0 * t).exp()
        })
        .collect();
    // Masses of tens of grams delay it by about 1/4.1e4 s at 4.6 mm/s: 0.1 um of 1 430.
    assert!(max_difference(&position, &limit) < 2e-7);
    for (fraction, expected) in [(0.5, 0.48), (0.1, 3.0), (0.02, 5.6)] {
        let time =
            time_to_fraction_s(&times, &position, presets::PLANAR_DEFLECTION_M, fraction).unwrap();
        assert!((time / expected - 1.0).abs() < 0.03, "{fraction}: {time}");
    }
}

/// Every root is a zero of det(lambda² M + lambda C + K), evaluated by nalgebra on the full matrices.
#[test]
fn roots_solve_the_characteristic_equation() {
    let rig = chain(&[(0.02, 900.0, 3.0), (0.05, 400.0, 0.4), (0.01, 2500.0, 1.0)]);
    let matrices = modes::Matrices::of(&rig);
    let roots = modes::roots(&rig).unwrap();
    assert_eq!(roots.len(), 6);
    assert!(roots.iter().any(|r| r.im != 0.0), "an underdamped chain oscillates: {roots:?}");
    for root in roots {
        let complex = |m: &nalgebra::DMatrix<f64>| m.map(nalgebra::Complex::from);
        let dynamic = complex(&matrices.mass) * (root * root)
            + complex(&matrices.damping) * root
            + complex(&matrices.stiffness);
        let size: f64 = dynamic.column_iter().map(|c| c.norm()).product();
        assert!(dynamic.determinant().norm() < 1e-10 * size, "{root}");
    }
}

/// One mass against the textbook formulas: oscillating, critical and overdamped.
#[test]
fn one_mass_by_the_textbook() {
    let times = times(400, 0.002);
    let x0 = 1.0e-3;
    let (m, k): (f64, f64) = (0.05, 400.0);
    let omega = (k / m).sqrt();
    for ratio in [0.05, 0.5, 1.0, 3.0, 40.0] {
        let decay = ratio * omega;
        let exact: Vec<f64> = times
            .iter()
            .map(|t| {
                if ratio < 1.0 {
                    let damped = omega * f64::sqrt(1.0 - ratio * ratio);
                    let (sin, cos) = (damped * t).sin_cos();
                    x0 * (-decay * t).exp() * (cos + decay / damped * sin)
                } else if ratio == 1.0 {
                    x0 * (-omega * t).exp() * (1.0 + omega * t)
                } else {
                    let spread = omega * f64::sqrt(ratio * ratio - 1.0);
                    let (a, b) = (-decay + spread, -decay - spread);
                    x0 * (a * (b * t).exp() - b * (a * t).exp()) / (a - b)
                }
            })
            .collect();
        let rig = chain(&[(m, k, ratio * 2.0 * (k * m).sqrt())]);
        let position = free_return(&rig, x0, &times, 0.0).unwrap();
        assert!(max_difference(&position, &exact) < 1e-9 * x0, "damping ratio {ratio}");
    }
}

/// Coinciding roots have no modes; the matrix exponential takes over.
#[test]
fn coinciding_roots_are_solved_too() {
    let rig = chain(&[(1.0, 1.0, 2.0)]);
    let release = Release::from_rest(&rig, 1.0).unwrap();
    assert!(release.uses_matrix_exponential());
    let times = times(200, 0.05);
    let exact: Vec<f64> = times.iter().map(|t| (1.0 + t) * (-t).exp()).collect();
    assert!(max_difference(&release.platform_m(&times, None), &exact) < 1e-10);
    let stepped = integrate::platform_m(&rig, &[1.0], &times).unwrap();
    assert!(max_difference(&stepped, &exact) < 1e-6);
}

/// The paper's cases by the implicit solver: planar and both spatial ones, one and two masses, seconds long.
#[test]
fn implicit_steps_agree_with_the_exact_solution() {
    let times = times(1600, 0.005);
    let planar = &[presets::PLANAR_DEFLECTION_M][..];
    let spatial = &presets::SPATIAL_DEFLECTIONS_M[..];
    for (name, deflections) in [
        ("belfiore-planar", planar),
        ("belfiore-planar-two-mass", planar),
        ("belfiore-spatial", spatial),
        ("belfiore-spatial-two-mass", spatial),
    ] {
        let rig = presets::named(name).unwrap();
        for deflection in deflections {
            let exact = free_return(&rig, *deflection, &times, 0.0).unwrap();
            let held = held_positions_m(&rig, *deflection).unwrap();
            let stepped = integrate::platform_m(&rig, &held, &times).unwrap();
            let difference = max_difference(&exact, &stepped);
            assert!(difference < 1e-6 * deflection, "{name} {deflection}: {difference}");
            assert!(exact[1599] < 0.03 * deflection && exact[200] > 0.3 * deflection);
        }
    }
}

/// Why the chain is not stepped explicitly: Euler at 10 kHz leaves the numbers.
#[test]
fn explicit_euler_at_10_khz_is_unstable() {
    let rig = presets::named("belfiore-planar-two-mass").unwrap();
    let matrix = modes::state_matrix(&rig);
    let mut z = nalgebra::DVector::from_vec(vec![0.953e-3, 1.43e-3, 0.0, 0.0]);
    for _ in 0..200 {
        z += &matrix * &z * 1e-4;
    }
    assert!(z.amax() > 1.0 || z.amax().is_nan(), "grew to {}", z.amax());
}

/// Classical Runge-Kutta (explicit, tiny steps) on the stretches of the springs, with the position of each branch's dashpot
/// as its memory: another formulation of the same physics.
fn explicit_steps(
    masses: &[(f64, f64, f64)],
    branches: &[(usize, f64, f64)],
    x0: f64,
    step_s: f64,
    steps: usize,
) -> Vec<f64> {
    let n = masses.len();
    let series: f64 = 1.0 / masses.iter().map(|(_, k, _)| 1.0 / k).sum::<f64>();
    let mut z: Vec<f64> = masses.iter().map(|(_, k, _)| x0 * series / k).collect();
    z.extend(vec![0.0; n]);
    z.extend(branches.iter().map(|(spring, _, _)| x0 * series / masses[*spring].1));
    let rate = |z: &[f64]| {
        let tension = |i: usize| {
            let branches = branches.iter().enumerate().filter(|(_, b)| b.0 == i);
            masses[i].1 * z[i]
                + masses[i].2 * z[n + i]
                + branches.map(|(b, (_, k, _))| k * (z[i] - z[2 * n + b])).sum::<f64>()
        };
        let acceleration = |i: usize| {
            let outer = if i + 1 < n { tension(i + 1) } else { 0.0 };
            (outer - tension(i)) / masses[i].0
        };
        let mut out = z[n..2 * n].to_vec();
        out.extend((0..n).map(|i| acceleration(i) - if i > 0 { acceleration(i - 1) } else { 0.0 }));
        out.extend(
            branches.iter().enumerate().map(|(b, (i, k, c))| k / c * (z[*i] - z[2 * n + b])),
        );
        out
    };
    let mut position = Vec::new();
    for _ in 0..steps {
        position.push(z[..n].iter().sum());
        let ahead =
            |k: &[f64], h: f64| -> Vec<f64> { z.iter().zip(k).map(|(z, k)| z + h * k).collect() };
        let k1 = rate(&z);
        let k2 = rate(&ahead(&k1, step_s / 2.0));
        let k3 = rate(&ahead(&k2, step_s / 2.0));
        let k4 = rate(&ahead(&k3, step_s));
        for i in 0..z.len() {
            z[i] += step_s / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
        }
    }
    position
}

#[test]
fn explicit_steps_in_other_coordinates_agree() {
    let masses = [(0.5, 300.0, 20.0), (0.3, 800.0, 4.0), (0.2, 500.0, 9.0)];
    let branches = [(1, 400.0, 60.0), (2, 150.0, 300.0)];
    let mut rig = chain(&masses);
    for (spring, k, c) in branches {
        rig.masses[spring].effects.viscoelasticity = branch(k, c);
    }
    let (x0, step) = (2.0e-3, 1e-4);
    let truth = explicit_steps(&masses, &branches, x0, step, 30_000);
    let truth: Vec<f64> = truth.iter().step_by(50).copied().collect();
    let times = times(truth.len(), step * 50.0);
    let exact = free_return(&rig, x0, &times, 0.0).unwrap();
    assert!(max_difference(&exact, &truth) < 1e-8 * x0);
    let held = held_positions_m(&rig, x0).unwrap();
    let stepped = integrate::platform_m(&rig, &held, &times).unwrap();
    assert!(max_difference(&stepped, &truth) < 1e-5 * x0);
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Random chains, from oscillating to strongly overdamped: the exact solution starts where the platform was held,
    /// follows the step-by-step solver, and never grows; the rig survives its file.
    #[test]
    fn random_chains(
        elements in prop::collection::vec((-2.5f64..0.5, 2.0f64..4.5, -0.5f64..4.5), 1..5),
        relaxing in prop::option::of((0usize..4, 1.5f64..4.0, 0.0f64..4.0)),
        deflection in 1e-4f64..5e-3,
    ) {
        let parameters: Vec<(f64, f64, f64)> = elements
            .iter()
            .map(|(m, k, c)| (10f64.powf(*m), 10f64.powf(*k), 10f64.powf(*c)))
            .collect();
        let mut rig = chain(&parameters);
        if let Some((spring, k, c)) = relaxing {
            let spring = spring.min(rig.masses.len() - 1);
            rig.masses[spring].effects.viscoelasticity = branch(10f64.powf(k), 10f64.powf(c));
        }
        prop_assert_eq!(&PlatformRig::parse(&rig.to_toml(), "again").unwrap(), &rig);
        let times = times(120, 0.01);
        let exact = free_return(&rig, deflection, &times, 0.0).unwrap();
        prop_assert!((exact[0] / deflection - 1.0).abs() < 1e-7, "starts at {}", exact[0]);
        let held = held_positions_m(&rig, deflection).unwrap();
        let stepped = integrate::platform_m(&rig, &held, &times).unwrap();
        let difference = max_difference(&exact, &stepped);
        prop_assert!(difference < 2e-5 * deflection, "differs by {difference} of {deflection}");
        for root in modes::roots(&rig).unwrap() {
            prop_assert!(root.re < 0.0, "unstable root {root}");
        }
    }
}

/// Hardening: the static force is k x + c x³, and in the massless limit the return obeys v = -(k x + c x³) / damping,
/// a Bernoulli equation: u = 1/x² gives u' = 2 (k u + c) / damping.
#[test]
fn hardening_return_has_its_closed_form() {
    let (k, c3, damping) = (4.0e3, 3.0e9, 4.0e3);
    let hardening = Some(rig::StiffnessHardening { cubic_n_per_m3: c3 });
    let mut rig = chain(&[(1e-3, k, damping)]);
    rig.masses[0].effects.stiffness_hardening = hardening;
    let x0 = 1.43e-3;
    let held = static_test(&rig, &[x0]).unwrap()[0].force_n;
    assert!((held / (k * x0 + c3 * x0.powi(3)) - 1.0).abs() < 1e-12);
    let times = times(400, 0.01);
    let position = free_return(&rig, x0, &times, 0.0).unwrap();
    let exact: Vec<f64> = times
        .iter()
        .map(|t| {
            let u0 = 1.0 / (x0 * x0);
            let u = (u0 + c3 / k) * (2.0 * k / damping * t).exp() - c3 / k;
            1.0 / u.sqrt()
        })
        .collect();
    assert!(max_difference(&position, &exact) < 1e-5 * x0);
    // Two such springs in series share the deflection equally.
    let mut two = chain(&[(0.01, k, damping), (0.01, k, damping)]);
    for mass in &mut two.masses {
        mass.effects.stiffness_hardening = hardening;
    }
    let held = held_positions_m(&two, x0).unwrap();
    assert!((held[0] / (x0 / 2.0) - 1.0).abs() < 1e-9);
}

/// Friction F in the massless limit: x = (x0 - F/k) exp(-k t / c) + F/k, so the platform stops at F/k.
#[test]
fn friction_leaves_the_platform_away_from_zero() {
    let mut rig = chain(&[(0.05, 4.0e3, 400.0)]);
    rig.masses[0].effects.friction = Some(rig::Friction { force_n: 0.8 });
    let times = times(400, 0.01);
    let position = free_return(&rig, 1.43e-3, &times, 0.0).unwrap();
    let exact: Vec<f64> =
        times.iter().map(|t| (1.43e-3 - 0.2e-3) * (-10.0 * t).exp() + 0.2e-3).collect();
    assert!(max_difference(&position[..60], &exact[..60]) < 3e-6);
    // Below the regularisation speed it creeps by less than a micrometre a second.
    assert!((position[399] - 0.2e-3).abs() < 4e-6, "stuck at {}", position[399]);
}

/// Force against displacement gives back the stiffness, and the springs of the chain act in series.
#[test]
fn static_test_gives_the_stiffness() {
    let rig = presets::named("belfiore-planar-two-mass").unwrap();
    let displacements: Vec<f64> = (0..8).map(|i| f64::from(i) * 0.2e-3).collect();
    let test = static_test(&rig, &displacements).unwrap();
    assert!((stiffness_from_test(&test).unwrap() / 4.0e3 - 1.0).abs() < 1e-12);
    assert!((rig.static_stiffness_n_per_m() / 4.0e3 - 1.0).abs() < 1e-12);
    assert_eq!(stiffness_from_test(&test[..1]), None);
}

/// Forced: a step settles at F/k, and a sine has the compliance of the frequency domain.
#[test]
fn forced_response_matches_step_and_frequency() {
    let rig = chain(&[(0.5, 900.0, 8.0), (0.3, 400.0, 5.0)]);
    let step = forced_response(&rig, &vec![2.0; 20_000], 1e-3).unwrap();
    assert_eq!(step[0], 0.0);
    assert!((step[19_999] / (2.0 / rig.static_stiffness_n_per_m()) - 1.0).abs() < 1e-6);

    let (frequency, rate) = (4.0, 20_000.0);
    let phase = |i: usize| std::f64::consts::TAU * frequency * i as f64 / rate;
    let force: Vec<f64> = (0..200_000).map(|i| phase(i).sin()).collect();
    let position = forced_response(&rig, &force, 1.0 / rate).unwrap();
    let (mut sin, mut cos) = (0.0, 0.0);
    for (i, position) in position.iter().enumerate().skip(100_000) {
        sin += position * phase(i).sin() / 50_000.0;
        cos += position * phase(i).cos() / 50_000.0;
    }
    let compliance = compliance_m_per_n(&rig, frequency);
    // A held force lags by half a sample: 0.6 mrad here.
    assert!((sin - compliance.re).abs() < 2e-3 * compliance.norm());
    assert!((cos - compliance.im).abs() < 2e-3 * compliance.norm());
    let soft = compliance_m_per_n(&rig, 1e-6).norm();
    assert!((soft * rig.static_stiffness_n_per_m() - 1.0).abs() < 1e-6);
}

/// Gain, curve, offset and drift on the session's clock; the lag against its closed form: y' = (x - y)/0.1 from y = x with
/// x = exp(-t) gives y = (10 exp(-t) - exp(-10 t)) / 9.
#[test]
fn sensor_effects_act_on_the_reading() {
    let mut rig = chain(&[(1e-3, 4.0e3, 4.0e3)]);
    let times = times(300, 0.01);
    let plain = free_return(&rig, 1e-3, &times, 5.0).unwrap();
    rig.effects.sensor_gain = Some(rig::SensorGain { factor: 1.02 });
    rig.effects.sensor_offset = Some(rig::SensorOffset { offset_m: 3e-6 });
    rig.effects.sensor_drift = Some(rig::SensorDrift { drift_m_per_s: 1e-6 });
    rig.effects.sensor_nonlinearity = Some(rig::SensorNonlinearity { quadratic_per_m: 10.0 });
    let read = free_return(&rig, 1e-3, &times, 5.0).unwrap();
    for ((read, plain), time) in read.iter().zip(&plain).zip(&times) {
        let expected = 1.02 * plain + 10.0 * plain * plain + 3e-6 + 1e-6 * (5.0 + time);
        assert!((read - expected).abs() < 1e-15);
    }
    let mut lagging = chain(&[(1e-3, 4.0e3, 4.0e3)]);
    lagging.effects.sensor_bandwidth = Some(rig::SensorBandwidth { time_constant_s: 0.1 });
    let read = free_return(&lagging, 1e-3, &times, 0.0).unwrap();
    for (read, t) in read.iter().zip(&times) {
        let expected = 1e-3 * (10.0 * (-t).exp() - (-10.0 * t).exp()) / 9.0;
        assert!((read - expected).abs() < 1e-8, "{read} {expected}");
    }
    let stepped = integrate::platform_m(&lagging, &[1e-3], &times).unwrap();
    assert!(max_difference(&stepped, &read) < 1e-8);
}

/// Lost samples: any ascending times are fine, others are refused.
#[test]
fn times_may_jump_but_not_run_back() {
    let rig = presets::named("belfiore-planar-two-mass").unwrap();
    let position = free_return(&rig, 1e-3, &[0.0, 0.005, 0.5, 3.0], 0.0).unwrap();
    let dense = free_return(&rig, 1e-3, &times(601, 0.005), 0.0).unwrap();
    assert_eq!(position[2], dense[100]);
    assert!(free_return(&rig, 1e-3, &[0.0, 1.0, 0.5], 0.0).is_err());
    assert!(free_return(&rig, 1e-3, &[f64::NAN], 0.0).is_err());
}

/// The rig file that came with the recording is the preset.
#[test]
fn shared_rig_file_is_the_preset() {
    let Some(path) = shared_data::find("rigs/belfiore-planar.toml") else { return };
    let rig = PlatformRig::load(&path).unwrap();
    assert_eq!(rig.masses, presets::named("belfiore-planar").unwrap().masses);
    assert_eq!(PlatformRig::parse(&rig.to_toml(), "again").unwrap(), rig);
}
