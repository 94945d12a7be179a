//! What to measure, the figures that came out, and the tuning that follows from them.

use std::path::PathBuf;

use eframe::egui::{self, Button, ComboBox, DragValue, Grid, ProgressBar, RichText, TextEdit, Ui};
use telemetry::AXES;
use telemetry::measure::Frf;
use telemetry::measure::campaign::Excitation;
use telemetry::measure::margins::Margins;
use telemetry::tune::LoopFigures;
use telemetry::tune::study::{Level, distance};

use super::{BAD, GOOD, WARN, axis_color};
use crate::link::{MeasureState, Measured, Measurement};

/// Band in which prediction and measurement are compared, Hz.
const BAND_HZ: f64 = 500.0;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Kind {
    #[default]
    Response,
    Closed,
    Step,
    Noise,
    Tune,
}

impl Kind {
    const ALL: [(Kind, &'static str); 5] = [
        (Kind::Response, "drive to position, loop margins"),
        (Kind::Closed, "reference to position"),
        (Kind::Step, "step response"),
        (Kind::Noise, "noise floor"),
        (Kind::Tune, "tune feedback and feedforward"),
    ];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(kind, _)| *kind == self).map_or("", |(_, name)| name)
    }
}

/// Choices.
#[derive(Clone, Debug, PartialEq)]
pub struct Measure {
    kind: Kind,
    axis: usize,
    excitation: Excitation,
    level: Level,
    center_um: f64,
    amplitude_um: f64,
    from_um: f64,
    to_um: f64,
    seconds: f64,
    model: String,
}

impl Default for Measure {
    fn default() -> Self {
        Self {
            kind: Kind::default(),
            axis: 0,
            excitation: Excitation::default(),
            level: Level::default(),
            center_um: 6.0,
            amplitude_um: 0.5,
            from_um: 5.0,
            to_um: 6.0,
            seconds: 5.0,
            model: String::new(),
        }
    }
}

/// What the person wants.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Measure.
    Start(Measurement),
    /// Park and give up.
    Stop,
}

impl Measure {
    fn measurement(&self) -> Measurement {
        let (axis, excitation, level) = (self.axis, self.excitation, self.level);
        match self.kind {
            Kind::Response => Measurement::Response { axis, excitation, level },
            Kind::Closed => {
                let level_um = (self.center_um, self.amplitude_um);
                Measurement::Closed { axis, excitation, level_um }
            }
            Kind::Step => Measurement::Step { axis, from_to_um: (self.from_um, self.to_um) },
            Kind::Noise => Measurement::Noise { seconds: self.seconds },
            Kind::Tune => {
                let path = self.model.trim();
                let model = (!path.is_empty()).then(|| PathBuf::from(path));
                Measurement::Tune { axis, level, model }
            }
        }
    }

    /// The panel.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        state: &MeasureState,
        measured: Option<&Measured>,
        can_start: bool,
    ) -> Option<Request> {
        let mut out = None;
        ComboBox::from_label("measurement").width(210.0).selected_text(self.kind.name()).show_ui(
            ui,
            |ui| {
                for (kind, name) in Kind::ALL {
                    ui.selectable_value(&mut self.kind, kind, name);
                }
            },
        );
        Grid::new("measure").num_columns(2).show(ui, |ui| self.choices(ui));
        ui.label(
            RichText::new(match self.kind {
                Kind::Noise => "Nothing is driven: the stage stays parked or holds.",
                Kind::Response => "Starts parked, drives one axis open loop, returns and parks.",
                Kind::Tune if !self.model.trim().is_empty() => {
                    "Measures a simulation of the rig file; the stage does not move until you apply."
                }
                _ => "Starts parked, drives one axis with the settings in effect, returns and parks.",
            })
            .weak(),
        );
        let is_running = matches!(state, MeasureState::Running(_));
        ui.horizontal(|ui| {
            if ui.add_enabled(can_start && !is_running, Button::new("Start measurement")).clicked()
            {
                out = Some(Request::Start(self.measurement()));
            }
            if ui.add_enabled(is_running, Button::new("Stop measuring")).clicked() {
                out = Some(Request::Stop);
            }
        });
        match state {
            MeasureState::Running(p) => {
                let share = (p.done_s / p.total_s.max(1e-9)) as f32;
                ui.add(ProgressBar::new(share).show_percentage());
                let left = (p.total_s - p.done_s).max(0.0);
                ui.label(format!("{}, {left:.0} s left", p.name));
            }
            MeasureState::Failed(why) => {
                ui.label(RichText::new(why).color(BAD));
            }
            MeasureState::Idle | MeasureState::Done => {}
        }
        if let Some(measured) = measured {
            ui.separator();
            let wants_apply = figures(ui, measured, can_start && !is_running);
            if wants_apply {
                out = Some(Request::Start(Measurement::Apply));
            }
        }
        out
    }

    fn choices(&mut self, ui: &mut Ui) {
        let number = |ui: &mut Ui, name: &str, value: &mut f64, speed: f64, unit: &str| {
            ui.label(name);
            ui.add(DragValue::new(value).speed(speed).suffix(format!(" {unit}")).max_decimals(4));
            ui.end_row();
        };
        if self.kind != Kind::Noise {
            ui.label("axis");
            ui.horizontal(|ui| {
                for axis in 0..AXES {
                    let text = RichText::new(format!("measure {}", axis + 1))
                        .color(axis_color(axis, false));
                    ui.selectable_value(&mut self.axis, axis, text);
                }
            });
            ui.end_row();
        }
        if matches!(self.kind, Kind::Response | Kind::Closed) {
            ui.label("excitation");
            ui.horizontal(|ui| {
                ui.selectable_value(&mut self.excitation, Excitation::Multisine, "multisine");
                ui.selectable_value(&mut self.excitation, Excitation::Sweep, "swept sine");
            });
            ui.end_row();
        }
        match self.kind {
            Kind::Response | Kind::Tune => {
                number(ui, "around", &mut self.level.bias_v, 0.5, "V");
                number(ui, "amplitude (peak)", &mut self.level.amplitude_v, 0.1, "V");
            }
            Kind::Closed => {
                number(ui, "around", &mut self.center_um, 0.05, "µm");
                number(ui, "amplitude (peak)", &mut self.amplitude_um, 0.01, "µm");
            }
            Kind::Step => {
                number(ui, "from", &mut self.from_um, 0.05, "µm");
                number(ui, "to", &mut self.to_um, 0.05, "µm");
            }
            Kind::Noise => number(ui, "length", &mut self.seconds, 0.1, "s"),
        }
        if self.kind == Kind::Tune {
            ui.label("rig file");
            let hint = "none: tune on the stage itself";
            ui.add(TextEdit::singleline(&mut self.model).hint_text(hint).desired_width(210.0));
            ui.end_row();
        }
    }
}

/// The figures of a measurement; whether the person wants the proposal applied.
fn figures(ui: &mut Ui, measured: &Measured, can_apply: bool) -> bool {
    match measured {
        Measured::Response { axis, response } => {
            ui.label(title(*axis, "drive to position"));
            response_lines(ui, &response.plant, "µm/V");
            margin_lines(ui, &response.margins);
        }
        Measured::Closed { axis, closed } => {
            ui.label(title(*axis, "reference to position"));
            response_lines(ui, closed, "µm/µm");
        }
        Measured::Step { axis, metrics, .. } => {
            ui.label(title(*axis, "step response"));
            let settling =
                metrics.settling_s.map_or("not settled".into(), |s| format!("{:.2} ms", s * 1e3));
            Grid::new("step figures").num_columns(2).show(ui, |ui| {
                for (name, value) in [
                    ("rise 10-90 %", format!("{:.2} ms", metrics.rise_s * 1e3)),
                    ("delay to 10 %", format!("{:.2} ms", metrics.delay_s * 1e3)),
                    ("overshoot", format!("{:.1} %", metrics.overshoot_percent)),
                    ("settling", settling),
                    ("settling band", format!("± {:.0} nm", metrics.band_nm)),
                    (
                        "steady error",
                        metrics.steady_error_nm.map_or("-".into(), |e| format!("{e:.1} nm")),
                    ),
                ] {
                    ui.label(name);
                    ui.monospace(value);
                    ui.end_row();
                }
            });
        }
        Measured::Noise(noise) => {
            ui.label(RichText::new("noise floor").strong());
            Grid::new("noise figures").num_columns(4).striped(true).show(ui, |ui| {
                for head in ["axis", "rms", "above 100 Hz", "lines (Hz: nm)"] {
                    ui.label(RichText::new(head).weak());
                }
                ui.end_row();
                for n in noise {
                    ui.label(
                        RichText::new(n.axis.to_string()).color(axis_color(n.axis - 1, false)),
                    );
                    ui.monospace(format!("{:.2} nm", n.rms_nm));
                    ui.monospace(format!("{:.2} nm", n.above_100hz_nm));
                    let lines: Vec<String> =
                        n.lines.iter().take(3).map(|(f, a)| format!("{f:.1}: {a:.2}")).collect();
                    ui.label(if lines.is_empty() { "none".into() } else { lines.join(", ") });
                    ui.end_row();
                }
            });
        }
        Measured::Tuning { study, applied } => {
            ui.label(title(study.axis, "proposal"));
            for change in &study.proposal.changes {
                ui.label(change);
            }
            ui.add_space(4.0);
            loop_lines(ui, "now", &study.proposal.before);
            loop_lines(ui, "predicted", &study.proposal.predicted);
            match applied {
                None => {
                    return ui
                        .add_enabled(can_apply, Button::new("Apply and measure again"))
                        .on_hover_text(
                            "Puts the proposal into effect on the board; not saved to flash",
                        )
                        .clicked();
                }
                Some(applied) => {
                    ui.label(RichText::new("measured with the proposal").strong());
                    margin_lines(ui, &applied.after.margins);
                    response_lines(ui, &applied.closed, "µm/µm");
                    if let Some(off) = distance(&study.closed_predicted, &applied.closed, BAND_HZ) {
                        let text = format!(
                            "prediction and measurement differ by {:.1} % rms up to {BAND_HZ:.0} Hz",
                            100.0 * off
                        );
                        ui.label(RichText::new(text).color(if off < 0.1 { GOOD } else { WARN }));
                    }
                    ui.label(
                        RichText::new("in effect, not saved: Settings, Save to board").color(WARN),
                    );
                }
            }
        }
    }
    false
}

fn title(axis: usize, what: &str) -> RichText {
    RichText::new(format!("axis {}: {what}", axis + 1)).color(axis_color(axis, false)).strong()
}

fn response_lines(ui: &mut Ui, frf: &Frf, unit: &str) {
    let gain = frf.static_gain().map_or("-".into(), |g| format!("{g:.4} {unit}"));
    let bandwidth = frf.bandwidth_hz().map_or("above the band".into(), |f| format!("{f:.0} Hz"));
    let resonance = frf.resonance().map_or("none".into(), |(f, _)| format!("{f:.0} Hz"));
    Grid::new(("response figures", unit)).num_columns(2).show(ui, |ui| {
        for (name, value) in
            [("static gain", gain), ("bandwidth (-3 dB)", bandwidth), ("resonance", resonance)]
        {
            ui.label(name);
            ui.monospace(value);
            ui.end_row();
        }
    });
}

/// A margin with its frequency, coloured by whether it is enough.
fn margin_lines(ui: &mut Ui, m: &Margins) {
    let at = |value: Option<f64>, unit: &str, hz: Option<f64>| match (value, hz) {
        (Some(v), Some(f)) => format!("{v:.1} {unit} at {f:.0} Hz"),
        _ => "not reached in the band".to_owned(),
    };
    let color = |value: Option<f64>, least: f64| match value {
        Some(v) if v < least => BAD,
        Some(_) => GOOD,
        None => egui::Color32::GRAY,
    };
    Grid::new("margins").num_columns(2).show(ui, |ui| {
        for (name, value, color) in [
            (
                "phase margin",
                at(m.phase_margin_deg, "°", m.crossover_hz),
                color(m.phase_margin_deg, 30.0),
            ),
            (
                "gain margin",
                at(m.gain_margin_db, "dB", m.phase_crossover_hz),
                color(m.gain_margin_db, 6.0),
            ),
            (
                "distance from -1",
                m.modulus_margin.map_or("-".into(), |v| format!("{v:.2}")),
                color(m.modulus_margin, 0.5),
            ),
        ] {
            ui.label(name);
            ui.label(RichText::new(value).monospace().color(color));
            ui.end_row();
        }
    });
}

fn loop_lines(ui: &mut Ui, name: &str, f: &LoopFigures) {
    let m = &f.margins;
    let or = |v: Option<f64>, unit: &str| v.map_or("-".to_owned(), |v| format!("{v:.1} {unit}"));
    ui.label(format!(
        "{name}: phase margin {}, gain margin {}, {:.0} % of a disturbance below 100 Hz is left",
        or(m.phase_margin_deg, "°"),
        or(m.gain_margin_db, "dB"),
        100.0 * f.left_of_disturbance
    ));
}
