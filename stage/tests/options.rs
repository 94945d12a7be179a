//! Options whose values cannot be, and what the values that can be mean: told before any work, in one line.

mod common;

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
