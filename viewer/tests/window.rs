//! The window driven as a person drives it, by what a screen reader sees: no GPU, a virtual board behind it.

use std::path::Path;
use std::time::{Duration, Instant};

use eframe::egui::{Key, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use flexstage::{Flags, State};
use telemetry::Target;
use telemetry::virtual_board::{Options as Board, Speed};
use viewer::{App, Options, Source};

fn window_of(source: Source, folder: &Path) -> Harness<'static, App> {
    let options = Options { source, history_s: 20.0, folder: folder.to_owned(), rig: None };
    let context = eframe::egui::Context::default();
    let app = App::new(&context, options).unwrap();
    Harness::builder()
        .with_size(vec2(1600.0, 960.0))
        .build_ui_state(|ui, app: &mut App| app.show(ui), app)
}

fn window(folder: &Path, speed: Speed) -> Harness<'static, App> {
    let board = Board { speed, ..Board::default() };
    let mut harness = window_of(Source::Board(Target::Virtual(board)), folder);
    until(&mut harness, "samples", |h| {
        h.state().link().history().last().is_some_and(|s| Flags(s.flags).is_parked())
    });
    harness
}

fn state(harness: &Harness<'static, App>) -> Option<State> {
    harness.state().link().history().last().map(|s| Flags(s.flags).state())
}

/// Frames until something is so.
fn until(
    harness: &mut Harness<'static, App>,
    what: &str,
    done: impl Fn(&Harness<'static, App>) -> bool,
) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while Instant::now() < deadline {
        harness.step();
        if done(harness) {
            // What became so shows in the next picture.
            harness.step();
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{what} did not happen; log: {:?}", harness.state().link().log());
}

fn click(harness: &mut Harness<'static, App>, label: &str) {
    harness.get_by_label(label).click();
    harness.step();
    harness.step();
}

fn shows(harness: &Harness<'static, App>, text: &str) -> bool {
    harness.query_all_by_label_contains(text).next().is_some()
}

#[test]
fn arm_jog_record_and_stop_with_the_keyboard() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    click(&mut harness, "Arm");
    until(&mut harness, "hold", |h| state(h) == Some(State::Hold));
    harness.key_press(Key::R);
    until(&mut harness, "the recording", |h| h.state().link().recording().is_some());
    click(&mut harness, "Jog 1 +");
    until(&mut harness, "the jog", |h| {
        h.state().link().history().last().is_some_and(|s| (s.position_um[0] - 0.5).abs() < 0.1)
    });
    harness.key_press(Key::R);
    until(&mut harness, "the file", |h| h.state().link().recorded().is_some());
    let path = harness.state().link().recorded().unwrap().path;
    let recording = recording::Recording::read(&path).unwrap();
    assert!(recording.len() > 100 && recording.lost().is_empty());
    // Space stops even while a button has the focus.
    harness.get_by_label("Jog 1 +").focus();
    harness.step();
    harness.key_press(Key::Space);
    until(&mut harness, "off", |h| state(h) == Some(State::Off));

    // The recording is in the list, opens, and goes away again; the board stays behind it.
    click(&mut harness, "Files");
    let name = path.file_name().unwrap().to_str().unwrap().to_owned();
    harness.get_by_label_contains(&name).click();
    until(&mut harness, "the recording on screen", |h| shows(h, "on screen:"));
    assert_eq!(harness.state().picture().history().ticks().0, recording.tick[0]);
    click(&mut harness, "Export as CSV");
    until(&mut harness, "the CSV", |_| path.with_extension("csv").exists());
    click(&mut harness, "Back to the board");
    assert!(!shows(&harness, "on screen:"));
}

#[test]
fn a_waveform_is_checked_before_it_is_sent() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    click(&mut harness, "Arm");
    until(&mut harness, "hold", |h| state(h) == Some(State::Hold));
    click(&mut harness, "Generator");
    assert!(shows(&harness, "checked: can be sent"));
    click(&mut harness, "Start waveform");
    until(&mut harness, "the waveform", |h| state(h) == Some(State::Run));
    harness.key_press(Key::H);
    until(&mut harness, "hold", |h| state(h) == Some(State::Hold));
    // A sentence says why nothing can be sent with no axis chosen.
    for axis in 1..=3 {
        let label = format!("on axis {axis}");
        let node = harness.get_by_label(&label);
        if node.accesskit_node().toggled() == Some(eframe::egui::accesskit::Toggled::True) {
            click(&mut harness, &label);
        }
    }
    assert!(shows(&harness, "choose an axis"));
}

#[test]
fn a_refused_command_stays_in_sight_until_it_is_put_away() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    click(&mut harness, "Jog 1 +");
    until(&mut harness, "the refusal", |h| shows(h, "not armed"));
    harness.get_by_label("OK").click();
    until(&mut harness, "no banner", |h| h.query_by_label("OK").is_none());
}

#[test]
fn every_panel_draws() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    for tab in ["Generator", "Settings", "Measure", "Probe", "Files", "Log", "Jog"] {
        click(&mut harness, tab);
    }
    for tab in ["XY loop", "Error", "Spectrum", "Response", "Tick time", "Status"] {
        click(&mut harness, tab);
    }
    for window in ["0.1 s", "10 min", "All"] {
        click(&mut harness, window);
    }
    harness.get_by_label_contains("no fault, no limit");
}

#[test]
fn a_measurement_and_a_tuning_by_buttons() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::Max);
    click(&mut harness, "Measure");
    click(&mut harness, "Start measurement");
    until(&mut harness, "the response", |h| shows(h, "static gain"));
    until(&mut harness, "parked", |h| {
        h.state().link().history().last().is_some_and(|s| Flags(s.flags).is_parked())
    });
    assert!(shows(&harness, "axis 1: drive to position"));
}

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
