//! The tabs on both sides, and what is done with what people ask for in them.

use std::path::{Path, PathBuf};

use eframe::egui::{RichText, ScrollArea, Ui};
use telemetry::AXES;

use super::{App, Left, Right, now};
use crate::Source;
use crate::link::{LinkState, show_file};
use crate::panels::{BAD, files, gains, log, measure, probe, response, status, timing, xy};

impl App {
    pub(super) fn left_panel(&mut self, ui: &mut Ui) {
        ui.add_space(4.0);
        ui.horizontal_wrapped(|ui| {
            for (tab, name) in [
                (Left::Drive, "Jog"),
                (Left::Generator, "Generator"),
                (Left::Gains, "Settings"),
                (Left::Measure, "Measure"),
                (Left::Probe, "Probe"),
                (Left::Files, "Files"),
                (Left::Log, "Log"),
            ] {
                ui.selectable_value(&mut self.left, tab, name);
            }
        });
        ui.separator();
        let settings = self.link.settings();
        if let Some(settings) = &settings {
            self.gains.observe(settings, self.link.generation());
        }
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
                match self.gains.show(ui, settings.as_ref(), self.link.is_stored()) {
                    Some(gains::Request::Apply(settings)) => self.link.apply(*settings),
                    Some(gains::Request::Save) => self.link.save(),
                    None => {}
                }
                None
            }
            Left::Measure => {
                ScrollArea::vertical().show(ui, |ui| self.measure_panel(ui));
                None
            }
            Left::Probe => {
                ScrollArea::vertical().show(ui, |ui| self.probe_panel(ui));
                None
            }
            Left::Files => {
                self.files_panel(ui);
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
            let text = RichText::new(format!("{} {}", line.utc, line.text));
            ui.label(if line.is_error { text.color(BAD) } else { text.weak() });
        }
    }

    fn measure_panel(&mut self, ui: &mut Ui) {
        let (state, measured) = (self.link.measure_state(), self.link.measured());
        let can = self.link.is_connected() && !self.link.is_busy();
        match self.measure.show(ui, &state, measured.as_deref(), can) {
            Some(measure::Request::Start(what)) => {
                self.link.measure(what);
                self.right = Right::Response;
            }
            Some(measure::Request::Stop) => self.link.stop(),
            None => {}
        }
    }

    fn probe_panel(&mut self, ui: &mut Ui) {
        let state = self.link.probe_state();
        let can = self.link.is_connected() && !self.link.is_busy();
        match self.probe.show(ui, &state, can) {
            Some(probe::Request::Start { options, rig }) => {
                let folder = self.options.folder.join(format!("probe-{}", now()));
                match rig.map(|rig| rig_file(&rig, &folder)).transpose() {
                    Ok(rig) => self.link.probe(options, folder, rig),
                    Err(error) => self.link.note(format!("probe: {error}"), true),
                }
            }
            Some(probe::Request::Stop) => self.link.stop(),
            Some(probe::Request::StopDiagnosis) => self.link.stop_diagnosis(),
            Some(probe::Request::Open(report)) => {
                if let Err(error) = show_file(&report) {
                    self.link.note(format!("{}: {error}", report.display()), true);
                }
            }
            None => {}
        }
    }

    fn files_panel(&mut self, ui: &mut Ui) {
        let has_board = matches!(self.options.source, Source::Board(_));
        let own = match &self.options.source {
            Source::Recording { path, .. } => Some(path.as_path()),
            Source::Board(_) => None,
        };
        let shown = self.shown.as_ref().map(|shown| shown.path.as_path()).or(own);
        let is_recording = self.link.recording().is_some();
        match self.files.show(ui, &self.options.folder, shown, has_board, is_recording) {
            Some(files::Request::Open { path, sample_rate_hz }) => {
                self.open_recording(path, sample_rate_hz);
            }
            Some(files::Request::Export(path)) => self.export(&path),
            Some(files::Request::Recover(path)) => self.recover(path),
            Some(files::Request::Live) => {
                self.shown = None;
                self.view.is_paused = false;
            }
            None => {}
        }
    }

    pub(super) fn right_panel(&mut self, ui: &mut Ui) {
        ui.add_space(4.0);
        ui.horizontal_wrapped(|ui| {
            for (tab, name) in [
                (Right::Status, "Status"),
                (Right::Loop, "XY loop"),
                (Right::Error, "Error"),
                (Right::Spectrum, "Spectrum"),
                (Right::Response, "Response"),
                (Right::Timing, "Tick time"),
            ] {
                ui.selectable_value(&mut self.right, tab, name);
            }
        });
        ui.separator();
        let link = self.shown.as_ref().map_or(&self.link, |shown| &shown.link);
        let info = match link.state() {
            LinkState::Connected(info) => Some(info),
            _ => None,
        };
        let is_gone = matches!(link.state(), LinkState::Waiting { .. });
        let statistics = link.statistics();
        if self.right == Right::Response {
            let measured = self.link.measured();
            return response::show(ui, measured.as_deref());
        }
        let history = link.history();
        let axes = self.visible.axes;
        match self.right {
            Right::Status => status::show(ui, &history, info.as_deref(), statistics, is_gone),
            Right::Loop => xy::show(ui, &self.view, axes, &history),
            Right::Error => self.histogram.show(ui, &self.view, axes, &history),
            Right::Spectrum => self.spectrum.show(ui, &self.view, axes, &history),
            Right::Timing => timing::show(ui, &history),
            Right::Response => {}
        }
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
