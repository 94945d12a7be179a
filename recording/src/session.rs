//! A session: a folder of recordings of one rig.

use std::path::{Path, PathBuf};

use crate::{Error, Recording, Result, csv, is_csv, is_parquet};

/// A folder of recordings of one rig. File names mean nothing; the session's clock orders them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Session {
    /// Sorted by start on the session's clock, then by file name.
    pub recordings: Vec<Entry>,
    /// What whoever reads the answer has to know of the folder, a sentence each: files that were left out, names that differ.
    pub notes: Vec<String>,
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
    /// if a sample rate is given; other `.csv` are left out and noted. Other files (a rig, notes) and hidden ones are left alone.
    /// Of recordings with the same samples the first one stays, and the others are noted: one that is fitted would be checked on itself.
    /// A recording that is damaged makes the session unusable: an answer from the others alone would be another one.
    pub fn read(folder: impl AsRef<Path>, csv_sample_rate_hz: Option<f64>) -> Result<Self> {
        let folder = folder.as_ref();
        let entries =
            std::fs::read_dir(folder).map_err(Error::io(folder, "open session folder"))?;
        let mut paths = Vec::new();
        for entry in entries {
            let path = entry.map_err(Error::io(folder, "list"))?.path();
            let is_hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
            if (is_csv(&path) || is_parquet(&path)) && !is_hidden && !path.is_dir() {
                paths.push(path);
            }
        }
        // Of several that are damaged always the same is named.
        paths.sort();
        let mut session = Self::default();
        for path in paths {
            let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let recording = match csv_sample_rate_hz {
                Some(rate) if is_csv(&path) => Recording::read_csv(&path, rate)?,
                None if is_csv(&path) && !csv::says_its_rate(&path)? => {
                    session.notes.push(format!(
                        "{file} was left out: a CSV without a sample rate (if it is a recording, give --sample-rate)."
                    ));
                    continue;
                }
                _ => Recording::read(&path)?,
            };
            session.recordings.push(Entry { path, file, recording });
        }
        if session.recordings.is_empty() {
            let found = match session.notes.len() {
                0 => "none".to_string(),
                n => format!("{n} CSV without a sample rate (give --sample-rate)"),
            };
            return Err(Error::invalid(
                folder,
                format!("expected recordings (*.parquet), found {found}"),
            ));
        }
        session.recordings.sort_by(|a, b| {
            let start = |entry: &Entry| entry.recording.meta.start_s;
            start(a).total_cmp(&start(b)).then_with(|| a.file.cmp(&b.file))
        });
        session.leave_out_copies();
        session.notes.extend(session.differing_rigs());
        Ok(session)
    }

    fn leave_out_copies(&mut self) {
        let mut kept: Vec<Entry> = Vec::with_capacity(self.recordings.len());
        for entry in self.recordings.drain(..) {
            match kept.iter().find(|first| has_same_samples(&first.recording, &entry.recording)) {
                Some(first) => self.notes.push(format!(
                    "{} was left out: its samples are those of {}, to the last digit.",
                    entry.file, first.file
                )),
                None => kept.push(entry),
            }
        }
        self.recordings = kept;
    }

    /// A session is of one rig. Who renames it in between still may mean the same, so this is no error.
    fn differing_rigs(&self) -> Option<String> {
        let mut named = self.recordings.iter().filter(|entry| !entry.recording.meta.rig.is_empty());
        let first = named.next()?;
        let other = named.find(|entry| entry.recording.meta.rig != first.recording.meta.rig)?;
        Some(format!(
            "The recordings name more than one rig: {} says \"{}\", {} says \"{}\". They were taken for one.",
            first.file, first.recording.meta.rig, other.file, other.recording.meta.rig
        ))
    }

    /// Number of axes of the session: the most that any of its recordings has.
    pub fn axes(&self) -> usize {
        self.recordings.iter().map(|entry| entry.recording.axes()).max().unwrap_or(0)
    }
}

/// Whether two recordings hold the same drives and positions at the same distances in time. What else they say of themselves does not count: a
/// copy may have been given another name, start or counter, or have lost its monitors.
fn has_same_samples(a: &Recording, b: &Recording) -> bool {
    let since_first = |r: &Recording, row: usize| r.tick[row] - r.tick[0];
    a.len() == b.len()
        && a.meta.sample_rate_hz == b.meta.sample_rate_hz
        && a.position_um == b.position_um
        && a.drive_v == b.drive_v
        && (0..a.len()).all(|row| since_first(a, row) == since_first(b, row))
}
