//! CSV with the contract's column names.
//!
//! A CSV has no place for metadata, so the sample rate comes from the command line. Files that we write carry the metadata
//! in a first line `# flexstage: {json}`, which readers that know comments skip and which makes the round trip whole.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use csv::{ErrorKind, ReaderBuilder, StringRecord};

use crate::columns::{Column, Table};
use crate::{Error, Meta, Recording, Result};

pub(crate) const COMMENT: &str = "# flexstage:";

/// Whether a file can be read without being told its sample rate: it begins with our metadata, or is Parquet with the wrong name.
pub(crate) fn says_its_rate(path: &Path) -> Result<bool> {
    let mut file = BufReader::new(File::open(path).map_err(Error::io(path, "open"))?);
    let start = file.fill_buf().map_err(Error::io(path, "read"))?;
    let text = start.strip_prefix("\u{feff}".as_bytes()).unwrap_or(start);
    Ok(text.starts_with(COMMENT.as_bytes()) || start.starts_with(b"PAR1"))
}

pub(crate) fn read(path: &Path, sample_rate_hz: Option<f64>) -> Result<Recording> {
    let file = File::open(path).map_err(Error::io(path, "open"))?;
    let mut file = BufReader::new(file);
    // A first line of many gigabytes is not a header; 64 KiB hold any metadata.
    let start = file.fill_buf().map_err(Error::io(path, "read"))?;
    if start.is_empty() {
        return Err(Error::invalid(path, "expected a CSV with a header line, found an empty file"));
    }
    let line = start.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let line = String::from_utf8_lossy(line).into_owned();
    let own = line.trim_start_matches('\u{feff}').strip_prefix(COMMENT);
    let meta = match (own, sample_rate_hz) {
        (Some(json), _) => Meta::from_json(json.trim(), path)?,
        (None, Some(rate)) => {
            let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
            Meta::new(name.unwrap_or_default(), rate)
        }
        (None, None) => {
            return Err(Error::invalid(
                path,
                "a CSV holds no sample rate: give it with --sample-rate",
            ));
        }
    };
    meta.check(path)?;

    let mut reader =
        ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(file);
    let unreadable = |error: csv::Error| match error.kind() {
        ErrorKind::UnequalLengths { pos, expected_len, len } => {
            let line = pos.as_ref().map_or(0, csv::Position::line);
            let what = format!(
                "not a whole CSV: line {line}: expected {expected_len} columns as in the header, found {len}; is it cut off?"
            );
            Error::invalid(path, what)
        }
        _ => Error::invalid(path, format!("not a CSV: {error}")),
    };
    let header = reader.headers().map_err(unreadable)?.clone();
    let name = |text: &str| Column::parse(text.trim_start_matches('\u{feff}'));
    let columns: Vec<Option<Column>> = header.iter().map(name).collect();
    for (index, column) in columns.iter().enumerate() {
        if let Some(column) = column.filter(|column| columns[..index].contains(&Some(*column))) {
            return Err(Error::invalid(path, format!("column `{}` is there twice", column.name())));
        }
    }
    let mut tick = Vec::new();
    let mut flags = Vec::new();
    let mut reals = vec![Vec::new(); columns.len()];
    let mut record = StringRecord::new();
    while reader.read_record(&mut record).map_err(unreadable)? {
        let line = record.position().map_or(0, csv::Position::line);
        for ((column, text), reals) in columns.iter().zip(&record).zip(&mut reals) {
            let wrong = |expected: &str| {
                let column = column.map(Column::name).unwrap_or_default();
                Error::invalid(
                    path,
                    format!(
                        "column `{column}`, line {line}: expected {expected}, found \"{text}\""
                    ),
                )
            };
            match column {
                None => {}
                Some(Column::Tick) => {
                    tick.push(text.parse().map_err(|_| wrong("a sample number"))?)
                }
                Some(Column::Flags) => {
                    flags.push(text.parse().map_err(|_| wrong("a 32-bit number"))?)
                }
                Some(_) => reals.push(text.parse::<f32>().map_err(|_| wrong("a number"))?),
            }
        }
    }
    let mut table = Table::default();
    for (column, reals) in columns.into_iter().zip(reals) {
        match column {
            None => {}
            Some(Column::Tick) => table.tick = Some(std::mem::take(&mut tick)),
            Some(Column::Flags) => table.flags = Some(std::mem::take(&mut flags)),
            Some(column) => table.set(column, reals),
        }
    }
    table.into_recording(meta, path)
}

pub(crate) fn write(recording: &Recording, file: &mut File, path: &Path) -> Result<()> {
    let reals = recording.real_columns();
    let mut write = || {
        let mut out = BufWriter::new(&mut *file);
        writeln!(out, "{COMMENT} {}", recording.meta.to_json())?;
        let mut writer = csv::Writer::from_writer(out);
        let mut fields = vec![Column::Tick.name()];
        fields.extend(reals.iter().map(|(column, _)| column.name()));
        if recording.flags.is_some() {
            fields.push(Column::Flags.name());
        }
        writer.write_record(&fields)?;
        for (row, tick) in recording.tick.iter().enumerate() {
            fields.clear();
            fields.push(tick.to_string());
            // The shortest text that reads back as the same float32.
            fields.extend(reals.iter().map(|(_, column)| column[row].to_string()));
            if let Some(flags) = &recording.flags {
                fields.push(flags[row].to_string());
            }
            writer.write_record(&fields)?;
        }
        writer.flush()
    };
    write().map_err(Error::io(path, "write"))?;
    file.sync_all().map_err(Error::io(path, "write"))
}
