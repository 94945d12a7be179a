//! From a rig and a session of free returns to a diagnosis, a corrected rig and a report.

use std::collections::BTreeMap;

use host_sim::platform::{PlatformRig, free_return, rig::Sensor};
use recording::Session;
use report::Report;

use super::{
    catalogue::{CATALOGUE, Effect},
    causes::{ambiguity, cause},
    data::{self, Part, PlatformDataError, Return, Split},
    fit::{Data, Fit, fit},
    identify::{self, Named},
    model::{Knob, Model},
    noise::{self, Noise},
    picture,
    select::{self, Question, Selection},
    tell,
};
use crate::Options;
use crate::diagnosis::{AxisGap, Diagnosis, Gap, Location, RecordingGap, Role, Verdict};

/// What a diagnosis gives.
pub struct Outcome {
    /// For diagnosis.json.
    pub diagnosis: Diagnosis,
    /// The rig with what was found added.
    pub rig: PlatformRig,
    /// For report.html.
    pub report: Report,
}

/// Everything that the report draws from.
#[derive(Debug)]
pub struct Findings<'a> {
    /// The rig as it was given.
    pub nominal: &'a PlatformRig,
    /// The rig as given with its own parameters refitted to all samples.
    pub refitted: Option<Fit>,
    /// The rig with what was found, fitted to all samples.
    pub found: Fit,
    /// Choice of effects, on the fitted part.
    pub selection: Selection,
    /// Returns of the session.
    pub returns: &'a [Return],
    /// Their noise.
    pub noise: &'a [Noise],
    /// What was held out.
    pub split: Split,
    /// Parameters of the found rig.
    pub parameters: Vec<Named>,
    /// Where in time the gap lies.
    pub windows: Vec<Window>,
    /// The answer.
    pub diagnosis: Diagnosis,
}

/// Gap in a stretch of time after the release.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Start and end, s.
    pub span_s: [f64; 2],
    /// Gap with the rig as it was given, m.
    pub before_m: f64,
    /// Gap with what was found, m.
    pub after_m: f64,
    /// Share of the explainable energy of the gap.
    pub share: f64,
}

/// Diagnose a session of free returns.
pub fn diagnose(
    rig: &PlatformRig,
    session: &Session,
    options: &Options,
) -> Result<Outcome, PlatformDataError> {
    let may_be_named = |effect: &Effect| options.exclude.iter().all(|name| name != effect.name());
    let catalogue: Vec<Effect> = CATALOGUE.into_iter().filter(may_be_named).collect();
    let returns = data::returns(session)?;
    let noise: Vec<Noise> = returns.iter().map(noise::measure).collect();
    let data = Data::new(rig, &returns, &noise);
    let split = data::split(&returns);
    let all = Part::all(&returns);
    let floor = part_floor_m(&noise, &split.held_out);
    let unusable = || PlatformDataError {
        file: rig.name.clone(),
        message: "the chain cannot be simulated; check masses, stiffness and damping of the rig"
            .to_owned(),
    };
    let question = Question { data, split: &split, floor_m: floor, catalogue: &catalogue };
    let selection = select::select(question, rig).ok_or_else(unusable)?;

    // The figures of the gap come from the fitted part alone; the rig that is handed out is refitted to all samples.
    let found = fit(data, &selection.fit.model, &all, std::slice::from_ref(&selection.fit.values))
        .ok_or_else(unusable)?;
    let memory = identify::fit_memory(data, &found, &all);
    let refitted = identify::chain_fit(data, rig, &all);
    let gap = gap(data, rig, &selection.fit.model.rig, &split, floor).ok_or_else(unusable)?;
    let windows = windows(data, rig, &selection.fit.model.rig, &all);
    let verdict = verdict(&gap, &selection, &split, memory, &noise);
    let ambiguity = ambiguity(&selection, &found);
    let mut notes = session.notes.clone();
    notes.extend(returns.iter().filter_map(Return::doubt));
    notes.extend(self::notes(data, &found, &selection, &all, &windows, memory, &gap));
    let diagnosis = Diagnosis {
        band: None,
        in_order_nm: None,
        looks_like: None,
        rest: None,
        verdict,
        location: location(data, &selection, &gap, verdict, &split),
        causes: selection.accepted.iter().map(|accepted| cause(accepted, &found, memory)).collect(),
        next_experiment: ambiguity,
        recordings: recordings(data, rig, &selection.fit.model.rig, &split),
        notes,
        gap,
    };
    let findings = Findings {
        nominal: rig,
        refitted,
        parameters: identify::chain_parameters(&found, memory),
        found,
        selection,
        returns: &returns,
        noise: &noise,
        split,
        windows,
        diagnosis,
    };
    let report = picture::report(&findings);
    let rig = corrected(rig, &findings.found, floor);
    Ok(Outcome { diagnosis: findings.diagnosis, rig, report })
}

/// The rig that is handed out: what was found, and the measured noise where the rig had none.
fn corrected(nominal: &PlatformRig, found: &Fit, floor_m: f64) -> PlatformRig {
    let mut rig = found.model.rig.clone();
    if found.values.is_empty() {
        rig = nominal.clone();
    }
    rig.sensor.get_or_insert(Sensor { noise_rms_m: floor_m, resolution_m: 0.0 });
    rig
}

/// Noise over a part, m.
fn part_floor_m(noise: &[Noise], part: &Part) -> f64 {
    let energy: f64 =
        part.rows.iter().map(|(i, rows)| noise[*i].rms_m.powi(2) * rows.len() as f64).sum();
    (energy / part.len().max(1) as f64).sqrt()
}

fn gap(
    data: Data,
    before: &PlatformRig,
    after: &PlatformRig,
    split: &Split,
    floor_m: f64,
) -> Option<Gap> {
    let part = &split.held_out;
    let before = data.residuals_m(before, part).ok()?;
    let after = data.residuals_m(after, part).ok()?;
    let pairs: Vec<(f64, f64, usize)> = select::blocks(&before)
        .zip(select::blocks(&after))
        .map(|(b, a)| (select::energy(b), select::energy(a), b.len()))
        .collect();
    let closed = |pairs: &[(f64, f64, usize)]| {
        let samples: usize = pairs.iter().map(|p| p.2).sum();
        let mean = |sum: f64| sum / samples.max(1) as f64 - floor_m.powi(2);
        let before = mean(pairs.iter().map(|p| p.0).sum());
        let after = mean(pairs.iter().map(|p| p.1).sum());
        if before > 0.0 { 1.0 - after / before } else { 0.0 }
    };
    let mut draws = select::resample(&pairs, closed);
    draws.sort_by(f64::total_cmp);
    let at = |share: f64| draws[((draws.len() - 1) as f64 * share).round() as usize];
    let rms = |pick: fn(&(f64, f64, usize)) -> f64| {
        (pairs.iter().map(pick).sum::<f64>() / part.len().max(1) as f64).sqrt() * 1e9
    };
    let (before_nm, after_nm, floor_nm) = (rms(|p| p.0), rms(|p| p.1), floor_m * 1e9);
    let closed = closed(&pairs);
    Some(Gap {
        before_nm,
        after_nm,
        floor_nm,
        closed,
        closed_ci95: [at(0.025), at(0.975)],
        per_axis: vec![AxisGap { axis: 1, before_nm, after_nm, floor_nm, closed }],
    })
}

/// Standard error of (gap² - floor²) / floor² for a perfect model: that of the gap's mean square and of the floor's.
fn relative_error(split: &Split, memory: f64, noise: &[Noise]) -> f64 {
    let floor = noise.iter().map(|n| n.relative_error).fold(0.0, f64::max);
    (2.0 * memory / split.held_out.len().max(1) as f64 + (2.0 * floor).powi(2)).sqrt()
}

fn verdict(
    gap: &Gap,
    selection: &Selection,
    split: &Split,
    memory: f64,
    noise: &[Noise],
) -> Verdict {
    let error = relative_error(split, memory, noise);
    let beyond = |nm: f64| (nm.powi(2) / gap.floor_nm.powi(2) - 1.0) / error;
    if selection.accepted.is_empty() {
        // Below a tenth of the noise in rms nothing is worth the name of a gap.
        let small = gap.before_nm.powi(2) < 1.01 * gap.floor_nm.powi(2);
        return if beyond(gap.before_nm) < 4.0 || small {
            Verdict::NoGap
        } else {
            Verdict::Unexplained
        };
    }
    if beyond(gap.after_nm) < 4.0 || gap.closed > 0.98 {
        Verdict::Explained
    } else {
        Verdict::PartlyExplained
    }
}

/// Shares of the stages: those of the accepted effects, and what is left over by whether the platform still moved.
fn location(
    data: Data,
    selection: &Selection,
    gap: &Gap,
    verdict: Verdict,
    split: &Split,
) -> Vec<Location> {
    if verdict == Verdict::NoGap {
        return Vec::new();
    }
    let mut shares: BTreeMap<&str, f64> = BTreeMap::new();
    for accepted in &selection.accepted {
        *shares.entry(accepted.effect.stage()).or_default() += accepted.closes.max(0.0);
    }
    if verdict != Verdict::Explained
        && let Ok(residuals) = data.residuals_m(&selection.fit.model.rig, &split.held_out)
    {
        let (mut moving, mut resting) = (1e-30, 1e-30);
        for ((index, rows), residual) in split.held_out.rows.iter().zip(&residuals) {
            let recording = &data.returns[*index];
            for (row, r) in rows.iter().zip(residual) {
                let away = recording.position_m[*row].abs() > 0.05 * recording.initial_m.abs();
                *if away { &mut moving } else { &mut resting } += r * r;
            }
        }
        let rest = (1.0 - gap.closed).clamp(0.0, 1.0);
        *shares.entry("mechanism").or_default() += rest * moving / (moving + resting);
        *shares.entry("sensor").or_default() += rest * resting / (moving + resting);
    }
    let sum: f64 = shares.values().sum();
    let mut list: Vec<Location> = shares
        .into_iter()
        .map(|(stage, share)| Location { axis: 1, stage: stage.to_owned(), share: share / sum })
        .filter(|location| location.share > 0.005)
        .collect();
    list.sort_by(|a, b| b.share.total_cmp(&a.share));
    list
}

fn recordings(
    data: Data,
    before: &PlatformRig,
    after: &PlatformRig,
    split: &Split,
) -> Vec<RecordingGap> {
    let mut list = Vec::new();
    for (part, role) in [(&split.fit, Role::Fit), (&split.held_out, Role::HeldOut)] {
        for rows in &part.rows {
            let single = Part { rows: vec![rows.clone()] };
            let nm = |rig| identify::rms_m(data, rig, &single).unwrap_or(f64::NAN) * 1e9;
            list.push(RecordingGap {
                file: data.returns[rows.0].file.clone(),
                role,
                before_nm: nm(before),
                after_nm: nm(after),
            });
        }
    }
    list
}

/// Gap in stretches of time that double in length.
fn windows(data: Data, before: &PlatformRig, after: &PlatformRig, all: &Part) -> Vec<Window> {
    let (Ok(before), Ok(after)) = (data.residuals_m(before, all), data.residuals_m(after, all))
    else {
        return Vec::new();
    };
    let end = data.returns.iter().filter_map(|r| r.time_s.last()).fold(0.0_f64, |a, b| a.max(*b));
    let edges: Vec<f64> =
        std::iter::once(0.0).chain((0..8).rev().map(|i| end / f64::from(1 << i))).collect();
    let mut sums = vec![(0.0, 0.0, 0.0, 0usize); edges.len() - 1];
    for (((index, rows), before), after) in all.rows.iter().zip(&before).zip(&after) {
        let floor = data.noise[*index].rms_m.powi(2);
        for ((row, before), after) in rows.iter().zip(before).zip(after) {
            let time = data.returns[*index].time_s[*row];
            let slot = edges[1..].iter().position(|edge| time <= *edge).unwrap_or(sums.len() - 1);
            let sum = &mut sums[slot];
            sum.0 += before * before;
            sum.1 += after * after;
            sum.2 += before * before - floor;
            sum.3 += 1;
        }
    }
    let total: f64 = sums.iter().map(|s| s.2.max(0.0)).sum::<f64>().max(f64::MIN_POSITIVE);
    sums.iter()
        .zip(edges.windows(2))
        .filter(|(sum, _)| sum.3 > 0)
        .map(|(sum, edge)| Window {
            span_s: [edge[0], edge[1]],
            before_m: (sum.0 / sum.3 as f64).sqrt(),
            after_m: (sum.1 / sum.3 as f64).sqrt(),
            share: sum.2.max(0.0) / total,
        })
        .collect()
}

fn notes(
    data: Data,
    found: &Fit,
    selection: &Selection,
    all: &Part,
    windows: &[Window],
    memory: f64,
    gap: &Gap,
) -> Vec<String> {
    let mut lines = Vec::new();
    if gap.before_nm > 1.1 * gap.floor_nm {
        let mut by_share = windows.to_vec();
        by_share.sort_by(|a, b| b.share.total_cmp(&a.share));
        let places: Vec<String> = by_share
            .iter()
            .take(3)
            .filter(|w| w.share > 0.05)
            .map(|w| {
                format!(
                    "{:.0} % from {:.2} to {:.2} s ({:.0} um rms)",
                    100.0 * w.share,
                    w.span_s[0],
                    w.span_s[1],
                    w.before_m * 1e6
                )
            })
            .collect();
        lines.push(format!("Where in time: {} of the gap's energy.", places.join(", ")));
    }
    for (recording, noise) in data.returns.iter().zip(data.noise) {
        lines.push(format!(
            "Noise of {}: {:.2} um rms about short cubics, {:.2} um from differences{}.",
            recording.file,
            noise.rms_m * 1e6,
            noise.differences_m * 1e6,
            if memory > 1.5 {
                format!("; its memory makes means {memory:.1} times more uncertain")
            } else {
                "; white".to_owned()
            }
        ));
    }
    if let Some(line) = drift_line(data, found, all, memory) {
        lines.push(line);
    }
    if !selection.accepted.is_empty() {
        lines.extend(tell::statements(data, found, all));
    }
    lines
}

/// Offset and drift of the reading, measured on top of what was found.
fn drift_line(data: Data, found: &Fit, all: &Part, memory: f64) -> Option<String> {
    let mut model: Model = found.model.clone();
    if model.knobs.contains(&Knob::SensorOffset) || model.knobs.contains(&Knob::SensorDrift) {
        return None; // a cause of its own, with its figures
    }
    model.free(Knob::SensorOffset);
    model.free(Knob::SensorDrift);
    let start = model.values();
    let fit = fit(data, &model, all, &[start])?;
    let offset = fit
        .estimate(memory, false, |rig| rig.effects.sensor_offset.map_or(0.0, |e| e.offset_m * 1e6));
    let drift = fit.estimate(memory, false, |rig| {
        rig.effects.sensor_drift.map_or(0.0, |e| e.drift_m_per_s * 1e6)
    });
    Some(format!(
        "Offset of the reading {:.2} um (95 %: {:.2} to {:.2}), drift {:.2} um/s (95 %: {:.2} to {:.2}), measured from the \
         recordings on top of what was found.",
        offset.value, offset.ci95[0], offset.ci95[1], drift.value, drift.ci95[0], drift.ci95[1]
    ))
}

/// Noiseless reading of a rig along a return, m.
pub fn predicted_m(rig: &PlatformRig, data: &Return) -> Vec<f64> {
    free_return(rig, data.initial_m, &data.time_s, data.start_s).unwrap_or_default()
}
