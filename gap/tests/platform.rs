//! Diagnosis of platforms: returns made by formulas of their own (closed forms and explicit steps), and the independent
//! simulator's recording where it is at hand.

use std::path::{Path, PathBuf};

use gap::Options;
use gap::diagnosis::{Diagnosis, Role, Verdict};
use gap::platform::{Outcome, diagnose, identify, replay};
use host_sim::platform::{PlatformRig, presets};
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use recording::{Entry, Meta, Recording, Session};

const RATE_HZ: f64 = 200.0;

/// White noise of unit size: the sum of twelve uniform numbers.
fn gauss(rng: &mut SmallRng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// A recording of `position` (um, over s) with noise (um).
fn recorded(
    name: &str,
    initial_um: f64,
    seconds: f64,
    noise_um: f64,
    seed: u64,
    position: impl Fn(f64) -> f64,
) -> Entry {
    let mut rng = SmallRng::seed_from_u64(seed);
    let mut meta = Meta::new("free return", RATE_HZ);
    meta.initial_position_um = Some(initial_um);
    let mut recording = Recording::empty(meta, 1);
    let count = (seconds * RATE_HZ) as u64;
    recording.tick = (0..count).collect();
    let values = (0..count)
        .map(|i| (position(i as f64 / RATE_HZ) + noise_um * gauss(&mut rng)) as f32)
        .collect();
    recording.position_um = vec![Some(values)];
    recording.drive_v = vec![vec![0.0; count as usize]];
    Entry { path: PathBuf::from(name), file: name.to_owned(), recording }
}

/// Two springs with dampers on their own: the massless limit of a two-mass chain, in closed form.
fn two_springs(initial: f64, share: f64, slow: f64, fast: f64) -> impl Fn(f64) -> f64 {
    move |t| initial * (share * (-slow * t).exp() + (1.0 - share) * (-fast * t).exp())
}

fn one_mass() -> PlatformRig {
    presets::named("belfiore-planar").unwrap()
}

fn answer(rig: &PlatformRig, recordings: Vec<Entry>) -> Outcome {
    diagnose(rig, &Session { recordings, ..Session::default() }, &Options::default()).unwrap()
}

fn check_format(diagnosis: &Diagnosis) {
    let json = serde_json::to_value(diagnosis).unwrap();
    for key in ["verdict", "gap", "where", "causes", "next_experiment", "recordings"] {
        assert!(json.get(key).is_some(), "{key}");
    }
    assert!(diagnosis.recordings.iter().any(|r| r.role == Role::Fit));
    assert!(diagnosis.recordings.iter().any(|r| r.role == Role::HeldOut));
    let gap = &diagnosis.gap;
    assert!(gap.closed_ci95[0] <= gap.closed && gap.closed <= gap.closed_ci95[1]);
}

/// Names the second mass, with what cannot be told from it, and closes the gap to the noise.
fn check_second_mass(outcome: &Outcome) {
    let diagnosis = &outcome.diagnosis;
    check_format(diagnosis);
    assert_eq!(diagnosis.verdict, Verdict::Explained);
    assert_eq!(diagnosis.causes.len(), 1, "{:?}", diagnosis.causes);
    let cause = &diagnosis.causes[0];
    assert_eq!((cause.effect.as_str(), cause.stage.as_str()), ("second-mass", "mechanism"));
    assert_eq!(cause.indistinguishable_from, ["viscoelasticity"]);
    assert!(diagnosis.next_experiment.is_some());
    assert_eq!(diagnosis.location.len(), 1);
    let gap = &diagnosis.gap;
    assert!(gap.after_nm < 1.03 * gap.floor_nm, "{} over {}", gap.after_nm, gap.floor_nm);
    assert!(gap.before_nm > 3.0 * gap.after_nm);
    assert!(gap.closed > 0.99);
    assert_eq!(outcome.rig.masses.len(), 2);
}

#[test]
fn one_recording_names_the_second_mass_and_its_dampers() {
    let recording =
        recorded("a", 1430.0, 8.0, 4.0, 7, two_springs(1430.0, 2.0 / 3.0, 0.625, 25.0 / 3.0));
    let outcome = answer(&one_mass(), vec![recording]);
    check_second_mass(&outcome);
    for (index, damper) in [(0, 9600.0), (1, 1440.0)] {
        let found = outcome.rig.masses[index].damping_n_s_per_m;
        assert!((found / damper - 1.0).abs() < 0.02, "damper {index}: {found}");
    }
    let notes = outcome.diagnosis.notes.join("\n");
    for statement in [
        "Mass of mass 1",
        "Common scale of forces",
        "Order of the springs",
        "Where in time",
        "drift",
    ] {
        assert!(notes.contains(statement), "{statement} in {notes}");
    }
    let html = outcome.report.to_html();
    assert!(html.contains("<svg") && html.contains("second-mass"));
}

/// What is taken out of the catalogue is not named, neither as a cause nor beside one.
#[test]
fn an_effect_out_of_the_catalogue() {
    let truth = two_springs(1430.0, 2.0 / 3.0, 0.625, 25.0 / 3.0);
    let session = Session {
        recordings: vec![recorded("a", 1430.0, 8.0, 4.0, 7, truth)],
        ..Session::default()
    };
    let options = Options { exclude: vec!["second-mass".into()], ..Options::default() };
    let causes = diagnose(&one_mass(), &session, &options).unwrap().diagnosis.causes;
    assert_eq!(causes[0].effect, "viscoelasticity");
    assert!(causes[0].indistinguishable_from.is_empty(), "{causes:?}");
}

/// Intervals of 95 % hold the truth about as often as they say: 30 recordings, four figures each.
#[test]
fn intervals_hold_the_truth() {
    let rig = presets::named("belfiore-planar-two-mass").unwrap();
    let (mut inside, mut all) = (0, 0);
    for seed in 100..130 {
        let truth = two_springs(1430.0, 2.0 / 3.0, 0.625, 25.0 / 3.0);
        let session = Session {
            recordings: vec![recorded("a", 1430.0, 8.0, 4.0, seed, truth)],
            ..Session::default()
        };
        let found = identify(&rig, &session).unwrap();
        for (name, truth) in [
            ("damping_n_s_per_m_1", 9600.0),
            ("damping_n_s_per_m_2", 1440.0),
            ("time_constant_s_1", 1.6),
            ("time_constant_s_2", 0.12),
        ] {
            let [low, high] =
                found.parameters.iter().find(|p| p.name == name).unwrap().estimate.ci95;
            all += 1;
            inside += usize::from(low < truth && truth < high);
        }
    }
    assert!(inside * 100 >= all * 87, "{inside} of {all}");
}

/// Two deflections: the other one is held out, and a third that nobody has seen is predicted to the noise.
#[test]
fn other_deflections_are_predicted() {
    let spatial = presets::named("belfiore-spatial").unwrap();
    let truth = |initial| two_springs(initial, 2.0 / 3.0, 0.4545, 5.0);
    let outcome = answer(
        &spatial,
        vec![
            recorded("small", 1710.0, 8.0, 4.0, 1, truth(1710.0)),
            recorded("large", 2680.0, 8.0, 4.0, 2, truth(2680.0)),
        ],
    );
    check_second_mass(&outcome);
    let role = |file: &str| {
        outcome.diagnosis.recordings.iter().find(|r| r.file == file).map(|r| r.role).unwrap()
    };
    assert_eq!((role("large"), role("small")), (Role::Fit, Role::HeldOut));
    let unseen = recorded("unseen", 900.0, 8.0, 0.0, 3, truth(900.0));
    let rig = PlatformRig::parse(&outcome.rig.to_toml(), "rig.toml").unwrap();
    let predicted = replay(&rig, &unseen.recording, Path::new("unseen")).unwrap();
    let pair = |r: &Recording| r.position_um[0].clone().unwrap();
    let worst = pair(&predicted)
        .iter()
        .zip(pair(&unseen.recording))
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(worst < 1.0, "{worst} um");
}

/// A rig that is right has no gap, whatever the noise does.
#[test]
fn no_gap_is_said() {
    for seed in 0..6 {
        let truth = |t: f64| 1430.0 * (-4.0e3 / 4.1e3 * t).exp();
        let outcome = answer(&one_mass(), vec![recorded("a", 1430.0, 8.0, 4.0, seed, truth)]);
        assert_eq!(outcome.diagnosis.verdict, Verdict::NoGap, "seed {seed}");
        assert!(outcome.diagnosis.causes.is_empty());
        assert_eq!(outcome.rig.masses, one_mass().masses);
    }
}

/// A wrong damper is a wrong value, not missing physics; stiffness would do as well.
#[test]
fn a_wrong_damper_is_parametric() {
    let truth = |t: f64| 1430.0 * (-4.0e3 / 5.2e3 * t).exp();
    let outcome = answer(&one_mass(), vec![recorded("a", 1430.0, 8.0, 4.0, 5, truth)]);
    let diagnosis = &outcome.diagnosis;
    assert_eq!(diagnosis.verdict, Verdict::Explained);
    assert_eq!(diagnosis.causes[0].effect, "damping");
    assert_eq!(diagnosis.causes[0].indistinguishable_from, ["stiffness"]);
    assert_eq!(diagnosis.causes.len(), 1);
    assert!((outcome.rig.masses[0].damping_n_s_per_m / 5.2e3 - 1.0).abs() < 0.01);
}

/// An offset of the reading is not taken for mechanics.
#[test]
fn an_offset_is_the_sensor() {
    let truth = |t: f64| 1430.0 * (-4.0e3 / 4.1e3 * t).exp() + 25.0;
    let outcome = answer(&one_mass(), vec![recorded("a", 1430.0, 8.0, 4.0, 9, truth)]);
    let diagnosis = &outcome.diagnosis;
    assert_eq!(diagnosis.causes.len(), 1, "{:?}", diagnosis.causes);
    assert_eq!(diagnosis.causes[0].effect, "sensor-offset");
    assert_eq!(diagnosis.location[0].stage, "sensor");
    assert!((diagnosis.causes[0].parameters["offset_m"].value - 25e-6).abs() < 1e-6);
}

/// Hardening changes the shape with the deflection: two deflections tell it from a second mass.
#[test]
fn hardening_is_told_from_a_second_mass() {
    // v = -(k x + c x^3) / damping in closed form.
    let truth = |x0: f64| {
        move |t: f64| {
            let (rate, ratio) = (1.0, 1.0e-6); // 1/s, cubic over linear per um^2
            let u = (1.0 / (x0 * x0) + ratio) * f64::exp(2.0 * rate * t) - ratio;
            1.0 / u.sqrt()
        }
    };
    let outcome = answer(
        &one_mass(),
        vec![
            recorded("small", 700.0, 8.0, 4.0, 1, truth(700.0)),
            recorded("large", 1430.0, 8.0, 4.0, 2, truth(1430.0)),
        ],
    );
    let causes: Vec<&str> = outcome.diagnosis.causes.iter().map(|c| c.effect.as_str()).collect();
    assert!(causes.contains(&"stiffness-hardening"), "{causes:?}");
    assert!(!causes.contains(&"second-mass"), "{causes:?}");
    assert!(outcome.diagnosis.gap.after_nm < 1.1 * outcome.diagnosis.gap.floor_nm);
}

/// A creeping motion that no effect has: the tool must not call it explained.
#[test]
fn what_is_not_in_the_catalogue_is_not_explained() {
    let truth = |t: f64| {
        1430.0 * (-4.0e3 / 4.1e3 * t).exp() + 40.0 * (std::f64::consts::TAU * 1.3 * t).sin()
    };
    let outcome = answer(&one_mass(), vec![recorded("a", 1430.0, 8.0, 4.0, 5, truth)]);
    let verdict = outcome.diagnosis.verdict;
    assert!(matches!(verdict, Verdict::Unexplained | Verdict::PartlyExplained), "{verdict:?}");
}

/// A lightly damped platform rings, and then its mass can be told.
#[test]
fn identify_tells_masses_only_where_they_show() {
    let (m, k, c): (f64, f64, f64) = (0.08, 300.0, 1.0);
    let omega = (k / m - (c / (2.0 * m)).powi(2)).sqrt();
    let decay = c / (2.0 * m);
    let truth = move |t: f64| {
        1000.0 * (-decay * t).exp() * ((omega * t).cos() + decay / omega * (omega * t).sin())
    };
    let mut rig = one_mass();
    rig.masses[0].mass_kg = 0.07;
    rig.masses[0].stiffness_n_per_m = Some(k);
    rig.masses[0].damping_n_s_per_m = 1.3;
    let session = Session {
        recordings: vec![recorded("a", 1000.0, 4.0, 4.0, 5, truth)],
        ..Session::default()
    };
    let found = identify(&rig, &session).unwrap();
    assert!(
        (found.rig.masses[0].mass_kg / m - 1.0).abs() < 5e-3,
        "{}",
        found.rig.masses[0].mass_kg
    );
    assert!((found.rig.masses[0].damping_n_s_per_m / c - 1.0).abs() < 1e-2);
    assert!(found.after_nm < 1.05 * found.floor_nm, "{} {}", found.after_nm, found.floor_nm);

    let slow = |t: f64| 1430.0 * (-t).exp();
    let session = Session {
        recordings: vec![recorded("a", 1430.0, 8.0, 4.0, 5, slow)],
        ..Session::default()
    };
    let found = identify(&one_mass(), &session).unwrap();
    assert_eq!(found.rig.masses[0].mass_kg, one_mass().masses[0].mass_kg);
    assert!((found.rig.masses[0].damping_n_s_per_m / 4.0e3 - 1.0).abs() < 5e-3);
    assert!(found.lines.join("\n").contains("not told by this return"));
}

/// Bad recordings are refused in one line that names file and key.
#[test]
fn bad_recordings_are_named() {
    let good = || recorded("a.parquet", 1430.0, 8.0, 4.0, 5, |t| 1430.0 * (-t).exp());
    let mut missing = good();
    missing.recording.meta.initial_position_um = None;
    let mut zero = good();
    zero.recording.meta.initial_position_um = Some(0.0);
    let short = recorded("a.parquet", 1430.0, 0.05, 4.0, 5, |t| 1430.0 * (-t).exp());
    let mut wide = good();
    let position = wide.recording.position_um[0].clone();
    wide.recording.position_um.push(position);
    wide.recording.drive_v.push(wide.recording.drive_v[0].clone());
    wide.recording.monitor_v = vec![None, None];
    wide.recording.reference_um = vec![None, None];
    for (entry, word) in [
        (missing, "initial_position_um"),
        (zero, "initial_position_um"),
        (short, "samples"),
        (wide, "one axis"),
    ] {
        let error =
            identify(&one_mass(), &Session { recordings: vec![entry], ..Session::default() })
                .unwrap_err()
                .to_string();
        assert!(error.starts_with("a.parquet: ") && error.contains(word), "{error}");
        assert!(!error.contains('\n'));
    }
}

/// The independent simulator's recording of figure 6: the bars of the second paper.
#[test]
fn planar_recording_of_the_independent_simulator() {
    let Some(folder) = shared_data::find("data/platform") else { return };
    let Some(rig) = shared_data::find("rigs/belfiore-planar.toml") else { return };
    let rig = PlatformRig::load(&rig).unwrap();
    let session = Session::read(&folder, None).unwrap();
    let outcome = diagnose(&rig, &session, &Options::default()).unwrap();
    check_second_mass(&outcome);
}

/// Three springs on a chain of two masses: one more mass is named, and nothing else is renamed into it.
#[test]
fn a_third_mass_is_named_on_a_chain_of_two() {
    let truth = |t: f64| {
        1430.0 * (0.55 * f64::exp(-0.5 * t) + 0.25 * f64::exp(-4.0 * t) + 0.2 * f64::exp(-30.0 * t))
    };
    let given = presets::named("belfiore-planar-two-mass").unwrap();
    let outcome = answer(&given, vec![recorded("a", 1430.0, 8.0, 4.0, 11, truth)]);
    let diagnosis = &outcome.diagnosis;
    check_format(diagnosis);
    assert_eq!(diagnosis.verdict, Verdict::Explained);
    assert_eq!(diagnosis.causes.len(), 1, "{:?}", diagnosis.causes);
    assert_eq!(diagnosis.causes[0].effect, "third-mass");
    assert!(diagnosis.causes[0].indistinguishable_from.iter().all(|e| e == "viscoelasticity"));
    assert_eq!(outcome.rig.masses.len(), 3);
    let gap = &diagnosis.gap;
    assert!(gap.after_nm < 1.05 * gap.floor_nm && gap.before_nm > 3.0 * gap.after_nm);
}
