//! The window and what a person does with it.

use std::path::Path;
use std::time::{Duration, Instant};

use eframe::egui::vec2;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use flexstage::{Flags, State};
use telemetry::Target;
use telemetry::virtual_board::{Options as Board, Speed};
use viewer::{App, Options, Source};

/// A window without a screen.
pub type Window = Harness<'static, App>;

/// The window on a source; recordings go to `folder`.
pub fn window_of(source: Source, folder: &Path) -> Window {
    let options = Options { source, history_s: 20.0, folder: folder.to_owned(), rig: None };
    let context = eframe::egui::Context::default();
    let app = App::new(&context, options).unwrap();
    Harness::builder()
        .with_size(vec2(1600.0, 960.0))
        .build_ui_state(|ui, app: &mut App| app.show(ui), app)
}

/// The window on a virtual board that is ready.
pub fn window(folder: &Path, speed: Speed) -> Window {
    window_on(folder, Board { speed, ..Board::default() })
}

/// The window on this board, when it is ready.
pub fn window_on(folder: &Path, board: Board) -> Window {
    let mut harness = window_of(Source::Board(Target::Virtual(board)), folder);
    until(&mut harness, "samples", |h| {
        h.state().link().history().last().is_some_and(|s| Flags(s.flags).is_parked())
    });
    harness
}

/// State of the newest sample.
pub fn state(harness: &Window) -> Option<State> {
    harness.state().link().history().last().map(|s| Flags(s.flags).state())
}

/// Frames until something is so.
pub fn until(harness: &mut Window, what: &str, done: impl Fn(&Window) -> bool) {
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

/// Click what has this label.
pub fn click(harness: &mut Window, label: &str) {
    harness.get_by_label(label).click();
    harness.step();
    harness.step();
}

/// Whether any label has this in it.
pub fn shows(harness: &Window, text: &str) -> bool {
    harness.query_all_by_label_contains(text).next().is_some()
}
