//! Rig files: every rig of the project is read and written back the same; bad ones get one line that names the key.

use host_sim::rig::Rig;
use host_sim::{Place, effects};

fn message(text: &str) -> String {
    let error = Rig::parse(text, "bad.toml").expect_err("a bad rig was accepted").to_string();
    assert!(!error.contains('\n'), "more than one line: {error}");
    assert!(error.starts_with("bad.toml: "), "does not name the file: {error}");
    error
}

fn handley() -> String {
    Rig::named("handley").unwrap().to_toml()
}

#[test]
fn embedded_rigs_are_read_and_written_back_the_same() {
    for name in Rig::names() {
        let rig = Rig::named(name).unwrap();
        assert_eq!(Rig::parse(&rig.to_toml(), name).unwrap(), rig, "{name}");
    }
}

#[test]
fn embedded_rigs_are_those_of_the_contract() {
    for name in ["handley", "fsm", "fsm-independent", "micromanipulator"] {
        let Some(path) = shared_data::find(&format!("rigs/{name}.toml")) else { return };
        assert_eq!(Rig::load(&path).unwrap(), Rig::named(name).unwrap(), "{name}");
    }
}

#[test]
fn every_effect_is_written_back_the_same() {
    for effect in effects::catalogue() {
        let info = effect.info();
        let mut rig = Rig::named("handley").unwrap();
        for place in Place::all(info.scope, 3) {
            for parameter in info.parameters {
                let value = (parameter.typical * 1.1).clamp(parameter.min, parameter.max);
                rig.set(info.name, place, parameter.name, value).unwrap();
            }
        }
        rig.validate().unwrap();
        let again = Rig::parse(&rig.to_toml(), info.name).unwrap();
        assert_eq!(again, rig, "{}", info.name);
    }
}

#[test]
fn an_unknown_key_is_named() {
    let text = handley().replace("mass_kg = 0.0013", "mass_kg = 0.0013\ncolour = 3");
    let error = message(&text);
    assert!(error.contains("unknown key `colour`") && error.contains("line "), "{error}");
    let error = message(&format!("{}\n[axis.effects.creeep]\nper_decade = 0.01\n", handley()));
    assert!(error.contains("creeep: unknown effect") && error.contains("creep,"), "{error}");
    let error = message(&format!("{}\n[axis.effects.creep]\nper_year = 0.01\n", handley()));
    assert!(
        error.contains("creep.per_year: unknown key") && error.contains("per_decade"),
        "{error}"
    );
    let error = message(&format!("{}\n[axis.effects]\ncreep = 1\n", handley()));
    assert!(error.contains("creep: expected a table"), "{error}");
    let error =
        message(&format!("{}\n[[axis.effects.sensor-crosstalk]]\nshare = 0.1\n", handley()));
    assert!(error.contains("sensor-crosstalk.from: expected"), "{error}");
}

#[test]
fn impossible_values_are_refused() {
    let cases = [
        (
            "capacitance_f = 0.000001063",
            "capacitance_f = -1.0",
            "axis 1: piezo.capacitance_f: expected a number above 0, found -1",
        ),
        ("min_v = -10.0", "min_v = 200.0", "amplifier.min_v: expected less than max_v"),
        ("sample_rate_hz = 10000.0", "sample_rate_hz = 0.0", "sample_rate_hz: expected 1 to"),
        ("sample_rate_hz = 10000.0", "sample_rate_hz = nan", "sample_rate_hz: expected 1 to"),
        ("time_constant_s = 0.0004", "time_constant_s = inf", "amplifier.time_constant_s"),
        ("limit_v = [0.372, ", "limit_v = [", "as many capacitance_f as limit_v, found 8 and 7"),
        (
            "noise_rms_m = 0.000000004",
            "noise_rms_m = -1.0",
            "sensor.noise_rms_m: expected 0 or more",
        ),
        (
            "sample_rate_hz = 10000.0",
            "sample_rate_hz = 10000.0\noutput_map = [[1.0, 0.0]]",
            "output_map: expected 3 rows of 3",
        ),
        (
            "sample_rate_hz = 10000.0",
            "sample_rate_hz = 10000.0\nkind = \"boat\"",
            "kind: expected \"stage\"",
        ),
        ("name = \"handley-2002\"", "", "missing key `name`"),
        ("name = \"handley-2002\"", "name = 7", "expected a string"),
        ("[[axis]]", "[[axe]]\nx = 1\n[[axis]]", "unknown key `axe`"),
        ("= ", "= =", "line 1: "),
    ];
    for (from, to, expected) in cases {
        let text = handley();
        assert!(text.contains(from), "the test looks for {from} in\n{text}");
        let error = message(&text.replacen(from, to, 1));
        assert!(error.contains(expected), "{error}\n  lacks {expected}");
    }
    let beyond = format!("{}\n[axis.effects.creep]\nper_decade = 7\n", handley());
    let error = message(&beyond);
    assert!(error.contains("creep.per_decade on axis 3: expected 0 to 0.3"), "{error}");
    let itself =
        format!("{}\n[[axis.effects.drive-crosstalk]]\nfrom = 3\nshare = 0.1\n", handley());
    assert!(message(&itself).contains("two different axes"));
    let absent =
        format!("{}\n[[axis.effects.drive-crosstalk]]\nfrom = 4\nshare = 0.1\n", handley());
    assert!(message(&absent).contains("expected axes 1 to 3"));
}

#[test]
fn settings_are_reached_by_name() {
    let mut rig = Rig::named("handley").unwrap();
    let pair = Place::Pair { on: 2, from: 0 };
    rig.set("stiffness-coupling", pair, "stiffness_n_per_m", 1.0e5).unwrap();
    let turned = Place::Pair { on: 0, from: 2 };
    assert_eq!(rig.get("stiffness-coupling", turned, "stiffness_n_per_m"), Some(1.0e5));
    rig.set("creep", Place::Axis(1), "per_decade", 0.01).unwrap();
    assert_eq!(rig.get("creep", Place::Axis(1), "onset_s"), Some(0.02));
    assert_eq!(rig.effects.len(), 2);
    assert!(rig.remove("creep", Place::Axis(1)));
    assert!(!rig.remove("creep", Place::Axis(1)));
    assert!(rig.set("creep", Place::Axis(1), "per_year", 0.01).is_err());
    assert!(rig.set("crepe", Place::Axis(1), "per_decade", 0.01).is_err());
}
