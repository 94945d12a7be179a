//! Recordings on screen: own ones, other programs', dropped ones, damaged ones.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::DroppedFile;
use egui_kittest::kittest::Queryable;
use telemetry::virtual_board::Speed;
use viewer::{App, Options, Source};

use crate::common::{click, shows, until, window, window_of};

#[test]
fn a_recording_is_shown_and_a_missing_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.parquet");
    let mut recording = recording::Recording::empty(recording::Meta::new("old", 1000.0), 1);
    recording.tick = (0..500).chain(600..1000).collect();
    recording.drive_v = vec![vec![1.0; 900]];
    recording.position_um = vec![Some(vec![2.0; 900])];
    recording.write(&path).unwrap();
    let source = |path: &Path| Source::Recording { path: path.to_owned(), sample_rate_hz: None };
    let mut harness = window_of(source(&path), folder.path());
    assert_eq!(harness.state().link().history().lost_total(), 100);
    harness.step();
    assert!(shows(&harness, "100 ticks lost"));
    // Another program's CSV, without metadata: the rate of the Files tab.
    let csv = folder.path().join("foreign.csv");
    std::fs::write(&csv, "tick,drive_v_1,position_um_1\n0,0,0\n1,1,0.1\n2,2,0.2\n").unwrap();
    click(&mut harness, "Files");
    harness.get_by_label_contains("foreign.csv").click();
    until(&mut harness, "the CSV", |h| h.state().picture().history().ticks() == (0, 3));
    // A file cut in half is refused in words, and the picture stays.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(folder.path().join("cut.parquet"), &bytes[..bytes.len() / 2]).unwrap();
    until(&mut harness, "the list", |h| shows(h, "cut.parquet"));
    harness.get_by_label_contains("cut.parquet").click();
    until(&mut harness, "the message", |h| h.state().link().last_error().is_some());
    let words = harness.state().link().last_error().unwrap().text;
    assert!(words.contains("cut.parquet"), "{words}");
    assert_eq!(harness.state().picture().history().ticks(), (0, 3));

    let context = eframe::egui::Context::default();
    let options = Options {
        source: source(&folder.path().join("no.parquet")),
        history_s: 10.0,
        folder: folder.path().to_owned(),
        rig: None,
    };
    let missing = App::new(&context, options);
    assert!(missing.is_err_and(|e| e.to_string().contains("no.parquet")));
}

/// What the desktop hands over.
#[derive(Debug)]
struct Dropped(PathBuf);

impl DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        std::fs::read(&self.0).map_err(|e| e.to_string())
    }
}

#[test]
fn a_file_dropped_on_the_window_is_shown_over_the_board() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    let path = folder.path().join("from elsewhere.csv");
    std::fs::write(&path, "tick,drive_v_1,position_um_1\n0,0,0\n1,1,0.1\n2,2,0.2\n3,2,0.2\n")
        .unwrap();
    harness.input_mut().dropped_files.push(Arc::new(Dropped(path)));
    until(&mut harness, "the file on screen", |h| shows(h, "on screen:"));
    assert_eq!(harness.state().picture().history().ticks(), (0, 4));
    assert!(harness.state().link().is_connected(), "the board stays behind it");
    // What cannot be read is named, and what is on screen stays.
    let nothing = folder.path().join("holiday.jpg");
    std::fs::write(&nothing, "no recording").unwrap();
    harness.input_mut().dropped_files.push(Arc::new(Dropped(nothing)));
    until(&mut harness, "the message", |h| shows(h, "holiday.jpg"));
    assert_eq!(harness.state().picture().history().ticks(), (0, 4));
}
