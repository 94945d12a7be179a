//! Effects that are not in the catalogue, taken out of it, must not be called by their neighbours' names.

use gap::diagnosis::Verdict;

mod common;

use common::{causes, drawn_without};

#[test]
fn without_dead_times_a_delay_is_no_slow_amplifier() {
    // A slow amplifier closes 0.93 of this gap; a right one would close 0.99.
    let diagnosis = drawn_without(2424, 38, "drive-delay");
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Unexplained, vec![]));
}

#[test]
fn without_offsets_a_shifted_gauge_is_none_that_drifts() {
    let diagnosis = drawn_without(2424, 67, "sensor-offset");
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Unexplained, vec![]));
}

#[test]
fn a_drive_that_is_shifted_is_no_shifted_gauge_where_its_monitor_shows_it() {
    // An offset of the gauge accounts for all that the gauge reads, and for nothing that the monitor does.
    let diagnosis = drawn_without(14141, 112, "drive-offset");
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Unexplained, vec![]));
    assert!(diagnosis.notes.iter().any(|note| note.contains("monitor reads")), "{diagnosis:?}");
}

#[test]
fn monitors_of_axes_without_a_gap_say_nothing() {
    let diagnosis = common::drawn(14141, 90, &["drive-gain"]);
    assert_eq!(causes(&diagnosis), vec![("drive-gain", &[3][..])]);
    assert!(!diagnosis.notes.iter().any(|note| note.contains("monitor reads")), "{diagnosis:?}");
}
