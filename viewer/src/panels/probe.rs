//! One click from rig to verdict: probe suite, session folder, diagnosis, report.

use std::path::PathBuf;

use eframe::egui::{ComboBox, DragValue, ProgressBar, RichText, TextEdit, Ui};
use telemetry::probe::{LOWEST_MAX_V, Length, Options, plan};
use telemetry::{AXES, probe::Experiment};

use super::{BAD, GOOD, axis_color};
use crate::link::ProbeState;

/// What the person wants.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Run it.
    Start {
        /// What.
        options: Options,
        /// Against which rig file it is diagnosed.
        rig: Option<PathBuf>,
    },
    /// Park and give up.
    Stop,
    /// Give up the diagnosis.
    StopDiagnosis,
    /// Show the report.
    Open(PathBuf),
}

/// Choices.
pub struct Probe {
    axes: [bool; AXES],
    options: Options,
    rig: String,
    diagnose: bool,
}

impl Probe {
    /// With the rig file to start from.
    pub fn new(rig: Option<PathBuf>) -> Self {
        Self {
            axes: [true; AXES],
            options: Options { length: Length::Quick, ..Options::default() },
            rig: rig.map(|p| p.display().to_string()).unwrap_or_default(),
            diagnose: true,
        }
    }

    /// The panel.
    pub fn show(&mut self, ui: &mut Ui, state: &ProbeState, can_start: bool) -> Option<Request> {
        let mut out = None;
        ui.label("Drives the stage open loop through excitations that tell the effects apart, then says why it and its model disagree.");
        ComboBox::from_label("length")
            .selected_text(match self.options.length {
                Length::Quick => "quick",
                Length::Standard => "standard",
                Length::Long => "long",
            })
            .show_ui(ui, |ui| {
                for (length, name) in [
                    (Length::Quick, "quick"),
                    (Length::Standard, "standard"),
                    (Length::Long, "long"),
                ] {
                    ui.selectable_value(&mut self.options.length, length, name);
                }
            });
        ui.horizontal(|ui| {
            ui.label("highest voltage");
            ui.add(
                DragValue::new(&mut self.options.max_v).range(LOWEST_MAX_V..=150.0).suffix(" V"),
            );
        });
        ui.horizontal(|ui| {
            for (axis, on) in self.axes.iter_mut().enumerate() {
                let text = format!("probe axis {}", axis + 1);
                ui.checkbox(on, RichText::new(text).color(axis_color(axis, false)));
            }
        });
        ui.checkbox(&mut self.diagnose, "diagnose afterwards");
        ui.horizontal(|ui| {
            ui.label("rig file");
            let hint = "built-in rig of the first paper";
            ui.add(TextEdit::singleline(&mut self.rig).hint_text(hint));
        });
        self.options.axes = (0..AXES).filter(|&axis| self.axes[axis]).collect();
        let is_running = matches!(state, ProbeState::Running(_));
        let is_diagnosing = matches!(state, ProbeState::Diagnosing { .. });
        let experiments = plan(&self.options);
        let seconds: f64 = experiments.iter().map(Experiment::total_s).sum();
        ui.label(format!("{} recordings, {}", experiments.len(), duration(seconds)));
        ui.horizontal(|ui| {
            let can = can_start && !is_diagnosing && !self.options.axes.is_empty();
            if ui.add_enabled(can, eframe::egui::Button::new("Probe the stage")).clicked() {
                let rig = self.diagnose.then(|| PathBuf::from(self.rig.trim()));
                out = Some(Request::Start { options: self.options.clone(), rig });
            }
            let (label, stop) = if is_diagnosing {
                ("Stop diagnosing", Request::StopDiagnosis)
            } else {
                ("Stop probing", Request::Stop)
            };
            let can = is_running || is_diagnosing;
            if ui.add_enabled(can, eframe::egui::Button::new(label)).clicked() {
                out = Some(stop);
            }
        });
        match state {
            ProbeState::Idle => {}
            ProbeState::Running(p) => {
                let share = (p.done_s / p.total_s.max(1e-9)) as f32;
                ui.add(ProgressBar::new(share).show_percentage());
                ui.label(format!(
                    "{} of {}: {}, {} left",
                    (p.index + 1).min(p.count),
                    p.count,
                    p.name,
                    duration((p.total_s - p.done_s).max(0.0))
                ));
            }
            ProbeState::Diagnosing { since } => {
                ui.horizontal(|ui| {
                    ui.spinner();
                    let seconds = since.elapsed().as_secs_f64();
                    ui.label(format!("diagnosing for {}: half a minute or so", duration(seconds)));
                });
            }
            ProbeState::Done { folder, report, verdict } => {
                ui.label(RichText::new(verdict).color(GOOD).strong());
                ui.label(RichText::new(folder.display().to_string()));
                if let Some(report) = report
                    && ui.button("Open the report").clicked()
                {
                    out = Some(Request::Open(report.clone()));
                }
            }
            ProbeState::Failed(why) => {
                ui.label(RichText::new(why).color(BAD));
            }
        }
        out
    }
}

/// Seconds as a person says them.
fn duration(seconds: f64) -> String {
    if seconds < 90.0 {
        format!("{seconds:.0} s")
    } else {
        format!("{:.0} min {:02.0} s", (seconds / 60.0).floor(), seconds % 60.0)
    }
}
