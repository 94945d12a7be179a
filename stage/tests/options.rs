//! Options whose values cannot be, and what the values that can be mean: told before any work, in one line.

mod common;

use std::path::Path;

use common::{json, ok, refused, run, text};

#[test]
fn nothing_is_probed_beyond_the_highest_voltage() {
    for max_v in ["20", "90", "100"] {
        for length in ["quick", "standard", "long"] {
            let plan = ok(run(&[
                "probe",
                "x",
                "--dry-run",
                "--json",
                "--max-v",
                max_v,
                "--length",
                length,
            ]));
            let plan = json(&plan);
            let highest = plan.as_array().unwrap().iter().map(|e| e["high_v"].as_f64().unwrap());
            assert_eq!(highest.fold(0.0, f64::max), max_v.parse::<f64>().unwrap(), "{length}");
        }
    }
}

#[test]
fn a_session_is_probed_into_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.csv");
    std::fs::write(&file, "mine").unwrap();
    let said = refused(run(&["probe", "--virtual", text(&file)]));
    assert!(
        said.contains("a.csv: expected a new or empty folder for the session, found a file"),
        "{said}"
    );
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");
}

#[test]
fn numbers_that_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let file = text(&file);
    let cases: &[(&[&str], &[&str])] = &[
        (
            &["measure", "--virtual", "noise", "--seconds", "nan"],
            &["--seconds nan", "0.1 to 3600 s"],
        ),
        (&["measure", "--virtual", "noise", "--seconds", "-3"], &["--seconds -3", "0.1 to 3600 s"]),
        (
            &["measure", "--virtual", "closed", "--amplitude-um", "inf"],
            &["--amplitude-um inf", "um"],
        ),
        (&["measure", "--virtual", "step", "--from-um", "6"], &["--from-um 6", "--to-um 6"]),
        (&["record", "--virtual", file, "--seconds", "nan"], &["--seconds nan", " s"]),
        (&["record", "--virtual", file, "--seconds", "-1"], &["--seconds -1", " s"]),
        (&["tune", "--virtual", "--amplitude-v=0"], &["--amplitude-v 0", "0.01 to 1000 V"]),
        (&["tune", "--virtual", "--bias-v", "500"], &["--bias-v", "drive limits"]),
        (&["tune", "--virtual", "--bias-v", "-5"], &["--bias-v", "-13.0 to 3.0 V", "drive limits"]),
        (&["tune", "--virtual", "--axis", "4"], &["--axis 4", "1 to 3"]),
        (&["probe", "--virtual", file, "--axes", "1,0"], &["--axes 0", "1 to 3"]),
        (&["probe", "--virtual", file, "--max-v", "0.1"], &["--max-v 0.1", "5 to 1000 V"]),
        (&["blind", "--weights", "1,nan,1,1"], &["--weights nan"]),
        (&["blind", "--weights", "-1,1,1,1"], &["--weights -1", "from 0"]),
        (&["blind", "--seed", "-1"], &["--seed -1", "whole number from 0"]),
        (&["blind", "--cases", "-1"], &["--cases -1", "0 to 1000000"]),
        (&["blind", "--cases", "1000000000000000000"], &["--cases", "0 to 1000000"]),
        (&["blind", "--first", "18446744073709551615", "--cases", "2"], &["--first", "from 0 to"]),
        (&["blind", "--out", ""], &["--out", "expected a value, found nothing"]),
        (&["blind", "--faults", "x"], &["--faults", "broken, physics, electronics, found x"]),
        (&["probe", "--virtual", file, "--seed", "-1"], &["--seed -1"]),
        (&["import", "--table", file, "--out", file, "--rate", "-1"], &["--rate -1", " Hz"]),
        (&["import", "--table", file, "--out", file, "--settle", "-1"], &["--settle -1", " s"]),
        (&["import", "--table", file, "--out", file, "--period", "0"], &["--period 0", " s"]),
        (&["diagnose", file, "--sample-rate", "-1"], &["--sample-rate -1", "0.001 to", " Hz"]),
        (&["identify", file, "--sample-rate", "nan"], &["--sample-rate nan", " Hz"]),
        (&["replay", file, "--sample-rate", "0"], &["--sample-rate 0", " Hz"]),
        (&["export", file, file, "--sample-rate", "inf"], &["--sample-rate inf", " Hz"]),
        (&["blind", "--min-ratio", "9", "--max-ratio", "3"], &["--min-ratio 9", "--max-ratio"]),
    ];
    for (arguments, words) in cases {
        let said = refused(run(arguments));
        for word in *words {
            assert!(said.contains(word), "{arguments:?}: `{word}` expected in {said}");
        }
        assert!(!said.contains("--max-v") || arguments[0] == "probe", "{arguments:?}: {said}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
}

#[test]
fn blind_cases_of_other_options_are_not_taken_for_these() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let out = text(&out);
    let blind =
        |options: &[&str]| run(&[&["blind", "--cases", "0", "--out", out][..], options].concat());
    ok(blind(&["--seed", "5"]));
    // The same again, of any number of cases, goes on.
    ok(blind(&["--seed", "5"]));
    ok(run(&["blind", "--cases", "1", "--seed", "5", "--write-only", out]));
    for (options, words) in [
        (&["--seed", "6"][..], ["--seed 5, not 6", "--out"]),
        (&["--seed", "5", "--other-rigs"], ["--other-rigs false, not true", "choose another"]),
        (&["--seed", "5", "--weights", "0,1,0,0"], ["--weights", "choose another"]),
        (&["--seed", "5", "--only", "creep"], ["--only []", "choose another"]),
        (&["--seed", "5", "--leave-one-out"], ["--leave-one-out", "choose another"]),
    ] {
        let said = refused(blind(options));
        for word in words {
            assert!(said.contains(word), "{options:?}: `{word}` expected in {said}");
        }
    }
    // Cases from before options were kept.
    std::fs::remove_file(folder.path().join("set/options.json")).unwrap();
    assert!(refused(blind(&["--seed", "5"])).contains("unknown options"));
}

#[cfg(unix)]
#[test]
fn a_standard_output_that_takes_nothing_is_no_crash() {
    use std::process::Stdio;
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("b0");
    let commands: &[&[&str]] = &[
        &["config", "--virtual", "get", "--toml"],
        &["config", "--virtual", "get"],
        &["status", "--virtual", "--json"],
        &["completions", "bash"],
        &["blind", "--cases", "0", "--out", text(&out)],
        &["probe", "x", "--dry-run"],
    ];
    for arguments in commands {
        let mut child = common::flexstage()
            .args(*arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let left = child.wait_with_output().unwrap();
        let words = String::from_utf8_lossy(&left.stderr).into_owned();
        assert!(left.status.success() && words.is_empty(), "{arguments:?}: {words}");
        // There where the system has a device that is always full.
        if let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") {
            let full = common::flexstage().args(*arguments).stdout(full).output().unwrap();
            assert!(refused(full).contains("standard output"), "{arguments:?}");
        }
    }
}

#[test]
fn files_that_cannot_be_written_are_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    let rig = path("rig.toml");
    std::fs::write(&rig, host_sim::Rig::named("handley").unwrap().to_toml()).unwrap();
    let (nowhere, below, session) = (path("no/x.html"), path("rig.toml/x"), path("session"));
    let board = common::Board::start(&[]);
    let before = ok(board.run(&["config", "get"]));
    for arguments in [
        ["tune", "--model", &rig, "--apply", "--out", &nowhere],
        ["tune", "--model", &rig, "--apply", "--write", &below],
        ["measure", "noise", "--seconds", "3600", "--out", &nowhere],
    ] {
        let said = refused(board.run(&arguments));
        assert!(said.contains(arguments[5]) && said.contains("expected a folder"), "{said}");
    }
    assert_eq!(ok(board.run(&["config", "get"])), before, "nothing was applied");
    // The session is not even looked for.
    for command in ["identify", "diagnose", "replay"] {
        let below = if command == "replay" { path("rig.toml/x.parquet") } else { below.clone() };
        let said = refused(run(&[command, "--rig", &rig, &session, "--out", &below]));
        assert!(said.contains(&below) && said.contains("found a file"), "{command}: {said}");
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("gone", folder.path().join("link")).unwrap();
        let said = refused(run(&["diagnose", "--rig", &rig, &session, "--out", &path("link")]));
        assert!(said.contains("found a link to nothing"), "{said}");
    }
}

/// Not the output file: it has never been written.
#[test]
fn a_simulation_that_leaves_all_bounds_is_the_fault_of_the_rig() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| text(&folder.path().join(name)).to_owned();
    let good = host_sim::Rig::named("handley").unwrap().to_toml();
    let mut recording = recording::Recording::empty(recording::Meta::new("step", 10_000.0), 3);
    recording.tick = (0..400).collect();
    for axis in 0..3 {
        recording.drive_v[axis] = (0..400).map(|row| if row < 100 { 0.0 } else { 50.0 }).collect();
        recording.position_um[axis] = Some(vec![0.0; 400]);
    }
    let (recorded, out) = (path("r.parquet"), path("p.parquet"));
    recording.write(&recorded).unwrap();
    let key = "transformer_n_per_v = 7.1";
    assert!(good.contains(key), "{good}");
    for (name, value) in [("large.toml", "1e9"), ("huge.toml", "1e30")] {
        std::fs::write(
            path(name),
            good.replacen(key, &format!("transformer_n_per_v = {value}"), 1),
        )
        .unwrap();
        let said = refused(run(&["replay", "--rig", &path(name), &recorded, "--out", &out]));
        for word in [name, "position of axis 1", " s into ", "rig file"] {
            assert!(said.contains(word), "{name}: `{word}` expected in {said}");
        }
        assert!(!said.contains("p.parquet"), "{said}");
    }
    assert!(!Path::new(&out).exists());
}
