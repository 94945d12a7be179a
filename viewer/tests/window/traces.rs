//! Traces: pause, zoom, cursors with values and differences.

use eframe::egui::accesskit::Role;
use eframe::egui::{Event, Modifiers, PointerButton, Pos2, pos2};
use egui_kittest::kittest::Queryable;
use telemetry::virtual_board::Speed;
use viewer::Source;

use crate::common::{Window, click, shows, until, window, window_of};

/// In the middle of the position trace, whatever the width of the panels beside it.
const IN_THE_PLOT: Pos2 = pos2(780.0, 250.0);

fn press(harness: &mut Window, at: Pos2, button: PointerButton) {
    harness.hover_at(at);
    harness.step();
    for pressed in [true, false] {
        harness.event(Event::PointerButton {
            pos: at,
            button,
            pressed,
            modifiers: Modifiers::NONE,
        });
        harness.step();
    }
    harness.step();
}

/// What stands in the table of cursors from this cell on: cells follow each other as the grid is filled.
fn row(harness: &Window, name: &str) -> Vec<String> {
    let texts: Vec<String> =
        harness.query_all_by_role(Role::Label).filter_map(|node| node.value()).collect();
    let at = texts.iter().position(|t| t == name).unwrap_or_else(|| panic!("{texts:?}"));
    texts[at..].to_vec()
}

#[test]
fn cursors_give_times_values_and_differences() {
    // A ramp of 1 um a second: the difference of the positions is that of the times.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ramp.parquet");
    let mut recording = recording::Recording::empty(recording::Meta::new("ramp", 1000.0), 1);
    recording.tick = (0..10_000).collect();
    recording.drive_v = vec![vec![1.0; 10_000]];
    recording.position_um = vec![Some((0..10_000).map(|i| i as f32 * 1e-3).collect())];
    recording.write(&path).unwrap();
    let mut harness = window_of(Source::Recording { path, sample_rate_hz: None }, folder.path());
    harness.step();
    click(&mut harness, "Cursors");
    press(&mut harness, IN_THE_PLOT, PointerButton::Primary);
    assert!(!shows(&harness, "B - A"), "one cursor has no difference");
    press(&mut harness, IN_THE_PLOT + eframe::egui::vec2(100.0, 0.0), PointerButton::Secondary);
    assert!(shows(&harness, "B - A"));
    let number = |text: &str| text.split(' ').next().unwrap().parse::<f64>().unwrap();
    let (a, b, d) = (row(&harness, "A"), row(&harness, "B"), row(&harness, "B - A"));
    let (ta, tb, dt) = (number(&a[1]), number(&b[1]), number(&d[1]));
    assert!(tb > ta && (tb - ta - dt).abs() < 2e-4, "{ta} {tb} {dt}");
    // The traces of the table: reference, position... by their heading.
    let head = row(&harness, "time (s)");
    let column = head.iter().position(|t| t.starts_with("position 1")).unwrap();
    let (pa, pb, dp) = (number(&a[1 + column]), number(&b[1 + column]), number(&d[1 + column]));
    assert!(
        (pa - ta).abs() < 2e-3 && (pb - tb).abs() < 2e-3,
        "{pa} um at {ta} s, {pb} um at {tb} s"
    );
    assert!((dp - (pb - pa)).abs() < 2e-4, "{dp}");
    click(&mut harness, "Clear cursors");
    assert!(!shows(&harness, "B - A"));
}

#[test]
fn there_is_no_value_before_the_first_sample() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    // Ten minutes of time, seconds of samples at their right end.
    click(&mut harness, "10 min");
    click(&mut harness, "Cursors");
    press(&mut harness, IN_THE_PLOT, PointerButton::Primary);
    let a = row(&harness, "A");
    assert!(a[1].parse::<f64>().unwrap() < 0.0 && a[2] == "-", "{:?}", &a[..4]);
}

#[test]
fn a_paused_picture_stands_still_while_samples_arrive() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    click(&mut harness, "1 s");
    click(&mut harness, "Pause (P)");
    let end = |h: &Window| h.state().link().history().ticks().1;
    let (shown, at) = (harness.state().shown_s(), end(&harness));
    until(&mut harness, "half a second more", |h| end(h) > at + 5000);
    assert_eq!(harness.state().shown_s(), shown);
    click(&mut harness, "Resume (P)");
    assert!(harness.state().shown_s().1 > shown.1 + 0.4);
}

#[test]
fn a_wheel_turn_over_a_trace_zooms_about_the_pointer() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    harness.hover_at(IN_THE_PLOT);
    harness.step();
    let width = |h: &Window| h.state().shown_s().1 - h.state().shown_s().0;
    let before = width(&harness);
    harness.event(Event::MouseWheel {
        unit: eframe::egui::MouseWheelUnit::Line,
        delta: eframe::egui::vec2(0.0, 3.0),
        phase: eframe::egui::TouchPhase::Move,
        source: eframe::egui::MouseWheelSource::Unknown,
        modifiers: Modifiers::NONE,
    });
    until(&mut harness, "a shorter stretch", |h| width(h) < 0.9 * before);
    assert!(shows(&harness, "Resume (P)"), "what is looked at stands still");
}
