//! Writes a recording while it happens, so that a crash or a full disk loses at most the last second.
//!
//! Samples go to `NAME.parquet.part`, one Parquet row group a second. A Parquet file is unreadable without its footer,
//! which lists all row groups and comes last; so beside it `NAME.parquet.journal` gets the footer of each row group
//! alone (length, CRC-32, Thrift), written after the group is on disk. When the recording ends, the footer is written and
//! the part renamed; when it does not end, [`recover`] builds the footer from the journal. Work a second is constant
//! however long the recording is.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use parquet::errors::ParquetError;
use parquet::file::metadata::{
    FileMetaData, ParquetMetaData, ParquetMetaDataReader, ParquetMetaDataWriter, RowGroupMetaData,
};
use parquet::file::writer::SerializedFileWriter;

use crate::columns::{Column, OfAxis};
use crate::parquet::{Values, cannot_write, properties, schema, write_group};
use crate::{Error, Meta, Recording, Result, is_parquet};

/// Which columns a stream has. `tick`, drive and position are always there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channels {
    /// Number of axes.
    pub axes: usize,
    /// Whether amplifier outputs are measured.
    pub monitor: bool,
    /// Whether there is a setpoint.
    pub reference: bool,
    /// Whether there are status flags.
    pub flags: bool,
}

/// One tick. Slices have one value an axis; those of absent channels are ignored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<'a> {
    /// Sample number.
    pub tick: u64,
    /// Commanded voltages (V).
    pub drive_v: &'a [f32],
    /// Measured amplifier outputs (V).
    pub monitor_v: &'a [f32],
    /// Measured positions (um).
    pub position_um: &'a [f32],
    /// Setpoints (um).
    pub reference_um: &'a [f32],
    /// Controller status and faults.
    pub flags: u32,
}

/// What a finished stream wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// The finished recording.
    pub path: PathBuf,
    /// Rows written.
    pub rows: u64,
    /// Ticks that never arrived.
    pub lost_ticks: u64,
}

/// Writes a recording while it happens.
///
/// Dropped without [`StreamWriter::finish`], it leaves the part and its journal for [`recover`].
pub struct StreamWriter {
    path: PathBuf,
    channels: Channels,
    writer: SerializedFileWriter<BufWriter<File>>,
    data: File,
    journal: File,
    journaled: usize,
    group_rows: usize,
    tick: Vec<u64>,
    flags: Vec<u32>,
    reals: Vec<Vec<f32>>,
    last_tick: Option<u64>,
    rows: u64,
    lost_ticks: u64,
}

/// Name of the unfinished recording and of its journal.
fn unfinished(path: &Path) -> (PathBuf, PathBuf) {
    let with = |suffix: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        PathBuf::from(name)
    };
    (with(".part"), with(".journal"))
}

impl StreamWriter {
    /// Starts a recording that will be called `path`. Refuses to overwrite one, finished or not.
    pub fn create(path: impl AsRef<Path>, meta: Meta, channels: Channels) -> Result<Self> {
        let path = path.as_ref();
        meta.check(path)?;
        // The footer of a Parquet file is all that can be rebuilt after a crash: a stream is never written as CSV.
        if !is_parquet(path) {
            return Err(Error::invalid(
                path,
                "expected a name that ends in .parquet (`export` makes a CSV of it)",
            ));
        }
        let (part, journal) = unfinished(path);
        for taken in [path, part.as_path(), journal.as_path()] {
            if taken.exists() {
                return Err(Error::invalid(
                    taken,
                    "expected a new file, found one: it is not overwritten",
                ));
            }
        }
        let mut columns = vec![Column::Tick];
        let groups: [(bool, OfAxis); 4] = [
            (true, Column::Drive),
            (channels.monitor, Column::Monitor),
            (true, Column::Position),
            (channels.reference, Column::Reference),
        ];
        for (present, name) in groups {
            if present {
                columns.extend((0..channels.axes).map(name));
            }
        }
        let reals = vec![Vec::new(); columns.len() - 1];
        if channels.flags {
            columns.push(Column::Flags);
        }
        let open = |path: &Path| {
            let file = OpenOptions::new().write(true).create_new(true).open(path);
            file.map_err(Error::io(path, "create"))
        };
        let file = open(&part)?;
        let data = file.try_clone().map_err(Error::io(&part, "create"))?;
        let journal = open(&journal)?;
        let group_rows = (meta.sample_rate_hz.round() as usize).clamp(1, 1 << 20);
        let properties = Arc::new(properties(&columns, &meta));
        let writer = SerializedFileWriter::new(BufWriter::new(file), schema(&columns), properties)
            .map_err(|error| cannot_write(&part, error))?;
        Ok(Self {
            path: path.into(),
            channels,
            writer,
            data,
            journal,
            journaled: 0,
            group_rows,
            tick: Vec::new(),
            flags: Vec::new(),
            reals,
            last_tick: None,
            rows: 0,
            lost_ticks: 0,
        })
    }

    /// Adds one tick. On an error (a full disk) everything up to the last full second is safe on disk.
    pub fn push(&mut self, sample: &Sample<'_>) -> Result<()> {
        if let Some(last) = self.last_tick {
            if sample.tick <= last {
                let found = sample.tick;
                let what = format!("column `tick`: expected more than {last}, found {found}");
                return Err(Error::invalid(&self.path, what));
            }
            self.lost_ticks += sample.tick - last - 1;
        }
        let groups = [
            (true, sample.drive_v, "drive_v"),
            (self.channels.monitor, sample.monitor_v, "monitor_v"),
            (true, sample.position_um, "position_um"),
            (self.channels.reference, sample.reference_um, "reference_um"),
        ];
        for (present, values, name) in groups {
            if present && values.len() != self.channels.axes {
                let (expected, found) = (self.channels.axes, values.len());
                let what = format!("`{name}`: expected {expected} values a tick, found {found}");
                return Err(Error::invalid(&self.path, what));
            }
            if let Some(value) = values.iter().find(|value| present && !value.is_finite()) {
                let what = format!("`{name}`: expected finite values, found {value}");
                return Err(Error::invalid(&self.path, what));
            }
        }
        let values =
            groups.iter().filter(|(present, ..)| *present).flat_map(|(_, values, _)| *values);
        for (column, value) in self.reals.iter_mut().zip(values) {
            column.push(*value);
        }
        self.tick.push(sample.tick);
        if self.channels.flags {
            self.flags.push(sample.flags);
        }
        self.last_tick = Some(sample.tick);
        self.rows += 1;
        if self.tick.len() >= self.group_rows { self.flush() } else { Ok(()) }
    }

    /// Rows taken so far.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Ticks lost so far.
    pub fn lost_ticks(&self) -> u64 {
        self.lost_ticks
    }

    /// Puts what is buffered on disk as one row group, then its entry in the journal.
    pub fn flush(&mut self) -> Result<()> {
        if self.tick.is_empty() {
            return Ok(());
        }
        let (part, journal) = unfinished(&self.path);
        let cannot = |error| cannot_write(&part, error);
        let mut values = vec![Values::Tick(&self.tick)];
        values.extend(self.reals.iter().map(|column| Values::Real(column)));
        if self.channels.flags {
            values.push(Values::Flags(&self.flags));
        }
        write_group(self.writer.next_row_group().map_err(cannot)?, &values).map_err(cannot)?;
        self.writer.inner_mut().flush().map_err(Error::io(&part, "write"))?;
        self.data.sync_data().map_err(Error::io(&part, "write"))?;
        self.tick.clear();
        self.flags.clear();
        self.reals.iter_mut().for_each(Vec::clear);

        let groups = self.writer.flushed_row_groups();
        let new = groups[self.journaled..].to_vec();
        self.journaled = groups.len();
        for group in new {
            let footer = footer(
                &file_meta(&group, self.writer.properties().key_value_metadata()),
                vec![group],
            )
            .map_err(|error| cannot_write(&journal, error))?;
            let mut entry = Vec::with_capacity(footer.len() + 8);
            entry.extend_from_slice(&(footer.len() as u32).to_le_bytes());
            entry.extend_from_slice(&crc32fast::hash(&footer).to_le_bytes());
            entry.extend_from_slice(&footer);
            self.journal.write_all(&entry).map_err(Error::io(&journal, "write"))?;
        }
        self.journal.sync_data().map_err(Error::io(&journal, "write"))
    }

    /// Ends the recording: writes what is left and the footer, and gives the file its name.
    pub fn finish(mut self) -> Result<Summary> {
        self.flush()?;
        let (part, journal) = unfinished(&self.path);
        self.writer.finish().map_err(|error| cannot_write(&part, error))?;
        self.writer.inner_mut().flush().map_err(Error::io(&part, "write"))?;
        self.data.sync_all().map_err(Error::io(&part, "write"))?;
        std::fs::rename(&part, &self.path).map_err(Error::io(&self.path, "rename to"))?;
        std::fs::remove_file(&journal).map_err(Error::io(&journal, "remove"))?;
        Ok(Summary { path: self.path, rows: self.rows, lost_ticks: self.lost_ticks })
    }
}

fn file_meta(
    group: &RowGroupMetaData,
    pairs: Option<&Vec<parquet::file::metadata::KeyValue>>,
) -> FileMetaData {
    FileMetaData::new(1, group.num_rows(), None, pairs.cloned(), group.schema_descr_ptr(), None)
}

/// Thrift footer of some row groups, with its length and the closing magic.
fn footer(
    meta: &FileMetaData,
    groups: Vec<RowGroupMetaData>,
) -> std::result::Result<Vec<u8>, ParquetError> {
    let mut bytes = Vec::new();
    ParquetMetaDataWriter::new(&mut bytes, &ParquetMetaData::new(meta.clone(), groups)).finish()?;
    Ok(bytes)
}

/// Finishes what an interrupted [`StreamWriter`] left behind (`path` is the name that the recording should have had), and
/// reads it. Nothing happens to a recording that was finished; nothing is deleted before the recovered file is complete.
pub fn recover(path: impl AsRef<Path>) -> Result<Recording> {
    let path = path.as_ref();
    let (part, journal) = unfinished(path);
    if path.exists() {
        return Recording::read(path);
    }
    let Some(Vouched { file: first, groups, end }) = vouched(path)? else {
        return Err(Error::invalid(
            &part,
            "expected at least one whole second of samples, found none",
        ));
    };
    let data = OpenOptions::new().write(true).open(&part).map_err(Error::io(&part, "open"))?;
    let rows = groups.iter().map(RowGroupMetaData::num_rows).sum();
    let pairs = first.key_value_metadata().cloned();
    let all = FileMetaData::new(1, rows, None, pairs, first.schema_descr_ptr(), None);
    let cannot = |error| cannot_write(&part, error);
    let footer = footer(&all, groups).map_err(cannot)?;
    // Only bytes that no journal entry vouches for are cut; interrupted here, recovery can start again.
    data.set_len(end).map_err(Error::io(&part, "shorten"))?;
    let mut data = data;
    std::io::Seek::seek(&mut data, std::io::SeekFrom::End(0)).map_err(Error::io(&part, "write"))?;
    data.write_all(&footer).map_err(Error::io(&part, "write"))?;
    data.sync_all().map_err(Error::io(&part, "write"))?;
    let recording = crate::parquet::read(&part)?;
    std::fs::rename(&part, path).map_err(Error::io(path, "rename to"))?;
    std::fs::remove_file(&journal).map_err(Error::io(&journal, "remove"))?;
    Ok(recording)
}

/// What the journal vouches for.
struct Vouched {
    file: FileMetaData,
    groups: Vec<RowGroupMetaData>,
    /// Where it ends in the part.
    end: u64,
}

/// How many rows [`recover`] would find in what an interrupted [`StreamWriter`] left behind.
pub fn recoverable_rows(path: impl AsRef<Path>) -> Result<u64> {
    let found = vouched(path.as_ref())?;
    let rows = |found: Vouched| found.groups.iter().map(|group| group.num_rows() as u64).sum();
    Ok(found.map_or(0, rows))
}

/// Removes what an interrupted [`StreamWriter`] left behind, as far as it can be removed.
pub fn discard(path: impl AsRef<Path>) {
    let (part, journal) = unfinished(path.as_ref());
    let _ = std::fs::remove_file(part);
    let _ = std::fs::remove_file(journal);
}

/// The row groups that are whole on disk, if there is one.
fn vouched(path: &Path) -> Result<Option<Vouched>> {
    let (part, journal) = unfinished(path);
    let mut entries = Vec::new();
    File::open(&journal)
        .and_then(|mut file| file.read_to_end(&mut entries))
        .map_err(Error::io(&journal, "open"))?;
    let length = std::fs::metadata(&part).map_err(Error::io(&part, "look at"))?.len();

    let mut groups: Vec<RowGroupMetaData> = Vec::new();
    let mut file = None;
    let mut end = 0;
    for footer in intact_entries(&entries) {
        let Ok(meta) = ParquetMetaDataReader::new().parse_and_finish(&Bytes::from(footer)) else {
            break;
        };
        let group_end = meta.row_groups().iter().flat_map(|g| g.columns()).map(|column| {
            let (start, bytes) = column.byte_range();
            start + bytes
        });
        let group_end = group_end.max().unwrap_or(0);
        if group_end > length {
            break;
        }
        end = group_end;
        groups.extend(meta.row_groups().iter().cloned());
        file.get_or_insert_with(|| meta.file_metadata().clone());
    }
    Ok(file.map(|file| Vouched { file, groups, end }))
}

/// Footers of the journal up to the first that is cut off or damaged, each as a Parquet file without row groups before it.
fn intact_entries(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut footers = Vec::new();
    while let Some((head, rest)) = bytes.split_at_checked(8) {
        let word =
            |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let Some((footer, rest)) = rest.split_at_checked(word(0) as usize) else { break };
        if crc32fast::hash(footer) != word(4) {
            break;
        }
        footers.push(footer.to_vec());
        bytes = rest;
    }
    footers
}
