//! The window: bar with state and stop, panels to drive on the left, traces in the middle, analysis on the right.
//!
//! Keys: Space or Escape stop, P pauses the picture, R starts and ends a recording, H holds.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use eframe::egui::{self, Button, Context, Key, Modifiers, Panel, RichText, ScrollArea, Ui};
use flexstage::link::message::Command;
use flexstage::{Flags, State};
use telemetry::AXES;

use crate::link::{Link, LinkState, ProbeState};
use crate::panels::drive::Drive;
use crate::panels::gains::{self, Gains};
use crate::panels::generator::Generator;
use crate::panels::probe::{self, Probe};
use crate::panels::spectrum::Spectrum;
use crate::panels::traces::{self, Visible};
use crate::panels::{BAD, GOOD, WARN, histogram, log, status, timing, xy};
use crate::view::TimeView;
use crate::{Options, Source};

#[derive(Clone, Copy, PartialEq, Eq)]
enum Left {
    Drive,
    Generator,
    Gains,
    Probe,
    Log,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Right {
    Status,
    Loop,
    Error,
    Spectrum,
    Timing,
}

/// The window's state.
pub struct App {
    link: Link,
    options: Options,
    view: TimeView,
    visible: Visible,
    left: Left,
    right: Right,
    drive: Drive,
    generator: Generator,
    gains: Gains,
    probe: Probe,
    spectrum: Spectrum,
    frame_s: f32,
}

impl App {
    /// Connect and set up.
    pub fn new(context: &Context, options: Options) -> anyhow::Result<Self> {
        context.set_theme(egui::Theme::Dark);
        let link = Link::start(&options.source, options.history_s)?;
        let mut view = TimeView::default();
        if matches!(options.source, Source::Recording { .. }) {
            let history = link.history();
            let (first, end) = history.ticks();
            view.show(history.time_s(first), history.time_s(end));
        }
        Ok(Self {
            link,
            view,
            visible: Visible::default(),
            left: Left::Drive,
            right: Right::Status,
            drive: Drive::default(),
            generator: Generator::default(),
            gains: Gains::default(),
            probe: Probe::new(options.rig.clone()),
            spectrum: Spectrum::default(),
            frame_s: 1.0 / 60.0,
            options,
        })
    }

    /// The board behind the window.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// One frame.
    pub fn show(&mut self, ui: &mut Ui) {
        self.keys(ui.ctx());
        let dt = ui.input(|i| i.stable_dt);
        self.frame_s += 0.05 * (dt - self.frame_s);
        Panel::top("bar").show(ui, |ui| self.bar(ui));
        Panel::left("left").default_size(370.0).show(ui, |ui| self.left_panel(ui));
        Panel::right("right").default_size(400.0).show(ui, |ui| self.right_panel(ui));
        egui::CentralPanel::default().show(ui, |ui| {
            let history = self.link.history();
            traces::toolbar(ui, &mut self.view, &mut self.visible, &history);
            traces::plots(ui, &mut self.view, &self.visible, &history);
        });
        // Live pictures move by themselves; a still one wakes up a few times a second for the state.
        if self.view.is_paused {
            ui.ctx().request_repaint_after(Duration::from_millis(100));
        } else {
            ui.ctx().request_repaint();
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

    fn toggle_recording(&mut self) {
        if self.link.recording().is_some() {
            self.link.stop_recording();
        } else if self.link.is_connected() {
            let path = self.options.folder.join(format!("{}.parquet", stamp()));
            self.link.record(path);
        }
    }

    fn bar(&mut self, ui: &mut Ui) {
        let connected = self.link.is_connected();
        let flags = self.link.history().last().map(|s| Flags(s.flags));
        let state = flags.filter(|_| connected).map(Flags::state);
        ui.add_space(2.0);
        ui.horizontal_wrapped(|ui| {
            let stop =
                Button::new(RichText::new("STOP (Space)").strong().color(egui::Color32::WHITE))
                    .fill(egui::Color32::from_rgb(190, 40, 35))
                    .min_size(egui::vec2(110.0, 30.0));
            if ui
                .add(stop)
                .on_hover_text("Open the loop, return slowly to the safe voltage")
                .clicked()
            {
                self.link.stop();
            }
            let off = state == Some(State::Off);
            let active = state.is_some_and(State::is_active);
            if ui.add_enabled(off, Button::new("Arm").min_size(egui::vec2(60.0, 30.0))).clicked() {
                self.link.send("arm", vec![Command::Arm]);
            }
            if ui
                .add_enabled(active, Button::new("Hold (H)").min_size(egui::vec2(70.0, 30.0)))
                .clicked()
            {
                self.link.send("hold", vec![Command::Hold]);
            }
            if ui
                .add_enabled(
                    state == Some(State::Fault),
                    Button::new("Clear faults").min_size(egui::vec2(80.0, 30.0)),
                )
                .clicked()
            {
                self.link.send("clear faults", vec![Command::ClearFaults]);
            }
            ui.separator();
            if let Some(state) = state {
                let text = RichText::new(state.name().to_uppercase()).size(18.0).strong();
                ui.label(text.color(status::state_color(state)));
            }
            match self.link.state() {
                LinkState::Connecting => {
                    ui.spinner();
                    ui.label("connecting")
                }
                LinkState::Connected(info) => ui.label(format!("{} {}", info.name, info.firmware)),
                LinkState::Waiting { reason } => ui.label(RichText::new(reason).color(BAD)),
                LinkState::Recording { path, about } => {
                    ui.label(format!("{}: {about}", path.display()))
                }
            };
            ui.separator();
            match self.link.recording() {
                Some(progress) => {
                    let text = format!("Stop recording (R) {:.1} s", progress.seconds);
                    if ui.button(RichText::new(text).color(BAD)).clicked() {
                        self.toggle_recording();
                    }
                }
                None => {
                    if ui.add_enabled(connected, Button::new("Record (R)")).clicked() {
                        self.toggle_recording();
                    }
                    if let Some(last) = self.link.recorded()
                        && ui
                            .button("Export CSV")
                            .on_hover_text(last.path.display().to_string())
                            .clicked()
                    {
                        self.export(&last.path);
                    }
                }
            }
            ui.separator();
            if let Some(s) = self.link.statistics() {
                let color = if s.lost_ticks == 0 { GOOD } else { WARN };
                ui.label(RichText::new(format!("{} ticks lost", s.lost_ticks)).color(color));
            }
            ui.label(RichText::new(format!("{:.0} fps", 1.0 / self.frame_s.max(1e-3))).weak());
        });
        if let Some(flags) = flags.filter(|f| connected && f.state() == State::Fault) {
            ui.label(RichText::new(telemetry::words::fault_line(flags)).color(BAD).strong());
        }
        ui.add_space(2.0);
    }

    fn left_panel(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            for (tab, name) in [
                (Left::Drive, "Jog"),
                (Left::Generator, "Generator"),
                (Left::Gains, "Settings"),
                (Left::Probe, "Probe"),
                (Left::Log, "Log"),
            ] {
                ui.selectable_value(&mut self.left, tab, name);
            }
        });
        ui.separator();
        let settings = self.link.settings();
        let limits = settings.as_ref().map_or([[-2.0, 18.0]; AXES], |settings| {
            [0, 1, 2].map(|axis| {
                let limits = &settings.axes[axis].limits;
                [limits.min_um, limits.max_um]
            })
        });
        let commands = match self.left {
            Left::Drive => self.drive.show(ui, &self.link.history(), limits),
            Left::Generator => self.generator.show(ui, limits),
            Left::Gains => {
                let generation = self.link.generation();
                match self.gains.show(ui, settings.as_ref(), generation, self.link.is_stored()) {
                    Some(gains::Request::Apply(settings)) => self.link.apply(*settings),
                    Some(gains::Request::Save) => self.link.save(),
                    None => {}
                }
                None
            }
            Left::Probe => {
                ScrollArea::vertical().show(ui, |ui| self.probe_panel(ui));
                None
            }
            Left::Log => {
                log::show(ui, &self.link.log());
                None
            }
        };
        if let Some((what, commands)) = commands {
            self.link.send(what, commands);
        }
        // The newest line is always in sight, whatever tab is open.
        if self.left != Left::Log
            && let Some(line) = self.link.log().last()
        {
            ui.separator();
            let text = RichText::new(&line.text).small();
            ui.label(if line.is_error { text.color(BAD) } else { text.weak() });
        }
    }

    fn probe_panel(&mut self, ui: &mut Ui) {
        let state = self.link.probe_state();
        match self.probe.show(ui, &state, self.link.is_connected()) {
            Some(probe::Request::Start { options, rig }) => {
                let folder = self.options.folder.join(format!("probe-{}", stamp()));
                match rig.map(|rig| rig_file(&rig, &folder)).transpose() {
                    Ok(rig) => self.link.probe(options, folder, rig),
                    Err(error) => self.link.note(format!("probe: {error}"), true),
                }
            }
            Some(probe::Request::Stop) => self.link.stop(),
            Some(probe::Request::Open(report)) => {
                if let Err(error) = open(&report) {
                    self.link.note(format!("{}: {error}", report.display()), true);
                }
            }
            None => {}
        }
        if matches!(state, ProbeState::Running(_)) {
            ui.ctx().request_repaint();
        }
    }

    fn right_panel(&mut self, ui: &mut Ui) {
        ui.horizontal_wrapped(|ui| {
            for (tab, name) in [
                (Right::Status, "Status"),
                (Right::Loop, "Voltage-displacement"),
                (Right::Error, "Error"),
                (Right::Spectrum, "Spectrum"),
                (Right::Timing, "Tick time"),
            ] {
                ui.selectable_value(&mut self.right, tab, name);
            }
        });
        ui.separator();
        let info = match self.link.state() {
            LinkState::Connected(info) => Some(info),
            _ => None,
        };
        let statistics = self.link.statistics();
        let history = self.link.history();
        let axes = self.visible.axes;
        match self.right {
            Right::Status => status::show(ui, &history, info.as_deref(), statistics),
            Right::Loop => xy::show(ui, &self.view, axes, &history),
            Right::Error => histogram::show(ui, &self.view, axes, &history),
            Right::Spectrum => self.spectrum.show(ui, &self.view, axes, &history),
            Right::Timing => timing::show(ui, &history),
        }
    }

    fn export(&self, path: &Path) {
        let csv = path.with_extension("csv");
        let written = recording::Recording::read(path).and_then(|recording| recording.write(&csv));
        match written {
            Ok(()) => self.link.note(format!("exported {}", csv.display()), false),
            Err(error) => self.link.note(format!("export: {error}"), true),
        }
    }
}

impl eframe::App for App {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }
}

/// The rig file that was named, or the built-in rig written beside the session.
fn rig_file(named: &Path, folder: &Path) -> anyhow::Result<PathBuf> {
    if !named.as_os_str().is_empty() {
        anyhow::ensure!(named.exists(), "{}: no such rig file", named.display());
        return Ok(named.to_owned());
    }
    let rig = host_sim::Rig::named("handley").ok_or_else(|| anyhow::anyhow!("no built-in rig"))?;
    let mut path = folder.as_os_str().to_owned();
    path.push("-rig.toml");
    let path = PathBuf::from(path);
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent)?;
    }
    std::fs::write(&path, rig.to_toml())?;
    Ok(path)
}

/// Seconds since 1970 in UTC as `2026-11-21-043000`, for file names (days to date: H. Hinnant, "chrono-compatible low-level
/// date algorithms", civil_from_days).
fn stamp() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()) as i64;
    let (days, rest) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let day = doy - (153 * mp + 2) / 5 + 1;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}-{:02}{:02}{:02}",
        rest / 3600,
        rest % 3600 / 60,
        rest % 60
    )
}

/// Show a file with the program that the desktop has for it.
fn open(path: &Path) -> std::io::Result<()> {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(target_os = "windows") {
        "explorer"
    } else {
        "xdg-open"
    };
    std::process::Command::new(program).arg(path).spawn().map(|_| ())
}
