//! From rig to verdict, as a person would: an effect is planted in the rig behind a board, `flexstage probe` drives it over the link,
//! `flexstage diagnose` gets the session and the model without the effect, and has to name it.
//!
//! The board is the virtual one: control core and wire format of the firmware against a simulated plant, faster than real time. The same
//! from the emulated board, with the flashed image itself, is a test of the emulator.

mod common;

use common::{json, ok, run, text};
use host_sim::Rig;
use host_sim::effects::Place;

/// Probes an axis of a rig with an effect, diagnoses against the model without it: the diagnosis.
fn verdict(axis: usize, plant: impl FnOnce(&mut Rig)) -> serde_json::Value {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let nominal = Rig::named("handley").unwrap();
    let mut planted = nominal.clone();
    plant(&mut planted);
    std::fs::write(path("model.toml"), nominal.to_toml()).unwrap();
    std::fs::write(path("rig.toml"), planted.to_toml()).unwrap();
    let axis = (axis + 1).to_string();
    let (rig, session) = (path("rig.toml"), path("session"));
    let report = json(&ok(run(&[
        "probe",
        "--virtual",
        "--fast",
        "--virtual-rig",
        text(&rig),
        "--virtual-seed",
        "7",
        "--length",
        "quick",
        "--axes",
        &axis,
        "--json",
        text(&session),
    ])));
    assert_eq!(report["lost_ticks"], 0);
    let (model, out) = (path("model.toml"), path("out"));
    ok(run(&["diagnose", "--rig", text(&model), text(&session), "--out", text(&out)]));
    assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("<svg"));
    json(&std::fs::read_to_string(out.join("diagnosis.json")).unwrap())
}

/// The planted effect must be the first cause, or in the set that the data cannot tell from it.
fn assert_names(diagnosis: &serde_json::Value, effect: &str, axis: usize) {
    let first = &diagnosis["causes"][0];
    let same = first["indistinguishable_from"].as_array().cloned().unwrap_or_default();
    assert!(
        first["effect"] == effect || same.iter().any(|name| name == effect),
        "planted {effect}: {:#}",
        diagnosis["causes"]
    );
    let axes: Vec<u64> =
        first["axes"].as_array().unwrap().iter().filter_map(|a| a.as_u64()).collect();
    assert!(axes.contains(&(axis as u64 + 1)), "planted on axis {}: {axes:?}", axis + 1);
    let closed = diagnosis["gap"]["closed"].as_f64().unwrap();
    assert!(closed > 0.9, "the gap shrinks by {closed}");
}

/// Plants one, probes, diagnoses, and wants to hear of it.
fn is_named(effect: &str, axis: usize, parameter: &str, value: f64) {
    let diagnosis = verdict(axis, |rig| {
        rig.set(effect, Place::Axis(axis), parameter, value).unwrap();
    });
    assert_names(&diagnosis, effect, axis);
}

#[test]
fn creep_planted_in_the_rig_is_named() {
    is_named("creep", 1, "per_decade", 0.02);
}

#[test]
fn a_slow_amplifier_is_named() {
    is_named("amplifier-bandwidth", 0, "ratio", 1.6);
}

#[test]
fn a_rig_like_its_model_has_no_gap() {
    let diagnosis = verdict(0, |_| ());
    assert_eq!(diagnosis["verdict"], "no-gap", "{:#}", diagnosis["gap"]);
    assert_eq!(diagnosis["causes"].as_array().map(Vec::len), Some(0));
}
