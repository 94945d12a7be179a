//! What is written reads back, what others wrote reads too, and what cannot be used is refused in one line.

use std::fs;
use std::path::Path;

use recording::{Channels, Meta, Recording, Sample, Session, StreamWriter, recover};

fn example() -> Recording {
    let mut meta = Meta::new("example", 1000.0);
    meta.settle_s = 0.5;
    meta.start_s = 12.5;
    meta.rig = "rig".into();
    meta.period_s = Some(0.25);
    let mut recording = Recording::empty(meta, 3);
    let rows = 2500;
    // Samples are lost between rows 999 and 1000.
    recording.tick = (0..rows).map(|row| row + if row >= 1000 { 7 } else { 0 }).collect();
    let wave =
        |scale: f32| (0..rows).map(|row| scale * (row as f32 * 0.01).sin()).collect::<Vec<_>>();
    recording.drive_v = vec![wave(10.0), vec![0.0; rows as usize], wave(30.0)];
    recording.monitor_v = vec![Some(wave(10.1)), None, None];
    recording.position_um = vec![Some(wave(1.0)), None, Some(wave(3.0))];
    recording.flags = Some((0..rows as u32).collect());
    recording
}

fn refused(path: &Path) -> String {
    let message = Recording::read(path).expect_err("must be refused").to_string();
    assert!(!message.contains('\n'), "one line: {message}");
    assert!(
        message.contains(path.file_name().unwrap().to_str().unwrap()),
        "names the file: {message}"
    );
    message
}

#[test]
fn both_formats_return_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    // Its second axis is absent, and stays so.
    let whole = example();
    for name in ["a.parquet", "a.csv"] {
        let path = folder.path().join(name);
        whole.write(&path).unwrap();
        assert_eq!(Recording::read(&path).unwrap(), whole, "{name}");
    }
    // Nothing else is left in the folder.
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn lost_ticks_are_listed_and_settling_counts_ticks() {
    let recording = example();
    assert_eq!(recording.lost(), [recording::Lost { after_row: 999, ticks: 7 }]);
    assert_eq!(recording.span_ticks(), 2507);
    assert_eq!(recording.settle_rows(), 500);
    assert!((recording.time_s(1000) - (12.5 + 1.007)).abs() < 1e-12);
}

#[test]
fn csv_of_others_needs_only_names_and_a_rate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("others.csv");
    fs::write(
        &path,
        "\u{feff}time, tick ,drive_v_1,position_um_1,note\r\n0.0,5,1.5,0.25,x\r\n0.1,6,2,0.5,y\r\n",
    )
    .unwrap();
    let recording = Recording::read_csv(&path, 250.0).unwrap();
    assert_eq!(recording.tick, [5, 6]);
    assert_eq!(recording.drive_v, [[1.5, 2.0]]);
    assert_eq!(recording.meta.sample_rate_hz, 250.0);
    assert!(refused(&path).contains("--sample-rate"));
    for (text, expected) in [
        (
            "tick,drive_v_1,position_um_1\n0,abc,1\n",
            "column `drive_v_1`, line 2: expected a number, found \"abc\"",
        ),
        ("tick,drive_v_1,position_um_1\n-4,1,1\n", "column `tick`, line 2"),
        ("tick,drive_v_1,position_um_1\n0,,1\n", "column `drive_v_1`, line 2"),
        (
            "tick,drive_v_1,position_um_1\n0,1\n",
            "line 2: expected 3 columns as in the header, found 2",
        ),
        ("tick,drive_v_1,position_um_1\n", "no samples"),
        ("tick,drive_v_1,drive_v_1,position_um_1\n0,1,1,1\n", "`drive_v_1` is there twice"),
        ("drive_v_1,position_um_1\n0,1\n", "column `tick` is missing"),
        ("tick,position_um_1\n0,1\n", "column `drive_v_1` is missing"),
        ("tick,drive_v_2\n0,1\n", "column `position_um_2` is missing"),
        (
            "tick,drive_v_1,position_um_1\n0,1,NaN\n",
            "column `position_um_1`, row 0: expected a finite number",
        ),
        ("tick,drive_v_1,position_um_1\n3,1,1\n3,1,1\n", "duplicate tick"),
        ("tick,drive_v_1,position_um_1\n3,1,1\n2,1,1\n", "unsorted tick"),
        ("tick,drive_v_1,position_um_1\n3,1,1\n18446744073709551615,1,1\n", "99 % lost"),
        ("", "empty file"),
    ] {
        fs::write(&path, text).unwrap();
        let message = Recording::read_csv(&path, 250.0).unwrap_err().to_string();
        assert!(message.contains(expected), "{text:?}: {message}");
        assert!(!message.contains('\n'));
    }
    fs::write(&path, "tick,drive_v_1,position_um_1\n0,1,1\n").unwrap();
    for rate in [0.0, -5.0, f64::NAN, f64::INFINITY] {
        let message = Recording::read_csv(&path, rate).unwrap_err().to_string();
        assert!(message.contains("sample_rate_hz"), "{message}");
    }
}

#[test]
fn metadata_are_checked_key_by_key() {
    let meta = |text: &str| Meta::from_json(text, Path::new("a.parquet"));
    let good =
        r#"{"format":"flexstage-recording","version":1,"sample_rate_hz":100,"colour":"red"}"#;
    assert_eq!(meta(good).unwrap().sample_rate_hz, 100.0);
    for (text, expected) in [
        ("[]", "expected a JSON object"),
        ("{", "expected JSON"),
        (
            r#"{"format":"flexstage-recording","version":2,"sample_rate_hz":100}"#,
            "key `version`: expected 1, found 2",
        ),
        (r#"{"version":1,"sample_rate_hz":100}"#, "key `format`"),
        (r#"{"format":"flexstage-recording","version":1}"#, "key `sample_rate_hz`: expected"),
        (
            r#"{"format":"flexstage-recording","version":1,"sample_rate_hz":"fast"}"#,
            "expected a number, found \"fast\"",
        ),
        (r#"{"format":"flexstage-recording","version":1,"sample_rate_hz":0}"#, "found 0"),
        (
            r#"{"format":"flexstage-recording","version":1,"sample_rate_hz":9,"settle_s":-1}"#,
            "key `settle_s`",
        ),
        (
            r#"{"format":"flexstage-recording","version":1,"sample_rate_hz":9,"period_s":0}"#,
            "key `period_s`",
        ),
    ] {
        let message = meta(text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text}: {message}");
    }
}

#[test]
fn damaged_parquet_is_refused_without_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.parquet");
    fs::write(&path, "").unwrap();
    assert!(refused(&path).contains("empty"));
    fs::write(&path, "PAR1 but no more than that PAR1").unwrap();
    assert!(refused(&path).contains("Parquet"));
    example().write(&path).unwrap();
    let good = fs::read(&path).unwrap();
    for length in (0..good.len()).step_by(good.len() / 50) {
        fs::write(&path, &good[..length]).unwrap();
        refused(&path);
    }
    // Flipped bytes anywhere: either the same kind of answer or a recording that passes every check.
    let mut state = 1u64;
    for _ in 0..500 {
        let mut bad = good.clone();
        for _ in 0..3 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let at = (state >> 33) as usize % bad.len();
            bad[at] ^= 1 << ((state >> 20) & 7);
        }
        fs::write(&path, &bad).unwrap();
        match Recording::read(&path) {
            Ok(recording) => recording.check(&path).unwrap(),
            Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
        }
    }
}

#[test]
fn half_an_axis_is_refused_and_a_missing_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("axes.csv");
    fs::write(&path, "tick,drive_v_3,position_um_3\n0,1,1\n").unwrap();
    let recording = Recording::read_csv(&path, 10.0).unwrap();
    assert_eq!((recording.axes(), recording.position_um[0].is_none()), (3, true));
    assert_eq!(recording.drive_v[0], [0.0]);
}

#[test]
fn writing_fails_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = example();
    recording.drive_v[0][3] = f32::NAN;
    assert!(recording.write(folder.path().join("a.parquet")).is_err());
    let nowhere = folder.path().join("no/such/folder/a.parquet");
    assert!(example().write(&nowhere).unwrap_err().to_string().contains("folder"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

fn stream(path: &Path, ticks: impl Iterator<Item = u64>) -> StreamWriter {
    let channels = Channels { axes: 1, monitor: false, reference: true, flags: true };
    let mut writer = StreamWriter::create(path, Meta::new("live", 100.0), channels).unwrap();
    for tick in ticks {
        let value = [tick as f32];
        let sample = Sample {
            tick,
            drive_v: &value,
            monitor_v: &[],
            position_um: &value,
            reference_um: &value,
            flags: tick as u32,
        };
        writer.push(&sample).unwrap();
    }
    writer
}

#[test]
fn a_stream_that_ends_is_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.parquet");
    let summary = stream(&path, (0..1234).filter(|tick| tick % 500 != 499)).finish().unwrap();
    assert_eq!((summary.rows, summary.lost_ticks), (1232, 2));
    let recording = Recording::read(&path).unwrap();
    assert_eq!(recording.len(), 1232);
    assert_eq!(recording.flags.as_ref().unwrap().last(), Some(&1233));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_stream_that_is_cut_loses_at_most_a_second() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("live.parquet");
    let part = folder.path().join("live.parquet.part");
    let journal = folder.path().join("live.parquet.journal");
    drop(stream(&path, 0..1234));
    assert!(
        StreamWriter::create(
            &path,
            Meta::new("again", 100.0),
            Channels { axes: 1, monitor: false, reference: false, flags: false }
        )
        .is_err(),
        "must not overwrite what can be recovered"
    );
    let (data, entries) = (fs::read(&part).unwrap(), fs::read(&journal).unwrap());
    // Power loss can cut either file anywhere, and leave rubbish after what was flushed.
    for (data_cut, entries_cut) in
        [(0, 0), (10, 0), (0, 5), (300, 100), (data.len() / 2, 0), (0, entries.len() / 2)]
    {
        let mut cut = data[..data.len() - data_cut].to_vec();
        if data_cut == 0 {
            // What the journal vouches for was on disk before it; only what came after can be rubbish.
            cut.extend_from_slice(&[0xaa; 33]);
        }
        fs::write(&part, cut).unwrap();
        fs::write(&journal, &entries[..entries.len() - entries_cut]).unwrap();
        let recording = recover(&path).unwrap();
        if (data_cut, entries_cut) == (0, 0) {
            assert_eq!(recording.len(), 1200);
        }
        assert!(recording.len().is_multiple_of(100) && !recording.is_empty());
        assert_eq!(recording, Recording::read(&path).unwrap());
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn every_shared_recording_reads() {
    let Some(shared) = shared_data::find("data") else { return };
    let mut files = 0;
    for kind in ["open", "sealed", "real"] {
        for entry in fs::read_dir(shared.join(kind)).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                let session = Session::read(&path, None).unwrap();
                assert!(session.recordings.is_sorted_by_key(|entry| entry.recording.meta.start_s));
                files += session.recordings.len();
            }
        }
    }
    assert!(files >= 16 * 11, "{files}");
    let platform = Recording::read(shared.join("platform/planar-1.43mm.parquet")).unwrap();
    assert_eq!(platform.meta.initial_position_um, Some(1430.0));
    assert_eq!(platform.drive_v[0], vec![0.0; 1600]);
}
