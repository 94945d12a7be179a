//! Every command that talks to a board, against a virtual board on a local socket: what it prints, its JSON, its exit status, and what it
//! says when something is wrong.

mod common;

use std::process::Stdio;

use common::{Board, json, ok, refused, run, text};

#[test]
fn status_says_how_the_board_is() {
    let board = Board::start(&[]);
    let words = ok(board.run(&["status"]));
    assert!(words.contains("off: drives parked") && words.contains("firmware"), "{words}");
    let status = json(&ok(board.run(&["status", "--json"])));
    assert_eq!(status["state"], "off");
    assert_eq!(status["parked"], true);
    assert_eq!(status["faults"].as_array().unwrap().len(), 0);
}

#[test]
fn a_reader_that_leaves_early_is_no_error() {
    let board = Board::start(&[]);
    let mut command = board.command(&["config", "get"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    let words = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success() && words.is_empty(), "{words}");
}

#[test]
fn settings_are_checked_changed_kept_and_compared() {
    let board = Board::start(&[]);
    let name = "axes.2.feedback.proportional_v_per_um";
    ok(board.run(&["config", "set", &format!("{name}=2.5")]));
    assert_eq!(ok(board.run(&["config", "get", name])), format!("{name} = 2.5\n"));
    assert_eq!(json(&ok(board.run(&["status", "--json"])))["settings_saved"], false);
    ok(board.run(&["config", "save"]));
    assert_eq!(json(&ok(board.run(&["status", "--json"])))["settings_saved"], true);

    // Nothing of a set that is wrong somewhere takes effect.
    let words =
        refused(board.run(&["config", "set", &format!("{name}=3"), "axes.1.limits.max_v=-900"]));
    assert!(words.contains("axis 1") && words.contains("limits"), "{words}");
    assert_eq!(ok(board.run(&["config", "get", name])), format!("{name} = 2.5\n"));
    for (assignment, expected) in [
        ("axes.1.feedback.nonsense=1", "nonsense"),
        ("axes.4.feedback.integral_v_per_um_s=1", "1 to 3"),
        ("axes.1.feedback.integral_v_per_um_s=fast", "found `fast`"),
        ("axes.1.feedback.integral_v_per_um_s", "NAME=VALUE"),
    ] {
        let words = refused(board.run(&["config", "set", assignment]));
        assert!(words.contains(expected), "{assignment}: {words}");
    }

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("settings.toml");
    let toml = ok(board.run(&["config", "get", "--toml"]));
    std::fs::write(
        &file,
        toml.replace("proportional_v_per_um = 2.5", "proportional_v_per_um = 1.25"),
    )
    .unwrap();
    let words = ok(board.run(&["config", "compare", text(&file)]));
    assert_eq!(words, format!("{name}: board 2.5, file 1.25\n"));
    ok(board.run(&["config", "set", "--file", text(&file)]));
    assert!(ok(board.run(&["config", "compare", text(&file)])).contains("agree"));
}

#[test]
fn a_recording_holds_every_tick() {
    let board = Board::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let out = json(&ok(board.run(&["record", text(&file), "--seconds", "1.5", "--json"])));
    let recording = recording::Recording::read(&file).unwrap();
    // A busy test machine may lose ticks of a board that runs in real time; then they are counted.
    let lost: u64 = recording.lost().iter().map(|lost| lost.ticks).sum();
    assert_eq!(out["lost_ticks"], lost);
    assert!(
        recording.span_ticks() >= 15_000 && recording.len() as u64 + lost == recording.span_ticks()
    );
    let words = refused(board.run(&["record", text(&file), "--seconds", "1"]));
    assert!(words.contains("not overwritten"), "{words}");
    // CSV there and back.
    let csv = folder.path().join("a.csv");
    ok(run(&["export", text(&file), text(&csv)]));
    let again = recording::Recording::read(&csv).unwrap();
    assert_eq!((again.tick, again.position_um), (recording.tick, recording.position_um));
}

#[test]
fn a_board_that_goes_away_ends_the_recording_but_not_the_file() {
    let mut board = Board::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let mut record = common::flexstage()
        .args(["record", text(&file), "--connect", &board.address])
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert!(record.try_wait().unwrap().is_none(), "it records until it is told to end");
    board.kill();
    let words = refused(record.wait_with_output().unwrap());
    assert!(words.contains("connection"), "{words}");
    let recording = recording::Recording::read(&file).unwrap();
    assert!(recording.len() > 5_000, "{}", recording.len());
}

#[test]
fn a_second_client_is_told_so() {
    let board = Board::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let mut first = common::flexstage()
        .args(["record", text(&file), "--connect", &board.address])
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    while !file.with_extension("parquet.part").exists() {
        std::thread::sleep(std::time::Duration::from_millis(20));
        assert!(first.try_wait().unwrap().is_none());
    }
    let words = refused(board.run(&["status"]));
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(words.contains("in use by another program"), "{words}");
    // It is free again once the first one is gone.
    std::thread::sleep(std::time::Duration::from_millis(200));
    ok(board.run(&["status"]));
}

#[test]
fn a_measurement_names_the_plant_the_margins_and_the_step() {
    let board = Board::start(&[]);
    ok(board.run(&[
        "config",
        "set",
        "axes.1.feedback.proportional_v_per_um=1.0",
        "axes.1.feedback.integral_v_per_um_s=1500",
    ]));
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("page.html");
    for excitation in ["multisine", "sweep"] {
        let out = ok(board.run(&[
            "measure",
            "--json",
            "--out",
            text(&page),
            "response",
            "--axis",
            "1",
            "--excitation",
            excitation,
        ]));
        let out = json(&out);
        let plant = out["plant"].as_array().unwrap();
        let at = |hz: f64| {
            let near = |p: &&serde_json::Value| p["frequency_hz"].as_f64().unwrap() >= hz;
            plant.iter().find(near).unwrap().clone()
        };
        // For small motion all eight slip elements stick (29 762 V/C each): a micrometre takes v_t = 53.4 / 7.1 = 7.52 V, draws
        // q = 7.1 + 1.063 * 7.52 = 15.1 uC, and 8 * 29 762 V/C of that are 3.6 V more: 0.0899 um/V or -20.9 dB. A little slip
        // makes it larger. The amplifier's lag of 0.4 ms halves the power at 398 Hz.
        let low = at(20.0)["magnitude_db"].as_f64().unwrap();
        assert!((-21.1..-20.4).contains(&low), "{excitation}: {low} dB");
        let fall = at(398.0)["magnitude_db"].as_f64().unwrap() - low;
        assert!((-3.6..-2.6).contains(&fall), "{excitation}: {fall} dB");
        assert!(at(100.0)["coherence"].as_f64().unwrap() > 0.95, "{excitation}");
        let margin = out["margins"]["phase_margin_deg"].as_f64().unwrap();
        assert!((60.0..120.0).contains(&margin), "{excitation}: {margin}");
        assert!(std::fs::read_to_string(&page).unwrap().contains("<svg"));
    }
    let step = json(&ok(board.run(&["measure", "--json", "step"])));
    let rise = step["step"]["rise_s"].as_f64().unwrap();
    assert!((1e-4..5e-3).contains(&rise), "{step}");
    assert!(step["step"]["steady_error_nm"].as_f64().unwrap().abs() < 5.0, "{step}");
    let closed = json(&ok(board.run(&["measure", "--json", "closed"])));
    assert!(closed["closed_loop"][1]["magnitude_db"].as_f64().unwrap().abs() < 0.3);
    let noise = json(&ok(board.run(&["measure", "--json", "noise", "--seconds", "2"])));
    let rms = noise["noise"][0]["rms_nm"].as_f64().unwrap();
    assert!((0.05..20.0).contains(&rms), "{noise}");
    assert_eq!(json(&ok(board.run(&["status", "--json"])))["parked"], true);
}

#[test]
fn tuning_predicts_what_is_then_measured() {
    let board = Board::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tuned.toml");
    let words = ok(board.run(&["tune", "--axis", "2", "--write", text(&file)]));
    assert!(words.contains("predicted") && words.contains("not applied"), "{words}");
    let before = ok(board.run(&["config", "get", "axes.2.feedback"]));
    assert!(before.contains("axes.2.feedback.integral_v_per_um_s = 0\n"), "{before}");
    let out = json(&ok(board.run(&["tune", "--axis", "2", "--apply", "--json"])));
    assert_eq!(out["applied"], true);
    let off = out["prediction_off"].as_f64().unwrap();
    assert!(off < 0.05, "the prediction is off by {off}");
    assert!(out["measured"]["modulus_margin"].as_f64().unwrap() > 0.55, "{}", out["measured"]);
    let after = ok(board.run(&["config", "compare", text(&file)]));
    let lines: Vec<&str> = after.lines().filter(|l| !l.starts_with("axes.2.")).collect();
    assert!(lines.is_empty() || after.contains("agree"), "only axis 2 differs: {after}");
}

/// An amplifier slower than the settings believe: tuned on the corrected rig file alone, the closed loop becomes what was predicted, and
/// follows better than with what could be told without the rig file.
#[test]
fn tuning_on_a_corrected_rig_predicts_the_stage() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = host_sim::Rig::named("handley").unwrap();
    rig.set("amplifier-bandwidth", host_sim::effects::Place::Axis(0), "ratio", 1.6).unwrap();
    let (model, page) = (folder.path().join("rig.toml"), folder.path().join("tune.html"));
    std::fs::write(&model, rig.to_toml()).unwrap();
    let board = Board::start(&["--virtual-rig", text(&model)]);
    let arguments = ["tune", "--model", text(&model), "--apply", "--json", "--out", text(&page)];
    let out = json(&ok(board.run(&arguments)));
    let off = out["prediction_off"].as_f64().unwrap();
    assert!(off < 0.05, "the prediction is off by {off}");
    let changes = out["changes"].to_string();
    assert!(changes.contains("amplifier time constant: 0.4000 -> 0.6400 ms"), "{changes}");
    assert_eq!(changes.matches("amplifier time constant").count(), 1, "{changes}");
    assert!(out["measured"]["modulus_margin"].as_f64().unwrap() > 0.55, "{}", out["measured"]);
    let at_400 = |key: &str| {
        let points = out[key].as_array().unwrap();
        let near = |p: &&serde_json::Value| p["frequency_hz"].as_f64().unwrap() >= 400.0;
        points.iter().find(near).unwrap()["magnitude_db"].as_f64().unwrap()
    };
    let (predicted, measured) = (at_400("predicted_closed_loop"), at_400("measured_closed_loop"));
    assert!(predicted.abs() < 0.5 && (predicted - measured).abs() < 0.3, "{predicted} {measured}");
    let page = std::fs::read_to_string(&page).unwrap();
    for word in ["before", "predicted", "measured", "Loop gain", "Reference to position"] {
        assert!(page.contains(word), "{word}");
    }
}

#[test]
fn the_loop_is_retuned_on_a_corrected_rig() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("corrected.toml"), folder.path().join("bench"));
    // As `diagnose` leaves it: springs between the axes, and a stage that creeps.
    let mut rig = host_sim::Rig::named("handley").unwrap();
    for (on, from) in [(0, 1), (1, 0), (1, 2), (2, 1)] {
        let place = host_sim::effects::Place::Pair { on, from };
        rig.set("stiffness-coupling", place, "stiffness_n_per_m", 1.5e6).unwrap();
    }
    for axis in 0..3 {
        rig.set("creep", host_sim::effects::Place::Axis(axis), "per_decade", 0.02).unwrap();
    }
    std::fs::write(&file, rig.to_toml()).unwrap();
    let said = ok(run(&["bench", "--rig", text(&file), "--out", text(&out)]));
    assert!(said.contains("retuned for the effects of the rig file"), "{said}");
    let results = json(&std::fs::read_to_string(out.join("bench.json")).unwrap());
    let worst = |name: &str| {
        let named = |r: &&serde_json::Value| r["name"] == name;
        let of_axes = results["experiments"].as_array().unwrap().iter().filter(named);
        of_axes.map(|r| r["rms_nm"].as_f64().unwrap()).reduce(f64::max).expect("a result")
    };
    // Feedforward alone: what the model knows of, the loop need not put right.
    let before = worst("tracking/rig/+ hysteresis/triangle 1 Hz");
    let after = worst("tracking/rig/retuned/+ hysteresis/triangle 1 Hz");
    assert!(after < 0.2 * before, "{before} nm, retuned {after} nm");
    assert!(out.join("report.html").is_file());

    let platform = host_sim::platform::presets::named("belfiore-planar").unwrap();
    std::fs::write(&file, platform.to_toml()).unwrap();
    let said = refused(run(&["bench", "--rig", text(&file), "--out", text(&out)]));
    assert!(said.contains("corrected.toml: a platform; expected a stage"), "{said}");
    rig.axes.pop();
    rig.effects.clear();
    std::fs::write(&file, rig.to_toml()).unwrap();
    let said = refused(run(&["bench", "--rig", text(&file), "--out", text(&out)]));
    assert!(said.contains("a rig of 2 axes; the controller has 3"), "{said}");
    for axis in &mut rig.axes {
        axis.amplifier.max_v = 1.0;
    }
    std::fs::write(&file, rig.to_toml()).unwrap();
    let said = refused(run(&["bench", "--rig", text(&file), "--out", text(&out)]));
    assert!(said.contains("an axis reaches 0.13"), "{said}");
}

#[test]
fn wrong_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let words = refused(run(&["status", "--connect", "127.0.0.1:1"]));
    assert!(words.contains("127.0.0.1:1") && words.contains("serve"), "{words}");
    let words = refused(run(&["record", "--recover", text(&folder.path().join("no.parquet"))]));
    assert!(words.contains("no.parquet"), "{words}");
    let words = refused(run(&["measure", "--virtual", "step", "--axis", "4"]));
    assert!(words.contains("1 to 3"), "{words}");
    let image = folder.path().join("x.bin");
    std::fs::write(&image, "not firmware").unwrap();
    assert!(refused(run(&["flash", text(&image)])).contains("cargo xtask firmware"));
    let words =
        refused(run(&["probe", "--virtual", "--max-v", "500", text(&folder.path().join("s"))]));
    assert!(words.contains("limits") && words.contains("--max-v"), "{words}");
    assert!(!folder.path().join("s").exists(), "nothing is left behind");
    let words = refused(run(&["status", "--virtual", "--virtual-rig", "nowhere.toml"]));
    assert!(words.contains("nowhere.toml"), "{words}");
}

#[test]
fn devices_and_completions_need_no_board() {
    let out = run(&["devices", "--json"]);
    // A machine without USB (a container) says so in one line.
    if out.status.success() {
        assert!(json(&ok(out)).is_array());
    } else {
        assert!(refused(out).contains("USB"));
    }
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(ok(run(&["completions", shell])).contains("flexstage"), "{shell}");
    }
}
