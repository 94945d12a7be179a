//! What is drawn is what is written: sizes, repeatability, speed, and every effect and fault does something.

use std::collections::BTreeSet;

use truth::case::{Case, Draw, Sessions};
use truth::effects::EFFECTS;
use truth::faults::Kind;

fn draw(only: &str, weights: [f64; 4]) -> Draw {
    let only = if only.is_empty() { Vec::new() } else { vec![only.to_string()] };
    Draw { weights, only, sessions: Sessions::Probe, ..Draw::default() }
}

#[test]
fn effects_reach_the_wanted_gap() {
    for (index, effect) in EFFECTS.iter().enumerate() {
        // Every ninth: all of them take minutes (`flexstage blind --write-only` draws as many as wanted).
        if !(index + 8).is_multiple_of(9) {
            continue;
        }
        let case = Case::draw(11, 1, &draw(effect.name, [0.0, 1.0, 0.0, 0.0]));
        let truth = &case.label.truth[0];
        assert_eq!((truth.effect.as_str(), truth.stage.as_str()), (effect.name, effect.stage));
        println!(
            "{}: {:.2} x noise, axes {:?}, {}",
            truth.effect, truth.ratio, truth.axes, truth.note
        );
        assert!((3.0..=60.0).contains(&truth.ratio), "{}: {}", effect.name, truth.ratio);
        for recording in case.session.iter().chain(&case.judging) {
            recording.check(effect.name.as_ref()).unwrap();
        }
    }
}

#[test]
fn what_rubs_does_not_chatter() {
    for index in 0..3 {
        let case = Case::draw(21, index, &draw("friction", [0.0, 1.0, 0.0, 0.0]));
        let still = case.session.iter().filter(|r| r.meta.experiment.contains("rest"));
        for recording in still {
            for position in recording.position_um.iter().flatten() {
                let from = recording.settle_rows();
                // Second differences of white noise have six times its variance; the median hears no edges.
                let mut bends: Vec<f32> =
                    position[from..].windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
                let middle = bends.len() / 2;
                let median = *bends.select_nth_unstable_by(middle, f32::total_cmp).1;
                let noise_nm = 1.0e3 * f64::from(median) / 0.6745 / 6.0_f64.sqrt();
                assert!(
                    noise_nm < 1.3 * case.label.floor_nm,
                    "{} {}: {noise_nm:.1} nm for {:.1}",
                    case.label.truth[0].note,
                    recording.meta.experiment,
                    case.label.floor_nm
                );
            }
        }
    }
}

#[test]
fn the_same_numbers_give_the_same_case_and_others_do_not() {
    let draw = Draw { other_rigs: true, sessions: Sessions::Random, ..Draw::default() };
    let first = Case::draw(5, 3, &draw);
    let again = Case::draw(5, 3, &draw);
    assert_eq!(first.label, again.label);
    assert_eq!(first.session, again.session);
    assert_ne!(first.session, Case::draw(5, 4, &draw).session);
}

#[test]
fn unknown_faults_are_of_many_kinds_and_visible() {
    let mut kinds = BTreeSet::new();
    for index in 0..3 {
        let case = Case::draw(3, index, &draw("", [0.0, 0.0, 0.0, 1.0]));
        let truth = &case.label.truth[0];
        println!("{} {:.2} x noise", truth.note, truth.ratio);
        assert_eq!(truth.effect, "unknown");
        assert!(truth.ratio > 1.0, "{} {}", truth.note, truth.ratio);
        kinds.insert(truth.note.split(',').next().unwrap().to_string());
    }
    assert!(kinds.len() >= 2, "{kinds:?}");
}

#[test]
fn electronics_that_nobody_measured_show_in_the_monitor() {
    for faults in [&[Kind::DriveBend], &[Kind::DriveTail]] {
        let draw = Draw { faults, ..draw("", [0.0, 0.0, 0.0, 1.0]) };
        let case = Case::draw_unjudged(11, 0, &draw);
        let truth = &case.label.truth[0];
        assert!(truth.note.starts_with(faults[0].name()), "{}", truth.note);
        assert!(truth.axes.len() < case.rig.axes.len(), "no axis is left to compare with");
        // The same session with nothing wrong, noise and all.
        let sound = Case::draw_unjudged(11, 0, &Draw { weights: [1.0, 0.0, 0.0, 0.0], ..draw });
        for axis in 0..case.rig.axes.len() {
            let both = case.session.iter().zip(&sound.session);
            let off = both.flat_map(|(a, b)| {
                let [a, b] = [a, b].map(|r| r.monitor_v[axis].as_ref().expect("a probe has them"));
                a.iter().zip(b).map(|(a, b)| (a - b).abs())
            });
            let most = off.fold(0.0, f32::max);
            let is_off = truth.axes.contains(&(axis + 1));
            assert!(
                if is_off { most > 0.02 } else { most == 0.0 },
                "{}, axis {}: {most} V",
                truth.note,
                axis + 1
            );
        }
    }
}

#[test]
fn a_rig_without_monitor_records_the_same_motion() {
    let with = Case::draw(31, 0, &draw("", [1.0, 0.0, 0.0, 0.0]));
    let mut without = with.clone();
    without.drop_monitor();
    assert!(with.label.monitor && !without.label.monitor);
    for (a, b) in
        with.session.iter().chain(&with.judging).zip(without.session.iter().chain(&without.judging))
    {
        assert!(a.monitor_v.iter().all(Option::is_some) && b.monitor_v.iter().all(Option::is_none));
        assert_eq!((&a.drive_v, &a.position_um), (&b.drive_v, &b.position_um));
        b.check("without monitor".as_ref()).unwrap();
    }
}
