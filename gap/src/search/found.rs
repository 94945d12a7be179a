//! What a search found: chosen, checked on other recordings, searched again where it left axes open, and taken back where it does
//! not account for enough.

use std::collections::BTreeMap;

use host_sim::effects::Place;
use host_sim::rig::Rig;
use indicatif::ProgressBar;

use crate::Error;
use crate::diagnosis::{AxisGap, Band};
use crate::fitting::fit::{Effort, cost};
use crate::fitting::guess::Ranges;
use crate::fitting::knobs::{EffectRef, axes_seen};
use crate::fitting::model::{Model, Term, join_terms, knobs_from, knobs_of, start_terms};
use crate::judge::accept::{self, AxisGapSize};
use crate::judge::ambiguity::{self, Standings};
use crate::judge::monitors::{self, Missing};
use crate::search::elsewhere::{carries_over, stands_elsewhere};
use crate::search::hidden::Hidden;
use crate::search::last_axis::is_as_elsewhere;
use crate::search::select::{Breadth, Search};
use crate::search::wander::wanders;
use crate::session::energy::{Energies, HAS_GAP};
use crate::session::scene::{Channel, Scene, Stack, Wanted};

/// A search that found something.
#[derive(Clone)]
pub(crate) struct Found {
    /// Fitted on the fit recordings.
    pub model: Model,
    /// Fitted on everything.
    pub whole: Model,
    /// How each cause stands against others.
    pub standings: Standings,
    /// Names of what else was tried, and the share of the gap that it explains.
    pub tried: Vec<(String, f64)>,
    /// Held-out recordings with a gap that the model does not close although it should have.
    pub missed: Vec<usize>,
    /// The causes account for slow motion only.
    pub band: Option<Band>,
    /// Effects that others hide on an axis (from 0), and that are named there because all other axes have them alike.
    pub hidden: Hidden,
}

impl Found {
    /// Effects of the answer that go without a period.
    pub(crate) fn wandering(&self) -> Vec<&'static str> {
        wandering(&self.model)
    }
}

/// Effects of a model that go without a period.
pub(crate) fn wandering(model: &Model) -> Vec<&'static str> {
    let terms = start_terms(model);
    let names = terms.iter().filter(|(term, values)| wanders(term, values));
    names.map(|(term, _)| term.name()).collect()
}

/// Search the fitted recordings, beside what `before` found in others, and check the model on those that were not fitted.
pub(crate) fn search(
    (scene, rig): (&Scene, &Rig),
    effects: &[EffectRef],
    ranges: &Ranges,
    bar: &ProgressBar,
    gaps: &[AxisGapSize],
    before: Option<&Found>,
) -> Result<Option<Found>, Error> {
    let fitted = |c: &Channel| !c.held_out;
    let tick = || bar.inc(1);
    let mut search = Search::new(scene, rig, effects, ranges, &fitted, &tick)?;
    search.known = before.map_or_else(Vec::new, |before| start_terms(&before.model));
    bar.set_message("fitting");
    let whole = search.run()?;
    let Some(model) = by_axis(&mut search, whole, effects, gaps)? else { return Ok(None) };
    let model = carries_over(&mut search, model)?;
    let model = without_specks(&search, stands_elsewhere(&search, model)?)?;
    let (model, hidden) = search.also_on_last_axis(model)?;
    let gap = search.gap.max(1.0);
    // The same effects on other axes, or from another start, are one entry: the best comes first.
    let mut tried: Vec<(String, f64)> = Vec::new();
    for m in &search.tried {
        let name = m.key().join(" + ");
        if tried.len() < 12 && tried.iter().all(|(known, _)| *known != name) {
            tried.push((name, 1.0 - (m.fit.cost - search.noise) / gap));
        }
    }
    let standings = ambiguity::standings(&search, &model);
    bar.set_message("checking on the recordings held out");
    let missed = missed(scene, rig, &model)?;
    let whole = refit(scene, rig, &model)?;
    Ok(Some(Found { model, whole, standings, tried, missed, band: None, hidden }))
}

/// Take out effects that by themselves move no position by what would count as a gap in any recording: what they save is a matter of another
/// one's form. A crosstalk that comes late is no slow amplifier.
fn without_specks(search: &Search, model: Model) -> Result<Model, Error> {
    if model.terms.len() < 2 {
        return Ok(model);
    }
    let everything = |_: &Channel| true;
    let from = search.scene.raw(search.nominal, everything)?;
    let mut kept = Vec::new();
    for (t, term) in start_terms(&model).into_iter().enumerate() {
        let alone = model.with(search.nominal, |other| other == t)?;
        let to = search.scene.raw(&alone, everything)?;
        if accept::moves(search.scene, &from, &to) {
            kept.push(term);
        }
    }
    if kept.is_empty() || kept.len() == model.terms.len() {
        return Ok(model);
    }
    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = kept.into_iter().unzip();
    search.fit_model(terms, start.concat(), search.effort())
}

/// The rig file gets the parameters of a fit to everything, started from the honest one.
pub(crate) fn refit(scene: &Scene, rig: &Rig, model: &Model) -> Result<Model, Error> {
    let ranges = &model.ranges;
    let all = |_: &Channel| true;
    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(model).into_iter().unzip();
    let knobs = knobs_of(&terms, ranges);
    let effort = Effort { iterations: 4, ..Effort::default() };
    let fit = crate::fitting::fit::fit(scene, rig, knobs, start.concat(), effort, None, &all)?;
    Ok(Model { terms, fit, ranges: ranges.clone() })
}

/// Share of the whole gap with which an axis decides every search.
const DECIDES: f64 = 0.85;

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
    // An axis that holds nearly all of the gap was searched by itself already.
    let alone = |axis: usize| {
        let own = scene.cost_on(&search.base, 1 << axis) - scene.noise_on(&search.base, 1 << axis);
        own > DECIDES * search.gap
    };
    let open: Vec<usize> = (0..axes)
        .filter(|&a| gaps[a].counts && by_axis[a].is_some_and(|c| !accept::names(c)))
        .filter(|&a| !alone(a) && !search.knows_nothing_of(a))
        .collect();
    let is_alone = gaps.iter().filter(|g| g.counts).count() < 2;
    // What goes without a period leaves recordings that are held out open, whatever the axis.
    let goes_on = model.as_ref().is_some_and(|model| !wandering(model).is_empty());
    if open.is_empty() || is_alone || goes_on || search.is_spent() {
        return Ok(model);
    }
    // What the whole search found keeps the axes that it closes.
    let closed_here = |term: &Term| term.axes().iter().all(|a| !open.contains(a));
    let mut terms = model.as_ref().map_or_else(Vec::new, |m| m.part(|_, alone| closed_here(alone)));
    let before = terms.len();
    for &axis in &open {
        let include = move |c: &Channel| !c.held_out && c.axis == axis;
        let tick = || {};
        let ranges = search.ranges.clone();
        let mut alone = Search::new(scene, rig, effects, &ranges, &include, &tick)?;
        alone.breadth = Breadth::BRIEF;
        let here = |_: &Term, alone: &Term| alone.places[0] == Place::Axis(axis);
        alone.known = model.as_ref().map_or_else(Vec::new, |m| m.part(here));
        let Some(own) = alone.run()? else { continue };
        if !closed(&own.fit.rig)?[axis].is_some_and(accept::names) {
            continue;
        }
        search.ranges.any_loop |= own.ranges.any_loop;
        join_terms(&mut terms, start_terms(&own));
    }
    if terms.len() == before && model.is_some() {
        return Ok(model);
    }
    terms.truncate(crate::search::select::MOST_EFFECTS);
    if terms.is_empty() {
        return Ok(model);
    }
    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
    let effort = search.effort();
    Ok(Some(search.fit_model(terms, start.concat(), effort)?))
}

/// A gap in a held-out recording that is worth another look, in noise variances.
const MISSED_GAP: f64 = 200.0;
/// ... and as a share of the gap of all recordings held out.
const MISSED_SHARE: f64 = 0.01;
/// ... and of its energy with the weights undone: what is next to nothing in nanometres is not worth a second search.
const MISSED_ENERGY: f64 = 0.002;

/// Share of an axis' gap in what is held out below which the recordings that are fitted count as showing none of it.
const SEEN_SHARE: f64 = 0.02;

/// Held-out recordings whose gap the model leaves open, all of it or that of an axis on which the others show none: worth a look with
/// these recordings among the fitted ones.
fn missed(scene: &Scene, rig: &Rig, model: &Model) -> Result<Vec<usize>, Error> {
    let mut stacks =
        scene.residuals(&[(rig, Wanted::ALL), (&model.fit.rig, Wanted::ALL)], |_| true)?;
    let (after, before) = (stacks.remove(1), stacks.remove(0));
    let pick = |stack: &Stack, include: &dyn Fn(&Channel) -> bool| -> Stack {
        let rows = stack.iter().zip(&scene.channels);
        rows.map(|(row, c)| row.as_ref().filter(|_| include(c)).cloned()).collect()
    };
    let of_all = pick(&before, &|c| c.held_out);
    let whole = cost(&of_all) - scene.noise_on(&of_all, u32::MAX);
    let energy = scene.excess(&of_all);
    let is_unseen = |&axis: &usize| {
        let here = |held_out: bool| {
            scene.excess(&pick(&before, &|c| c.axis == axis && c.held_out == held_out))
        };
        here(false) < SEEN_SHARE * here(true)
    };
    let unseen = (0..rig.axes.len()).filter(is_unseen).map(|axis| 1 << axis);
    let parts: Vec<u32> = std::iter::once(u32::MAX).chain(unseen).collect();
    let is_missed = |&track: &usize| {
        parts.iter().any(|axes| {
            let here = |c: &Channel| c.held_out && c.track == track && axes >> c.axis & 1 == 1;
            let (b, a) = (pick(&before, &here), pick(&after, &here));
            let noise = scene.noise_on(&b, u32::MAX);
            let (gap, left) = (cost(&b) - noise, cost(&a) - noise);
            gap > MISSED_GAP.max(MISSED_SHARE * whole)
                && left > 0.5 * gap
                && scene.excess(&a) > MISSED_ENERGY * energy
        })
    };
    Ok((0..scene.tracks.len()).filter(is_missed).collect())
}

/// Energy beyond noise of every channel, noise variances: of residuals whitened with the weights that the channels have now.
pub(crate) fn excess(scene: &Scene, white: &Stack) -> Vec<f64> {
    let rows = scene.channels.iter().zip(white);
    rows.map(|(channel, row)| row.as_ref().map_or(0.0, |row| channel.excess(row))).collect()
}

/// Recordings with a gap of their own in the channels asked for, none of them next to nothing beside another, the one with the
/// smallest gap first.
pub(crate) fn with_gap(
    scene: &Scene,
    excess: &[f64],
    include: impl Fn(&Channel) -> bool,
) -> Vec<usize> {
    let mut sizes: BTreeMap<usize, f64> = BTreeMap::new();
    for (channel, &excess) in scene.channels.iter().zip(excess) {
        if include(channel) && excess > HAS_GAP * channel.samples() {
            *sizes.entry(channel.track).or_default() += excess;
        }
    }
    let largest = sizes.values().copied().fold(0.0, f64::max);
    let mut tracks: Vec<(usize, f64)> =
        sizes.into_iter().filter(|(_, size)| *size > 0.02 * largest).collect();
    tracks.sort_by(|a, b| a.1.total_cmp(&b.1));
    tracks.into_iter().map(|(track, _)| track).collect()
}

/// Share of the whole gap that causes have to close on the axes where they are believed to be named at all: a nanometre on one axis is no answer
/// to sixty on another, and as likely the form of what is at work there.
const LEAST_OVERALL: f64 = 0.1;

/// Take back causes on axes that stay mostly open: they are proxies of something that is not in the catalogue.
pub(crate) fn abstain(
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
    let has_laws = |axis: usize| {
        let terms = start_terms(&found.model);
        let has_laws = |(term, values): &(Term, Vec<f64>)| {
            accept::has_many_laws(term.name()) || wanders(term, values)
        };
        terms.iter().any(|known| has_laws(known) && reaches(rig, &known.0, axis))
    };
    let mut trusted = accept::trusted(&whole, gaps, has_laws);
    // What goes as chance has it is checked on parts of recordings, where it was fitted.
    let is_told = found.wandering().is_empty();
    let held_out = Energies::new(scene, raw_before, &after, &|c: &Channel| c.held_out);
    let held_out = held_out.gap(axes).per_axis;
    if is_told {
        accept::refuted(&held_out).for_each(|axis| trusted[axis] = false);
    }
    let abstained: Vec<String> =
        (0..axes).filter(|&a| !trusted[a]).map(|a| (a + 1).to_string()).collect();
    if !abstained.is_empty() {
        notes.push(format!(
            "On axis {} the best effects of the catalogue close too little to be named: something else is at work there.",
            abstained.join(" and ")
        ));
    }
    let per_axis = whole.gap(axes).per_axis;
    let contradicted = monitors::contradicted(rig, scene, [raw_before, &after], &per_axis);
    for axis in (0..axes).filter(|&axis| gaps[axis].counts) {
        let Some(Missing { before_v, after_v }) = contradicted[axis].filter(|_| trusted[axis])
        else {
            continue;
        };
        trusted[axis] = false;
        notes.push(format!(
            "Axis {}: the amplifier's monitor reads other voltages than the rig file and the best effects of the catalogue give \
             ({after_v:.3} V rms of {before_v:.3} V left), enough to move the stage by a good part of the gap. Something before the stack is \
             missing, unless the monitor itself is wrong: no cause is named on this axis.",
            axis + 1
        ));
    }
    let loud: Vec<bool> = gaps.iter().map(|g| g.counts).collect();
    let proxies = proxies(rig, &found.model, &trusted, &per_axis);
    if !proxies.is_empty() {
        keep(rig, &mut found, |term, _| !proxies.contains(&term.name()))?;
        notes.push(format!(
            "{} would close the gap on some axes, but not on those where more of it lies, and is not named on any.",
            proxies.join(" and ")
        ));
    }
    restrict(rig, &mut found, &trusted, &loud)?;
    let least = |gaps: &[AxisGap]| accept::closed_on(gaps, &trusted) >= LEAST_OVERALL;
    let closes = least(&per_axis) && (!is_told || !accept::is_loud(&held_out) || least(&held_out));
    Ok((!found.model.terms.is_empty() && closes).then_some(found))
}

/// Whether a term changes what is measured on an axis.
fn reaches(rig: &Rig, term: &Term, axis: usize) -> bool {
    let seen = |&place: &Place| axes_seen(rig, term.effect, place);
    term.places.iter().any(|place| seen(place) >> axis & 1 == 1)
}

/// Effects on axes that are not trusted and hold more of what the model closes than those that are: what passes for something else here is not
/// believed there. On an axis that the model leaves open it passes for nothing.
fn proxies(rig: &Rig, model: &Model, trusted: &[bool], gaps: &[AxisGap]) -> Vec<&'static str> {
    let is_proxy = |term: &&Term| {
        let mut energy = [0.0; 2];
        for gap in gaps.iter().filter(|gap| reaches(rig, term, gap.axis - 1)) {
            let closed = gap.closed.clamp(0.0, 1.0) * gap.energy_nm2().max(0.0);
            energy[usize::from(trusted[gap.axis - 1])] += closed;
        }
        energy[0] > energy[1]
    };
    model.terms.iter().filter(is_proxy).map(Term::name).collect()
}

/// Keep only the places that act on trusted axes and reach an axis with a gap, or have the same as enough such axes: what takes a little noise
/// off a quiet axis is no cause.
fn restrict(rig: &Rig, found: &mut Found, trusted: &[bool], loud: &[bool]) -> Result<(), Error> {
    let model = found.model.clone();
    let keep = |term: &Term, alone: &Term| {
        let axes = alone.axes();
        let nth = model.terms.iter().position(|known| known.name() == term.name());
        let speaks = |axis: usize| trusted[axis] && loud[axis];
        let is_as_elsewhere =
            || nth.is_some_and(|t| is_as_elsewhere(&model, t, alone.places[0], speaks));
        axes.iter().all(|&a| trusted[a]) && (axes.iter().any(|&a| loud[a]) || is_as_elsewhere())
    };
    self::keep(rig, found, keep)
}

/// Keep the places that `keep` lets through, given the term and itself there alone.
pub(crate) fn keep(
    rig: &Rig,
    found: &mut Found,
    keep: impl Fn(&Term, &Term) -> bool,
) -> Result<(), Error> {
    let mut places =
        found.model.terms.iter().flat_map(|t| t.places.iter().map(move |&p| (t, t.at(p))));
    if places.all(|(term, alone)| keep(term, &alone)) {
        return Ok(());
    }
    let kept: Vec<bool> = found
        .model
        .terms
        .iter()
        .map(|term| term.places.iter().any(|&p| keep(term, &term.at(p))))
        .collect();
    for model in [&mut found.model, &mut found.whole] {
        let (terms, values): (Vec<Term>, Vec<Vec<f64>>) = model.part(&keep).into_iter().unzip();
        let values = values.concat();
        let knobs = knobs_from(&terms, &values, &model.ranges);
        model.fit.rig = crate::fitting::fit::rig_with(rig, &knobs, &values)?;
        model.fit.at_bound = vec![false; knobs.len()];
        model.fit.normal = nalgebra::DMatrix::identity(knobs.len(), knobs.len());
        model.fit.knobs = knobs;
        model.fit.values = values;
        model.terms = terms;
    }
    keep_marked(&mut found.standings.causes, &kept);
    Ok(())
}

/// Keep those of `items` that are marked, one mark each.
fn keep_marked<T>(items: &mut Vec<T>, marks: &[bool]) {
    let mut marks = marks.iter();
    items.retain(|_| marks.next().is_some_and(|mark| *mark));
}
