//! Faults and limits in words, with what to do; losses; who the board is.

use eframe::egui::{RichText, Ui};
use flexstage::{Flags, State};
use telemetry::decode::StreamStatistics;
use telemetry::words::{fault_line, faulted_axes, faults, state_words};
use telemetry::{DeviceInfo, History};

use super::{BAD, GOOD, WARN};

/// Colour of a state.
pub fn state_color(state: State) -> eframe::egui::Color32 {
    match state {
        State::Off => eframe::egui::Color32::GRAY,
        State::Arming => WARN,
        State::Run | State::Hold => GOOD,
        State::Fault => BAD,
    }
}

/// The panel.
pub fn show(
    ui: &mut Ui,
    history: &History,
    info: Option<&DeviceInfo>,
    statistics: Option<StreamStatistics>,
    is_gone: bool,
) {
    if is_gone {
        ui.label(RichText::new("no connection: what the board does now is not known").color(BAD));
        ui.label(RichText::new("when it was last heard of:").weak());
    }
    if let Some(last) = history.last() {
        let flags = Flags(last.flags);
        ui.label(RichText::new(state_words(flags)).color(state_color(flags.state())).strong());
        for fault in faults(flags) {
            ui.label(RichText::new(fault.code).color(BAD).strong());
            ui.label(fault.words);
        }
        let axes = faulted_axes(flags);
        if !axes.is_empty() {
            let names: Vec<String> = axes.iter().map(usize::to_string).collect();
            ui.label(format!("on axis {}", names.join(", ")));
        }
        for words in flags.limits().describe() {
            ui.label(RichText::new(format!("limited: {words}")).color(WARN));
        }
        if faults(flags).is_empty() && flags.limits().is_empty() {
            ui.label(RichText::new("no fault, no limit").color(GOOD));
        }
    } else {
        ui.label("no samples yet");
    }
    let changes: Vec<(u64, u32)> = history.flag_changes().collect();
    let past: Vec<String> = changes
        .windows(2)
        .filter(|w| {
            let new = Flags(w[1].1).faults();
            !new.is_empty() && new != Flags(w[0].1).faults()
        })
        .map(|w| format!("{:.3} s: {}", history.time_s(w[1].0), fault_line(Flags(w[1].1))))
        .collect();
    if !past.is_empty() {
        ui.separator();
        ui.label(RichText::new("faults so far").strong());
        for line in past.iter().rev().take(5) {
            ui.label(RichText::new(line).color(BAD));
        }
    }
    ui.separator();
    if let Some(s) = statistics {
        let text = format!(
            "{} samples, {} ticks lost ({} dropped by the board, {} on the way), {} damaged frames",
            s.samples, s.lost_ticks, s.dropped_by_board, s.lost_in_transit, s.malformed
        );
        ui.label(RichText::new(text).color(if s.lost_ticks > 0 { WARN } else { GOOD }));
    }
    if let Some(info) = info {
        ui.label(RichText::new(format!(
            "{}\nserial {}\nfirmware {}, {} Hz\nlast restart: {}, {} since power-on",
            info.name,
            info.serial,
            info.firmware,
            info.sample_rate_hz,
            info.reset_reason,
            info.restarts
        )));
        if info.self_test != 0 {
            let text = format!("converter self-test failed: bits {:#06x}", info.self_test);
            ui.label(RichText::new(text).color(BAD));
        }
    }
    let megabytes = history.bytes() as f64 / 1e6;
    ui.label(RichText::new(format!("history in memory: {megabytes:.0} MB")));
}
