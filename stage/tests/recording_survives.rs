//! A recording whose program is killed or whose disk is full: at most the last second is missing, and that is said.

#![cfg(target_os = "linux")]

mod common;

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use common::{Board, flexstage, ok, run, text};
use recording::Recording;

#[test]
fn a_killed_program_loses_at_most_the_last_second() {
    let board = Board::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let mut record = flexstage()
        .args(["record", text(&file), "--connect", &board.address])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let part = file.with_extension("parquet.part");
    while !part.exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    let started = Instant::now();
    std::thread::sleep(Duration::from_millis(3600));
    // SIGKILL: no handler runs, nothing is flushed.
    record.kill().unwrap();
    let recorded = started.elapsed().as_secs_f64();
    record.wait().unwrap();
    assert!(!file.exists() && part.exists(), "what is left is not called finished");

    let words = ok(run(&["record", "--recover", text(&file)]));
    assert!(words.contains("recovered"), "{words}");
    let kept = Recording::read(&file).unwrap();
    let seconds = kept.span_ticks() as f64 / 1e4;
    // The stream starts some milliseconds after the file is made.
    assert!(seconds >= recorded - 1.3, "{seconds} s of {recorded} s");
    assert!(!part.exists());
}

#[test]
fn a_full_disk_is_said_and_loses_at_most_the_last_second() {
    let folder = tempfile::tempdir().unwrap();
    // A small disk of our own in a namespace of our own; where that is not allowed this test says so.
    let script = "mount -t tmpfs -o size=2m none \"$1\" && shift && \"$@\"; code=$?; \
                  cp \"$0\"/* \"$0\"/../kept/ 2>/dev/null; exit $code";
    let disk = folder.path().join("disk");
    let kept = folder.path().join("kept");
    std::fs::create_dir(&disk).unwrap();
    std::fs::create_dir(&kept).unwrap();
    let allowed = Command::new("unshare")
        .args(["-rm", "mount", "-t", "tmpfs", "-o", "size=64k", "none", text(&disk)])
        .output()
        .is_ok_and(|out| out.status.success());
    if !allowed {
        eprintln!("skipped: this machine lets nobody mount a disk in a namespace (unshare -rm)");
        return;
    }
    let file = disk.join("a.parquet");
    let out = Command::new("unshare")
        .args(["-rm", "sh", "-c", script, text(&disk), text(&disk)])
        .arg(env!("CARGO_BIN_EXE_flexstage"))
        .args(["record", "--virtual", "--fast", text(&file), "--json"])
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(2), "{words}");
    assert!(words.contains("the disk is full"), "{words}");
    let told = common::json(&String::from_utf8(out.stdout).unwrap());
    let taken = told["seconds"].as_f64().unwrap();
    let file = kept.join("a.parquet");
    if !file.exists() {
        // Not even the footer fitted: the message says how to get at it once there is room.
        assert!(words.contains("--recover"), "{words}");
        ok(run(&["record", "--recover", text(&file)]));
    } else {
        assert!(words.contains("are safe in"), "{words}");
    }
    let seconds = Recording::read(&file).unwrap().span_ticks() as f64 / 1e4;
    assert!(seconds >= 1.0 && seconds >= taken - 1.0, "{seconds} s of {taken} s");
}

#[test]
fn a_disk_that_is_full_in_the_first_second_keeps_nothing_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (disk, left) = (folder.path().join("disk"), folder.path().join("left"));
    std::fs::create_dir(&disk).unwrap();
    let script = "mount -t tmpfs -o size=64k none \"$1\" || exit 77; shift; \"$@\"; code=$?; \
                  ls \"$0\" > \"$0\"/../left; exit $code";
    let out = Command::new("unshare")
        .args(["-rm", "sh", "-c", script, text(&disk), text(&disk)])
        .arg(env!("CARGO_BIN_EXE_flexstage"))
        .args(["record", "--virtual", "--fast", "--seconds", "20", text(&disk.join("a.parquet"))])
        .output();
    // Without the list of what is left there was no disk.
    let Some(out) = out.ok().filter(|_| left.exists()) else {
        eprintln!("skipped: this machine lets nobody mount a disk in a namespace (unshare -rm)");
        return;
    };
    let words = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(2), "{words}");
    assert!(words.contains("the disk is full") && words.contains("nothing had been"), "{words}");
    assert!(!words.contains("is kept") && !words.contains("--recover"), "{words}");
    assert_eq!(std::fs::read_to_string(&left).unwrap(), "", "nothing is in the way");
}

#[test]
fn a_recording_is_as_long_as_it_was_to_be_at_any_speed() {
    let folder = tempfile::tempdir().unwrap();
    for seconds in ["0.01", "1"] {
        let file = folder.path().join(format!("{seconds}.parquet"));
        ok(run(&["record", "--virtual", "--fast", "--seconds", seconds, text(&file)]));
        let length = Recording::read(&file).unwrap().span_ticks() as f64 / 1e4;
        assert_eq!(length, seconds.parse::<f64>().unwrap());
    }
}
