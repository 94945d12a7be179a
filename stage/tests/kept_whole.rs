//! What a command must not do to files: write over what it reads, leave half an answer behind, or pass over what it cannot read.

mod common;

use std::fs;
use std::path::Path;

use common::{ok, refused, run, text};
use host_sim::Rig;
use recording::{Meta, Recording};

/// A recording of three axes at rest, of so many samples.
fn rest(rows: u64, rate_hz: f64) -> Recording {
    let mut recording = Recording::empty(Meta::new("rest", rate_hz), 3);
    recording.tick = (0..rows).collect();
    for axis in 0..3 {
        recording.drive_v[axis] = vec![0.0; rows as usize];
        recording.position_um[axis] = Some(vec![0.0; rows as usize]);
    }
    recording
}

/// A rig, a session of one recording and a table.
fn given() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("rig.toml"), Rig::named("handley").unwrap().to_toml()).unwrap();
    fs::create_dir(at("session")).unwrap();
    rest(400, 10_000.0).write(at("session/r.parquet")).unwrap();
    fs::write(at("table.csv"), "drive,position\n1,2\n3,4\n").unwrap();
    folder
}

/// All that lies in a folder and below, by name and content.
fn snapshot(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.push((path.display().to_string(), Vec::new()));
            all.extend(snapshot(&path));
        } else {
            all.push((path.display().to_string(), fs::read(&path).unwrap()));
        }
    }
    all.sort();
    all
}

/// What a command says that must change nothing; `@` is the folder.
fn says(folder: &Path, words: &str) -> String {
    let before = snapshot(folder);
    let words: Vec<String> = words.split(' ').map(|w| w.replace('@', text(folder))).collect();
    let said = refused(run(&words));
    assert!(before == snapshot(folder), "{words:?} changed something");
    said
}

#[test]
fn nothing_is_written_over_what_it_is_made_from() {
    let folder = given();
    let folder = folder.path();
    let columns = "--columns drive_v_1=drive,position_um_1=position --rate 10";
    for words in [
        "replay --rig @/rig.toml @/session/r.parquet --out @/session/r.parquet",
        "replay --rig @/rig.toml @/session/r.parquet --out @/session/../session/r.parquet",
        &format!("import --table @/table.csv {columns} --out @/table.csv"),
        "diagnose --rig @/rig.toml @/session --out @",
        "identify --rig @/rig.toml @/session --out @/rig.toml",
        "identify --rig @/rig.toml @/session --out @/session/r.parquet",
    ] {
        let said = says(folder, words);
        assert!(said.contains("would overwrite what it is made from"), "{words}: {said}");
    }
}

#[test]
fn an_answer_is_whole_or_not_there() {
    let folder = given();
    let folder = folder.path();
    fs::create_dir_all(folder.join("half/rig.toml")).unwrap();
    let said = says(folder, "diagnose --rig @/rig.toml @/session --out @/half");
    assert!(said.contains("half/rig.toml") && said.contains("folder"), "{said}");

    let array = ndarray::Array3::<i64>::zeros((8, 1, 2));
    ndarray_npy::write_npy(folder.join("u.npy"), &array).unwrap();
    fs::create_dir_all(folder.join("out/ms-2.parquet")).unwrap();
    let import = "import --drive @/u.npy --position @/u.npy --dims time,axis,record --rate 64";
    let said = says(folder, &format!("{import} --experiment ms --out @/out"));
    assert!(said.contains("ms-2.parquet"), "{said}");
    for name in ["a/b", ".hidden", ".."] {
        let said = says(folder, &format!("{import} --experiment {name} --out @/new"));
        assert!(said.contains("--experiment"), "{said}");
    }
    let said = says(folder, &format!("{import} --out @/new.txt"));
    assert!(said.contains(".parquet or .csv"), "{said}");
    // Integers of any width.
    ok(run(&format!("{import} --out @/new")
        .replace('@', text(folder))
        .split(' ')
        .collect::<Vec<_>>()));
    assert_eq!(Recording::read(folder.join("new/import-2.parquet")).unwrap().len(), 8);
}

#[test]
fn names_of_recordings() {
    let folder = given();
    let folder = folder.path();
    let said = says(folder, "export @/session/r.parquet @/a.txt");
    assert!(said.contains("a.txt") && said.contains(".parquet or .csv"), "{said}");
    let columns = "--columns drive_v_1=drive,position_um_1=position --rate 10";
    let words = format!("import --table @/table.csv {columns} --out @/o.PARQUET");
    ok(run(&words.replace('@', text(folder)).split(' ').collect::<Vec<_>>()));
    assert!(folder.join("o.PARQUET").is_file());
    for (table, line) in [("a;b\n1,5;2,5\n2,5;3,5\n", "1,5;2,5"), ("a,b\n1,2,\n3,4,\n", "1,2,")] {
        fs::write(folder.join("table.csv"), table).unwrap();
        let said = says(folder, &words);
        assert!(said.contains(&format!("line 2 is \"{line}\"")), "{said}");
    }
}

#[test]
fn sessions_are_read_whole() {
    let folder = given();
    let folder = folder.path();
    let diagnose = "diagnose --rig @/rig.toml @/session --out @/out";
    let csv = folder.join("session/s.csv");
    rest(400, 10_000.0).write(&csv).unwrap();
    let good = fs::read_to_string(&csv).unwrap();
    let said = says(folder, &format!("{diagnose} --sample-rate 5000"));
    for word in ["session/s.csv", "10000 Hz", "5000 Hz"] {
        assert!(said.contains(word), "{said}");
    }
    fs::write(&csv, &good[..good.len() - 5]).unwrap();
    let said = says(folder, diagnose);
    assert!(said.contains("session/s.csv") && said.contains("cut off"), "{said}");

    // A table of something else is left out, and the answer says so.
    fs::write(&csv, "time,temperature\n0,21\n").unwrap();
    ok(run(&diagnose.replace('@', text(folder)).split(' ').collect::<Vec<_>>()));
    let answer = fs::read_to_string(folder.join("out/diagnosis.json")).unwrap();
    assert!(answer.contains("s.csv was left out"), "{answer}");
}

#[test]
fn too_little_or_too_slow() {
    let folder = given();
    let folder = folder.path();
    let diagnose = "diagnose --rig @/rig.toml @/session --out @/out";
    for (recording, words) in [
        (rest(10, 10_000.0), ["session/r.parquet", "0 of 10 samples", "5 ms"]),
        (rest(400, 0.001), ["session/r.parquet", "sample_rate_hz", "0.001"]),
    ] {
        recording.write(folder.join("session/r.parquet")).unwrap();
        let said = says(folder, diagnose);
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }
}

#[test]
fn effects_are_left_out_of_the_catalogue_of_the_rig() {
    let folder = given();
    let folder = folder.path();
    let platform = host_sim::platform::presets::named("belfiore-planar").unwrap();
    fs::write(folder.join("platform.toml"), platform.to_toml()).unwrap();
    for (rig, wrong, right) in
        [("platform", "creep", "third-mass"), ("rig", "third-mass", "amplifier-hum")]
    {
        let words = |name: &str| {
            format!("diagnose --rig @/{rig}.toml @/session --out @/out --exclude {name}")
        };
        let said = says(folder, &words(wrong));
        assert!(said.contains(&format!("--exclude {wrong}: no such effect")), "{said}");
        assert!(said.contains(right), "{said}");
    }
    // It goes on to the recordings, which are none of a platform.
    let said =
        says(folder, "diagnose --rig @/platform.toml @/session --out @/out --exclude third-mass");
    assert!(said.contains("initial_position_um"), "{said}");
}
