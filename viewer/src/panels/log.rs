//! What happened, newest first.

use eframe::egui::{RichText, ScrollArea, Ui};

use super::BAD;
use crate::link::LogLine;

/// The panel.
pub fn show(ui: &mut Ui, lines: &[LogLine]) {
    ui.label(RichText::new("times are UTC").weak());
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        for line in lines.iter().rev() {
            let text = RichText::new(format!("{} {}", line.utc, line.text));
            ui.label(if line.is_error { text.color(BAD) } else { text });
        }
    });
}
