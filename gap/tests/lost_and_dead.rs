//! Recordings that lost samples, and gauges that do not follow.

mod common;

use common::{diagnosed_as_paper_rig, paper_rig, session, session_of, stiffer};
use gap::diagnosis::Verdict;
use host_sim::rig::Rig;
use recording::Session;

/// The session without the rows that `is_lost` (recording, row) says.
fn without_rows(mut session: Session, is_lost: impl Fn(usize, usize) -> bool) -> Session {
    for (nth, entry) in session.recordings.iter_mut().enumerate() {
        let recording = &mut entry.recording;
        let kept: Vec<usize> =
            (0..recording.tick.len()).filter(|&row| !is_lost(nth, row)).collect();
        recording.tick = kept.iter().map(|&row| recording.tick[row]).collect();
        let pick = |column: &mut Vec<f32>| {
            *column = kept.iter().map(|&row| column[row]).collect();
        };
        recording.drive_v.iter_mut().for_each(pick);
        recording.monitor_v.iter_mut().flatten().for_each(pick);
        recording.position_um.iter_mut().flatten().for_each(pick);
        recording.flags.iter_mut().for_each(|flags| {
            *flags = kept.iter().map(|&row| flags[row]).collect();
        });
    }
    session
}

#[test]
fn lost_samples_are_no_samples_without_a_gap() {
    let other = stiffer();
    let whole = session(&other, |_, _, um| um);
    // One row of ninety, which with the time after each loss is half of all.
    let holed =
        without_rows(session(&other, |_, _, um| um), |nth, row| (row * 7_919 + nth * 31) % 90 == 0);
    let (whole, holed) = (diagnosed_as_paper_rig(&whole), diagnosed_as_paper_rig(&holed));
    eprintln!("{:?}\n{:?}", whole.gap, holed.gap);
    for d in [&whole, &holed] {
        assert_eq!(d.verdict, Verdict::Explained);
        assert_eq!(d.causes[0].axes, [2]);
        assert!((d.gap.after_nm / d.gap.floor_nm - 1.0).abs() < 0.03, "{:?}", d.gap);
        assert!((d.gap.floor_nm - 4.0).abs() < 0.2, "{:?}", d.gap);
        assert!(d.gap.closed < 1.001, "{:?}", d.gap);
    }
    let ratio = holed.gap.before_nm / whole.gap.before_nm;
    assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
}

/// What a stack did while nothing was recorded is still in it afterwards: of the rig itself 10.4 nm are left here where that counts as a gap, with
/// noise of 4.0.
#[test]
fn what_happened_in_a_long_interruption_is_no_gap() {
    let other = stiffer();
    // Never twice the same, so that no turn wipes out what was before it; the largest are in the half that is lost.
    let wanders = |nth: u32, axis: usize, time_s: f64| {
        let hz = 7.0 + f64::from(nth) + axis as f64;
        let wave = |hz: f64| (std::f64::consts::TAU * time_s * hz).sin();
        let swells = (-((time_s - 0.6) / 0.25).powi(2)).exp();
        45.0 + 8.0 * wave(hz) + 6.0 * wave(2.7 * hz) + 25.0 * swells * wave(1.3 * hz)
    };
    let answer = |of: &Rig| {
        let whole = session_of(of, wanders, |_, _, um| um);
        let half = without_rows(whole, |_, row| (3_000..9_000).contains(&row));
        diagnosed_as_paper_rig(&half)
    };
    let (none, stiff) = (answer(&paper_rig()), answer(&other));
    eprintln!("{:?}\n{:?}", none.gap, stiff.gap);
    assert_eq!(none.verdict, Verdict::NoGap, "{:?}", none.gap);
    assert!(none.notes.iter().any(|n| n.contains("interrupted for 0.60 s")), "{:?}", none.notes);
    assert_eq!((stiff.verdict, &stiff.causes[0].axes[..]), (Verdict::Explained, &[2][..]));
    assert!((stiff.gap.after_nm / stiff.gap.floor_nm - 1.0).abs() < 0.03, "{:?}", stiff.gap);
}

#[test]
fn lost_samples_are_none_that_do_not_repeat() {
    let other = stiffer();
    // Half a second is a period of every axis.
    let repeats = |nth: u32, axis: usize, time_s: f64| {
        let hz = 2.0 * (1.0 + f64::from(nth) + axis as f64);
        (15.0 + 6.0 * f64::from(nth)) * (1.0 - (std::f64::consts::TAU * time_s * hz).cos())
    };
    let answer = |lost_of: usize| {
        let mut session = session_of(&other, repeats, |_, _, um| um);
        session.recordings.iter_mut().for_each(|e| e.recording.meta.period_s = Some(0.5));
        let session = without_rows(session, |nth, row| (row * 7_919 + nth * 31) % lost_of == 0);
        diagnosed_as_paper_rig(&session)
    };
    let (whole, holed) = (answer(usize::MAX), answer(400));
    eprintln!("{:?}\n{:?}", whole.gap, holed.gap);
    for d in [&whole, &holed] {
        assert_eq!((d.verdict, &d.causes[0].axes[..]), (Verdict::Explained, &[2][..]));
        assert!((d.gap.floor_nm - 4.0).abs() < 0.2, "{:?}", d.gap);
        assert!(!d.notes.iter().any(|n| n.contains("period_s")), "{:?}", d.notes);
    }
}

#[test]
fn a_gauge_that_does_not_follow_is_nobodys_effect() {
    let rig = paper_rig();
    // Not connected, or frozen: with the noise of its amplifier, or without any.
    for (rest_um, share) in [(0.0, 0.0), (3.7, 0.0), (0.0, 1.0e-3)] {
        let still = |axis: usize, _: usize, um: f64| {
            if axis == 1 { rest_um + share * um } else { um }
        };
        let mut session = session(&rig, still);
        if share == 0.0 {
            let recordings = session.recordings.iter_mut();
            recordings
                .filter_map(|e| e.recording.position_um[1].as_mut())
                .for_each(|um| um.fill(rest_um as f32));
        }
        let d = diagnosed_as_paper_rig(&session);
        assert_eq!(d.verdict, Verdict::Unexplained, "{rest_um}, {share}: {:?}", d.causes);
        assert!(d.causes.is_empty());
        assert!(d.notes.iter().any(|n| n.starts_with("Axis 2 does not move")), "{:?}", d.notes);
    }
}
