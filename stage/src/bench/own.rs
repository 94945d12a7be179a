//! `bench --rig RIG.toml`: the experiments and the controller on a rig of one's own, with the effects that `diagnose` wrote into its file and
//! without them. What retuning the closed loop on the corrected model buys is the difference of two tables.

use std::path::Path;

use anyhow::bail;
use flexstage::AXES;
use host_sim::{AnyRig, Rig};

use super::book::Book;
use super::tracking::{Ends, Form, Full, controllers, percent, summary, table};
use super::{coupling, hysteresis};

/// Drive of the first paper's experiments, V; less where an amplifier ends before.
const PEAK_V: f64 = 90.0;
/// Share of what an axis reaches at the amplifier's upper rail that motions use: the loop and the effects need the rest.
const USED: f64 = 0.7;

/// Motions of less tell nothing beside the converters' steps.
const LEAST_UM: f32 = 1.0;

/// A stage of three axes from a file.
pub fn load(path: &Path) -> anyhow::Result<Rig> {
    let rig = match AnyRig::load(path)? {
        AnyRig::Stage(rig) => rig,
        AnyRig::Platform(_) => bail!(
            "{}: a platform; expected a stage driven by stacks (`bench` without --rig simulates the second paper's platforms)",
            path.display()
        ),
    };
    if ends(&rig).high_um < LEAST_UM {
        bail!(
            "{}: an axis reaches {:.3} um at its amplifier's upper rail: expected a stage that can make motions of {LEAST_UM} um with {:.0} % of it",
            path.display(),
            reach_um(&rig),
            100.0 * USED
        );
    }
    if rig.axes.len() != AXES {
        bail!(
            "{}: a rig of {} axes; the controller has {AXES}, and the experiments use all of them",
            path.display(),
            rig.axes.len()
        );
    }
    Ok(rig)
}

/// What the axis that reaches least reaches.
fn reach_um(rig: &Rig) -> f64 {
    let reach = |axis: &host_sim::rig::Axis| axis.rest_m_per_v() * axis.amplifier.max_v * 1.0e6;
    rig.axes.iter().map(reach).fold(f64::INFINITY, f64::min)
}

/// Motions that every axis can make without and with its effects, of the size of the paper's at most.
fn ends(rig: &Rig) -> Ends {
    // To a tenth of a micrometre, as people choose them.
    let tenths = |um: f64| ((um * 10.0).floor() / 10.0) as f32;
    let high_um = (reach_um(rig) * USED).clamp(0.0, 12.0);
    Ends { low_um: tenths(high_um / 6.0), high_um: tenths(high_um) }
}

/// An experiment on a rig.
type OnRig = fn(&mut Book, &Rig) -> anyhow::Result<()>;
/// The same on several rigs, by name, up to a drive (V).
type OnRigs = fn(&mut Book, &[(&str, &Rig)], f64) -> anyhow::Result<()>;

/// What runs on it.
pub const EXPERIMENTS: [(&str, OnRig); 3] = [
    ("coupling between axes", |book, rig| with_and_without(book, rig, coupling::of_rig)),
    ("hysteresis", |book, rig| with_and_without(book, rig, hysteresis::of_rig)),
    ("tracking", tracking),
];

/// The rig as it was believed before something was found missing.
fn believed(rig: &Rig) -> Rig {
    Rig { effects: Vec::new(), ..rig.clone() }
}

fn with_and_without(book: &mut Book, rig: &Rig, experiment: OnRigs) -> anyhow::Result<()> {
    let rails = rig.axes.iter().map(|axis| axis.amplifier.max_v);
    let peak_v = rails.fold(PEAK_V, f64::min);
    if rig.effects.is_empty() {
        experiment(book, &[("as given", rig)], peak_v)
    } else {
        let rigs = [("without its effects", &believed(rig)), ("with its effects", rig)];
        experiment(book, &rigs, peak_v)
    }
}

/// The controller as it is designed for the model without effects, and retuned for the one with them.
fn tracking(book: &mut Book, rig: &Rig) -> anyhow::Result<()> {
    let (believed, ends) = (believed(rig), ends(rig));
    let straight = |rig: &Rig| -> Vec<(f64, f64)> {
        rig.axes.iter().map(|axis| (1.0e-6 / axis.rest_m_per_v(), 0.0)).collect()
    };
    let plant = ("rig", rig);
    if rig.effects.is_empty() {
        let full = table(book, "Tracking", plant, &controllers(rig, &straight(rig), false), ends)?;
        summary(book, "given", &full);
        return Ok(());
    }
    let settings = controllers(&believed, &straight(&believed), false);
    let before = table(book, "Tracking, designed without the effects", plant, &settings, ends)?;
    let settings = controllers(rig, &straight(rig), false);
    let retuned = ("rig/retuned", rig);
    let after = table(book, "Tracking, retuned for the effects", retuned, &settings, ends)?;
    summary(book, "retuned", &after);
    if rows_of(&before) == rows_of(&after) {
        book.finding(
            "The controller has no counterpart of these effects: what it can learn of them, `identify --for-control` learns from recordings.",
        );
    }
    let percent = |full: &Full, hz, controller| {
        let percent = percent(full, Form::Sine, hz, controller);
        if percent.is_finite() { format!("{percent:.3} %") } else { "a fault".to_string() }
    };
    let said = format!(
        "Worst axis, rms error of sines: retuned for the effects of the rig file {} at 1 Hz, {} at 10 Hz and {} at 100 Hz ({}, {} and {} designed \
         without them); feedforward alone {} at 10 Hz ({}).",
        percent(&after, 1.0, 4),
        percent(&after, 10.0, 4),
        percent(&after, 100.0, 4),
        percent(&before, 1.0, 4),
        percent(&before, 10.0, 4),
        percent(&before, 100.0, 4),
        percent(&after, 10.0, 2),
        percent(&before, 10.0, 2),
    );
    book.finding(&said);
    book.verdict(&said);
    Ok(())
}

/// Every error of the tables, to tell whether two are the same.
fn rows_of(full: &Full) -> Vec<u64> {
    full.iter().flat_map(|(_, runs)| runs.iter().map(|run| run.worst_percent.to_bits())).collect()
}
