//! What happened, newest first.

use eframe::egui::{RichText, ScrollArea, Ui};

use super::BAD;
use crate::link::LogLine;

/// The panel.
pub fn show(ui: &mut Ui, lines: &[LogLine]) {
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        for line in lines.iter().rev() {
            let text = RichText::new(&line.text).small();
            ui.label(if line.is_error { text.color(BAD) } else { text });
        }
    });
}
