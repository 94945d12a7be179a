//! The whole diagnosis, step by step: intake, floor, locate, split, search, accept, refit, report.

use host_sim::effects::{Effect, catalogue};
use host_sim::rig::Rig;
use indicatif::{ProgressBar, ProgressStyle};
use recording::Session;

use crate::accept::{self, AxisGapSize};
use crate::ambiguity::{self, place_words};
use crate::diagnosis::{
    Band, Cause, CauseKind, Diagnosis, NextExperiment, Parameter, RecordingGap, Role, Verdict,
};
use crate::energy::Energies;
use crate::fit::{Effort, cost};
use crate::guess::Ranges;
use crate::knobs::{EffectRef, knobs_at};
use crate::locate;
use crate::picture;
use crate::scene::{Channel, Scene, Stack, TOLERANCE, Wanted};
use crate::select::{Model, Search, Term, noise_cost, start_terms};
use crate::split::split;
use crate::{Error, Options, intake, slow};

/// What `flexstage diagnose` writes.
pub struct Outcome {
    /// `diagnosis.json`.
    pub diagnosis: Diagnosis,
    /// `rig.toml`: the rig with what was found added.
    pub rig: Rig,
    /// `report.html`.
    pub report: report::Report,
}

/// Everything that the report draws from.
pub struct Findings<'a> {
    /// Session and channels.
    pub scene: &'a Scene,
    /// Rig as given.
    pub nominal: &'a Rig,
    /// Rig with the causes.
    pub rig: &'a Rig,
    /// Raw residuals of the nominal rig.
    pub before: &'a Stack,
    /// Raw residuals of the corrected rig.
    pub after: &'a Stack,
    /// Cuts of the nominal gap.
    pub cuts: &'a locate::Cuts,
    /// Cuts of what is left.
    pub cuts_after: &'a locate::Cuts,
    /// Gap (nm, held out) after each cause is added in turn.
    pub staircase: &'a [(String, f64)],
    /// The answer.
    pub diagnosis: &'a Diagnosis,
    /// Names and scores of what else was tried.
    pub tried: &'a [(String, f64)],
}

pub(crate) fn bar(options: &Options) -> ProgressBar {
    if !options.progress {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    if let Ok(style) =
        ProgressStyle::with_template("{spinner} {msg} ({pos} simulations, {elapsed})")
    {
        bar.set_style(style);
    }
    bar
}

/// Diagnose a session.
pub fn diagnose(rig: &Rig, session: &Session, options: &Options) -> Result<Outcome, Error> {
    let bar = bar(options);
    bar.set_message("reading the recordings");
    let (tracks, passed_over) = intake::tracks(rig, session)?;
    let mut scene = Scene::new(rig, tracks);
    bar.set_message("measuring the noise");
    let mut notes = passed_over;
    notes.extend(integrity_notes(&scene, rig));
    split(&mut scene, &[]);
    scene.set_aside_memory(rig)?;
    let everything = |_: &Channel| true;
    // Weights of noise alone first: they tell how large the gap is in each band.
    let nominal = scene.residuals(&[(rig, Wanted::ALL)], everything)?.remove(0);
    let gaps = accept::gaps(&scene, &nominal);
    let raw_before = scene.raw(rig, everything)?;
    let cuts = locate::cuts(&scene, &raw_before, &nominal);
    let electrical = locate::electrical(&scene, &nominal);
    for (c, channel) in scene.channels.iter_mut().enumerate() {
        if let Some(row) = &nominal[c] {
            let power = channel.band_power(row);
            channel.weigh(&power, TOLERANCE);
        }
    }
    let effects: Vec<EffectRef> = catalogue()
        .iter()
        .copied()
        .filter(|e: &&'static dyn Effect| !options.exclude.iter().any(|x| x == e.info().name))
        .collect();

    let ranges = crate::guess::ranges(&scene, rig, &raw_before)?;
    let mut found: Option<Found> = None;
    if gaps.iter().any(|g| g.counts) {
        bar.set_message("screening the catalogue");
        found = search(&scene, rig, &effects, &ranges, &bar, &gaps)?;
        let missed = match &found {
            Some(f) => f.missed.clone(),
            // Nothing found in the fitted ones: the gap may be in the others alone.
            None => held_out_with_gap(&scene, &nominal),
        };
        if !missed.is_empty() && scene.tracks.len() >= 3 {
            bar.set_message("looking again with other recordings");
            let first = scene.clone();
            split(&mut scene, &missed);
            let second = search(&scene, rig, &effects, &ranges, &bar, &gaps)?;
            // The look that closes more of the whole session stands.
            let open = |scene: &Scene, found: &Option<Found>| -> Result<f64, Error> {
                let Some(f) = found else { return Ok(f64::INFINITY) };
                let after = scene.raw(&f.model.fit.rig, everything)?;
                Ok(Energies::new(scene, &raw_before, &after, &everything).excess().1)
            };
            if open(&scene, &second)? < open(&first, &found)? {
                found = second;
            } else {
                scene = first;
            }
        }
    }

    let mut found = match found {
        Some(found) => abstain(rig, &scene, found, &raw_before, &gaps, &mut notes)?,
        None => None,
    };
    if found.is_none() && rig.axes.len() > 1 && gaps.iter().any(|g| g.counts) {
        bar.set_message("looking at slow motion alone");
        found = slow::cross_axis(&scene, rig, &effects, &ranges, &bar)?;
    }

    bar.set_message("writing the answer");
    let outcome =
        answer(rig, &scene, &nominal, &raw_before, &cuts, &electrical, &gaps, found, &mut notes)?;
    bar.finish_and_clear();
    Ok(outcome)
}

/// A search that found something.
pub(crate) struct Found {
    /// Fitted on the fit recordings.
    pub model: Model,
    /// Fitted on everything.
    pub whole: Model,
    /// Effects that cannot be told from each cause.
    pub rivals: Vec<Vec<String>>,
    pub confidence: Vec<f64>,
    pub next: Option<NextExperiment>,
    pub tried: Vec<(String, f64)>,
    /// Held-out recordings with a gap that the model does not close although it should have.
    pub missed: Vec<usize>,
    /// The causes account for slow motion only.
    pub band: Option<Band>,
}

fn search(
    scene: &Scene,
    rig: &Rig,
    effects: &[EffectRef],
    ranges: &Ranges,
    bar: &ProgressBar,
    gaps: &[AxisGapSize],
) -> Result<Option<Found>, Error> {
    let fitted = |c: &Channel| !c.held_out;
    let tick = || bar.inc(1);
    let mut search = Search::new(scene, rig, effects, ranges, &fitted, &tick)?;
    bar.set_message("fitting");
    let whole = search.run()?;
    let Some(model) = by_axis(&mut search, whole, effects, gaps)? else { return Ok(None) };
    let model = stands_elsewhere(&search, model)?;
    let gap = search.gap.max(1.0);
    let tried: Vec<(String, f64)> = search
        .tried
        .iter()
        .take(12)
        .map(|m| (m.key().join(" + "), 1.0 - (m.fit.cost - search.noise) / gap))
        .collect();
    let mut rivals = Vec::new();
    let mut confidence = Vec::new();
    let mut next = None;
    for term in 0..model.terms.len() {
        let standing = ambiguity::standing(&search, &model, term);
        if let (None, Some((name, rival))) = (&next, standing.rivals.first()) {
            next = ambiguity::next_experiment(
                scene,
                (model.terms[term].name(), &model),
                (name, rival),
            );
        }
        rivals.push(standing.rivals.iter().map(|(n, _)| n.to_string()).collect());
        confidence.push(standing.confidence);
    }
    bar.set_message("checking on the recordings held out");
    let missed = missed(scene, rig, &model, gaps)?;
    let whole = refit(scene, rig, &model, ranges)?;
    Ok(Some(Found { model, whole, rivals, confidence, next, tried, missed, band: None }))
}

/// Take out effects that make the held-out recordings worse: they only mended the form of another one where it was fitted.
fn stands_elsewhere(search: &Search, model: Model) -> Result<Model, Error> {
    /// Rise of the held-out cost that is no accident, in noise variances.
    const WORSE: f64 = 30.0;
    let held = |c: &Channel| c.held_out;
    let mut model = model;
    while model.terms.len() > 1 {
        let mut rigs = vec![model.fit.rig.clone()];
        for t in 0..model.terms.len() {
            rigs.push(model.without(search.nominal, t, |_| true)?);
        }
        let jobs: Vec<(&Rig, Wanted)> = rigs.iter().map(|r| (r, Wanted::ALL)).collect();
        let costs: Vec<f64> = search.scene.residuals(&jobs, held)?.iter().map(cost).collect();
        let worst = (0..model.terms.len()).min_by(|&a, &b| costs[a + 1].total_cmp(&costs[b + 1]));
        let Some(t) = worst.filter(|&t| costs[t + 1] < costs[0] - WORSE) else { break };
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(&model)
            .into_iter()
            .enumerate()
            .filter(|(k, _)| *k != t)
            .map(|(_, term)| term)
            .unzip();
        model = search.fit_model(terms, start.concat(), search.effort())?;
    }
    Ok(model)
}

/// The rig file gets the parameters of a fit to everything, started from the honest one.
pub(crate) fn refit(
    scene: &Scene,
    rig: &Rig,
    model: &Model,
    ranges: &Ranges,
) -> Result<Model, Error> {
    let all = |_: &Channel| true;
    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(model).into_iter().unzip();
    let knobs = terms
        .iter()
        .flat_map(|t| t.places.iter().flat_map(|&p| knobs_at(t.effect, p, ranges)))
        .collect();
    let effort = Effort { iterations: 4, ..Effort::default() };
    let fit = crate::fit::fit(scene, rig, knobs, start.concat(), effort, None, &all)?;
    Ok(Model { terms, fit, ranges: ranges.clone() })
}

/// Axes that `model` leaves open are searched again, each by itself: what is loud and unknown on one axis must not hide what is
/// quiet and known on another. Causes found that way join those of the other axes.
fn by_axis(
    search: &mut Search,
    model: Option<Model>,
    effects: &[EffectRef],
    gaps: &[AxisGapSize],
) -> Result<Option<Model>, Error> {
    let axes = search.nominal.axes.len();
    let (scene, rig) = (search.scene, search.nominal);
    let everything = |_: &Channel| true;
    let raw = scene.raw(rig, everything)?;
    let closed = |rig: &Rig| -> Result<Vec<Option<f64>>, Error> {
        let after = scene.raw(rig, everything)?;
        Ok(accept::closed_by_axis(&Energies::new(scene, &raw, &after, &everything), axes))
    };
    let by_axis = closed(model.as_ref().map_or(rig, |m| &m.fit.rig))?;
    let open: Vec<usize> = (0..axes)
        .filter(|&a| gaps[a].counts && by_axis[a].is_some_and(|c| !accept::names(c)))
        .collect();
    if open.is_empty() || gaps.iter().filter(|g| g.counts).count() < 2 {
        return Ok(model);
    }
    // What the whole search found keeps the axes that it closes.
    let mut terms: Vec<(Term, Vec<f64>)> = Vec::new();
    if let Some(model) = &model {
        for (t, term) in model.terms.iter().enumerate() {
            let kept: Vec<usize> = (0..term.places.len())
                .filter(|&p| {
                    let own = Term { effect: term.effect, places: vec![term.places[p]] };
                    own.axes().iter().all(|a| !open.contains(a))
                })
                .collect();
            if !kept.is_empty() {
                let places = kept.iter().map(|&p| term.places[p]).collect();
                let values = kept.iter().flat_map(|&p| model.values(t, p).to_vec()).collect();
                terms.push((Term { effect: term.effect, places }, values));
            }
        }
    }
    let before = terms.len();
    for axis in open {
        let include = move |c: &Channel| !c.held_out && c.axis == axis;
        let tick = || {};
        let ranges = search.ranges.clone();
        let mut alone = Search::new(scene, rig, effects, &ranges, &include, &tick)?;
        let Some(own) = alone.run()? else { continue };
        if !closed(&own.fit.rig)?[axis].is_some_and(accept::names) {
            continue;
        }
        for (term, values) in start_terms(&own) {
            match terms.iter_mut().find(|(known, _)| known.name() == term.name()) {
                Some((known, all)) => {
                    known.places.extend(term.places);
                    all.extend(values);
                }
                None => terms.push((term, values)),
            }
        }
    }
    if terms.len() == before && model.is_some() {
        return Ok(model);
    }
    terms.truncate(crate::select::MOST_EFFECTS);
    if terms.is_empty() {
        return Ok(model);
    }
    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
    let effort = search.effort();
    Ok(Some(search.fit_model(terms, start.concat(), effort)?))
}

/// Held-out recordings whose gap the model leaves open: worth a look with these recordings among the fitted ones.
fn missed(
    scene: &Scene,
    rig: &Rig,
    model: &Model,
    _gaps: &[AxisGapSize],
) -> Result<Vec<usize>, Error> {
    let held = |c: &Channel| c.held_out;
    let mut stacks = scene.residuals(&[(rig, Wanted::ALL), (&model.fit.rig, Wanted::ALL)], held)?;
    let after = stacks.remove(1);
    let before = stacks.remove(0);
    let mut missed = Vec::new();
    for track in 0..scene.tracks.len() {
        let pick = |stack: &Stack| -> Stack {
            stack
                .iter()
                .zip(&scene.channels)
                .map(|(row, c)| if c.track == track { row.clone() } else { None })
                .collect()
        };
        let (b, a) = (pick(&before), pick(&after));
        let noise = noise_cost(scene, &b);
        let (gap, left) = (cost(&b) - noise, cost(&a) - noise);
        if gap > 200.0 && left > 0.5 * gap {
            missed.push(track);
        }
    }
    Ok(missed)
}

fn held_out_with_gap(scene: &Scene, nominal: &Stack) -> Vec<usize> {
    let mut tracks: Vec<usize> = scene
        .channels
        .iter()
        .enumerate()
        .filter(|(c, channel)| {
            channel.held_out
                && nominal[*c]
                    .as_ref()
                    .is_some_and(|row| channel.excess(row) > 0.1 * row.len() as f64)
        })
        .map(|(_, channel)| channel.track)
        .collect();
    tracks.sort_unstable();
    tracks.dedup();
    tracks
}

#[allow(clippy::too_many_arguments)] // every one is a step's result that the answer states; a struct would only rename them
fn answer(
    rig: &Rig,
    scene: &Scene,
    nominal_white: &Stack,
    raw_before: &Stack,
    cuts: &locate::Cuts,
    electrical: &[Option<bool>],
    gaps: &[AxisGapSize],
    found: Option<Found>,
    notes: &mut Vec<String>,
) -> Result<Outcome, Error> {
    let axes = rig.axes.len();
    let everything = |_: &Channel| true;
    let held = |c: &Channel| c.held_out;
    let any_gap = gaps.iter().any(|g| g.counts);
    let mut final_rig = rig.clone();
    let mut raw_after = raw_before.clone();
    let mut honest_after = raw_before.clone();
    if let Some(f) = &found {
        raw_after = scene.raw(&f.whole.fit.rig, everything)?;
        honest_after = scene.raw(&f.model.fit.rig, everything)?;
        final_rig = f.whole.fit.rig.clone();
    }
    let energies = Energies::new(scene, raw_before, &honest_after, &held);
    let gap = energies.gap(axes);
    let mut causes = Vec::new();
    let mut claimed = Vec::new();
    let mut staircase = Vec::new();
    if let Some(f) = &found {
        let (mut list, claims, stairs) = causes_of(rig, scene, f, raw_before, &honest_after)?;
        let mut order: Vec<usize> = (0..list.len()).collect();
        order.sort_by(|&a, &b| list[b].closes.total_cmp(&list[a].closes));
        let total: f64 = list.iter().map(|c| c.closes).sum();
        if total > gap.closed.max(0.0) && total > 0.0 {
            for cause in &mut list {
                cause.closes *= gap.closed.max(0.0) / total;
            }
        }
        causes = order.iter().map(|&k| list[k].clone()).collect();
        claimed = order.iter().map(|&k| claims[k].clone()).collect();
        staircase = stairs;
    }
    let white_after = scene.residuals(&[(&final_rig, Wanted::ALL)], everything)?.remove(0);
    let left = accept::gaps(scene, &white_after);
    let band = found.as_ref().and_then(|f| f.band.clone());
    let verdict = match (any_gap, &band) {
        (false, _) => Verdict::NoGap,
        (true, Some(_)) => Verdict::PartlyExplained,
        (true, None) => accept::verdict(gap.closed, causes.len(), &left),
    };
    let location = if verdict == Verdict::NoGap {
        Vec::new()
    } else {
        locate::locations(scene, cuts, &raw_after, electrical, &causes, &claimed)
    };
    let recordings = (0..scene.tracks.len())
        .map(|track| {
            let every = Energies::new(scene, raw_before, &honest_after, &everything);
            let (before_nm, after_nm) = every.of_track(track);
            let role = if scene.channels.iter().any(|c| c.track == track && !c.held_out) {
                Role::Fit
            } else {
                Role::HeldOut
            };
            RecordingGap { file: scene.tracks[track].file.clone(), role, before_nm, after_nm }
        })
        .collect();
    let next_experiment = if causes.iter().any(|c| !c.indistinguishable_from.is_empty()) {
        found.as_ref().and_then(|f| f.next.clone())
    } else {
        None
    };
    let diagnosis = Diagnosis {
        verdict,
        gap,
        location,
        causes,
        next_experiment,
        recordings,
        band,
        notes: std::mem::take(notes),
    };
    let cuts_after = locate::cuts(scene, &raw_after, &white_after);
    let tried = found.as_ref().map(|f| f.tried.clone()).unwrap_or_default();
    let _ = nominal_white;
    let report = picture::report(&Findings {
        scene,
        nominal: rig,
        rig: &final_rig,
        before: raw_before,
        after: &raw_after,
        cuts,
        cuts_after: &cuts_after,
        staircase: &staircase,
        diagnosis: &diagnosis,
        tried: &tried,
    });
    Ok(Outcome { diagnosis, rig: final_rig, report })
}

/// Take back causes on axes that stay mostly open: they are proxies of something that is not in the catalogue.
fn abstain(
    rig: &Rig,
    scene: &Scene,
    mut found: Found,
    raw_before: &Stack,
    gaps: &[AxisGapSize],
    notes: &mut Vec<String>,
) -> Result<Option<Found>, Error> {
    let axes = rig.axes.len();
    let everything = |_: &Channel| true;
    let after = scene.raw(&found.model.fit.rig, everything)?;
    let whole = Energies::new(scene, raw_before, &after, &everything);
    let overall = whole.gap(axes).closed;
    let trusted: Vec<bool> = accept::closed_by_axis(&whole, axes)
        .iter()
        .zip(gaps)
        .map(|(closed, gap)| !gap.counts || closed.is_none_or(accept::names))
        .collect();
    let abstained: Vec<String> =
        (0..axes).filter(|&a| !trusted[a]).map(|a| (a + 1).to_string()).collect();
    if !abstained.is_empty() {
        notes.push(format!(
            "On axis {} the best effects of the catalogue close too little to be named: something else is at work there.",
            abstained.join(" and ")
        ));
    }
    let loud: Vec<bool> = gaps.iter().map(|g| g.counts).collect();
    restrict(rig, &mut found, &trusted, &loud)?;
    Ok((!found.model.terms.is_empty() && overall >= 0.0).then_some(found))
}

/// Keep only the places that act on trusted axes, of effects that reach at least one axis with a gap.
fn restrict(rig: &Rig, found: &mut Found, trusted: &[bool], loud: &[bool]) -> Result<(), Error> {
    let own = |term: &Term, place| Term { effect: term.effect, places: vec![place] }.axes();
    let stands = |term: &Term| {
        term.places.iter().any(|&p| {
            let axes = own(term, p);
            axes.iter().all(|&a| trusted[a]) && axes.iter().any(|&a| loud[a])
        })
    };
    if trusted.iter().all(|&t| t) && found.model.terms.iter().all(stands) {
        return Ok(());
    }
    let mut keep_terms = Vec::new();
    for model in [&mut found.model, &mut found.whole] {
        let mut terms = Vec::new();
        let mut values = Vec::new();
        keep_terms.clear();
        for (t, term) in model.terms.iter().enumerate() {
            let mut places = Vec::new();
            for (p, &place) in term.places.iter().enumerate() {
                if stands(term) && own(term, place).iter().all(|&a| trusted[a]) {
                    places.push(place);
                    values.extend_from_slice(model.values(t, p));
                }
            }
            if !places.is_empty() {
                keep_terms.push(t);
                terms.push(Term { effect: term.effect, places });
            }
        }
        let ranges = &model.ranges;
        let knobs: Vec<_> = terms
            .iter()
            .flat_map(|t| t.places.iter().flat_map(|&p| knobs_at(t.effect, p, ranges)))
            .collect();
        model.fit.rig = crate::fit::rig_with(rig, &knobs, &values)?;
        model.fit.at_bound = vec![false; knobs.len()];
        model.fit.normal = nalgebra::DMatrix::identity(knobs.len(), knobs.len());
        model.fit.knobs = knobs;
        model.fit.values = values;
        model.terms = terms;
    }
    found.rivals = keep_terms.iter().map(|&t| found.rivals[t].clone()).collect();
    found.confidence = keep_terms.iter().map(|&t| found.confidence[t]).collect();
    Ok(())
}

type CauseList = (Vec<Cause>, Vec<Vec<f64>>, Vec<(String, f64)>);

/// Causes with the energy that each closes, by axis, and the gap after each is added in turn.
fn causes_of(
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
    let before = Energies::new(scene, raw_before, raw_after, &everything);
    let full = before.excess();
    let mut causes = Vec::new();
    let mut claimed = Vec::new();
    let inflate = 4.0 + whole.fit.cost / noise_cost(scene, &whole.fit.stack).max(1.0) * 8.0;
    let deviations = whole.fit.deviations(inflate);
    let mut at = 0;
    for (t, term) in model.terms.iter().enumerate() {
        let reduced = model.without(rig, t, |_| true)?;
        let raw = scene.raw(&reduced, everything)?;
        let energies = Energies::new(scene, &raw, raw_after, &everything);
        let (without, with) = energies.excess();
        let per_axis = energies.gap(axes).per_axis;
        claimed.push(
            (0..axes)
                .map(|axis| {
                    per_axis.iter().find(|g| g.axis == axis + 1).map_or(0.0, |g| {
                        let samples = samples_of_axis(scene, axis);
                        (g.before_nm.powi(2) - g.after_nm.powi(2)) * samples
                    })
                })
                .collect(),
        );
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
            if agree {
                let n = term.places.len() as f64;
                let value = (0..term.places.len()).map(|q| whole.values(t, q)[k]).sum::<f64>() / n;
                let sd =
                    (0..term.places.len()).map(|q| deviations[at + q * width + k]).sum::<f64>() / n;
                parameters.insert(p.name.to_string(), parameter(value, sd, p.unit));
            } else {
                for (q, place) in term.places.iter().enumerate() {
                    let name = match *place {
                        host_sim::effects::Place::Axis(a) => format!("{}_{}", p.name, a + 1),
                        host_sim::effects::Place::Pair { on, from } => {
                            format!("{}_{}_{}", p.name, on + 1, from + 1)
                        }
                    };
                    parameters.insert(
                        name,
                        parameter(whole.values(t, q)[k], deviations[at + q * width + k], p.unit),
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
            closes: if full.0 > 0.0 { ((without - with) / full.0).clamp(0.0, 1.0) } else { 0.0 },
            parameters,
            confidence: found.confidence[t],
            indistinguishable_from: found.rivals[t].clone(),
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
        let raw = scene.raw(&partial, held)?;
        let nm = Energies::new(scene, raw_before, &raw, &held).gap(axes).after_nm;
        let words: Vec<String> = model.terms[t].places.iter().map(|&p| place_words(p)).collect();
        let place =
            if words.len() > 3 { format!("{} places", words.len()) } else { words.join(", ") };
        stairs.push((format!("{} ({place})", model.terms[t].name()), nm));
    }
    Ok((causes, claimed, stairs))
}

fn samples_of_axis(scene: &Scene, axis: usize) -> f64 {
    scene
        .channels
        .iter()
        .filter(|c| c.axis == axis && c.kind == crate::floor::Kind::Position)
        .map(|c| c.range.len() as f64)
        .sum()
}

fn parameter(value: f64, sd: f64, unit: &str) -> Parameter {
    let sd = if sd.is_finite() { sd } else { value.abs() };
    Parameter { value, ci95: [value - 1.96 * sd, value + 1.96 * sd], unit: unit.into() }
}

/// What a reader of the report should know about the recordings themselves.
fn integrity_notes(scene: &Scene, rig: &Rig) -> Vec<String> {
    let mut notes = Vec::new();
    for track in scene.tracks.iter() {
        if track.lost > 0 {
            notes.push(format!(
                "{}: {} ticks lost; the drive was held over them and nothing scored there.",
                track.file, track.lost
            ));
        }
        if track.closed_loop {
            notes.push(format!(
                "{}: recorded with a setpoint; if the loop was closed, its noise is in the drive.",
                track.file
            ));
        }
    }
    for (axis, noise) in scene.position_noise.iter().enumerate() {
        let stated = rig.axes[axis].sensor.noise_rms_m * 1.0e6;
        match noise {
            None => notes.push(format!("Axis {} was not measured.", axis + 1)),
            Some(n) if stated > 0.0 && (n.sigma > 2.0 * stated || n.sigma < 0.5 * stated) => notes
                .push(format!(
                    "Axis {}: the gauge noise measured is {:.2} nm, the rig file states {:.2} nm.",
                    axis + 1,
                    n.sigma * 1.0e3,
                    stated * 1.0e3
                )),
            Some(_) => {}
        }
    }
    if scene.monitor_noise.iter().all(Option::is_none) {
        notes.push("No amplifier monitor was recorded: drive and amplifier can be told from the stack only by their signature.".into());
    }
    notes
}
