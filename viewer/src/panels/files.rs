//! Recordings on disk: those of this window, and any other by its path or dropped on the window.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::{DragValue, RichText, ScrollArea, TextEdit, Ui};

use super::BAD;

/// How often the folder is looked at.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// What the person wants.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Show a recording.
    Open {
        /// The file.
        path: PathBuf,
        /// Rate of a CSV that does not carry it.
        sample_rate_hz: f64,
    },
    /// Write a CSV beside it.
    Export(PathBuf),
    /// Finish what a crash or a full disk left.
    Recover(PathBuf),
    /// Back to the board.
    Live,
}

/// A recording in the folder.
struct Entry {
    path: PathBuf,
    megabytes: f64,
    is_unfinished: bool,
}

/// The panel's memory.
pub struct Files {
    path: String,
    sample_rate_hz: f64,
    entries: Vec<Entry>,
    looked: Option<Instant>,
}

impl Default for Files {
    fn default() -> Self {
        Self { path: String::new(), sample_rate_hz: 10_000.0, entries: Vec::new(), looked: None }
    }
}

impl Files {
    /// Rate that a CSV without metadata is taken to have.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// The panel. `shown` is the recording on screen, when it is not the board.
    pub fn show(
        &mut self,
        ui: &mut Ui,
        folder: &Path,
        shown: Option<&Path>,
        has_board: bool,
        is_recording: bool,
    ) -> Option<Request> {
        if self.looked.is_none_or(|at| at.elapsed() > LOOK_AGAIN) {
            self.entries = look(folder);
            self.looked = Some(Instant::now());
        }
        let mut out = None;
        let sample_rate_hz = self.sample_rate_hz;
        let open = |path: PathBuf| Some(Request::Open { path, sample_rate_hz });
        if let Some(shown) = shown {
            ui.horizontal(|ui| {
                if has_board && ui.button("Back to the board").clicked() {
                    out = Some(Request::Live);
                }
                if !is_csv(shown) && ui.button("Export as CSV").clicked() {
                    out = Some(Request::Export(shown.to_owned()));
                }
            });
            ui.separator();
        }
        ui.label("Parquet or CSV with the columns tick, drive_v_1, position_um_1 …; drop a file on the window, or:");
        ui.horizontal(|ui| {
            ui.add(TextEdit::singleline(&mut self.path).hint_text("path").desired_width(210.0));
            let can = !self.path.trim().is_empty();
            if ui.add_enabled(can, eframe::egui::Button::new("Open")).clicked() {
                out = open(PathBuf::from(self.path.trim()));
            }
        });
        ui.horizontal(|ui| {
            ui.label("a CSV without a rate has");
            ui.add(DragValue::new(&mut self.sample_rate_hz).range(0.1..=1e6).suffix(" Hz"));
        });
        ui.separator();
        ui.label(RichText::new(format!("in {}", folder.display())).strong());
        if self.entries.is_empty() {
            ui.label("no recordings yet: R records");
        }
        ScrollArea::vertical().show(ui, |ui| {
            for entry in &self.entries {
                let name = entry.path.strip_prefix(folder).unwrap_or(&entry.path);
                ui.horizontal(|ui| {
                    let text = format!("{}  {:.1} MB", name.display(), entry.megabytes);
                    if entry.is_unfinished && is_recording {
                        ui.label(RichText::new(text).weak());
                        ui.label("being written");
                    } else if entry.is_unfinished {
                        ui.label(RichText::new(text).color(BAD));
                        if ui.button("Recover").on_hover_text("A crash or a full disk ended it; at most its last second is missing").clicked() {
                            out = Some(Request::Recover(entry.path.clone()));
                        }
                    } else if ui
                        .selectable_label(shown == Some(entry.path.as_path()), text)
                        .clicked()
                    {
                        out = open(entry.path.clone());
                    }
                });
            }
        });
        out
    }
}

fn is_csv(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"))
}

/// Recordings in a folder, newest first. An unfinished one is listed under the name that it should have.
fn look(folder: &Path) -> Vec<Entry> {
    let mut found: Vec<(std::time::SystemTime, Entry)> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|file| {
            let path = file.path();
            let meta = file.metadata().ok().filter(|m| m.is_file())?;
            let extension = path.extension()?.to_ascii_lowercase();
            let is_unfinished =
                extension == "part" && path.file_stem()?.to_str()?.ends_with(".parquet");
            if !is_unfinished && extension != "parquet" && extension != "csv" {
                return None;
            }
            let path = if is_unfinished { path.with_extension("") } else { path };
            let megabytes = meta.len() as f64 / 1e6;
            Some((meta.modified().ok()?, Entry { path, megabytes, is_unfinished }))
        })
        .collect();
    found.sort_by_key(|found| std::cmp::Reverse(found.0));
    found.into_iter().map(|(_, entry)| entry).collect()
}
