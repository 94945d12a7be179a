//! Free returns whose numbers cannot be: refused in one line, or answered in reasonable time with a word about it; never a panic.

use std::path::{Path, PathBuf};

use gap::Options;
use gap::platform::{diagnose, identify, replay};
use host_sim::platform::presets;
use recording::{Entry, Meta, Recording, Session};

/// Eight seconds at 200 Hz with a little that is not the platform's.
fn session(initial_um: f64, position_um: impl Fn(f64) -> f64) -> Session {
    let mut meta = Meta::new("free return", 200.0);
    meta.initial_position_um = Some(initial_um);
    let mut recording = Recording::empty(meta, 1);
    recording.tick = (0..1600).collect();
    let noise_um = |row: u64| 4.0 * ((row * row % 101) as f64 / 50.0 - 1.0);
    let read = |row: u64| (position_um(row as f64 / 200.0) + noise_um(row)) as f32;
    recording.position_um = vec![Some((0..1600).map(read).collect())];
    recording.drive_v = vec![vec![0.0; 1600]];
    let entry = Entry { path: PathBuf::from("a.parquet"), file: "a.parquet".to_owned(), recording };
    Session { recordings: vec![entry], ..Session::default() }
}

#[test]
fn impossible_positions_are_refused() {
    let rig = presets::named("belfiore-planar").unwrap();
    let home = |t: f64| 1430.0 * f64::exp(-t);
    let mut row = session(1430.0, home);
    row.recordings[0].recording.position_um[0].as_mut().unwrap()[7] = -2.0e6;
    for (session, words) in [
        (session(1430.0, |_| 1.0e38), ["column position_um_1, row 0", "1e38"]),
        (row, ["column position_um_1, row 7", "-2e6"]),
        (session(1.0e30, home), ["initial_position_um", "1e30"]),
        (session(-1430.0, home), ["initial_position_um is -1430.0", "the same sign"]),
    ] {
        let errors = [
            diagnose(&rig, &session, &Options::default()).map(drop).unwrap_err(),
            identify(&rig, &session).map(drop).unwrap_err(),
        ];
        for error in errors.map(|error| error.to_string()) {
            assert!(error.starts_with("a.parquet: ") && !error.contains('\n'), "{error}");
            assert!(words.iter().all(|word| error.contains(word)), "{words:?} in {error}");
        }
    }
    let far = &session(1.0e30, home).recordings[0].recording;
    let error = replay(&rig, far, Path::new("a.parquet")).unwrap_err().to_string();
    assert!(error.contains("initial_position_um"), "{error}");
}

/// A fit that drives the dampers away makes chains that ring thousands of times: following them step by step took minutes for each effect.
#[test]
fn positions_that_contradict_the_initial_one_come_to_an_end() {
    let rig = presets::named("belfiore-planar").unwrap();
    for share in [-0.45, 0.0] {
        let session = session(1430.0, |t| share * 1430.0 * f64::exp(-t));
        let began = std::time::Instant::now();
        let outcome = diagnose(&rig, &session, &Options::default()).unwrap();
        let notes = outcome.diagnosis.notes.join("\n");
        assert!(notes.contains("a.parquet: initial_position_um is 1430, but"), "{notes}");
        assert!(began.elapsed().as_secs() < 120, "{share}: {:?}", began.elapsed());
    }
}
