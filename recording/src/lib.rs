//! Recordings and sessions: the Parquet and CSV files that every flexstage tool reads and writes.
//!
//! A [`Recording`] is one experiment: commanded voltages in, measured positions (and amplifier monitors) out, on the
//! sample clock. A [`Session`] is a folder of them. Column names, units and metadata are those of the project's contract;
//! units are in the names (`_v` volts, `_um` micrometres, `_s` seconds), axes are numbered from 1 in files and from 0 in
//! vectors. Reading checks everything that a later step relies on: a recording that was read is sorted, finite and whole.
//!
//! ```
//! use recording::{Meta, Recording};
//!
//! let mut recording = Recording::empty(Meta::new("ramp", 10_000.0), 1);
//! recording.tick = vec![0, 1, 4];
//! recording.drive_v[0] = vec![0.0, 0.1, 0.2];
//! recording.position_um[0] = Some(vec![0.0, 0.01, 0.02]);
//! let folder = tempfile::tempdir().unwrap();
//! let path = folder.path().join("ramp.parquet");
//! recording.write(&path).unwrap();
//! let read = Recording::read(&path).unwrap();
//! assert_eq!(read, recording);
//! assert_eq!(read.lost()[0].ticks, 2);
//! ```

mod columns;
mod csv;
mod error;
mod meta;
mod parquet;
mod session;
mod stream;
mod together;

use std::fs::File;
use std::io::Read;
use std::path::Path;

pub use columns::MAX_AXES;
pub use error::{Error, Result};
pub use meta::{FORMAT, METADATA_KEY, Meta, VERSION};
pub use session::{Entry, Session};
pub use stream::{Channels, Sample, StreamWriter, Summary, discard, recover, recoverable_rows};
pub use together::{Together, check_target};

/// One experiment. All columns have the length of `tick`; the outer vectors have one entry an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What the recording says about itself.
    pub meta: Meta,
    /// Sample number, strictly increasing; a step of more than one means lost samples.
    pub tick: Vec<u64>,
    /// Voltage (V) commanded at the amplifier output, held from this tick to the next; 0 V for an axis without the column.
    pub drive_v: Vec<Vec<f32>>,
    /// Measured amplifier output (V), sampled at the tick.
    pub monitor_v: Vec<Option<Vec<f32>>>,
    /// Measured position (um), sampled at the tick, before this tick's drive acts.
    pub position_um: Vec<Option<Vec<f32>>>,
    /// Setpoint (um).
    pub reference_um: Vec<Option<Vec<f32>>>,
    /// Controller status and faults.
    pub flags: Option<Vec<u32>>,
}

/// Samples that were lost between two rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost {
    /// The last row before the hole.
    pub after_row: usize,
    /// How many ticks are missing.
    pub ticks: u64,
}

impl Recording {
    /// A recording of `axes` axes without samples, monitors, positions, references or flags.
    pub fn empty(meta: Meta, axes: usize) -> Self {
        Self {
            meta,
            tick: Vec::new(),
            drive_v: vec![Vec::new(); axes],
            monitor_v: vec![None; axes],
            position_um: vec![None; axes],
            reference_um: vec![None; axes],
            flags: None,
        }
    }

    /// Number of axes: the highest axis number of any column.
    pub fn axes(&self) -> usize {
        self.drive_v.len()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.tick.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.tick.is_empty()
    }

    /// Length on the sample clock (ticks), lost ones included.
    pub fn span_ticks(&self) -> u64 {
        match (self.tick.first(), self.tick.last()) {
            (Some(first), Some(last)) => last - first + 1,
            _ => 0,
        }
    }

    /// The first row to be scored: everything before it only settles the stack's memory.
    pub fn settle_rows(&self) -> usize {
        let Some(&first) = self.tick.first() else { return 0 };
        let settle = self.settle_ticks();
        self.tick.partition_point(|tick| tick - first < settle)
    }

    /// Ticks from the first one on that are not scored.
    pub fn settle_ticks(&self) -> u64 {
        // Half a tick of slack: 0.5 s at 10 kHz is row 5000 whatever the rounding of the product.
        (self.meta.settle_s * self.meta.sample_rate_hz - 0.5).ceil().max(0.0) as u64
    }

    /// Time of a row on the session's clock (s).
    pub fn time_s(&self, row: usize) -> f64 {
        self.meta.start_s + (self.tick[row] - self.tick[0]) as f64 / self.meta.sample_rate_hz
    }

    /// Where samples were lost.
    pub fn lost(&self) -> Vec<Lost> {
        let steps = self.tick.windows(2).enumerate();
        steps
            .filter(|(_, pair)| pair[1] > pair[0] + 1)
            .map(|(after_row, pair)| Lost { after_row, ticks: pair[1] - pair[0] - 1 })
            .collect()
    }

    /// Checks all that reading promises: possible metadata, columns of one length, increasing ticks, finite values.
    ///
    /// `name` is the file that the error names.
    pub fn check(&self, name: &Path) -> Result<()> {
        self.meta.check(name)?;
        let rows = self.tick.len();
        if rows == 0 {
            return Err(Error::invalid(name, "no samples: expected at least one row, found none"));
        }
        let axes = self.axes();
        for group in [&self.monitor_v, &self.position_um, &self.reference_um] {
            if group.len() != axes {
                let found = group.len();
                let what = format!("expected {axes} axes in every group of columns, found {found}");
                return Err(Error::invalid(name, what));
            }
        }
        for axis in 0..axes {
            // An axis may be absent; one that is driven or watched has a gauge.
            let touched = self.drive_v[axis].iter().any(|volts| *volts != 0.0)
                || self.monitor_v[axis].is_some()
                || self.reference_um[axis].is_some();
            if self.position_um[axis].is_none() && touched {
                let number = axis + 1;
                let what =
                    format!("column `position_um_{number}` is missing (axis {number} has a drive)");
                return Err(Error::invalid(name, what));
            }
        }
        let wrong_length = |column: &str, found: usize| {
            let what =
                format!("column `{column}`: expected {rows} rows like `tick`, found {found}");
            Err(Error::invalid(name, what))
        };
        if let Some(flags) = self.flags.as_ref().filter(|flags| flags.len() != rows) {
            return wrong_length("flags", flags.len());
        }
        for (column, values) in self.real_columns() {
            let column = column.name();
            if values.len() != rows {
                return wrong_length(&column, values.len());
            }
            if let Some(row) = values.iter().position(|value| !value.is_finite()) {
                let found = values[row];
                let what = format!(
                    "column `{column}`, row {row}: expected a finite number, found {found}"
                );
                return Err(Error::invalid(name, what));
            }
        }
        if let Some(row) = self.tick.windows(2).position(|pair| pair[1] <= pair[0]) {
            let (before, after) = (self.tick[row], self.tick[row + 1]);
            let kind = if before == after { "duplicate" } else { "unsorted" };
            let what = format!(
                "column `tick`, row {}: {kind} tick: expected more than {before}, found {after}",
                row + 1
            );
            return Err(Error::invalid(name, what));
        }
        // A broken counter would otherwise make a simulation of years out of a second of data.
        let lost = self.span_ticks() as u128 - rows as u128;
        if lost > 100 * rows as u128 + 1_000_000 {
            let what = format!(
                "column `tick`: {rows} rows span ticks {} to {}: expected a sample counter, found more than 99 % lost",
                self.tick[0],
                self.tick[rows - 1]
            );
            return Err(Error::invalid(name, what));
        }
        Ok(())
    }

    /// Reads Parquet, or a CSV that carries its metadata (see [`Recording::read_csv`] for others).
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        read(path.as_ref(), None)
    }

    /// Reads a CSV with the contract's column names, sampled at `sample_rate_hz`; the other metadata are defaults unless the
    /// file carries its own. A file that says another rate itself is refused; Parquet always says one.
    pub fn read_csv(path: impl AsRef<Path>, sample_rate_hz: f64) -> Result<Self> {
        read(path.as_ref(), Some(sample_rate_hz))
    }

    /// Writes `.csv` or `.parquet`, whole or not at all: a temporary file beside it is renamed when complete.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut together = Together::default();
        self.write_into(&mut together, path.as_ref())?;
        together.publish()
    }

    /// The same as one of several files that appear together.
    pub fn write_into(&self, together: &mut Together, path: &Path) -> Result<()> {
        self.check(path)?;
        check_name(path)?;
        together.add(path, |file| {
            if is_csv(path) {
                csv::write(self, file, path)
            } else {
                parquet::write(self, file, path)
            }
        })
    }
}

/// Whether a recording can be written under this name: what is there already, and whether the name says what it is.
pub fn check_name(path: &Path) -> Result<()> {
    check_target(path)?;
    if is_csv(path) || is_parquet(path) {
        return Ok(());
    }
    Err(Error::invalid(path, "expected the name of a recording, which ends in .parquet or .csv"))
}

/// What the file holds says how it is read, not its name: that decides only where the file does not tell.
fn read(path: &Path, sample_rate_hz: Option<f64>) -> Result<Recording> {
    let begins_with = |mark: &[u8]| -> Result<bool> {
        // A pipe can be read once only, and a folder not at all: their readers know what to say.
        if !path.is_file() {
            return Ok(false);
        }
        let mut start = vec![0; mark.len()];
        let mut file = File::open(path).map_err(Error::io(path, "open"))?;
        Ok(file.read_exact(&mut start).is_ok() && start == mark)
    };
    let by_name = is_csv(path) || (sample_rate_hz.is_some() && !is_parquet(path));
    let is_text = !begins_with(b"PAR1")? && (by_name || begins_with(csv::COMMENT.as_bytes())?);
    let recording = if is_text { csv::read(path, sample_rate_hz)? } else { parquet::read(path)? };
    let own = recording.meta.sample_rate_hz;
    match sample_rate_hz {
        // As good as a rate that was printed with few digits; NaN is no rate at all.
        Some(given) if given.is_nan() || (own / given - 1.0).abs() > 1e-6 => Err(Error::invalid(
            path,
            format!(
                "the file itself says a sample rate of {own} Hz, --sample-rate {given} Hz: expected the same (it may be left out)"
            ),
        )),
        _ => Ok(recording),
    }
}

fn is_parquet(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("parquet"))
}

fn is_csv(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}
