//! Gains and limits: applied, undone, saved, compared; a tuning from proposal to undo.

use eframe::egui::accesskit::Role;
use egui_kittest::kittest::{NodeT, Queryable};
use flexstage::{Flags, Settings};
use telemetry::virtual_board::Speed;

use crate::common::{Window, click, shows, until, window};

fn in_effect(harness: &Window) -> Settings {
    harness.state().link().settings().unwrap()
}

fn notches(harness: &Window) -> usize {
    in_effect(harness).axes[0].feedback.notches.len()
}

fn can_click(harness: &Window, label: &str) -> bool {
    !harness.get_by_label(label).accesskit_node().is_disabled()
}

#[test]
fn a_change_is_applied_undone_saved_and_compared() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::RealTime);
    let before = in_effect(&harness);
    click(&mut harness, "Settings");
    assert!(shows(&harness, "as on the board"));
    assert!(!can_click(&harness, "Apply") && !can_click(&harness, "Undo"));
    click(&mut harness, "Add notch");
    assert!(shows(&harness, "checked, not sent yet"));
    assert_eq!(in_effect(&harness), before, "nothing is sent before Apply");
    click(&mut harness, "Apply");
    until(&mut harness, "the notch", |h| notches(h) == 1);
    assert!(shows(&harness, "a restart forgets it"), "the warning comes with the settings");

    // Compared with a file: first the same, then with the notch undone.
    let file = folder.path().join("settings.toml");
    let path = harness.get_by_role(Role::TextInput);
    path.focus();
    path.type_text(file.to_str().unwrap());
    harness.step();
    click(&mut harness, "Write");
    assert!(file.exists(), "the settings are written");
    click(&mut harness, "Compare");
    assert!(shows(&harness, "board and file agree"));
    click(&mut harness, "Undo");
    until(&mut harness, "the undo", |h| in_effect(h) == before);
    assert!(!can_click(&harness, "Undo"), "what Undo did is nothing to undo");
    click(&mut harness, "Compare");
    assert!(shows(&harness, "differ (board, file)"));
    click(&mut harness, "Load");
    assert!(shows(&harness, "checked, not sent yet"));
    click(&mut harness, "Apply");
    until(&mut harness, "the notch of the file", |h| notches(h) == 1);

    click(&mut harness, "Save to board");
    until(&mut harness, "saved", |h| h.state().link().is_stored());
    assert!(shows(&harness, "is saved on the board"));
}

#[test]
fn a_tuning_is_proposed_applied_compared_and_undone() {
    let folder = tempfile::tempdir().unwrap();
    let mut harness = window(folder.path(), Speed::Max);
    let before = in_effect(&harness);
    click(&mut harness, "Measure");
    harness.get_by_role(Role::ComboBox).click();
    harness.step();
    harness.step();
    click(&mut harness, "tune feedback and feedforward");
    click(&mut harness, "Start measurement");
    until(&mut harness, "the proposal", |h| shows(h, "Apply and measure again"));
    assert_eq!(in_effect(&harness), before, "a proposal changes nothing");
    click(&mut harness, "Apply and measure again");
    until(&mut harness, "the comparison", |h| shows(h, "prediction and measurement differ by"));
    assert!(in_effect(&harness).axes[0].feedback.integral_v_per_um_s > 0.0);
    // Undo knows of what the tuning did.
    click(&mut harness, "Settings");
    click(&mut harness, "Undo");
    until(&mut harness, "the undo", |h| in_effect(h) == before);
    until(&mut harness, "parked", |h| {
        h.state().link().history().last().is_some_and(|s| Flags(s.flags).is_parked())
    });
}
