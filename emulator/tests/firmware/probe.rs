//! From rig to verdict with the flashed image: an effect is planted behind the emulated board, `flexstage probe` drives it over its USB,
//! `flexstage diagnose` gets the session and a model without the effect, and has to name it, and nothing else.
//!
//! Where the recording itself were wrong (a drive one tick early, say), that would be named beside it: so this also tests what the
//! firmware streams.

use std::path::{Path, PathBuf};
use std::process::Command;

use host_sim::effects::Place;

use crate::common::{image, rig};
use crate::socket::start;

/// The `flexstage` program, built beside the emulator, or `None` when the test has to be skipped.
fn program() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_BIN_EXE_emulator"))
        .with_file_name(format!("flexstage{}", std::env::consts::EXE_SUFFIX));
    if !path.exists() {
        println!("skipped: no {}: `cargo xtask test` builds it before", path.display());
        return None;
    }
    Some(path)
}

/// Run it to the end; what it says when it fails is the test's failure.
fn flexstage(program: &Path, arguments: &[&str]) {
    let ran = Command::new(program).args(arguments).output().unwrap();
    let words = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{arguments:?}: {}: {words}", ran.status);
}

#[test]
fn an_effect_behind_the_emulated_board_is_named_and_nothing_else() {
    let (Some(_), Some(program)) = (image(), program()) else { return };
    let folder = std::env::temp_dir().join(format!("flexstage-probe-{}", std::process::id()));
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::create_dir_all(&folder).unwrap();
    let mut planted = rig();
    planted.set("amplifier-bandwidth", Place::Axis(0), "ratio", 1.6).unwrap();
    std::fs::write(path("model.toml"), rig().to_toml()).unwrap();
    std::fs::write(path("planted.toml"), planted.to_toml()).unwrap();
    {
        let (_emulator, address) = start(&["--rig", &path("planted.toml")]);
        let arguments = ["probe", "--connect", &address, "--length", "quick", "--axes", "1"];
        flexstage(&program, &[&arguments[..], &[&path("session")]].concat());
    }
    let arguments = ["diagnose", "--rig", &path("model.toml"), &path("session"), "--out"];
    flexstage(&program, &[&arguments[..], &[&path("out")]].concat());
    let text = std::fs::read_to_string(path("out/diagnosis.json")).unwrap();
    let diagnosis: serde_json::Value = serde_json::from_str(&text).unwrap();
    // The folder stays when the test fails: it is what one wants to look at.
    let place = folder.display();
    let causes = diagnosis["causes"].as_array().unwrap();
    let names: Vec<&str> = causes.iter().filter_map(|c| c["effect"].as_str()).collect();
    assert_eq!(names, ["amplifier-bandwidth"], "{place}");
    assert_eq!(causes[0]["axes"], serde_json::json!([1]), "{place}");
    let ratio = causes[0]["parameters"]["ratio"]["value"].as_f64().unwrap();
    assert!((ratio - 1.6).abs() < 0.02, "{ratio}: {place}");
    let (before, after) = (&diagnosis["gap"]["before_nm"], &diagnosis["gap"]["after_nm"]);
    println!("amplifier-bandwidth {ratio:.4} on axis 1: {before:.1} nm -> {after:.1} nm");
    std::fs::remove_dir_all(&folder).unwrap();
}
