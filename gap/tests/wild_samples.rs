//! Recordings with readings that no motion makes.

mod common;

use common::{diagnosed_as_paper_rig, paper_rig, session, session_of, squares, stiffer};
use gap::diagnosis::Verdict;
use gap::session::intake;
use recording::Session;

/// Change readings of a gauge (from 0) in a recording.
fn disturb(session: &mut Session, nth: usize, axis: usize, change: impl Fn(usize, f32) -> f32) {
    let um = session.recordings[nth].recording.position_um[axis].as_mut().expect("measured");
    um.iter_mut().enumerate().for_each(|(row, um)| *um = change(row, *um));
}

/// What is said of wild readings, and how many samples are not scored.
fn taken_out(session: &Session) -> (Vec<String>, usize) {
    let (tracks, notes) = intake::tracks(&paper_rig(), session).expect("tracks");
    let absent = tracks.iter().flat_map(|track| &track.present).filter(|&&present| !present);
    (notes, absent.count())
}

#[test]
fn a_wild_sample_is_lost_and_told() {
    let whole = session(&stiffer(), |_, _, um| um);
    let mut spoilt = whole.clone();
    // One that is held out, one that is fitted, and a pair in what is not scored at all.
    disturb(&mut spoilt, 1, 1, |row, um| if row == 7_001 { um - 20.0 } else { um });
    disturb(&mut spoilt, 4, 0, |row, um| if row == 3_000 { um + 0.6 } else { um });
    disturb(&mut spoilt, 2, 2, |row, um| if row / 2 == 250 { um + 20.0 } else { um });
    let (whole, spoilt) = (diagnosed_as_paper_rig(&whole), diagnosed_as_paper_rig(&spoilt));
    for d in [&whole, &spoilt] {
        assert_eq!((d.verdict, &d.causes[0].axes[..]), (Verdict::Explained, &[2][..]));
        assert!((d.gap.after_nm / d.gap.floor_nm - 1.0).abs() < 0.02, "{:?}", d.gap);
    }
    assert_eq!(whole.causes[0].effect, spoilt.causes[0].effect);
    assert!((spoilt.gap.before_nm / whole.gap.before_nm - 1.0).abs() < 1.0e-3);
    let is_said = |of: &str| spoilt.notes.iter().any(|n| n.starts_with(of));
    assert!(
        is_said("r1.parquet: the gauge of axis 2 reads 20.0 um off at tick 7001"),
        "{:?}",
        spoilt.notes
    );
    assert!(is_said("r4.parquet: the gauge of axis 1 reads 5"), "{:?}", spoilt.notes);
    assert!(is_said(
        "r2.parquet: 2 readings of the gauge of axis 3 are up to 20.0 um off, the first at tick 500"
    ));
}

#[test]
fn what_disturbs_all_converters_at_once_is_taken_out_of_all_of_them() {
    let mut all = session(&paper_rig(), |_, row, um| if row == 5_000 { 50.0 } else { um });
    let (notes, absent) = taken_out(&all);
    assert_eq!((notes.len(), absent), (15, 5), "{notes:?}");
    // And out of a monitor as well as out of gauges.
    for entry in &mut all.recordings {
        let drive = entry.recording.drive_v[0].clone();
        entry.recording.monitor_v[0] = Some(drive);
    }
    let monitor = all.recordings[3].recording.monitor_v[0].as_mut().expect("just put there");
    monitor[8_000] += 40.0;
    let (notes, absent) = taken_out(&all);
    assert_eq!((notes.len(), absent), (16, 6), "{notes:?}");
    assert!(notes.iter().any(|n| n.starts_with("r3.parquet: the monitor of axis 1 reads")));
}

#[test]
fn motion_and_diseases_of_a_gauge_are_not_wild() {
    let noise = |row: usize| f64::from(((row * 7_919) % 1_000) as u32) / 1_000.0 - 0.5;
    let ringing = |row: usize, hz: f64| {
        let since_s = (row % 3_000) as f64 / 10_000.0;
        0.5 * (-since_s / 1.0e-3).exp() * (std::f64::consts::TAU * hz * since_s).sin()
    };
    let state = |row: usize, long: usize| if row % 1_700 < long { 1.0 } else { 0.0 };
    type Fault<'a> = (&'a str, Box<dyn Fn(usize, f64) -> f64 + 'a>);
    let faults: [Fault; 8] = [
        ("nothing", Box::new(|_, um| um)),
        ("two states", Box::new(|row, um| um + state(row, 400) + state(row + 900, 2))),
        ("a stuck bit", Box::new(|_, um| (((um / 0.001) as i64) & !(1 << 9)) as f64 * 0.001)),
        ("coarse", Box::new(|_, um| (um / 0.2).round() * 0.2)),
        ("clipped", Box::new(|_, um| um.clamp(0.4, 3.0))),
        ("ringing", Box::new(move |row, um| um + ringing(row, 900.0) + ringing(row, 4_300.0))),
        ("bursts", Box::new(|row, um| um + 2.0 * state(row, 30) * noise(row))),
        ("hum", Box::new(|row, um| um + (std::f64::consts::TAU * 0.005 * row as f64).sin())),
    ];
    for (name, fault) in &faults {
        for drive in [squares, |_: u32, _: usize, s: f64| 40.0 * (s * 30.0).fract()] {
            let session =
                session_of(
                    &stiffer(),
                    drive,
                    |axis, row, um| if axis == 0 { fault(row, um) } else { um },
                );
            let (notes, absent) = taken_out(&session);
            assert_eq!(absent, 0, "{name}: {notes:?}");
        }
    }
    // A gauge that is late by a tick, or by many: the edges of its readings stand out of the difference.
    for late in [1, 3, 60] {
        let mut session = session_of(&paper_rig(), squares, |_, _, um| um);
        session.recordings.iter_mut().for_each(|entry| {
            let um = entry.recording.position_um[0].as_mut().expect("measured");
            um.rotate_right(late);
            um[..late].fill(0.0);
        });
        assert_eq!(taken_out(&session), (Vec::new(), 0), "{late}");
    }
}

#[test]
fn many_wild_samples_are_a_disease_that_stays() {
    let sick =
        session(
            &paper_rig(),
            |axis, row, um| {
                if axis == 2 && (row * 7_919) % 12_000 < 40 { um + 5.0 } else { um }
            },
        );
    let (notes, absent) = taken_out(&sick);
    assert_eq!((notes.len(), absent), (1, 0), "{notes:?}");
    assert!(notes[0].contains("readings of the gauge of axis 3 are up to 5.0 um off"), "{notes:?}");
    assert!(notes[0].contains("no accident"), "{notes:?}");
}
