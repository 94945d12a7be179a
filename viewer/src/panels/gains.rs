//! Gains, filters and limits: edit, check, see what changes, apply, undo, save, compare with a file.

use std::path::Path;

use eframe::egui::{DragValue, Grid, RichText, ScrollArea, Ui};
use flexstage::settings::NotchSettings;
use flexstage::{Config, Settings};
use telemetry::AXES;

use super::{BAD, GOOD, WARN, axis_color};
use crate::settings_text::differences;

/// Changes that are listed before they are sent.
const SHOWN: usize = 4;

/// What the person wants.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Put these into effect.
    Apply(Box<Settings>),
    /// Write those in effect to flash.
    Save,
}

/// Most changes that can be undone.
const UNDO: usize = 50;

/// Name, value on the board, value in the file.
type Difference = (String, String, String);

/// The editor.
#[derive(Default)]
pub struct Gains {
    edited: Option<Settings>,
    generation: u64,
    /// In effect when last looked at.
    last: Option<Settings>,
    /// In effect before, oldest first, whoever changed them: this panel, a tuning, a restart of the board.
    undo: Vec<Settings>,
    /// Asked for by Undo: their coming into effect is nothing to be undone.
    undone: Option<Settings>,
    axis: usize,
    file: String,
    comparison: Option<Result<Vec<Difference>, String>>,
}

impl Gains {
    /// Take note of what is in effect; to be called in every picture, whether the panel is on screen or not.
    pub fn observe(&mut self, in_effect: &Settings, generation: u64) {
        if self.generation == generation && self.edited.is_some() {
            return;
        }
        self.generation = generation;
        let last = self.last.replace(in_effect.clone());
        // Saved, or connected again: what is being edited stays.
        if last.as_ref() == Some(in_effect) && self.edited.is_some() {
            return;
        }
        self.edited = Some(in_effect.clone());
        let Some(last) = last else { return };
        if self.undone.take().as_ref() != Some(in_effect) {
            self.undo.push(last);
            if self.undo.len() > UNDO {
                self.undo.remove(0);
            }
        }
    }

    /// The panel.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        in_effect: Option<&Settings>,
        is_stored: bool,
    ) -> Option<Request> {
        let Some(in_effect) = in_effect else {
            ui.label("no board: no settings");
            return None;
        };
        let mut edited = self.edited.take().unwrap_or_default();
        ui.horizontal(|ui| {
            for axis in 0..AXES {
                let text =
                    RichText::new(format!("settings {}", axis + 1)).color(axis_color(axis, false));
                ui.selectable_value(&mut self.axis, axis, text);
            }
        });
        ScrollArea::vertical().max_height((ui.available_height() - 190.0).max(120.0)).show(
            ui,
            |ui| {
                edit(ui, &mut edited, self.axis);
            },
        );
        let out = self.footer(ui, in_effect, &mut edited, is_stored);
        self.edited = Some(edited);
        out
    }

    fn footer(
        &mut self,
        ui: &mut Ui,
        in_effect: &Settings,
        edited: &mut Settings,
        is_stored: bool,
    ) -> Option<Request> {
        let mut out = None;
        let changes = differences(in_effect, edited);
        let problem = Config::build(edited).err();
        ui.separator();
        match &problem {
            Some(error) => ui.label(RichText::new(error.to_string()).color(BAD)),
            None if changes.is_empty() => ui.label(RichText::new("as on the board").color(GOOD)),
            None => ui.label(
                RichText::new(format!("{} changed, checked, not sent yet", changes.len()))
                    .color(WARN),
            ),
        };
        ui.horizontal_wrapped(|ui| {
            let can = problem.is_none() && !changes.is_empty();
            if ui.add_enabled(can, eframe::egui::Button::new("Apply")).clicked() {
                out = Some(Request::Apply(Box::new(edited.clone())));
            }
            if ui.add_enabled(!changes.is_empty(), eframe::egui::Button::new("Revert")).clicked() {
                *edited = in_effect.clone();
            }
            if ui.add_enabled(!self.undo.is_empty(), eframe::egui::Button::new("Undo")).clicked()
                && let Some(before) = self.undo.pop()
            {
                self.undone = Some(before.clone());
                out = Some(Request::Apply(Box::new(before)));
            }
            if ui.button("Copy to all axes").clicked() {
                let from = edited.axes[self.axis].clone();
                for axis in &mut edited.axes {
                    axis.feedback = from.feedback.clone();
                    axis.feedforward = from.feedforward.clone();
                }
            }
            let save = ui
                .add_enabled(!is_stored, eframe::egui::Button::new("Save to board"))
                .on_hover_text(
                    "Writes what is in effect to flash; only while the drives are parked",
                );
            if save.clicked() {
                out = Some(Request::Save);
            }
        });
        ui.label(
            RichText::new(if is_stored {
                "what is in effect is saved on the board"
            } else {
                "what is in effect is not saved: a restart forgets it"
            })
            .color(if is_stored { GOOD } else { WARN }),
        );
        ui.horizontal(|ui| {
            ui.label("file");
            ui.add(
                eframe::egui::TextEdit::singleline(&mut self.file)
                    .hint_text("settings.toml")
                    .desired_width(150.0),
            );
            let [compare, read, write] =
                ["Compare", "Load", "Write"].map(|name| ui.button(name).clicked());
            if self.file.trim().is_empty() {
                if compare || read || write {
                    let error = "type the name of a settings file first, like settings.toml";
                    self.comparison = Some(Err(error.into()));
                }
                return;
            }
            if compare {
                self.comparison =
                    Some(load(Path::new(&self.file)).map(|file| differences(in_effect, &file)));
            }
            if read {
                match load(Path::new(&self.file)) {
                    Ok(settings) => *edited = settings,
                    Err(error) => self.comparison = Some(Err(error)),
                }
            }
            if write {
                let text = toml::to_string_pretty(in_effect).map_err(|e| e.to_string());
                let written =
                    text.and_then(|t| std::fs::write(&self.file, t).map_err(|e| e.to_string()));
                self.comparison = Some(match written {
                    Ok(()) => Ok(Vec::new()),
                    Err(error) => Err(format!("{}: {error}", self.file)),
                });
            }
        });
        // Below the buttons, so that these stay where they are while one types.
        for (name, old, new) in changes.iter().take(SHOWN) {
            ui.label(RichText::new(format!("{name}: {old} -> {new}")));
        }
        if changes.len() > SHOWN {
            ui.label(format!("and {} more", changes.len() - SHOWN));
        }
        match &self.comparison {
            Some(Err(error)) => {
                ui.label(RichText::new(error).color(BAD));
            }
            Some(Ok(lines)) if lines.is_empty() => {
                ui.label(RichText::new("board and file agree").color(GOOD));
            }
            Some(Ok(lines)) => {
                ui.label(RichText::new(format!("{} differ (board, file):", lines.len())));
                for (name, board, file) in lines.iter().take(6) {
                    ui.label(RichText::new(format!("{name}: {board}, {file}")));
                }
            }
            None => {}
        }
        out
    }
}

fn load(path: &Path) -> Result<Settings, String> {
    let name = path.display();
    let text = std::fs::read_to_string(path).map_err(|e| format!("{name}: {e}"))?;
    let settings: Settings =
        toml::from_str(&text).map_err(|e| format!("{name}: {}", e.message()))?;
    Config::build(&settings).map_err(|e| format!("{name}: {e}"))?;
    Ok(settings)
}

fn edit(ui: &mut Ui, settings: &mut Settings, axis: usize) {
    let axis = &mut settings.axes[axis];
    let number = |ui: &mut Ui, name: &str, value: &mut f32, speed: f64, unit: &str| {
        ui.label(name);
        ui.add(DragValue::new(value).speed(speed).suffix(format!(" {unit}")).max_decimals(6));
        ui.end_row();
    };
    ui.label(RichText::new("feedback").strong());
    Grid::new("feedback").num_columns(2).show(ui, |ui| {
        let f = &mut axis.feedback;
        number(ui, "proportional", &mut f.proportional_v_per_um, 0.05, "V/µm");
        number(ui, "integral", &mut f.integral_v_per_um_s, 5.0, "V/(µm s)");
        number(ui, "derivative", &mut f.derivative_v_ms_per_um, 0.01, "V ms/µm");
        number(ui, "derivative filter", &mut f.derivative_filter_hz, 10.0, "Hz");
        number(ui, "setpoint weight", &mut f.setpoint_weight, 0.01, "");
        number(ui, "integral limit", &mut f.integral_limit_v, 0.5, "V");
    });
    for (i, notch) in axis.feedback.notches.iter_mut().enumerate() {
        ui.label(RichText::new(format!("notch {}", i + 1)).strong());
        Grid::new(("notch", i)).num_columns(2).show(ui, |ui| {
            number(ui, "frequency", &mut notch.frequency_hz, 5.0, "Hz");
            number(ui, "damping ratio", &mut notch.damping_ratio, 0.01, "");
            number(ui, "depth", &mut notch.depth, 0.01, "");
        });
    }
    ui.horizontal(|ui| {
        if ui.button("Add notch").clicked() {
            // A full list stays as it is.
            let _ = axis.feedback.notches.push(NotchSettings::default());
        }
        if ui.button("Remove notch").clicked() {
            axis.feedback.notches.pop();
        }
    });
    ui.add_space(6.0);
    ui.label(RichText::new("feedforward").strong());
    Grid::new("feedforward").num_columns(2).show(ui, |ui| {
        let f = &mut axis.feedforward;
        number(ui, "gain", &mut f.gain, 0.01, "");
        number(ui, "advance", &mut f.advance_s, 1e-5, "s");
        ui.checkbox(&mut f.hysteresis, "hysteresis");
        ui.checkbox(&mut f.dynamics, "damping and inertia");
        ui.end_row();
        ui.checkbox(&mut f.amplifier_lead, "amplifier lead");
        ui.end_row();
        number(ui, "stiffness of the load", &mut axis.mechanism.stiffness_n_per_m, 1e4, "N/m");
        number(ui, "amplifier time constant", &mut axis.amplifier_time_constant_s, 1e-5, "s");
        number(ui, "origin", &mut axis.origin_um, 0.01, "µm");
    });
    ui.add_space(6.0);
    ui.label(RichText::new("limits").strong());
    Grid::new("limits").num_columns(2).show(ui, |ui| {
        let l = &mut axis.limits;
        number(ui, "lowest drive", &mut l.min_v, 0.5, "V");
        number(ui, "highest drive", &mut l.max_v, 0.5, "V");
        number(ui, "slew", &mut l.slew_v_per_ms, 1.0, "V/ms");
        number(ui, "lowest position", &mut l.min_um, 0.1, "µm");
        number(ui, "highest position", &mut l.max_um, 0.1, "µm");
        number(ui, "following error", &mut l.following_error_um, 0.05, "µm");
    });
}
