//! Parquet: one flat table, columns by name, metadata as a key of the file.
//!
//! Any file that holds the contract's columns is read, whatever wrote it: optional or required fields, several row
//! groups, Snappy, LZ4 or Zstandard, any integer type for `tick` and `flags`, 32- or 64-bit floats for the rest.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{
    Compression, ConvertedType, Encoding, Repetition, Type as Physical, ZstdLevel,
};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{DataType, DoubleType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};

use crate::columns::{Column, Table};
use crate::{Error, METADATA_KEY, Meta, Recording, Result};

/// Rows of a row group in a file that is written at once.
const ROW_GROUP: usize = 1 << 20;

pub(crate) fn read(path: &Path) -> Result<Recording> {
    let file = File::open(path).map_err(Error::io(path, "open"))?;
    let bytes = file.metadata().map_err(Error::io(path, "look at"))?;
    if !bytes.is_file() {
        return Err(Error::invalid(path, "expected a Parquet file, found a folder or device"));
    }
    if bytes.len() == 0 {
        return Err(Error::invalid(path, "expected a Parquet file, found an empty one"));
    }
    let broken = |error| not_parquet(path, error);
    // Decoders of damaged files may panic (slice bounds, capacity); a damaged recording is bad input, not a bug of ours.
    let table = no_panic(|| read_table(&file, path))
        .unwrap_or_else(|| Err(broken("damaged data".into())))?;
    let (meta, table) = table;
    table.into_recording(meta, path)
}

/// Runs `read`; `None` if it panicked. Silent: the caller says what is wrong in one line.
fn no_panic<T>(read: impl FnOnce() -> T) -> Option<T> {
    use std::cell::Cell;
    use std::panic;
    use std::sync::Once;
    thread_local!(static QUIET: Cell<bool> = const { Cell::new(false) });
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !QUIET.get() {
                before(info);
            }
        }));
    });
    QUIET.set(true);
    let result = panic::catch_unwind(panic::AssertUnwindSafe(read));
    QUIET.set(false);
    result.ok()
}

fn not_parquet(path: &Path, error: String) -> Error {
    Error::invalid(path, format!("expected a readable Parquet file: {error}"))
}

fn read_table(file: &File, path: &Path) -> Result<(Meta, Table)> {
    let broken = |error: ParquetError| not_parquet(path, error.to_string());
    let file = file.try_clone().map_err(Error::io(path, "open"))?;
    let reader = SerializedFileReader::new(file).map_err(broken)?;
    let file_meta = reader.metadata().file_metadata();
    let json = file_meta
        .key_value_metadata()
        .and_then(|pairs| pairs.iter().find(|pair| pair.key == METADATA_KEY))
        .and_then(|pair| pair.value.as_deref());
    let Some(json) = json else {
        let what = format!(
            "file metadata has no key `{METADATA_KEY}`: expected a recording's JSON object there"
        );
        return Err(Error::invalid(path, what));
    };
    let meta = Meta::from_json(json, path)?;
    let groups = (0..reader.num_row_groups())
        .map(|index| reader.get_row_group(index))
        .collect::<std::result::Result<Vec<_>, _>>()
        .map_err(broken)?;
    let mut table = Table::default();
    let mut seen = Vec::new();
    for (index, field) in file_meta.schema_descr().columns().iter().enumerate() {
        if field.path().parts().len() != 1 {
            continue;
        }
        let Some(column) = Column::parse(field.name()) else { continue };
        if seen.contains(&column) {
            return Err(Error::invalid(path, format!("column `{}` is there twice", column.name())));
        }
        seen.push(column);
        let source =
            Source { groups: &groups, index, nullable: field.max_def_level() > 0, column, path };
        let physical = field.physical_type();
        let unsigned =
            matches!(field.converted_type(), ConvertedType::UINT_32 | ConvertedType::UINT_64);
        match column {
            Column::Tick => table.tick = Some(source.ticks(physical, unsigned)?),
            Column::Flags => table.flags = Some(source.flags(physical)?),
            _ => table.set(column, source.reals(physical)?),
        }
    }
    Ok((meta, table))
}

/// One column of all row groups.
struct Source<'a> {
    groups: &'a [Box<dyn RowGroupReader + 'a>],
    index: usize,
    nullable: bool,
    column: Column,
    path: &'a Path,
}

impl Source<'_> {
    fn wrong_type(&self, expected: &str, found: Physical) -> Error {
        let column = self.column.name();
        Error::invalid(
            self.path,
            format!("column `{column}`: expected {expected}, found type {found}"),
        )
    }

    fn reals(&self, physical: Physical) -> Result<Vec<f32>> {
        match physical {
            Physical::FLOAT => self.values::<FloatType>(),
            Physical::DOUBLE => {
                Ok(self.values::<DoubleType>()?.into_iter().map(|value| value as f32).collect())
            }
            _ => Err(self.wrong_type("float32", physical)),
        }
    }

    fn ticks(&self, physical: Physical, unsigned: bool) -> Result<Vec<u64>> {
        let signed: Vec<i64> = match physical {
            Physical::INT64 if unsigned => {
                return Ok(self
                    .values::<Int64Type>()?
                    .into_iter()
                    .map(|value| value as u64)
                    .collect());
            }
            Physical::INT32 if unsigned => {
                return Ok(self
                    .values::<Int32Type>()?
                    .into_iter()
                    .map(|v| u64::from(v as u32))
                    .collect());
            }
            Physical::INT64 => self.values::<Int64Type>()?,
            Physical::INT32 => self.values::<Int32Type>()?.into_iter().map(i64::from).collect(),
            _ => return Err(self.wrong_type("uint64", physical)),
        };
        let tick = |(row, value): (usize, i64)| {
            u64::try_from(value).map_err(|_| {
                let what =
                    format!("column `tick`, row {row}: expected a sample number, found {value}");
                Error::invalid(self.path, what)
            })
        };
        signed.into_iter().enumerate().map(tick).collect()
    }

    fn flags(&self, physical: Physical) -> Result<Vec<u32>> {
        match physical {
            Physical::INT32 => {
                Ok(self.values::<Int32Type>()?.into_iter().map(|v| v as u32).collect())
            }
            Physical::INT64 => {
                Ok(self.values::<Int64Type>()?.into_iter().map(|v| v as u32).collect())
            }
            _ => Err(self.wrong_type("uint32", physical)),
        }
    }

    fn values<T: DataType>(&self) -> Result<Vec<T::T>>
    where
        ColumnReaderImpl<T>: TryFromReader,
    {
        let broken = |error: ParquetError| {
            let column = self.column.name();
            not_parquet(self.path, format!("column `{column}`: {error}"))
        };
        let mut values = Vec::new();
        for group in self.groups {
            let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            let reader = group.get_column_reader(self.index).map_err(broken)?;
            let Some(mut reader) = ColumnReaderImpl::<T>::try_from_reader(reader) else {
                return Err(Error::invalid(
                    self.path,
                    format!("column `{}`: changes type", self.column.name()),
                ));
            };
            let before = values.len();
            let mut records = 0;
            let mut levels = Vec::new();
            while records < rows {
                let levels = self.nullable.then_some(&mut levels);
                let (read, _, _) = reader
                    .read_records(rows - records, levels, None, &mut values)
                    .map_err(broken)?;
                if read == 0 {
                    break;
                }
                records += read;
            }
            if records != rows {
                let what = format!("expected {rows} rows in a row group, found {records}");
                return Err(broken(ParquetError::General(what)));
            }
            if values.len() - before != rows {
                let row = before + levels.iter().position(|&level| level == 0).unwrap_or(0);
                let what = format!(
                    "column `{}`, row {row}: expected a value, found null",
                    self.column.name()
                );
                return Err(Error::invalid(self.path, what));
            }
        }
        Ok(values)
    }
}

/// The untyped reader of a column as one of a known type.
trait TryFromReader: Sized {
    fn try_from_reader(reader: ColumnReader) -> Option<Self>;
}

macro_rules! try_from_reader {
    ($($data:ty => $variant:ident),*) => {$(
        impl TryFromReader for ColumnReaderImpl<$data> {
            fn try_from_reader(reader: ColumnReader) -> Option<Self> {
                match reader {
                    ColumnReader::$variant(reader) => Some(reader),
                    _ => None,
                }
            }
        }
    )*};
}

try_from_reader!(
    Int32Type => Int32ColumnReader, Int64Type => Int64ColumnReader,
    FloatType => FloatColumnReader, DoubleType => DoubleColumnReader
);

/// The schema of the columns, in this order.
pub(crate) fn schema(columns: &[Column]) -> TypePtr {
    let field = |column: &Column| {
        let (physical, converted) = match column {
            Column::Tick => (Physical::INT64, ConvertedType::UINT_64),
            Column::Flags => (Physical::INT32, ConvertedType::UINT_32),
            _ => (Physical::FLOAT, ConvertedType::NONE),
        };
        let field = Type::primitive_type_builder(&column.name(), physical)
            .with_repetition(Repetition::REQUIRED)
            .with_converted_type(converted)
            .build();
        Arc::new(field.expect("names and types of the contract make valid fields"))
    };
    let fields = columns.iter().map(field).collect();
    let schema = Type::group_type_builder("recording").with_fields(fields).build();
    Arc::new(schema.expect("a flat group of valid fields is a valid schema"))
}

pub(crate) fn properties(columns: &[Column], meta: &Meta) -> WriterProperties {
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(3).expect("3 is a level of zstd")))
        .set_created_by(concat!("flexstage ", env!("CARGO_PKG_VERSION")).into())
        .set_key_value_metadata(Some(vec![KeyValue::new(METADATA_KEY.into(), meta.to_json())]))
        // Nobody searches a recording by value; indexes and page statistics would only slow the recorder.
        .set_statistics_enabled(EnabledStatistics::None)
        .set_offset_index_disabled(true)
        .set_max_row_group_row_count(None);
    for column in columns {
        let encoding = match column {
            Column::Tick | Column::Flags => Encoding::DELTA_BINARY_PACKED,
            // Noise fills the low bits and leaves the high ones alone: apart, they compress.
            _ => Encoding::BYTE_STREAM_SPLIT,
        };
        let path = ColumnPath::from(column.name());
        properties = properties
            .set_column_dictionary_enabled(path.clone(), false)
            .set_column_encoding(path, encoding);
    }
    properties.build()
}

/// Values of one column of one row group.
pub(crate) enum Values<'a> {
    Tick(&'a [u64]),
    Flags(&'a [u32]),
    Real(&'a [f32]),
}

pub(crate) fn write_group<W: Write + Send>(
    mut group: SerializedRowGroupWriter<'_, W>,
    columns: &[Values<'_>],
) -> std::result::Result<(), ParquetError> {
    for values in columns {
        let Some(mut writer) = group.next_column()? else { break };
        match values {
            Values::Tick(ticks) => {
                let ticks: Vec<i64> = ticks.iter().map(|&tick| tick as i64).collect();
                writer.typed::<Int64Type>().write_batch(&ticks, None, None)?;
            }
            Values::Flags(flags) => {
                let flags: Vec<i32> = flags.iter().map(|&flag| flag as i32).collect();
                writer.typed::<Int32Type>().write_batch(&flags, None, None)?;
            }
            Values::Real(reals) => {
                writer.typed::<FloatType>().write_batch(reals, None, None)?;
            }
        }
        writer.close()?;
    }
    group.close()?;
    Ok(())
}

pub(crate) fn write(recording: &Recording, file: &mut File, path: &Path) -> Result<()> {
    let reals = recording.real_columns();
    let mut columns = vec![Column::Tick];
    columns.extend(reals.iter().map(|(column, _)| *column));
    if recording.flags.is_some() {
        columns.push(Column::Flags);
    }
    let properties = Arc::new(properties(&columns, &recording.meta));
    let write = || {
        let buffered = std::io::BufWriter::new(&mut *file);
        let mut writer = SerializedFileWriter::new(buffered, schema(&columns), properties)?;
        for start in (0..recording.len()).step_by(ROW_GROUP) {
            let rows = start..recording.len().min(start + ROW_GROUP);
            let mut values = vec![Values::Tick(&recording.tick[rows.clone()])];
            values.extend(reals.iter().map(|(_, column)| Values::Real(&column[rows.clone()])));
            if let Some(flags) = &recording.flags {
                values.push(Values::Flags(&flags[rows]));
            }
            write_group(writer.next_row_group()?, &values)?;
        }
        writer.close()?;
        Ok::<(), ParquetError>(())
    };
    write().map_err(|error| cannot_write(path, error))?;
    file.sync_all().map_err(Error::io(path, "write"))
}

pub(crate) fn cannot_write(path: &Path, error: ParquetError) -> Error {
    match error {
        // The system's own words ("no space left on device") say more than the library's wrapping.
        ParquetError::External(source) => match source.downcast::<std::io::Error>() {
            Ok(cause) => Error::Io { path: path.into(), action: "write", cause: *cause },
            Err(source) => Error::invalid(path, format!("cannot write: {source}")),
        },
        error => Error::invalid(path, format!("cannot write: {error}")),
    }
}
