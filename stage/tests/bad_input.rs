//! Input that cannot be used, through the program: exit status 2, one line on standard error that says which file, what
//! was expected and what was found, and nothing left behind.

use std::fs;
use std::path::Path;
use std::process::Command;

use host_sim::Rig;
use recording::{Meta, Recording};

/// What the program says to arguments that it must refuse; `out` is where its answer would have gone.
fn refused(arguments: &[&str], folder: &Path) -> String {
    let out = folder.join("out");
    fs::create_dir_all(&out).unwrap();
    let ran = Command::new(env!("CARGO_BIN_EXE_flexstage"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ran.stderr).into_owned();
    assert_eq!(ran.status.code(), Some(2), "{arguments:?}: {said}");
    assert_eq!(said.lines().count(), 1, "{arguments:?}: one line expected, found {said}");
    assert!(said.starts_with("flexstage: "), "{arguments:?}: {said}");
    let left: Vec<_> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(left.is_empty(), "{arguments:?} left {left:?}");
    said
}

fn must_say(said: &str, words: &[&str]) {
    for word in words {
        assert!(said.contains(word), "`{word}` expected in: {said}");
    }
}

fn rig_text() -> String {
    Rig::named("handley").unwrap().to_toml()
}

/// A recording of three axes at rest.
fn recording() -> Recording {
    let mut recording = Recording::empty(Meta::new("rest", 10_000.0), 3);
    recording.tick = (0..400).collect();
    for axis in 0..3 {
        recording.drive_v[axis] = vec![0.0; 400];
        recording.position_um[axis] = Some(vec![0.0; 400]);
    }
    recording
}

#[test]
fn rigs_that_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    recording().write(folder.join("r.parquet")).unwrap();
    let good = rig_text();
    let changed = |from: &str, to: &str| {
        assert!(good.contains(from), "{from} is not in the rig");
        good.replacen(from, to, 1)
    };
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        (
            "unknown-key",
            changed("time_constant_s", "time_constant_ms").into(),
            &["`time_constant_ms`", "time_constant_s", "line"],
        ),
        ("missing-key", changed("sample_rate_hz", "# sample_rate_hz").into(), &["sample_rate_hz"]),
        (
            "negative",
            changed("transformer_n_per_v = ", "transformer_n_per_v = -").into(),
            &["axis 1", "above 0", "-7.1"],
        ),
        ("rails", changed("min_v = -10.0", "min_v = 200.0").into(), &["min_v", "less than", "200"]),
        (
            "not-a-number",
            changed("sample_rate_hz = 10000.0", "sample_rate_hz = nan").into(),
            &["sample_rate_hz", "NaN"],
        ),
        (
            "text",
            changed("sample_rate_hz = 10000.0", "sample_rate_hz = \"fast\"").into(),
            &["fast", "line"],
        ),
        ("kind", b"kind = \"ship\"".to_vec(), &["kind", "platform", "ship"]),
        ("empty", Vec::new(), &["name"]),
        ("not-toml", b"name = \"x".to_vec(), &["line 1"]),
        ("binary", vec![0xff, 0xfe, 0, 1], &["not a text file", "TOML"]),
        (
            "platform",
            b"name = \"p\"\nkind = \"platform\"\nsample_rate_hz = 200.0\n".to_vec(),
            &["mass"],
        ),
    ];
    for (name, text, words) in cases {
        let file = format!("{name}.toml");
        fs::write(folder.join(&file), text).unwrap();
        for arguments in [
            vec!["replay", "--rig", &file, "r.parquet", "--out", "out/p.parquet"],
            vec!["identify", "--rig", &file, ".", "--out", "out/c.toml"],
            vec!["diagnose", "--rig", &file, ".", "--out", "out/d"],
        ] {
            let said = refused(&arguments, folder);
            must_say(&said, words);
            must_say(&said, &[&file]);
        }
    }
    let said =
        refused(&["replay", "--rig", "none.toml", "r.parquet", "--out", "out/p.parquet"], folder);
    must_say(&said, &["none.toml", "no such file", "rig file in TOML", "docs/rig.md"]);
    let said = refused(&["replay", "--rig", ".", "r.parquet", "--out", "out/p.parquet"], folder);
    must_say(&said, &["folder", "rig file in TOML"]);
}

#[test]
fn recordings_that_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("rig.toml"), rig_text()).unwrap();
    recording().write(folder.join("good.parquet")).unwrap();
    let good = fs::read(folder.join("good.parquet")).unwrap();
    // The same length, so that the file's structure stays whole.
    let changed = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = good.windows(from.len()).rposition(|w| w == from.as_bytes()).expect("in the file");
        let mut bytes = good.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        bytes
    };
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        ("empty", Vec::new(), &["empty"]),
        ("junk", b"PAR1 this is not a recording".to_vec(), &["Parquet"]),
        ("truncated", good[..good.len() / 2].to_vec(), &["Parquet"]),
        (
            "format",
            changed("flexstage-recording", "flexstage-somethings"[..19].into()),
            &["format", "flexstage-recording"],
        ),
        ("no-metadata", changed("\"format\"", "\"farmot\""), &["format"]),
    ];
    for (name, bytes, words) in cases {
        let session = folder.join(name);
        fs::create_dir(&session).unwrap();
        fs::write(session.join("r.parquet"), bytes).unwrap();
        let file = format!("{name}/r.parquet");
        for arguments in [
            vec!["replay", "--rig", "rig.toml", &file, "--out", "out/p.parquet"],
            vec!["identify", "--rig", "rig.toml", name, "--out", "out/c.toml"],
            vec!["diagnose", "--rig", "rig.toml", name, "--out", "out/d"],
        ] {
            let said = refused(&arguments, folder);
            must_say(&said, words);
            must_say(&said, &[name, "expected"]);
        }
    }
    fs::create_dir(folder.join("nothing")).unwrap();
    for (arguments, words) in [
        (
            ["identify", "--rig", "rig.toml", "nothing", "--out", "out/c.toml"],
            ["*.parquet", "none"],
        ),
        (
            ["identify", "--rig", "rig.toml", "nowhere", "--out", "out/c.toml"],
            ["nowhere", "no such"],
        ),
        (
            ["identify", "--rig", "rig.toml", "good.parquet", "--out", "out/c.toml"],
            ["good.parquet", "folder of recordings"],
        ),
        (["diagnose", "--rig", "rig.toml", "nowhere", "--out", "out/d"], ["nowhere", "no such"]),
        (
            ["replay", "--rig", "rig.toml", "nowhere.parquet", "--out", "out/p.parquet"],
            ["nowhere", "no such"],
        ),
        (
            ["replay", "--rig", "rig.toml", "good.parquet", "--out", "no/p.parquet"],
            ["no/p.parquet", "no such"],
        ),
        (["replay", "--rig", "rig.toml", "good.parquet", "--out", "out"], ["out", "folder"]),
        (["identify", "--rig", "rig.toml", ".", "--out", "out"], ["out", "found a folder"]),
    ] {
        must_say(&refused(&arguments, folder), &words);
    }
}

#[test]
fn columns_that_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("rig.toml"), rig_text()).unwrap();
    let head = "tick,drive_v_1,position_um_1,drive_v_2,position_um_2,drive_v_3,position_um_3\n";
    let row = |tick: &str, drive: &str| format!("{tick},{drive},0,0,0,0,0\n");
    let rows = |list: &[(&str, &str)]| {
        list.iter().fold(head.to_owned(), |text, (tick, drive)| text + &row(tick, drive))
    };
    let cases: Vec<(&str, String, &[&str])> = vec![
        ("nan", rows(&[("0", "1"), ("1", "NaN"), ("2", "1")]), &["drive_v_1", "NaN"]),
        ("infinite", rows(&[("0", "1"), ("1", "inf")]), &["drive_v_1", "finite"]),
        ("words", rows(&[("0", "1"), ("1", "high")]), &["drive_v_1", "number", "high"]),
        ("unsorted", rows(&[("0", "1"), ("2", "1"), ("1", "1")]), &["tick", "unsorted"]),
        ("twice", rows(&[("0", "1"), ("1", "1"), ("1", "1")]), &["tick", "duplicate"]),
        ("all-lost", rows(&[("0", "1"), ("1", "1"), ("90000000000", "1")]), &["tick", "lost"]),
        ("missing", rows(&[("0", "1")]).replace("drive_v_2", "other"), &["drive_v_2", "missing"]),
        ("no-tick", rows(&[("0", "1")]).replace("tick", "time"), &["tick", "missing"]),
        ("no-rows", head.to_owned(), &["no samples"]),
        ("ragged", format!("{head}0,1,2\n"), &["CSV"]),
    ];
    for (name, text, words) in cases {
        let file = format!("{name}.csv");
        fs::write(folder.join(&file), text).unwrap();
        let said = refused(
            &[
                "replay",
                "--rig",
                "rig.toml",
                &file,
                "--sample-rate",
                "10000",
                "--out",
                "out/p.parquet",
            ],
            folder,
        );
        must_say(&said, words);
        must_say(&said, &[&file]);
        fs::remove_file(folder.join(&file)).unwrap();
    }
    fs::write(folder.join("r.csv"), rows(&[("0", "1"), ("1", "1")])).unwrap();
    for (rate, words) in
        [("0", ["sample", "0"]), ("nan", ["sample", "nan"]), ("1e12", ["sample", "1"])]
    {
        let arguments = [
            "replay",
            "--rig",
            "rig.toml",
            "r.csv",
            "--sample-rate",
            rate,
            "--out",
            "out/p.parquet",
        ];
        must_say(&refused(&arguments, folder), &words);
    }
    let said = refused(&["replay", "--rig", "rig.toml", "r.csv", "--out", "out/p.parquet"], folder);
    must_say(&said, &["--sample-rate"]);
}

#[test]
fn rigs_and_recordings_that_do_not_belong_together() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("stage.toml"), rig_text()).unwrap();
    let mut one = Rig::named("handley").unwrap();
    one.axes.truncate(1);
    fs::write(folder.join("one.toml"), one.to_toml()).unwrap();
    fs::write(
        folder.join("platform.toml"),
        host_sim::platform::presets::named("belfiore-planar").unwrap().to_toml(),
    )
    .unwrap();
    fs::create_dir(folder.join("rest")).unwrap();
    recording().write(folder.join("rest/r.parquet")).unwrap();
    let mut free = Recording::empty(Meta::new("free return", 200.0), 1);
    free.meta.initial_position_um = Some(1430.0);
    free.tick = (0..400).collect();
    free.drive_v = vec![vec![0.0; 400]];
    free.position_um = vec![Some((0..400).map(|i| 1430.0 * (-0.005 * i as f32).exp()).collect())];
    fs::create_dir(folder.join("return")).unwrap();
    free.write(folder.join("return/r.parquet")).unwrap();

    for (rig, session, words) in [
        ("platform.toml", "rest", ["initial_position_um", "r.parquet"]),
        ("stage.toml", "return", ["platform", "stage"]),
        ("one.toml", "rest", ["r.parquet", "handley-2002"]),
    ] {
        let file = format!("{session}/r.parquet");
        for arguments in [
            ["replay", "--rig", rig, &file, "--out", "out/p.parquet"],
            ["identify", "--rig", rig, session, "--out", "out/c.toml"],
            ["diagnose", "--rig", rig, session, "--out", "out/d"],
        ] {
            must_say(&refused(&arguments, folder), &words);
        }
    }
}
