//! The window driven as a person drives it, by what a screen reader sees: no GPU, a virtual board behind it.

use std::time::{Duration, Instant};

use eframe::egui::{Key, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use flexstage::{Flags, State};
use telemetry::Target;
use telemetry::virtual_board::Options as Board;
use viewer::{App, Options, Source};

fn window(folder: &std::path::Path) -> Harness<'static, App> {
    let options = Options {
        source: Source::Board(Target::Virtual(Board::default())),
        history_s: 20.0,
        folder: folder.to_owned(),
        rig: None,
    };
    let context = eframe::egui::Context::default();
    let app = App::new(&context, options).unwrap();
    Harness::builder()
        .with_size(vec2(1500.0, 900.0))
        .build_ui_state(|ui, app: &mut App| app.show(ui), app)
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
    let deadline = Instant::now() + Duration::from_secs(30);
    while Instant::now() < deadline {
        harness.step();
        if done(harness) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{what} did not happen; log: {:?}", harness.state().link().log());
}

fn click(harness: &mut Harness<'static, App>, label: &str) {
    harness.get_by_label(label).click();
    harness.step();
}

#[test]
fn arm_jog_record_and_stop_with_the_keyboard() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path());
    until(&mut harness, "samples", |h| {
        h.state().link().history().last().is_some_and(|s| Flags(s.flags).is_parked())
    });
    harness.step();
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
}

#[test]
fn every_panel_draws() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path());
    until(&mut harness, "samples", |h| h.state().link().history().last().is_some());
    for tab in ["Generator", "Settings", "Probe", "Log", "Jog"] {
        click(&mut harness, tab);
        harness.step();
    }
    for tab in ["Voltage-displacement", "Error", "Spectrum", "Tick time", "Status"] {
        click(&mut harness, tab);
        harness.step();
    }
    for window in ["0.1 s", "10 min", "All"] {
        click(&mut harness, window);
    }
    harness.get_by_label_contains("no fault, no limit");
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
    let source = |path: &std::path::Path| Options {
        source: Source::Recording { path: path.to_owned(), sample_rate_hz: None },
        history_s: 10.0,
        folder: folder.path().to_owned(),
        rig: None,
    };
    let context = eframe::egui::Context::default();
    let app = App::new(&context, source(&path)).unwrap();
    assert_eq!(app.link().history().lost_total(), 100);
    let mut harness = Harness::builder().build_ui_state(|ui, app: &mut App| app.show(ui), app);
    harness.step();
    harness.get_by_label_contains("100 ticks lost");
    let missing = App::new(&context, source(&folder.path().join("no.parquet")));
    assert!(missing.is_err_and(|e| e.to_string().contains("no.parquet")));
}
