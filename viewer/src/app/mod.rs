//! The window: bar with state and stop, panels to drive on the left, traces in the middle, analysis on the right.
//!
//! Keys: Space or Escape stop, P pauses the picture, R starts and ends a recording, H holds. They act on the board, also while a
//! recording is on screen.

mod bar;
mod sides;

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use eframe::egui::{self, Context, Key, Modifiers, Panel, Ui};
use flexstage::link::message::Command;

use crate::link::Link;
use crate::panels::drive::Drive;
use crate::panels::files::Files;
use crate::panels::gains::Gains;
use crate::panels::generator::Generator;
use crate::panels::histogram::Histogram;
use crate::panels::measure::Measure;
use crate::panels::probe::Probe;
use crate::panels::spectrum::Spectrum;
use crate::panels::traces::{self, Visible};
use crate::view::TimeView;
use crate::{Options, Source, clock};

/// Pictures a second that are aimed at.
const FRAME: Duration = Duration::from_micros(16_600);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Left {
    Drive,
    Generator,
    Gains,
    Measure,
    Probe,
    Files,
    Log,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Right {
    Status,
    Loop,
    Error,
    Spectrum,
    Response,
    Timing,
}

/// The window's state.
pub struct App {
    link: Link,
    /// A recording that is on screen instead of the board; the board stays connected behind it.
    shown: Option<Shown>,
    options: Options,
    view: TimeView,
    visible: Visible,
    left: Left,
    right: Right,
    drive: Drive,
    generator: Generator,
    gains: Gains,
    measure: Measure,
    probe: Probe,
    spectrum: Spectrum,
    histogram: Histogram,
    files: Files,
    /// Number of the last bad news that the person has put away.
    dismissed: u64,
    frame_s: f32,
    /// Processor time of the last pass, s.
    cpu_s: f32,
}

struct Shown {
    path: PathBuf,
    link: Link,
}

impl App {
    /// Connect and set up.
    pub fn new(context: &Context, options: Options) -> anyhow::Result<Self> {
        context.set_theme(egui::Theme::Dark);
        let link = Link::start(&options.source, options.history_s)?;
        let mut view = TimeView::default();
        if matches!(options.source, Source::Recording { .. }) {
            show_all(&mut view, &link);
        }
        Ok(Self {
            link,
            shown: None,
            view,
            visible: Visible::default(),
            left: Left::Drive,
            right: Right::Status,
            drive: Drive::default(),
            generator: Generator::default(),
            gains: Gains::default(),
            measure: Measure::default(),
            probe: Probe::new(options.rig.clone()),
            spectrum: Spectrum::default(),
            histogram: Histogram::default(),
            files: Files::default(),
            dismissed: 0,
            frame_s: 1.0 / 60.0,
            cpu_s: 0.0,
            options,
        })
    }

    /// The board behind the window.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// What is on screen: the board, or a recording.
    pub fn picture(&self) -> &Link {
        self.shown.as_ref().map_or(&self.link, |shown| &shown.link)
    }

    /// First and last time on screen, s.
    pub fn shown_s(&self) -> (f64, f64) {
        self.view.range_s
    }

    /// One frame.
    pub fn show(&mut self, ui: &mut Ui) {
        self.keys(ui.ctx());
        self.take_dropped(ui.ctx());
        let dt = ui.input(|i| i.stable_dt);
        self.frame_s += 0.05 * (dt - self.frame_s);
        Panel::top("bar").show(ui, |ui| self.bar(ui));
        Panel::left("left").default_size(390.0).show(ui, |ui| self.left_panel(ui));
        Panel::right("right").default_size(430.0).show(ui, |ui| self.right_panel(ui));
        egui::CentralPanel::default().show(ui, |ui| {
            let link = self.shown.as_ref().map_or(&self.link, |shown| &shown.link);
            let history = link.history();
            traces::toolbar(ui, &mut self.view, &mut self.visible, &history);
            traces::plots(ui, &mut self.view, &self.visible, &history);
        });
        // Live pictures move by themselves; a still one wakes up a few times a second for the state. Where drawing does not wait
        // for the screen (no vsync), the rest of the frame's time is slept.
        if self.view.is_paused {
            ui.ctx().request_repaint_after(Duration::from_millis(100));
        } else {
            let busy = Duration::from_secs_f32(self.cpu_s.clamp(0.0, 1.0) + 0.002);
            ui.ctx().request_repaint_after(FRAME.saturating_sub(busy));
        }
    }

    fn keys(&mut self, context: &Context) {
        let typing = context.text_edit_focused();
        // Taken before any widget sees them: a focused button must not swallow the stop.
        let pressed = |key: Key| context.input_mut(|i| i.consume_key(Modifiers::NONE, key));
        if pressed(Key::Escape) || (!typing && pressed(Key::Space)) {
            self.link.stop();
        }
        if typing {
            return;
        }
        if pressed(Key::P) {
            self.view.is_paused = !self.view.is_paused;
        }
        if pressed(Key::R) {
            self.toggle_recording();
        }
        if pressed(Key::H) && self.link.is_connected() {
            self.link.send("hold", vec![Command::Hold]);
        }
    }

    /// A file dropped on the window is opened.
    fn take_dropped(&mut self, context: &Context) {
        let dropped = context.input(|i| i.raw.dropped_files.first().map(|f| f.path().to_owned()));
        if let Some(path) = dropped {
            let rate = self.files.sample_rate_hz();
            self.open_recording(path, rate);
        }
    }

    fn toggle_recording(&mut self) {
        if self.link.recording().is_some() {
            self.link.stop_recording();
        } else if self.link.is_connected() {
            self.link.record(self.options.folder.join(format!("{}.parquet", now())));
        }
    }

    /// Show a recording; the board goes on behind it.
    fn open_recording(&mut self, path: PathBuf, csv_rate_hz: f64) {
        let source = |sample_rate_hz| Source::Recording { path: path.clone(), sample_rate_hz };
        // A CSV of our own carries its rate; the one given is for others.
        let opened =
            Link::start(&source(None), self.options.history_s).or_else(|first| {
                match is_csv(&path) {
                    true => Link::start(&source(Some(csv_rate_hz)), self.options.history_s),
                    false => Err(first),
                }
            });
        match opened {
            Ok(link) => {
                show_all(&mut self.view, &link);
                self.link.note(format!("showing {}", path.display()), false);
                self.shown = Some(Shown { path, link });
            }
            Err(error) => self.link.note(format!("open: {error:#}"), true),
        }
    }

    fn export(&self, path: &Path) {
        let csv = path.with_extension("csv");
        if csv.exists() {
            let text = format!("export: {} is there already, it is not overwritten", csv.display());
            self.link.note(text, true);
            return;
        }
        // Minutes of samples take seconds to write as text: not on the drawing thread.
        let path = path.to_owned();
        self.link.background(move || {
            recording::Recording::read(&path)
                .and_then(|recording| recording.write(&csv))
                .map(|()| format!("exported {}", csv.display()))
                .map_err(|error| format!("export: {error}"))
        });
    }

    fn recover(&self, path: PathBuf) {
        self.link.background(move || match recording::recover(&path) {
            Ok(kept) => Ok(format!(
                "{}: {:.1} s recovered",
                path.display(),
                kept.span_ticks() as f64 / kept.meta.sample_rate_hz
            )),
            Err(error) => Err(format!("recover: {error}")),
        });
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, frame: &mut eframe::Frame) {
        self.cpu_s = frame.info().cpu_usage.unwrap_or(0.0);
        self.show(ui);
    }
}

fn now() -> String {
    clock::stamp(SystemTime::now())
}

fn is_csv(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"))
}

fn show_all(view: &mut TimeView, link: &Link) {
    let history = link.history();
    let (first, end) = history.ticks();
    view.show(history.time_s(first), history.time_s(end));
}
