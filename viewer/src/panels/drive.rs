//! Jog: go to a position or a step away from it.

use eframe::egui::{DragValue, RichText, Ui};
use flexstage::GeneratorSettings;
use flexstage::link::message::Command;
use telemetry::{AXES, History};

use super::axis_color;

/// Where to go.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    target_um: [f32; AXES],
    step_um: f32,
    seconds: f32,
}

impl Default for Drive {
    fn default() -> Self {
        Self { target_um: [0.0; AXES], step_um: 0.5, seconds: 0.2 }
    }
}

/// Commands that bring axes to positions, all starting at the same tick.
pub fn go(targets: &[(usize, f32)], seconds: f32) -> Vec<Command> {
    let mut mask = 0;
    let mut commands = Vec::new();
    for &(axis, target_um) in targets {
        mask |= 1 << axis;
        let generator = GeneratorSettings::Ramp { target_um, duration_s: seconds };
        commands.push(Command::Stage { axis: axis as u8, generator });
    }
    commands.push(Command::Start { axes: mask });
    commands
}

impl Drive {
    /// The panel; commands to send and what to call them.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        history: &History,
        limits_um: [[f32; 2]; AXES],
    ) -> Option<(String, Vec<Command>)> {
        let mut out = None;
        let now = history.last().map(|s| s.reference_um);
        ui.horizontal(|ui| {
            ui.label("step");
            ui.add(DragValue::new(&mut self.step_um).range(0.001..=10.0).speed(0.01).suffix(" µm"));
            ui.label("within");
            ui.add(DragValue::new(&mut self.seconds).range(0.001..=60.0).speed(0.01).suffix(" s"));
        });
        for axis in 0..AXES {
            let [min, max] = limits_um[axis];
            ui.horizontal(|ui| {
                ui.label(
                    RichText::new(format!("axis {}", axis + 1)).color(axis_color(axis, false)),
                );
                let here = now.map_or(0.0, |um| um[axis]);
                for (sign, label) in [(-1.0, "-"), (1.0, "+")] {
                    let target = (here + sign * self.step_um).clamp(min, max);
                    let text = format!("Jog {} {label}", axis + 1);
                    if ui.button(text).clicked() {
                        out = Some((
                            format!("axis {} to {target:.3} µm", axis + 1),
                            go(&[(axis, target)], self.seconds),
                        ));
                    }
                }
                ui.add(
                    DragValue::new(&mut self.target_um[axis])
                        .range(min..=max)
                        .speed(0.05)
                        .suffix(" µm"),
                );
                if ui.button(format!("Go {}", axis + 1)).clicked() {
                    let target = self.target_um[axis];
                    out = Some((
                        format!("axis {} to {target:.3} µm", axis + 1),
                        go(&[(axis, target)], self.seconds),
                    ));
                }
                if let Some(sample) = history.last() {
                    ui.monospace(format!(
                        "{:8.3} µm {:7.2} V",
                        sample.position_um[axis], sample.drive_v[axis]
                    ));
                }
            });
        }
        ui.horizontal(|ui| {
            if ui.button("All to targets").clicked() {
                let targets: Vec<(usize, f32)> =
                    self.target_um.iter().copied().enumerate().collect();
                out = Some(("all axes to their targets".into(), go(&targets, self.seconds)));
            }
            if ui.button("All to 0 µm").clicked() {
                let targets: Vec<(usize, f32)> = (0..AXES).map(|axis| (axis, 0.0)).collect();
                out = Some(("all axes to 0 µm".into(), go(&targets, self.seconds)));
            }
        });
        out
    }
}
