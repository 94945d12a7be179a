//! How a file is read: by what it holds, and whole or not at all. What a session makes of files that are no recordings.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{BrotliLevel, Compression, GzipLevel};
use parquet::data_type::{FloatType, Int64Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use recording::{Channels, Meta, Recording, Session, StreamWriter, Together};

fn example() -> Recording {
    let mut recording = Recording::empty(Meta::new("rest", 100.0), 1);
    recording.tick = (0..50).collect();
    recording.drive_v[0] = vec![1.0; 50];
    recording.position_um[0] = Some(vec![0.5; 50]);
    recording
}

/// The message of an error, which is one line and names the file.
fn refused<T: std::fmt::Debug>(result: recording::Result<T>, file: &str) -> String {
    let message = result.unwrap_err().to_string();
    assert!(message.contains(file) && !message.contains('\n'), "{message}");
    message
}

/// What other programs compress with.
#[test]
fn any_compression() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let schema = "message m { required int64 tick; required float drive_v_1; required float position_um_1; }";
    for compression in [
        Compression::GZIP(GzipLevel::default()),
        Compression::BROTLI(BrotliLevel::default()),
        Compression::SNAPPY,
        Compression::LZ4_RAW,
    ] {
        let meta = KeyValue::new("flexstage".into(), Meta::new("gzip", 100.0).to_json());
        let properties = WriterProperties::builder()
            .set_compression(compression)
            .set_key_value_metadata(Some(vec![meta]))
            .build();
        let file = fs::File::create(&path).unwrap();
        let schema = Arc::new(parse_message_type(schema).unwrap());
        let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties)).unwrap();
        let mut group = writer.next_row_group().unwrap();
        let mut column = group.next_column().unwrap().unwrap();
        column.typed::<Int64Type>().write_batch(&[0, 1, 2], None, None).unwrap();
        column.close().unwrap();
        while let Some(mut column) = group.next_column().unwrap() {
            column.typed::<FloatType>().write_batch(&[1.0, 2.0, 3.0], None, None).unwrap();
            column.close().unwrap();
        }
        group.close().unwrap();
        writer.close().unwrap();
        assert_eq!(Recording::read(&path).unwrap().drive_v, [[1.0, 2.0, 3.0]], "{compression:?}");
    }
}

#[test]
fn what_it_holds_decides() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    example().write(at("a.parquet")).unwrap();
    example().write(at("b.csv")).unwrap();
    fs::rename(at("a.parquet"), at("a.csv")).unwrap();
    fs::rename(at("b.csv"), at("b.parquet")).unwrap();
    for name in ["a.csv", "b.parquet"] {
        assert_eq!(Recording::read(at(name)).unwrap(), example(), "{name}");
        assert_eq!(Recording::read_csv(at(name), 100.0).unwrap(), example(), "{name}");
        let message = refused(Recording::read_csv(at(name), 250.0), name);
        assert!(message.contains("100 Hz") && message.contains("250 Hz"), "{message}");
        // What is compared with NaN is never unequal.
        let message = refused(Recording::read_csv(at(name), f64::NAN), name);
        assert!(message.contains("100 Hz") && message.contains("NaN Hz"), "{message}");
    }
    // As these two have the same samples, one of them is enough.
    let session = Session::read(folder.path(), None).unwrap();
    assert_eq!(session.recordings.len(), 1);
    assert_eq!(
        session.notes,
        ["b.parquet was left out: its samples are those of a.csv, to the last digit."]
    );
}

#[test]
fn a_copy_is_known_by_its_samples() {
    let folder = tempfile::tempdir().unwrap();
    let mut copy = example();
    copy.meta.start_s += 100.0;
    copy.meta.experiment = "again".into();
    copy.tick.iter_mut().for_each(|tick| *tick += 5_000);
    let mut other = example();
    other.position_um[0].as_mut().unwrap()[3] += 1.0e-3;
    let mut other_ticks = example();
    *other_ticks.tick.last_mut().unwrap() += 1;
    for (file, recording) in
        [("a", example()), ("b", copy), ("c", other), ("d", other_ticks), ("e", example())]
    {
        recording.write(folder.path().join(file).with_extension("parquet")).unwrap();
    }
    let session = Session::read(folder.path(), None).unwrap();
    let files: Vec<&str> = session.recordings.iter().map(|entry| entry.file.as_str()).collect();
    assert_eq!(files, ["a.parquet", "c.parquet", "d.parquet"]);
    assert_eq!(session.notes.len(), 2, "{:?}", session.notes);
}

#[test]
fn a_damaged_csv_makes_a_session_unusable() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    example().write(at("a.parquet")).unwrap();
    example().write(at("b.csv")).unwrap();
    let good = fs::read_to_string(at("b.csv")).unwrap();
    for (bad, expected) in [
        (good.replacen("7,1,0.5", "7,1,NaN", 1), "column `position_um_1`, row 7"),
        (good[..good.len() - 6].to_owned(), "line 52: expected 3 columns"),
        (good[..30].to_owned(), "JSON"),
    ] {
        fs::write(at("b.csv"), bad).unwrap();
        let message = refused(Session::read(folder.path(), None), "b.csv");
        assert!(message.contains(expected), "{message}");
    }
    // One that is no recording is left out, and named.
    fs::write(at("b.csv"), "time,temperature\n0,21.5\n").unwrap();
    let session = Session::read(folder.path(), None).unwrap();
    assert_eq!(session.recordings.len(), 1);
    assert!(session.notes[0].contains("b.csv was left out"), "{:?}", session.notes);
}

#[test]
fn names_of_several_rigs_are_noted() {
    let folder = tempfile::tempdir().unwrap();
    for (file, rig) in [("a.parquet", "old"), ("b.parquet", ""), ("c.parquet", "new")] {
        let mut recording = example();
        recording.meta.rig = rig.into();
        // Else the later ones would be copies of the first.
        recording.drive_v[0][0] += f32::from(file.as_bytes()[0]);
        recording.write(folder.path().join(file)).unwrap();
    }
    let notes = Session::read(folder.path(), None).unwrap().notes;
    assert!(notes[0].contains("a.parquet says \"old\", c.parquet says \"new\""), "{notes:?}");
}

#[test]
fn names_that_say_something_else() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["a.txt", "a", "a.csv.part"] {
        assert!(refused(example().write(at(name)), name).contains(".parquet or .csv"));
    }
    let channels = Channels { axes: 1, monitor: false, reference: false, flags: false };
    let stream = StreamWriter::create(at("a.csv"), Meta::new("live", 100.0), channels);
    assert!(refused(stream.map(|_| ()), "a.csv").contains("ends in .parquet"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    example().write(at("a.PARQUET")).unwrap();
    assert_eq!(Recording::read(at("a.PARQUET")).unwrap(), example());
}

/// A device node, which root could replace by a file; here a socket.
#[cfg(unix)]
#[test]
fn what_is_no_file_is_not_replaced() {
    use std::os::unix::fs::FileTypeExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let _socket = std::os::unix::net::UnixListener::bind(&path).unwrap();
    assert!(refused(example().write(&path), "a.parquet").contains("device"));
    assert!(fs::metadata(&path).unwrap().file_type().is_socket());
    assert!(refused(example().write("/dev/full"), "/dev/full").contains("device"));
}

#[test]
fn several_files_appear_together() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let names = |folder: &Path| fs::read_dir(folder).unwrap().count();
    let write = |second: &str| {
        let mut together = Together::default();
        together.folder(&at("new/deep"))?;
        example().write_into(&mut together, &at("new/deep/a.parquet"))?;
        together.add_text(&at(second), "text")?;
        together.publish()
    };
    fs::create_dir(at("taken")).unwrap();
    assert!(refused(write("taken"), "taken").contains("folder"));
    assert_eq!(names(folder.path()), 1, "the folders are gone again");
    write("new/b.txt").unwrap();
    assert_eq!((names(&at("new")), names(&at("new/deep"))), (2, 1));
}
