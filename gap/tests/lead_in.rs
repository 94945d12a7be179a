//! What the part before `settle_s` tells of a creeping stack's past, in recordings that are replayed one by one.

use std::sync::Arc;

use gap::session::lead_in;
use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Output, Place, Stretch, simulate};
use rand::{RngExt, SeedableRng, rngs::StdRng};

mod common;

const RATE_HZ: f64 = 10_000.0;
const SETTLE: usize = 5_000;
const SAMPLES: usize = 45_000;

/// Noise of a gauge, m.
const NOISE_M: f64 = 1.5e-9;

/// A ramp to 100 V and back in 0.4 s, 0.1 s of rest, then 60 V at 1 Hz.
fn drive_v() -> Vec<f64> {
    let time_s = |i: usize| i as f64 / RATE_HZ;
    (0..SAMPLES)
        .map(|i| match i {
            0..SETTLE => 100.0 * (1.0 - (time_s(i) / 0.2 - 1.0).abs()).max(0.0),
            _ => 30.0 * (1.0 - (std::f64::consts::TAU * time_s(i - SETTLE)).cos()),
        })
        .collect()
}

fn creeping(per_decade: f64) -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    for axis in 0..3 {
        rig.set("creep", Place::Axis(axis), "per_decade", per_decade).unwrap();
    }
    rig
}

/// A recording of stacks with these pasts, and what a replay makes of it: root mean square of what is left of each axis (m) without a
/// past and with the one that the lead-in tells.
fn replayed(
    rig: &Rig,
    pasts: [&[(f64, f64)]; 3],
    measured: impl Fn(f64) -> Option<f64>,
) -> [[f64; 3]; 2] {
    let drive = drive_v();
    replayed_with(rig, [&drive; 3], pasts, measured)
}

/// The same with a drive of its own for each axis.
fn replayed_with(
    rig: &Rig,
    drives: [&[f64]; 3],
    pasts: [&[(f64, f64)]; 3],
    measured: impl Fn(f64) -> Option<f64>,
) -> [[f64; 3]; 2] {
    let input = Input {
        sample_rate_hz: RATE_HZ,
        start_s: 0.0,
        ticks: None,
        drive_v: &drives,
        monitor_v: None,
        initial: &[],
    };
    let run = |initial: &[Initial]| -> Output {
        simulate(rig, &Input { initial, ..input }, Axes::All).unwrap()
    };
    let stretch = |&(lasted_s, transducer_v): &(f64, f64)| Stretch { lasted_s, transducer_v };
    let lived = pasts.map(|past| Initial {
        past: Some(past.iter().map(stretch).collect::<Arc<[_]>>()),
        ..Initial::default()
    });
    let mut rng = StdRng::seed_from_u64(5);
    let mut position_m = run(&lived).position_m;
    let mut noise = || NOISE_M * (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>();
    position_m.iter_mut().flatten().for_each(|x| *x += noise());
    let read = |axis: usize, sample: usize| {
        assert!(sample < SETTLE, "looked at sample {sample}, which is scored");
        measured(position_m[axis][sample])
    };
    let told = lead_in::initial(rig, &input, SETTLE, read).unwrap();
    [Vec::new(), told].map(|initial| {
        let output = run(&initial);
        std::array::from_fn(|axis| {
            let both = position_m[axis].iter().zip(&output.position_m[axis]).skip(SETTLE);
            let squares: f64 = both.map(|(a, b)| (a - b).powi(2)).sum();
            (squares / (SAMPLES - SETTLE) as f64).sqrt()
        })
    })
}

#[test]
fn creep_of_what_was_done_before_is_told_by_the_lead_in() {
    // A hold of a minute that ended 8 s ago, one of 20 s that ended a second ago, and a rested stack.
    let pasts = [&[(60.0, 90.0), (8.0, 0.0)][..], &[(20.0, 60.0), (1.0, 0.0)], &[]];
    let [without, with] = replayed(&creeping(0.02), pasts, Some);
    for (axis, left) in [(0, 0.05), (1, 0.2)] {
        let [without, with] = [without[axis], with[axis]];
        assert!(without > 100.0e-9, "axis {}: {without} m without", axis + 1);
        assert!(with < left * without, "axis {}: {without} -> {with} m", axis + 1);
    }
    assert!(with[2] < 1.02 * without[2], "rested: {} -> {} m", without[2], with[2]);
}

#[test]
fn a_large_creep_is_told_as_well() {
    let pasts = [&[(60.0, 90.0), (8.0, 0.0)][..], &[], &[]];
    let [without, with] = replayed(&creeping(0.05), pasts, Some);
    assert!(without[0] > 400.0e-9 && with[0] < 0.02 * without[0], "{without:?} {with:?}");
}

#[test]
fn stacks_that_are_always_biased_are_not_taken_for_driven_before() {
    let mut rig = creeping(0.02);
    rig.axes.iter_mut().for_each(|axis| axis.amplifier.min_v = 20.0);
    let [without, with] = replayed(&rig, [&[]; 3], Some);
    assert!(with[0] < 1.02 * without[0], "{without:?} {with:?}");
}

#[test]
fn without_creep_or_gauges_the_lead_in_tells_nothing() {
    let pasts = [&[(60.0, 90.0), (8.0, 0.0)][..]; 3];
    let [without, with] = replayed(&creeping(0.0), pasts, Some);
    assert_eq!(without, with);
    let [without, with] = replayed(&creeping(0.02), pasts, |_| None);
    assert_eq!(without, with);
    // Columns of zeros where nothing was measured, and a stage that is driven by something else.
    let [without, with] = replayed(&creeping(0.02), pasts, |_| Some(0.0));
    assert_eq!(without, with);
    let [without, with] = replayed(&creeping(0.02), pasts, |measured_m| Some(0.7 * measured_m));
    assert_eq!(without, with);
}

#[test]
fn an_axis_that_is_idle_while_others_lead_in_stays_rested() {
    let pasts = [&[(60.0, 90.0), (8.0, 0.0)][..]; 3];
    let drive = drive_v();
    // One is driven by half a millivolt of noise alone, one only from where positions are scored.
    let mut rng = StdRng::seed_from_u64(6);
    let idle: Vec<f64> = drive.iter().map(|_| 1.0e-3 * (rng.random::<f64>() - 0.5)).collect();
    let later = [&idle[..SETTLE], &drive[SETTLE..]].concat();
    let drives = [&drive[..], &idle, &later];
    let [without, with] = replayed_with(&creeping(0.02), drives, pasts, Some);
    assert!(with[0] < 0.2 * without[0], "driven: {} -> {} m", without[0], with[0]);
    assert_eq!([without[1], without[2]], [with[1], with[2]], "idle");
}

/// A law of creep that is not the catalogue's, in a session in which it runs on from file to file: its recordings are promised and replayed
/// one by one.
#[test]
fn a_replay_of_single_files_comes_near_to_the_session_in_order() {
    let diagnosis = common::drawn(12121, 103, &["creep"]);
    let in_order_nm = diagnosis.in_order_nm.expect("creep runs on here");
    assert!(diagnosis.gap.after_nm < 1.5 * in_order_nm, "{in_order_nm} {:?}", diagnosis.gap);
}
