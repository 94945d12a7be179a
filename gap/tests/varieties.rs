//! Forms of an effect that a fit of its plain form does not get to. Recordings come from the simulator that is fitted, so what is asked is whether
//! the search gets there; the same forms of an independent simulator are told of in docs/blind.md.

use std::cell::RefCell;
use std::f64::consts::TAU;

use gap::diagnosis::Verdict;
use gap::{Diagnosis, Options, diagnose};
use host_sim::effects::Place;
use host_sim::rig::Rig;
use recording::Session;

mod common;

use common::{assert_explained, causes, session, session_of, squares};

fn handley() -> Rig {
    Rig::named("handley").expect("library rig")
}

/// `rig` with settings (effect, parameter, value) at some places.
fn with(rig: &Rig, places: &[Place], settings: &[(&str, &str, f64)]) -> Rig {
    let mut rig = rig.clone();
    for &place in places {
        for &(effect, parameter, value) in settings {
            rig.set(effect, place, parameter, value).expect("known parameter");
        }
    }
    rig
}

fn diagnosis_of(nominal: &Rig, session: &Session) -> Diagnosis {
    diagnose(nominal, session, &Options::default()).expect("a diagnosis").diagnosis
}

/// Value of a parameter of the first cause.
fn first(diagnosis: &Diagnosis, name: &str) -> f64 {
    diagnosis.causes[0].parameters[name].value
}

/// It shows no line in a spectrum, and from one that rings a fit lets the damping run down to none.
#[test]
fn a_mass_that_hardly_rings_is_one() {
    let settings = [("inertia", "added_kg", 0.77), ("inertia", "added_damping_n_s_per_m", 2500.0)];
    let heavy = with(&handley(), &[Place::Axis(2)], &settings);
    let diagnosis = diagnosis_of(&handley(), &session_of(&heavy, squares, |_, _, um| um));
    assert_explained(&diagnosis, &[("inertia", &[3])]);
    let damping = first(&diagnosis, "added_damping_n_s_per_m");
    assert!((damping / 2500.0 - 1.0).abs() < 0.02, "{damping} N s/m");
}

#[test]
fn a_spring_from_axis_to_axis_is_one_cause() {
    for own in [-1.0, 1.0] {
        let settings = [
            ("stiffness-coupling", "stiffness_n_per_m", 3.2e5),
            ("stiffness-coupling", "own", own),
        ];
        let tied = with(&handley(), &[Place::Pair { on: 1, from: 2 }], &settings);
        let diagnosis = diagnosis_of(&handley(), &session(&tied, |_, _, um| um));
        assert_explained(&diagnosis, &[("stiffness-coupling", &[2, 3])]);
        assert_eq!(first(&diagnosis, "own"), own);
    }
}

#[test]
fn friction_that_takes_more_to_break_loose_is_told_how_much() {
    let settings = [
        ("friction", "coulomb_n", 12.0),
        ("friction", "presliding_m", 6.0e-8),
        ("friction", "stribeck", 0.4),
        ("friction", "stribeck_m_per_s", 2.0e-4),
    ];
    let rubs = with(&handley(), &[Place::Axis(0)], &settings);
    let diagnosis = diagnosis_of(&handley(), &session(&rubs, |_, _, um| um));
    assert_explained(&diagnosis, &[("friction", &[1])]);
    let stribeck = first(&diagnosis, "stribeck");
    assert!((stribeck - 0.4).abs() < 0.05, "{stribeck}");
}

/// A bridge that is right in the middle of the travel.
#[test]
fn a_gauge_that_bends_about_its_middle_is_no_gain() {
    let bridge = |axis: usize, _: usize, um: f64| {
        if axis == 2 { um / (1.0 + 0.01 * (um - 4.0)) } else { um }
    };
    let diagnosis = diagnosis_of(&handley(), &session(&handley(), bridge));
    assert_explained(&diagnosis, &[("sensor-nonlinearity", &[3])]);
}

#[test]
fn a_gauge_may_bend_and_repeat_itself() {
    for period_um in [1.8, 4.0] {
        let bent = |_: usize, _: usize, um: f64| {
            let far = um / 10.0;
            um + 0.1 * far * far - 0.06 * far.powi(3) + 0.012 * (TAU * um / period_um).sin()
        };
        let diagnosis = diagnosis_of(&handley(), &session(&handley(), bent));
        assert_explained(&diagnosis, &[("sensor-nonlinearity", &[1, 2, 3])]);
    }
}

/// A gain that changes within recordings has no place in the catalogue.
#[test]
fn a_gain_that_changes_within_recordings_is_not_named() {
    let cracks = |axis: usize, row: usize, um: f64| {
        if axis == 0 && row > 7_000 { 0.97 * um } else { um }
    };
    let diagnosis = diagnosis_of(&handley(), &session(&handley(), cracks));
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Unexplained, vec![]));
}

/// Its strains are of one size and begin at once, where the logarithm has ever smaller ones below its onset: a stack that is built of such a chain
/// was called a mechanism that relaxes. What rings beside it, louder, must not decide whether it runs on from file to file; here it does not.
#[test]
fn creep_that_begins_sharply_is_creep_beside_a_mass() {
    let settings = [
        ("inertia", "added_kg", 0.45),
        ("inertia", "added_damping_n_s_per_m", 170.0),
        ("creep", "per_decade", 0.012),
        ("creep", "onset_s", 0.05),
        ("creep", "sharp", 1.0),
    ];
    let both = with(&handley(), &[Place::Axis(2)], &settings);
    let diagnosis = diagnosis_of(&handley(), &session_of(&both, squares, |_, _, um| um));
    assert_explained(&diagnosis, &[("inertia", &[3]), ("creep", &[3])]);
    let sharp = diagnosis.causes[1].parameters["sharp"].value;
    assert!(sharp > 0.8, "{sharp}");
}

/// A springpot: relaxation times over four and a half decades, the stiffness of each with a power of it, as a recursion on the readings.
#[test]
fn relaxation_by_a_power_of_time_is_one_cause() {
    const BRANCHES: usize = 14;
    const TIMES_S: (f64, f64) = (1.0e-3, 30.0);
    const POWER: f64 = -0.17;
    const STIFFNESS_SHARE: f64 = 0.15;
    let times_s: Vec<f64> = (0..BRANCHES)
        .map(|j| TIMES_S.0 * (TIMES_S.1 / TIMES_S.0).powf(j as f64 / (BRANCHES - 1) as f64))
        .collect();
    let all: f64 = times_s.iter().map(|t| t.powf(POWER)).sum();
    let shares: Vec<f64> = times_s.iter().map(|t| STIFFNESS_SHARE * t.powf(POWER) / all).collect();
    let dampers_um = RefCell::new(vec![0.0; BRANCHES]);
    let relaxes = |axis: usize, row: usize, um: f64| {
        if axis != 1 {
            return um;
        }
        let mut dampers_um = dampers_um.borrow_mut();
        if row == 0 {
            dampers_um.fill(um);
        }
        let held: f64 = shares.iter().zip(&*dampers_um).map(|(k, y)| k * y).sum();
        let read_um = (um + held) / (1.0 + STIFFNESS_SHARE);
        for (y, t) in dampers_um.iter_mut().zip(&times_s) {
            *y += (read_um - *y) * -(-1.0e-4 / t).exp_m1();
        }
        read_um
    };
    let diagnosis = diagnosis_of(&handley(), &session_of(&handley(), squares, relaxes));
    assert_explained(&diagnosis, &[("viscoelasticity", &[2])]);
    assert!(diagnosis.causes[0].closes > 0.97, "{}", diagnosis.causes[0].closes);
}
