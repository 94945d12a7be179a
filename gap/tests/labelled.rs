//! The labelled sessions of `data/open`: recordings of an independent simulator whose missing effects are known.

use std::path::Path;

use gap::Options;
use gap::diagnosis::Verdict;
use host_sim::rig::Rig;
use recording::Session;

fn diagnose(id: &str) -> Option<gap::Outcome> {
    let folder = shared_data::find(&format!("data/open/{id}"))?;
    let rig = Rig::load(&folder.join("rig.toml")).expect("rig file");
    let session = Session::read(&folder, None).expect("session");
    Some(gap::diagnose(&rig, &session, &Options::default()).expect("diagnosis"))
}

/// Cause names with axes; each name may be the named cause or one that the tool cannot tell from it.
fn expect(id: &str, truth: &[(&str, &[usize])], least_closed: f64) {
    let Some(outcome) = diagnose(id) else { return };
    let d = &outcome.diagnosis;
    assert_eq!(d.verdict, Verdict::Explained, "{id}: {}", gap::sentence(d));
    assert_eq!(d.causes.len(), truth.len(), "{id}: {}", gap::sentence(d));
    for (effect, axes) in truth {
        let cause = d
            .causes
            .iter()
            .find(|c| c.effect == *effect || c.indistinguishable_from.iter().any(|n| n == effect))
            .unwrap_or_else(|| panic!("{id}: {effect} not among {}", gap::sentence(d)));
        assert_eq!(cause.axes, *axes, "{id}: {effect}");
    }
    assert!(d.gap.closed > least_closed, "{id}: closed {}", d.gap.closed);
    let json = serde_json::to_value(d).expect("serialises");
    for key in ["verdict", "gap", "where", "causes", "next_experiment", "recordings"] {
        assert!(json.get(key).is_some(), "{key} is missing from diagnosis.json");
    }
    assert!(outcome.report.to_html().contains("<svg"));
    Rig::parse(&outcome.rig.to_toml(), "rig.toml").expect("the written rig is read again");
}

#[test]
fn o1_has_no_gap() {
    let Some(outcome) = diagnose("o1") else { return };
    assert_eq!(outcome.diagnosis.verdict, Verdict::NoGap, "{}", gap::sentence(&outcome.diagnosis));
    assert!(outcome.diagnosis.causes.is_empty());
}

#[test]
fn o2_creeps() {
    expect("o2", &[("creep", &[1, 2, 3])], 0.95);
}

#[test]
fn o3_has_a_slow_amplifier() {
    expect("o3", &[("amplifier-bandwidth", &[2])], 0.95);
}

#[test]
fn o4_is_coupled() {
    expect("o4", &[("stiffness-coupling", &[1, 2, 3])], 0.95);
}

#[test]
fn o5_is_heavier_and_has_another_hysteresis() {
    expect("o5", &[("hysteresis-shape", &[1, 2, 3]), ("inertia", &[1, 2, 3])], 0.95);
}

#[test]
fn o6_is_not_in_the_catalogue() {
    let Some(outcome) = diagnose("o6") else { return };
    let d = &outcome.diagnosis;
    assert_eq!(d.verdict, Verdict::Unexplained, "{}", gap::sentence(d));
    assert!(d.causes.is_empty());
    assert_eq!((d.location[0].axis, d.location[0].stage.as_str()), (3, "sensor"));
}

#[test]
fn recordings_of_another_rig_are_refused_by_name() {
    let Some(folder) = shared_data::find("data/open/o1") else { return };
    let mut rig = Rig::load(&folder.join("rig.toml")).expect("rig file");
    rig.axes.truncate(1);
    let session = Session::read(Path::new(&folder), None).expect("session");
    let Err(error) = gap::diagnose(&rig, &session, &Options::default()) else {
        panic!("must be refused")
    };
    let line = error.to_string();
    assert!(line.contains("axis 2") && !line.contains('\n'), "{line}");
}
