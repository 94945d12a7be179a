//! Causes as the answer states them: parameters with intervals, the share of the gap that each closes, and the staircase of the report.

use host_sim::rig::Rig;

use crate::Error;
use crate::diagnosis::{Cause, CauseKind, Parameter};
use crate::fitting::knobs::knobs_at;
use crate::judge::ambiguity::place_words;
use crate::search::found::Found;
use crate::session::energy::{Energies, moved_on};
use crate::session::scene::{Channel, Scene, Stack};

/// Causes, the energy that each claims on each axis (nm^2 times samples), and the gap (nm, held out) after each is added.
pub(crate) type CauseList = (Vec<Cause>, Vec<Vec<f64>>, Vec<(String, f64)>);

/// Causes with the energy that each closes, by axis, and the gap after each is added in turn, with every recording taken by
/// itself.
///
/// What a cause closes is its share of what all causes of the answer move, each by itself: two that work against each other (a stack
/// that gives more, a spring that stiffens) each move more than the gap, and what taking one out of them leaves, or adding one closes,
/// says which was asked first and not which is larger.
pub(crate) fn causes_of(
    rig: &Rig,
    scene: &Scene,
    found: &Found,
    raw_before: &Stack,
    raw_after: &Stack,
) -> Result<CauseList, Error> {
    let axes = rig.axes.len();
    let everything = |_: &Channel| true;
    let model = &found.model;
    let whole = &found.whole;
    let closed = Energies::new(scene, raw_before, raw_after, &everything).closed_on(axes);
    let mut moved = Vec::new();
    for t in 0..model.terms.len() {
        let alone = scene.raw(&model.with(rig, |other| other == t)?, everything)?;
        moved.push(moved_on(scene, raw_before, &alone, axes));
    }
    let all: f64 = moved.iter().flatten().sum();
    let all_on: Vec<f64> =
        (0..axes).map(|axis| moved.iter().map(|of_cause| of_cause[axis]).sum()).collect();
    let claim = |axis: usize, energy: f64| {
        if all_on[axis] > 0.0 { closed[axis] * energy / all_on[axis] } else { 0.0 }
    };
    let claimed = moved
        .iter()
        .map(|on| on.iter().enumerate().map(|(axis, &energy)| claim(axis, energy)).collect())
        .collect();
    let mut causes = Vec::new();
    let inflate = 4.0 + whole.fit.cost / scene.noise_on(&whole.fit.stack, u32::MAX).max(1.0) * 8.0;
    let deviations = whole.fit.deviations(inflate);
    let mut at = 0;
    for (t, term) in model.terms.iter().enumerate() {
        let info = term.effect.info();
        let width = info.parameters.len();
        let mut parameters = std::collections::BTreeMap::new();
        let agree = (0..width).all(|k| {
            let values: Vec<f64> = (0..term.places.len()).map(|p| whole.values(t, p)[k]).collect();
            let (low, high) = values
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
            high - low <= 0.1 * high.abs().max(low.abs())
        });
        for (k, p) in info.parameters.iter().enumerate() {
            // A part of the effect may be there on some axes only.
            // What tells a variety of it from another one is told although no fit turns it.
            let is_silent = |q: usize| {
                let knob = &whole.fit.knobs[at + q * width + k];
                let is_told = knob.is_variety() && whole.values(t, q)[k] != p.zero;
                knob.is_frozen() && !is_told
            };
            if (0..term.places.len()).all(is_silent) {
                continue;
            }
            if agree {
                let n = term.places.len() as f64;
                let value = (0..term.places.len()).map(|q| whole.values(t, q)[k]).sum::<f64>() / n;
                let sd =
                    (0..term.places.len()).map(|q| deviations[at + q * width + k]).sum::<f64>() / n;
                parameters.insert(p.name.to_string(), parameter(value, sd, (p.min, p.max), p.unit));
            } else {
                for (q, place) in term.places.iter().enumerate().filter(|(q, _)| !is_silent(*q)) {
                    let name = match *place {
                        host_sim::effects::Place::Axis(a) => format!("{}_{}", p.name, a + 1),
                        host_sim::effects::Place::Pair { on, from } => {
                            format!("{}_{}_{}", p.name, on + 1, from + 1)
                        }
                    };
                    parameters.insert(
                        name,
                        parameter(
                            whole.values(t, q)[k],
                            deviations[at + q * width + k],
                            (p.min, p.max),
                            p.unit,
                        ),
                    );
                }
            }
        }
        at += width * term.places.len();
        causes.push(Cause {
            effect: info.name.into(),
            kind: match info.kind {
                host_sim::effects::Kind::Parametric => CauseKind::Parametric,
                host_sim::effects::Kind::Structural => CauseKind::Structural,
            },
            stage: info.stage.name().into(),
            axes: term.axes().iter().map(|a| a + 1).collect(),
            closes: if all > 0.0 { moved[t].iter().sum::<f64>() / all } else { 0.0 },
            parameters,
            confidence: found.standings.causes[t].confidence,
            indistinguishable_from: found.standings.causes[t].rivals.clone(),
        });
    }
    // Add the causes one after the other, the largest first.
    let mut order: Vec<usize> = (0..causes.len()).collect();
    order.sort_by(|&a, &b| causes[b].closes.total_cmp(&causes[a].closes));
    let mut stairs = Vec::new();
    let mut partial = rig.clone();
    let held = |c: &Channel| c.held_out;
    for &t in &order {
        for (p, &place) in model.terms[t].places.iter().enumerate() {
            for (knob, &value) in
                knobs_at(model.terms[t].effect, place, &model.ranges).iter().zip(model.values(t, p))
            {
                knob.write(&mut partial, value)?;
            }
        }
        let raw = scene.file_by_file(&partial)?.raw(&partial, held)?;
        let nm = Energies::new(scene, raw_before, &raw, &held).gap(axes).after_nm;
        let mut words: Vec<String> =
            model.terms[t].places.iter().map(|&p| place_words(p)).collect();
        words.sort_unstable();
        let place =
            if words.len() > 3 { format!("{} places", words.len()) } else { words.join(", ") };
        // On two lines: side by side the names of several causes run into each other.
        stairs.push((format!("{}\n({place})", model.terms[t].name()), nm));
    }
    Ok((causes, claimed, stairs))
}

/// With the interval that is left within `range`, which the value is in.
fn parameter(value: f64, sd: f64, range: (f64, f64), unit: &str) -> Parameter {
    let sd = if sd.is_finite() { sd } else { value.abs() };
    let least = (value - 1.96 * sd).max(range.0.min(value));
    let most = (value + 1.96 * sd).min(range.1.max(value));
    Parameter { value, ci95: [least, most], unit: unit.into() }
}
