//! `identify --for-control` as a person would use it: a stage that differs from its model is probed, identified, and controlled
//! with what was found. The board is the virtual one.

mod common;

use std::fs;

use common::{ok, refused, run, text};
use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Place, Rig, controller_settings};
use recording::{Meta, Recording, Session};

/// Mean error and rms about it (nm) of the true position of an axis (from 0) under feedforward alone: a sine from 2 to 10 um.
fn feedforward_error_nm(stage: &Rig, believed: &Rig, axis: usize, hz: f32) -> (f64, f64) {
    let mut settings = controller_settings(believed);
    for axis in &mut settings.axes {
        axis.feedback = Default::default();
        axis.limits.following_error_um = 0.0;
    }
    let mut bench = ClosedLoop::new(stage, &settings, Options::default()).unwrap();
    bench.arm().unwrap();
    bench.start(&[(axis as u8, GeneratorSettings::Sine(Wave::between(2.0, 10.0, hz)))]).unwrap();
    bench.run(10_000, |_| {});
    let (mut sum, mut squares) = (0.0, 0.0);
    bench.run(20_000, |step| {
        let error = 1.0e3 * (step.record.axes[axis].reference.to_f64() - step.true_um[axis]);
        sum += error;
        squares += error * error;
    });
    let mean = sum / 20_000.0;
    (mean, (squares / 20_000.0 - mean * mean).sqrt())
}

#[test]
fn a_probed_stage_is_controlled_better_with_what_was_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let nominal = Rig::named("handley").unwrap();
    let mut stage = nominal.clone();
    let axis = 1;
    stage.axes[axis].piezo.transformer_n_per_v *= 0.93;
    stage.axes[axis].piezo.hysteresis.limit_v.iter_mut().for_each(|v| *v *= 1.3);
    stage.axes[axis].mechanism.mass_kg = 0.5;
    stage.axes[axis].mechanism.damping_n_s_per_m = 200.0;
    stage.set("creep", Place::Axis(axis), "per_decade", 0.015).unwrap();
    fs::write(path("model.toml"), nominal.to_toml()).unwrap();
    fs::write(path("stage.toml"), stage.to_toml()).unwrap();
    ok(run(&[
        "probe",
        "--virtual",
        "--fast",
        "--virtual-rig",
        text(&path("stage.toml")),
        "--virtual-seed",
        "7",
        "--length",
        "standard",
        "--axes",
        "2",
        text(&path("session")),
    ]));
    let said = ok(run(&[
        "identify",
        "--for-control",
        "--rig",
        text(&path("model.toml")),
        text(&path("session")),
        "--out",
        text(&path("found.toml")),
    ]));
    println!("{said}");
    for word in ["axis 2: ", "slip elements", "last third", "amplifier", "resonance", "creep"] {
        assert!(said.contains(word), "{word} in: {said}");
    }
    assert!(said.contains("axis 1: all as it was"), "{said}");
    let found = Rig::load(&path("found.toml")).unwrap();
    assert_eq!(found.axes[0], nominal.axes[0]);
    // A probed stack has a past that nobody knows, so what it would do on its very first ascent is not in the recordings: the constant
    // is for the integral. What moves is what is found.
    for hz in [1.0, 100.0] {
        let (before_mean, before) = feedforward_error_nm(&stage, &nominal, axis, hz);
        let (after_mean, after) = feedforward_error_nm(&stage, &found, axis, hz);
        println!(
            "feedforward alone at {hz} Hz: {before_mean:.0} nm and {before:.0} nm rms about it with the model, {after_mean:.0} nm and \
             {after:.0} nm with what was found"
        );
        assert!(after < 0.25 * before, "{hz} Hz: {before:.0} nm -> {after:.0} nm");
    }

    // What is written goes on to the other commands.
    let recording = Session::read(path("session"), None).unwrap().recordings[1].path.clone();
    let (rig, out) = (path("found.toml"), path("predicted.parquet"));
    ok(run(&["replay", "--rig", text(&rig), text(&recording), "--out", text(&out)]));
    ok(run(&[
        "tune",
        "--virtual",
        "--fast",
        "--virtual-rig",
        text(&path("stage.toml")),
        "--axis",
        "2",
        "--model",
        text(&rig),
        "--json",
    ]));
}

#[test]
fn sessions_that_cannot_be_used_are_refused_in_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("rig.toml"), Rig::named("handley").unwrap().to_toml()).unwrap();
    let drive: Vec<f32> = (0..20_000).map(|n| 45.0 + 10.0 * (0.5 * n as f32).sin()).collect();
    let mut fast = Recording::empty(Meta::new("fast", 10_000.0), 3);
    fast.tick = (0..20_000).collect();
    for axis in 0..3 {
        fast.drive_v[axis] = drive.clone();
        fast.position_um[axis] = Some(drive.iter().map(|v| v / 7.5).collect());
    }
    let no_gauge = path("no-gauge.csv");
    fs::write(&no_gauge, "tick,drive_v_1\n0,1.0\n1,2.0\n").unwrap();
    for name in ["empty", "fast", "column"] {
        fs::create_dir(path(name)).unwrap();
    }
    fast.write(path("fast").join("f.parquet")).unwrap();
    fs::copy(&no_gauge, path("column").join("c.csv")).unwrap();
    for (session, words) in [
        ("empty", ["expected recordings", "none"]),
        ("fast", ["slow motion", "flexstage probe"]),
        ("column", ["position_um_1", "missing"]),
    ] {
        let said = refused(run(&[
            "identify",
            "--for-control",
            "--sample-rate",
            "10000",
            "--rig",
            text(&path("rig.toml")),
            text(&path(session)),
            "--out",
            text(&path("found.toml")),
        ]));
        for word in words {
            assert!(said.contains(word), "{session}: {word} in: {said}");
        }
        assert!(!path("found.toml").exists(), "{session}");
    }
}
