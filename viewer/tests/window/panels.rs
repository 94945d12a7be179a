//! Buttons, keys and tabs, on a virtual board.

use eframe::egui::Key;
use egui_kittest::kittest::{NodeT, Queryable};
use flexstage::{Flags, State};
use host_sim::effects::Place;
use telemetry::virtual_board::{Options as Board, Speed};

use crate::common::{click, shows, state, until, window, window_on};

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
fn a_fault_says_what_happened_and_what_to_do_until_it_is_cleared() {
    let folder = tempfile::tempdir().unwrap();
    let mut board = Board::default();
    // A gauge that reads a fifth too much, and a limit that a jog of half a micrometre then exceeds by far.
    board.rig.set("sensor-gain", Place::Axis(1), "ratio", 1.2).unwrap();
    board.settings.axes[1].limits.following_error_um = 0.03;
    let mut harness = window_on(folder.path(), board);
    click(&mut harness, "Arm");
    until(&mut harness, "hold", |h| state(h) == Some(State::Hold));
    click(&mut harness, "Jog 2 +");
    until(&mut harness, "the fault", |h| state(h) == Some(State::Fault));
    assert!(shows(&harness, "did not follow its reference") && shows(&harness, "on axis 2"));
    until(&mut harness, "the way back", |h| {
        h.state().link().history().last().is_some_and(|s| Flags(s.flags).is_parked())
    });
    click(&mut harness, "Clear faults");
    until(&mut harness, "off", |h| state(h) == Some(State::Off));
    assert!(shows(&harness, "faults so far"), "what happened stays in sight");
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
fn a_measurement_by_a_button() {
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
