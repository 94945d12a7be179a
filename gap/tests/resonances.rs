//! Masses that ring: every axis at a frequency of its own, far from where a screen looks.

use gap::{Options, diagnose};
use host_sim::effects::Place;
use host_sim::rig::Rig;

mod common;

#[test]
fn every_axis_gets_the_mass_that_it_has() {
    let nominal = Rig::named("handley").expect("library rig");
    let masses_kg = [0.36, 0.45, 0.55];
    let mut heavy = nominal.clone();
    for (axis, kg) in masses_kg.into_iter().enumerate() {
        heavy.set("inertia", Place::Axis(axis), "added_kg", kg).expect("known parameter");
    }
    let session = common::session_of(&heavy, common::squares, |_, _, um| um);
    let outcome = diagnose(&nominal, &session, &Options::default()).expect("a diagnosis");
    let diagnosis = outcome.diagnosis;
    let found: Vec<_> = diagnosis.causes.iter().map(|c| (c.effect.as_str(), &c.axes[..])).collect();
    assert_eq!(found, [("inertia", &[1, 2, 3][..])], "{:?}", diagnosis.gap);
    for (axis, kg) in masses_kg.into_iter().enumerate() {
        let name = format!("added_kg_{}", axis + 1);
        let value = diagnosis.causes[0].parameters[&name].value;
        assert!((value - kg).abs() < 0.01 * kg, "axis {}: {value} kg for {kg}", axis + 1);
    }
}

#[test]
fn a_lag_of_two_poles_is_one_cause() {
    let nominal = Rig::named("handley").expect("library rig");
    let mut slow = nominal.clone();
    for axis in 0..3 {
        let mut set = |parameter, value| {
            slow.set("sensor-bandwidth", Place::Axis(axis), parameter, value)
                .expect("known parameter");
        };
        set("time_constant_s", 5.2e-4);
        set("curvature", 0.49);
    }
    let session = common::session_of(&slow, common::squares, |_, _, um| um);
    let outcome = diagnose(&nominal, &session, &Options::default()).expect("a diagnosis");
    let diagnosis = outcome.diagnosis;
    let found: Vec<_> = diagnosis.causes.iter().map(|c| (c.effect.as_str(), &c.axes[..])).collect();
    assert_eq!(found, [("sensor-bandwidth", &[1, 2, 3][..])], "{:?}", diagnosis.gap);
    // Axes that agree share a number.
    let parameters = diagnosis.causes[0].parameters.iter();
    let curvatures: Vec<f64> = parameters
        .filter(|(name, _)| name.starts_with("curvature"))
        .map(|(_, fitted)| fitted.value)
        .collect();
    assert!(!curvatures.is_empty());
    assert!(curvatures.iter().all(|c| (c - 0.49).abs() < 0.02), "{curvatures:?}");
}

/// Its resonance with the axis lies a third below its own.
#[test]
fn a_heavy_part_that_swings_is_no_mass_that_sits_fast() {
    let diagnosis = common::drawn(1616, 74, &["second-mass"]);
    assert_eq!(common::causes(&diagnosis), [("second-mass", &[3][..])]);
}

/// A sweep ends where the axis rings, and nothing else of the session goes there.
#[test]
fn a_mass_is_found_at_the_end_of_a_sweep() {
    let diagnosis = common::drawn(1818, 44, &["inertia"]);
    assert_eq!(common::causes(&diagnosis), [("inertia", &[3][..])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn two_parts_that_swing_are_found_on_every_axis() {
    // 0.24 kg at 607 Hz, a quarter of that at 1700 Hz; without the second one no axis but the loudest comes out.
    let diagnosis = common::drawn(16161, 102, &["second-mass"]);
    assert_eq!(common::causes(&diagnosis), [("second-mass", &[1, 2, 3][..])]);
    let parameters = &diagnosis.causes[0].parameters;
    let further_hz = parameters["further_hz_1"].value;
    assert!((1680.0..1720.0).contains(&further_hz), "{further_hz}");
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn an_axis_that_rings_at_the_end_of_one_sweep_alone_is_checked_there() {
    // Two thirds of that sweep, by time, show nothing of it.
    let diagnosis = common::drawn(16161, 98, &["inertia"]);
    assert_eq!(common::causes(&diagnosis), [("inertia", &[1, 2, 3][..])]);
    assert!(diagnosis.gap.closed > 0.99, "{}", diagnosis.gap.closed);
}

#[test]
fn a_mass_that_rings_beyond_half_the_sample_rate_is_found_by_its_alias() {
    // 2.9 kHz in recordings of 5 kHz, and on the other axis next to nothing of it: that one rings near the first.
    let diagnosis = common::drawn(20202, 6, &["inertia"]);
    common::assert_explained(&diagnosis, &[("inertia", &[2, 3][..])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_part_that_swings_is_found_on_an_axis_that_hardly_shows_it() {
    // A fortieth of the other axis, and most of what a gain leaves on its own.
    let diagnosis = common::drawn(20202, 107, &["second-mass", "sensor-gain"]);
    let named = [("sensor-gain", &[2, 3][..]), ("second-mass", &[1, 2])];
    common::assert_explained(&diagnosis, &named);
}

#[test]
fn a_mass_of_forty_grams_is_found_by_its_alias() {
    // It rings at 5.9 kHz, which at 10 kHz is seen at 4.1.
    let diagnosis = common::drawn_of_the_paper(37373, 102, &["inertia"]);
    common::assert_explained(&diagnosis, &[("inertia", &[1, 2, 3])]);
}

#[test]
fn a_light_mass_that_rings_just_beyond_half_the_rate_of_the_loop_is_found_by_its_alias() {
    // 5.2 kHz at 10 kHz: what is seen rings at 4.8 kHz.
    let diagnosis = common::drawn(27272, 56, &["inertia"]);
    common::assert_explained(&diagnosis, &[("inertia", &[3][..])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn two_parts_that_ring_as_loud_as_each_other_are_found() {
    // The first one alone accounts for less than half of the gap.
    let diagnosis = common::drawn(29292, 113, &["second-mass"]);
    common::assert_explained(&diagnosis, &[("second-mass", &[3][..])]);
    assert!(diagnosis.gap.closed > 0.99, "{}", diagnosis.gap.closed);
}
