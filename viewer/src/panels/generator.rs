//! Waveforms: checked here with the board's own rules before anything is sent.

use eframe::egui::{ComboBox, DragValue, Grid, RichText, Ui};
use flexstage::generator::{Multisine, Wave};
use flexstage::link::message::Command;
use flexstage::{Generator as Built, GeneratorSettings};
use telemetry::AXES;

use super::{BAD, GOOD, axis_color};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Triangle,
    Sine,
    Square,
    Staircase,
    Multisine,
    Sweep,
}

impl Kind {
    const ALL: [Kind; 6] =
        [Kind::Triangle, Kind::Sine, Kind::Square, Kind::Staircase, Kind::Multisine, Kind::Sweep];

    fn name(self) -> &'static str {
        match self {
            Kind::Triangle => "triangle",
            Kind::Sine => "sine",
            Kind::Square => "square",
            Kind::Staircase => "staircase",
            Kind::Multisine => "multisine",
            Kind::Sweep => "swept sine",
        }
    }
}

/// What the person has put in.
#[derive(Clone, Debug, PartialEq)]
pub struct Generator {
    kind: Kind,
    axes: [bool; AXES],
    center_um: f32,
    amplitude_um: f32,
    frequency_hz: f32,
    to_hz: f32,
    slope_um_per_ms: f32,
    steps: u16,
    tones: u8,
    seed: u32,
    duration_s: f32,
    blend_s: f32,
}

impl Default for Generator {
    fn default() -> Self {
        Self {
            kind: Kind::Triangle,
            axes: [true, false, false],
            center_um: 6.0,
            amplitude_um: 5.0,
            frequency_hz: 1.0,
            to_hz: 500.0,
            slope_um_per_ms: 1.0,
            steps: 10,
            tones: 16,
            seed: 1,
            duration_s: 0.0,
            blend_s: 0.2,
        }
    }
}

impl Generator {
    fn settings(&self) -> GeneratorSettings {
        let wave = Wave {
            center_um: self.center_um,
            amplitude_um: self.amplitude_um,
            frequency_hz: self.frequency_hz,
            phase_turns: if self.kind == Kind::Sine { 0.0 } else { 0.75 },
            blend_s: self.blend_s,
            duration_s: self.duration_s,
        };
        match self.kind {
            Kind::Triangle => GeneratorSettings::Triangle(wave),
            Kind::Sine => GeneratorSettings::Sine(wave),
            Kind::Square => {
                GeneratorSettings::Square { wave, slope_um_per_ms: self.slope_um_per_ms }
            }
            Kind::Staircase => GeneratorSettings::Staircase {
                wave,
                steps: self.steps,
                slope_um_per_ms: self.slope_um_per_ms,
            },
            Kind::Multisine => GeneratorSettings::Multisine(Multisine {
                center_um: self.center_um,
                peak_um: self.amplitude_um,
                base_hz: self.frequency_hz,
                first: 1,
                stride: 2,
                tones: self.tones,
                seed: self.seed,
                blend_s: self.blend_s,
                duration_s: self.duration_s,
            }),
            Kind::Sweep => GeneratorSettings::Sweep {
                center_um: self.center_um,
                amplitude_um: self.amplitude_um,
                from_hz: self.frequency_hz,
                to_hz: self.to_hz,
                duration_s: self.duration_s.max(1.0),
                blend_s: self.blend_s,
            },
        }
    }

    /// Why this cannot be sent, if so: the board's own check, and the travel limits of the axes that would move.
    fn problem(&self, limits_um: [[f32; 2]; AXES]) -> Option<String> {
        if let Err(error) = Built::build(&self.settings()) {
            return Some(error.to_string());
        }
        let (low, high) = (self.center_um - self.amplitude_um, self.center_um + self.amplitude_um);
        for axis in (0..AXES).filter(|&axis| self.axes[axis]) {
            let [min, max] = limits_um[axis];
            if low < min || high > max {
                return Some(format!(
                    "axis {}: {low:.2} to {high:.2} µm would be cut to its travel limits {min} to {max} µm",
                    axis + 1
                ));
            }
        }
        (!self.axes.contains(&true)).then(|| "choose an axis".to_owned())
    }

    /// The panel; commands to send and what to call them.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        limits_um: [[f32; 2]; AXES],
    ) -> Option<(String, Vec<Command>)> {
        ComboBox::from_label("waveform").selected_text(self.kind.name()).show_ui(ui, |ui| {
            for kind in Kind::ALL {
                ui.selectable_value(&mut self.kind, kind, kind.name());
            }
        });
        ui.horizontal(|ui| {
            for (axis, on) in self.axes.iter_mut().enumerate() {
                let text = format!("on axis {}", axis + 1);
                ui.checkbox(on, RichText::new(text).color(axis_color(axis, false)));
            }
        });
        let kind = self.kind;
        Grid::new("generator").num_columns(2).show(ui, |ui| {
            let row = |ui: &mut Ui, name: &str, value: &mut f32, speed: f64, suffix: &str| {
                ui.label(name);
                ui.add(DragValue::new(value).speed(speed).suffix(suffix).max_decimals(4));
                ui.end_row();
            };
            row(ui, "centre", &mut self.center_um, 0.05, " µm");
            row(ui, "amplitude (peak)", &mut self.amplitude_um, 0.05, " µm");
            let name = match kind {
                Kind::Multisine => "base frequency",
                Kind::Sweep => "from frequency",
                _ => "frequency",
            };
            row(ui, name, &mut self.frequency_hz, 0.1, " Hz");
            if kind == Kind::Sweep {
                row(ui, "to frequency", &mut self.to_hz, 1.0, " Hz");
            }
            if matches!(kind, Kind::Square | Kind::Staircase) {
                row(ui, "edge slope", &mut self.slope_um_per_ms, 0.05, " µm/ms");
            }
            row(ui, "fade in", &mut self.blend_s, 0.01, " s");
            row(ui, "duration (0: for ever)", &mut self.duration_s, 0.1, " s");
            if kind == Kind::Staircase {
                ui.label("steps up");
                ui.add(DragValue::new(&mut self.steps).range(1..=1000));
                ui.end_row();
            }
            if kind == Kind::Multisine {
                ui.label("tones (odd lines)");
                ui.add(DragValue::new(&mut self.tones).range(1..=16));
                ui.end_row();
                ui.label("phase seed");
                ui.add(DragValue::new(&mut self.seed));
                ui.end_row();
            }
        });
        let problem = self.problem(limits_um);
        match &problem {
            Some(words) => ui.label(RichText::new(words).color(BAD)),
            None => ui.label(RichText::new("checked: can be sent").color(GOOD)),
        };
        let start = ui.add_enabled(problem.is_none(), eframe::egui::Button::new("Start waveform"));
        if !start.clicked() {
            return None;
        }
        let mut mask = 0;
        let mut commands = Vec::new();
        for axis in (0..AXES).filter(|&axis| self.axes[axis]) {
            mask |= 1 << axis;
            commands.push(Command::Stage { axis: axis as u8, generator: self.settings() });
        }
        commands.push(Command::Start { axes: mask });
        Some((format!("{} started", kind.name()), commands))
    }
}
