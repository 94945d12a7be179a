//! A session: a folder of recordings of one rig.

use std::path::{Path, PathBuf};

use crate::{Error, Recording, Result, is_csv};

/// A folder of recordings of one rig. File names mean nothing; the session's clock orders them.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Sorted by start on the session's clock, then by file name.
    pub recordings: Vec<Entry>,
}

/// One recording of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Where it was read from.
    pub path: PathBuf,
    /// File name, to be shown.
    pub file: String,
    /// What it holds.
    pub recording: Recording,
}

impl Session {
    /// Reads all recordings that lie directly in `folder`: `.parquet`, and `.csv` that carry their metadata or all `.csv`
    /// if a sample rate is given. Other files (a rig, notes) and hidden ones are left alone.
    pub fn read(folder: impl AsRef<Path>, csv_sample_rate_hz: Option<f64>) -> Result<Self> {
        let folder = folder.as_ref();
        let entries =
            std::fs::read_dir(folder).map_err(Error::io(folder, "open session folder"))?;
        let mut recordings = Vec::new();
        let mut skipped_csv = 0;
        for entry in entries {
            let path = entry.map_err(Error::io(folder, "list"))?.path();
            let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if file.starts_with('.') || path.is_dir() {
                continue;
            }
            let recording = if is_csv(&path) {
                match csv_sample_rate_hz {
                    Some(rate) => Recording::read_csv(&path, rate)?,
                    None => match Recording::read(&path) {
                        Ok(recording) => recording,
                        Err(_) => {
                            skipped_csv += 1;
                            continue;
                        }
                    },
                }
            } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("parquet")) {
                Recording::read(&path)?
            } else {
                continue;
            };
            recordings.push(Entry { path, file, recording });
        }
        if recordings.is_empty() {
            let found = match skipped_csv {
                0 => "none".to_string(),
                n => format!("{n} CSV without a sample rate (give --sample-rate)"),
            };
            return Err(Error::invalid(
                folder,
                format!("expected recordings (*.parquet), found {found}"),
            ));
        }
        recordings.sort_by(|a, b| {
            let start = |entry: &Entry| entry.recording.meta.start_s;
            start(a).total_cmp(&start(b)).then_with(|| a.file.cmp(&b.file))
        });
        Ok(Self { recordings })
    }

    /// Number of axes of the session: the most that any of its recordings has.
    pub fn axes(&self) -> usize {
        self.recordings.iter().map(|entry| entry.recording.axes()).max().unwrap_or(0)
    }
}
