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
