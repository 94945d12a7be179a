//! What recordings say of themselves and the answer says of them: periods that are none, and checks on parts of what was fitted.

mod common;

use common::{diagnosed_as_paper_rig, paper_rig, session, session_of, stiffer};
use gap::diagnosis::{Role, Verdict};
use gap::{Diagnosis, sentence};

#[test]
fn a_period_that_is_none_is_not_believed() {
    let with_period = |period_s: Option<f64>| {
        // In the first one nothing moves: its drive repeats with any period.
        let drive = |nth: u32, axis: usize, time_s: f64| {
            let hz = 3.0 * f64::from(nth) + axis as f64;
            12.0 * f64::from(nth) * (1.0 - (std::f64::consts::TAU * time_s * hz).cos())
        };
        let mut session = session_of(&stiffer(), drive, |_, _, um| um);
        session.recordings.iter_mut().for_each(|entry| entry.recording.meta.period_s = period_s);
        diagnosed_as_paper_rig(&session)
    };
    let without = with_period(None);
    let wrong = with_period(Some(0.37));
    for d in [&without, &wrong] {
        assert_eq!((d.verdict, &d.causes[0].axes[..]), (Verdict::Explained, &[2][..]));
    }
    let said = |n: &&String| n.starts_with("r1.parquet: period_s = 0.37 s was ignored");
    let note = wrong.notes.iter().find(said).expect("a note");
    assert!(note.ends_with("of r2.parquet, r3.parquet, r4.parquet."), "{note}");
    let figures = |d: &Diagnosis| serde_json::to_string(&d.gap).expect("json");
    assert_eq!(figures(&without), figures(&wrong));
}

#[test]
fn a_period_of_the_drive_is_believed() {
    let mut session = session(&stiffer(), |_, _, um| um);
    // Whole hertz on every axis; a fifth of the second period is there, and enough to see that it repeats.
    session.recordings.iter_mut().for_each(|entry| entry.recording.meta.period_s = Some(1.0));
    let d = diagnosed_as_paper_rig(&session);
    assert!(!d.notes.iter().any(|n| n.contains("period_s")), "{:?}", d.notes);
}

#[test]
fn a_check_on_parts_of_what_was_fitted_says_so() {
    let mut session = session(&stiffer(), |_, _, um| um);
    for many in [3, 2, 1] {
        session.recordings.truncate(many);
        let d = diagnosed_as_paper_rig(&session);
        assert_eq!(d.verdict, Verdict::Explained, "{many}");
        let is_in_parts = d.recordings.iter().all(|r| r.role == Role::Fit);
        let is_noted = d.notes.iter().any(|n| n.contains("weaker promise"));
        let is_said = sentence(&d).contains("on parts of the recording");
        assert_eq!([is_in_parts, is_noted, is_said], [many < 3; 3], "{many}: {:?}", d.notes);
    }
    // Where there is no gap nothing is promised.
    let mut none = common::session(&paper_rig(), |_, _, um| um);
    none.recordings.truncate(1);
    let d = diagnosed_as_paper_rig(&none);
    assert_eq!(d.verdict, Verdict::NoGap);
    assert!(!d.notes.iter().any(|n| n.contains("weaker promise")), "{:?}", d.notes);
}
