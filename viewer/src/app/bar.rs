//! The bar: stop, arm, hold, state, recording, losses; bad news below it until it is put away.

use eframe::egui::{self, Button, RichText, Ui};
use flexstage::link::message::Command;
use flexstage::{Flags, State};

use super::App;
use crate::link::LinkState;
use crate::panels::{BAD, GOOD, WARN, status};

/// Height of the buttons that matter.
const TALL: f32 = 30.0;

impl App {
    pub(super) fn bar(&mut self, ui: &mut Ui) {
        let connected = self.link.is_connected();
        let flags = self.link.history().last().map(|s| Flags(s.flags)).filter(|_| connected);
        ui.add_space(2.0);
        ui.horizontal_wrapped(|ui| {
            self.state_buttons(ui, flags.map(Flags::state));
            ui.separator();
            self.board(ui, flags);
            ui.separator();
            self.recording_buttons(ui, connected);
            ui.separator();
            self.health(ui);
        });
        if let Some(flags) = flags.filter(|f| f.state() == State::Fault) {
            ui.label(RichText::new(telemetry::words::fault_line(flags)).color(BAD).strong());
        }
        self.bad_news(ui);
        ui.add_space(2.0);
    }

    fn state_buttons(&mut self, ui: &mut Ui, state: Option<State>) {
        let stop = Button::new(RichText::new("STOP (Space)").strong().color(egui::Color32::WHITE))
            .fill(egui::Color32::from_rgb(190, 40, 35))
            .min_size(egui::vec2(110.0, TALL));
        if ui
            .add(stop)
            .on_hover_text("Open the loop, return slowly to the safe voltage (also Escape)")
            .clicked()
        {
            self.link.stop();
        }
        let mut tall = |enabled: bool, text: &str, width: f32, hint: &str| {
            let button = Button::new(text).min_size(egui::vec2(width, TALL));
            ui.add_enabled(enabled, button).on_hover_text(hint).clicked()
        };
        let idle = !self.link.is_busy();
        if tall(
            idle && state == Some(State::Off),
            "Arm",
            60.0,
            "Close the loop at the measured position",
        ) {
            self.link.send("arm", vec![Command::Arm]);
        }
        let active = state.is_some_and(State::is_active);
        if tall(active && idle, "Hold (H)", 70.0, "End the waveforms softly and stay there") {
            self.link.send("hold", vec![Command::Hold]);
        }
        if tall(
            state == Some(State::Fault),
            "Clear faults",
            80.0,
            "After the cause is gone: back to off",
        ) {
            self.link.send("clear faults", vec![Command::ClearFaults]);
        }
    }

    fn board(&self, ui: &mut Ui, flags: Option<Flags>) {
        if let Some(flags) = flags {
            let state = flags.state();
            let text = RichText::new(state.name().to_uppercase()).size(18.0).strong();
            ui.label(text.color(status::state_color(state)))
                .on_hover_text(telemetry::words::state_words(flags));
        }
        match self.link.state() {
            LinkState::Connecting => {
                ui.spinner();
                ui.label("connecting")
            }
            LinkState::Connected(info) => {
                ui.label(format!("{}, firmware {}", info.name, info.firmware))
            }
            // The whole reason stands below, until it is put away.
            LinkState::Waiting { reason } => ui
                .label(RichText::new("not connected, tried again all the time").color(BAD))
                .on_hover_text(reason),
            LinkState::Recording { path, about } => {
                ui.label(format!("{}: {about}", path.display()))
            }
        };
        if let Some(shown) = &self.shown
            && let LinkState::Recording { about, .. } = shown.link.state()
        {
            let text = format!("on screen: {} ({about})", shown.path.display());
            ui.label(RichText::new(text).color(WARN));
        }
    }

    fn recording_buttons(&mut self, ui: &mut Ui, connected: bool) {
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
    }

    fn health(&self, ui: &mut Ui) {
        if let Some(s) = self.link.statistics() {
            let color = if s.lost_ticks == 0 { GOOD } else { WARN };
            ui.label(RichText::new(format!("{} ticks lost", s.lost_ticks)).color(color));
        }
        let fps = 1.0 / self.frame_s.max(1e-3);
        ui.label(RichText::new(format!("{fps:.0} fps")).weak()).on_hover_text(format!(
            "{:.1} ms of processor time for the last picture",
            self.cpu_s * 1e3
        ));
    }

    /// The newest bad news stays until it is put away: a full disk must not scroll by.
    fn bad_news(&mut self, ui: &mut Ui) {
        let Some(line) = self.link.last_error().filter(|line| line.number > self.dismissed) else {
            return;
        };
        ui.horizontal_wrapped(|ui| {
            if ui.small_button("OK").on_hover_text("Put away; the log keeps it").clicked() {
                self.dismissed = line.number;
            }
            ui.label(RichText::new(format!("{} {}", line.utc, line.text)).color(BAD));
        });
    }
}
