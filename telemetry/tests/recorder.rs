//! The recorder against everything that can end it.

use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

use recording::{Meta, Recording};
use telemetry::recorder::{Ended, Recorder};
use telemetry::{Batch, Sample};

fn batch(ticks: std::ops::Range<u64>, restarted: bool) -> Batch {
    let samples: Vec<Sample> = ticks
        .map(|tick| Sample { tick, position_um: [tick as f32; 3], ..Default::default() })
        .collect();
    Batch { samples: samples.into(), restarted }
}

fn start(path: &Path) -> (mpsc::Sender<Batch>, Recorder) {
    let (sender, receiver) = mpsc::channel();
    (sender, Recorder::record(receiver, path, Meta::new("test", 1000.0), None).unwrap())
}

fn wait(recorder: &Recorder) -> Ended {
    for _ in 0..500 {
        if let Some(ended) = recorder.progress().ended {
            return ended;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("the recorder did not end: {:?}", recorder.progress());
}

#[test]
fn a_stop_keeps_everything() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let (sender, recorder) = start(&path);
    sender.send(batch(5..1505, false)).unwrap();
    sender.send(batch(1600..2000, false)).unwrap();
    // Many more, so that they wait when the stop comes.
    (200..10_200).for_each(|n| sender.send(batch(10 * n..10 * n + 10, false)).unwrap());
    let progress = recorder.stop();
    assert_eq!(progress.ended, Some(Ended::Stopped));
    assert_eq!((progress.rows, progress.lost_ticks), (101_900, 95));
    let read = Recording::read(&path).unwrap();
    assert_eq!((read.len(), read.tick[0], read.lost().len()), (101_900, 5, 1));
}

#[test]
fn a_recording_is_as_long_as_it_was_to_be() {
    let folder = tempfile::tempdir().unwrap();
    // The end within a batch, with one, and in a gap.
    for (n, (seconds, last)) in [(0.25, 254), (0.3, 304), (0.55, 504)].into_iter().enumerate() {
        let path = folder.path().join(format!("{n}.parquet"));
        let (sender, receiver) = mpsc::channel();
        for from in [5, 105, 205, 305, 405, 605, 705] {
            sender.send(batch(from..from + 100, false)).unwrap();
        }
        let meta = Meta::new("test", 1000.0);
        let recorder = Recorder::record(receiver, &path, meta, Some(seconds)).unwrap();
        assert_eq!(wait(&recorder), Ended::Stopped);
        let progress = recorder.stop();
        let read = Recording::read(&path).unwrap();
        assert_eq!((read.tick[0], read.tick[read.len() - 1]), (5, last), "{seconds} s");
        assert_eq!(progress.rows, read.len() as u64);
        assert_eq!(progress.lost_ticks, 0, "{seconds} s");
    }
}

#[test]
fn a_recording_that_never_was_is_not_said_to_be_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let (sender, recorder) = start(&path);
    // As below, in the first second.
    sender.send(batch(0..10, false)).unwrap();
    let bad = Sample { tick: 10, position_um: [f32::NAN; 3], ..Default::default() };
    sender.send(Batch { samples: vec![bad].into(), restarted: false }).unwrap();
    let Ended::CannotWrite { reason } = wait(&recorder) else { panic!() };
    assert!(reason.contains("nothing had been written"), "{reason}");
    assert_eq!(folder.path().read_dir().unwrap().count(), 0, "nothing is left");
}

#[test]
fn an_unplugged_board_leaves_a_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let (sender, recorder) = start(&path);
    sender.send(batch(0..700, false)).unwrap();
    drop(sender);
    assert!(matches!(wait(&recorder), Ended::BoardGone { .. }));
    assert_eq!(Recording::read(&path).unwrap().len(), 700);
}

#[test]
fn a_restarted_board_ends_the_file_before_its_ticks_repeat() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let (sender, recorder) = start(&path);
    sender.send(batch(5000..5500, false)).unwrap();
    sender.send(batch(0..100, true)).unwrap();
    let Ended::BoardGone { reason } = wait(&recorder) else { panic!() };
    assert!(reason.contains("restarted"));
    assert_eq!(Recording::read(&path).unwrap().len(), 500);
}

#[test]
fn what_cannot_be_written_is_said_and_the_rest_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let (sender, recorder) = start(&path);
    sender.send(batch(0..2500, false)).unwrap();
    // A value that no file may hold stands in for a disk that fails: the writer's error path is the same.
    let bad = Sample { tick: 3000, position_um: [f32::NAN; 3], ..Default::default() };
    sender.send(Batch { samples: vec![bad].into(), restarted: false }).unwrap();
    let Ended::CannotWrite { reason } = wait(&recorder) else { panic!() };
    assert!(reason.contains("2.0 s are safe"), "{reason}");
    assert_eq!(Recording::read(&path).unwrap().len(), 2000);
}

#[test]
fn no_file_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    std::fs::write(&path, "precious").unwrap();
    let (_sender, receiver) = mpsc::channel();
    assert!(Recorder::record(receiver, &path, Meta::new("test", 1000.0), None).is_err());
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
}
