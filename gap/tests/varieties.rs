//! Forms of an effect that a fit of its plain form does not get to. Recordings come from the simulator that is fitted, so what is asked is whether
//! the search gets there; the same forms of an independent simulator are told of in docs/blind.md.

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
