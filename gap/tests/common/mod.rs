//! Sessions that need no file, and cases of the truth generator.
#![allow(dead_code, reason = "every test takes what it needs of this module")]

use gap::diagnosis::Verdict;
use gap::{Diagnosis, Options, diagnose};
use host_sim::rig::Rig;
use host_sim::{Axes, Input, simulate};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recording::{Entry, Meta, Recording, Session};
use truth::case::{Case, Draw};
use truth::faults::Kind;

const RATE_HZ: f64 = 10_000.0;
const ROWS: usize = 12_000;
const AXES: usize = 3;
/// Noise of the gauges, um rms.
const NOISE_UM: f64 = 0.004;

/// The paper's rig.
pub fn paper_rig() -> Rig {
    Rig::named("handley").expect("library rig")
}

/// The same with a stiffer second axis.
pub fn stiffer() -> Rig {
    let mut rig = paper_rig();
    rig.axes[1].mechanism.stiffness_n_per_m *= 1.2;
    rig
}

/// What is said of a session of the paper's rig.
pub fn diagnosed_as_paper_rig(session: &Session) -> Diagnosis {
    diagnose(&paper_rig(), session, &Options::default()).expect("diagnosis").diagnosis
}

/// Five recordings of sines on all axes of `rig`, each reading passed through `gauge` (axis, row, um).
pub fn session(rig: &Rig, gauge: impl Fn(usize, usize, f64) -> f64) -> Session {
    session_of(rig, sines, gauge)
}

/// Drive (V) of the `nth` recording of an axis at a time, s: a sine.
fn sines(nth: u32, axis: usize, time_s: f64) -> f64 {
    let hz = 2.0 + 3.0 * f64::from(nth) + axis as f64;
    (15.0 + 6.0 * f64::from(nth)) * (1.0 - (std::f64::consts::TAU * time_s * hz).cos())
}

/// The same, switched on and off.
pub fn squares(nth: u32, axis: usize, time_s: f64) -> f64 {
    let hz = 4.0 + f64::from(nth) + 0.3 * axis as f64;
    let is_on = (time_s * hz).fract() > 0.5;
    if is_on { 20.0 + 10.0 * f64::from(nth) } else { 0.0 }
}

/// Five recordings of a drive of all axes of `rig`, each reading passed through `gauge` (axis, row, um).
pub fn session_of(
    rig: &Rig,
    volts: impl Fn(u32, usize, f64) -> f64,
    gauge: impl Fn(usize, usize, f64) -> f64,
) -> Session {
    let mut rng = StdRng::seed_from_u64(7);
    let recordings = (0..5_u32)
        .map(|nth| {
            let drive: Vec<Vec<f64>> = (0..AXES)
                .map(|axis| (0..ROWS).map(|row| volts(nth, axis, row as f64 / RATE_HZ)).collect())
                .collect();
            let columns: Vec<&[f64]> = drive.iter().map(Vec::as_slice).collect();
            let start_s = 10.0 * f64::from(nth);
            let input = Input {
                sample_rate_hz: RATE_HZ,
                start_s,
                ticks: None,
                drive_v: &columns,
                monitor_v: None,
                initial: &[],
            };
            let output = simulate(rig, &input, Axes::All).expect("simulation");
            let mut noise = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let position_um = output
                .position_m
                .iter()
                .enumerate()
                .map(|(axis, column)| {
                    let reading = |(row, m): (usize, &f64)| {
                        (gauge(axis, row, m * 1.0e6) + NOISE_UM * noise()) as f32
                    };
                    Some(column.iter().enumerate().map(reading).collect())
                })
                .collect();
            let recording = Recording {
                meta: Meta { start_s, settle_s: 0.1, ..Meta::new("drive", RATE_HZ) },
                tick: (0..ROWS as u64).collect(),
                drive_v: drive.iter().map(|c| c.iter().map(|&v| v as f32).collect()).collect(),
                monitor_v: vec![None; AXES],
                position_um,
                reference_um: vec![None; AXES],
                flags: None,
            };
            let file = format!("r{nth}.parquet");
            Entry { path: file.clone().into(), file, recording }
        })
        .collect();
    Session { recordings, ..Session::default() }
}

/// What is said of a case of the truth generator, which shares no code with the catalogue. `of`: what it was drawn for; the generator is
/// free to change, and then another case has to be chosen.
pub fn drawn(seed: u64, index: u64, of: &[&str]) -> Diagnosis {
    diagnosed_case((seed, index), &Draw { other_rigs: true, ..Draw::default() }, of, &[])
}

/// The same with effects in further forms, one a case.
pub fn drawn_in_a_further_form(seed: u64, index: u64, of: &str, among: &[&str]) -> Diagnosis {
    let draw = Draw { other_rigs: true, ..in_a_further_form(among) };
    diagnosed_case((seed, index), &draw, &[of], &[])
}

/// The same on the paper's rig.
pub fn drawn_in_a_further_form_of_the_paper(seed: u64, index: u64, of: &str) -> Diagnosis {
    diagnosed_case((seed, index), &in_a_further_form(&[of]), &[of], &[])
}

fn in_a_further_form(among: &[&str]) -> Draw {
    Draw {
        further_forms: true,
        weights: [0.0, 1.0, 0.0, 0.0],
        only: owned(among),
        ..Draw::default()
    }
}

/// The same with a fault that is physics of a healthy rig; the note of the case begins with the fault's name.
pub fn drawn_physics(seed: u64, index: u64, fault: &str, exclude: &[&str]) -> Diagnosis {
    let case = drawn_fault((seed, index), &Kind::PHYSICS, fault);
    diagnosed(case, &["unknown"], &owned(exclude))
}

/// The same with electronics that nobody measured, on a rig whose amplifiers have no monitors: those would tell at once.
pub fn drawn_electronics(seed: u64, index: u64, fault: &str, exclude: &[&str]) -> Diagnosis {
    let mut case = drawn_fault((seed, index), &Kind::ELECTRONICS, fault);
    case.drop_monitor();
    diagnosed(case, &["unknown"], &owned(exclude))
}

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_string()).collect()
}

fn drawn_fault(case: (u64, u64), faults: &'static [Kind], fault: &str) -> Case {
    let draw = Draw { other_rigs: true, weights: [0.0, 0.0, 0.0, 1.0], faults, ..Draw::default() };
    let drawn = Case::draw_unjudged(case.0, case.1, &draw);
    let note = &drawn.label.truth[0].note;
    assert!(note.starts_with(fault), "{case:?} is {note}: choose a new one");
    drawn
}

/// The same with this effect taken out of the catalogue.
pub fn drawn_without(seed: u64, index: u64, effect: &str) -> Diagnosis {
    let draw = Draw { other_rigs: true, ..Draw::default() };
    diagnosed_case((seed, index), &draw, &[effect], &[effect.to_string()])
}

/// The same, on the paper's rig.
pub fn drawn_of_the_paper(seed: u64, index: u64, of: &[&str]) -> Diagnosis {
    diagnosed_case((seed, index), &Draw::default(), of, &[])
}

/// Two of these effects on the paper's rig.
pub fn drawn_pair_of_the_paper(seed: u64, index: u64, among: &[&str], of: &[&str]) -> Diagnosis {
    let weights = [0.0, 0.0, 1.0, 0.0];
    diagnosed_case((seed, index), &Draw { weights, only: owned(among), ..Draw::default() }, of, &[])
}

fn diagnosed_case(
    (seed, index): (u64, u64),
    draw: &Draw,
    of: &[&str],
    exclude: &[String],
) -> Diagnosis {
    diagnosed(Case::draw_unjudged(seed, index, draw), of, exclude)
}

fn diagnosed(mut case: Case, of: &[&str], exclude: &[String]) -> Diagnosis {
    let truth: Vec<&str> = case.label.truth.iter().map(|t| t.effect.as_str()).collect();
    assert_eq!(truth, of, "{} is another one now: choose a new one", case.label.id);
    case.label.id = "case".into();
    let folder = tempfile::tempdir().expect("folder");
    case.write(folder.path()).expect("written");
    let case = folder.path().join("case");
    let rig = Rig::load(&case.join("rig.toml")).expect("rig");
    let session = Session::read(case.join("session"), None).expect("session");
    let options = Options { exclude: exclude.to_vec(), ..Options::default() };
    diagnose(&rig, &session, &options).expect("a diagnosis").diagnosis
}

/// The gap is explained by these effects on these axes, in this order, and by nothing else.
pub fn assert_explained(diagnosis: &Diagnosis, named: &[(&str, &[usize])]) {
    assert_eq!((diagnosis.verdict, &causes(diagnosis)[..]), (Verdict::Explained, named));
}

/// Effects and axes that are named.
pub fn causes(diagnosis: &Diagnosis) -> Vec<(&str, &[usize])> {
    diagnosis.causes.iter().map(|c| (c.effect.as_str(), &c.axes[..])).collect()
}
