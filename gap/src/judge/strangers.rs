//! Effects outside the catalogue that pass for some inside it.
//!
//! Causes that close nearly all of a gap are not the right ones if something that the catalogue does not have leaves clearly less. A floor
//! that shakes at one frequency is the hum of a gauge but for the memory that it leaves in the stack: a per cent of its energy, and no
//! accident. Such causes are taken back, and the answer says what it looks like instead.

use std::fmt::Write as _;

use host_sim::effects::{Role, strangers};
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::knobs::{EffectRef, axes_seen};
use crate::fitting::model::{Model, Term, start_terms};
use crate::search::found::{Found, keep};
use crate::search::select::Search;
use crate::search::wander::drifts_freely;
use crate::search::worth::WORTH_ABSOLUTE;
use crate::session::scene::{Channel, Scene, Stack, Wanted, dot};

/// Share of the gap that causes have to leave before a stranger is looked for.
const OPEN: f64 = 1.0e-3;
/// Most that a stranger may leave, as a share of what as many causes leave.
const CLEARLY_LESS: f64 = 0.5;
/// ... in the place of a drift without a period, which has a dozen numbers more.
const AS_DRIFT: f64 = 3.0;

/// Most that a stranger may leave of any recording, as a multiple of what the causes leave of it.
const MORE: f64 = 1.2;

/// A stranger that passed for causes.
pub(crate) struct Masked {
    /// Where it sits.
    pub stage: &'static str,
    /// On which axes.
    pub axes: Vec<usize>,
    /// What a person is told.
    pub words: String,
}

/// Take back the causes in whose place a stranger leaves clearly less; it is given if there is one.
pub(crate) fn unmask(
    scene: &Scene,
    rig: &Rig,
    exclude: &[String],
    found: &mut Found,
) -> Result<Option<Masked>, Error> {
    let wanted = strangers().iter().filter(|s| exclude.iter().all(|name| name != s.info().name));
    let mut best: Option<(Model, Vec<&str>)> = None;
    for &stranger in wanted {
        let Some(model) = instead(scene, rig, stranger, &found.model)? else { continue };
        if best.as_ref().is_none_or(|(known, _)| model.fit.cost < known.fit.cost) {
            let stays = model.key();
            let gone = found.model.key().into_iter().filter(|name| !stays.contains(name)).collect();
            best = Some((model, gone));
        }
    }
    let Some((model, gone)) = best else { return Ok(None) };
    let goes = |(term, values): &(Term, Vec<f64>)| {
        gone.contains(&term.name()) && drifts_freely(term, values)
    };
    let is_loose = start_terms(&found.model).iter().any(goes);
    keep(rig, found, |_, alone| !gone.contains(&alone.name()))?;
    Ok(model.terms.last().map(|term| Masked {
        stage: term.effect.info().stage.name(),
        axes: term.axes(),
        words: sentence(&model, &gone, is_loose),
    }))
}

/// The best model with `stranger` in the place of one cause that it passes for, or of all causes, if that leaves clearly less of the
/// recordings that were fitted; in the place of several it may leave as much.
fn instead(
    scene: &Scene,
    rig: &Rig,
    stranger: EffectRef,
    model: &Model,
) -> Result<Option<Model>, Error> {
    let is_like = |term: &Term| stranger.info().confused_with.contains(&term.name());
    if !model.terms.iter().any(is_like) {
        return Ok(None);
    }
    let fitted = |c: &Channel| !c.held_out;
    let tick = || {};
    let left_on =
        |stack: &Stack, axes: u32| scene.cost_on(stack, axes) - scene.noise_on(stack, axes);
    // Two causes for what one stranger does are taken back although they leave nothing.
    let is_pair = model.terms.iter().filter(|term| is_like(term)).count() > 1;
    let left = left_on(&model.fit.stack, u32::MAX);
    if !is_pair && left < WORTH_ABSOLUTE {
        return Ok(None);
    }
    let mut search = Search::new(scene, rig, &[stranger], &model.ranges, &fitted, &tick)?;
    // What leaves clearly more is not fitted to the end.
    search.remember(model.clone());
    let worth = WORTH_ABSOLUTE.max(OPEN * search.gap);
    if !is_pair && left < worth {
        return Ok(None);
    }
    let all = model.terms.len();
    let mut kept: Vec<Vec<usize>> = vec![Vec::new()];
    if all > 1 {
        let like = (0..all).filter(|&t| is_like(&model.terms[t]));
        kept.extend(like.map(|t| (0..all).filter(|&other| other != t).collect()));
    }
    let mut best: Option<Model> = None;
    for kept in kept {
        // A stranger that accounts for everything by itself needs no cause beside it.
        if best.as_ref().is_some_and(|best| best.terms.len() <= kept.len()) {
            break;
        }
        let terms = start_terms(model).into_iter().enumerate();
        let others: Vec<_> =
            terms.filter(|(t, _)| kept.contains(t)).map(|(_, term)| term).collect();
        let without = model.with(rig, |t| kept.contains(&t))?;
        let stack = scene.residuals_at(&without, Wanted::ALL, fitted)?;
        let gains = search.screen.test(scene, &stack, None);
        let Some((effect, gains)) = search.shortlist(&gains, &[], 1).pop() else { continue };
        let other = search.fit_terms((&others, &stack), effect, &gains)?;
        // What axes have that the causes do not reach is not for the stranger to close.
        let axes = reach(rig, model);
        let [ours, theirs] = [&other, model].map(|model| left_on(&model.fit.stack, axes));
        let goes = |(t, (term, values)): (usize, &(Term, Vec<f64>))| {
            !kept.contains(&t) && drifts_freely(term, values)
        };
        let is_better = if start_terms(model).iter().enumerate().any(goes) {
            ours < AS_DRIFT * theirs.max(0.0) + worth
        } else if other.terms.len() < all {
            // Gauges that warmed up before the first recording are gains, of twice as many numbers.
            other.numbers() <= model.numbers()
                && ours < theirs.max(0.0) + worth
                && nowhere_more(scene, [&other, model], axes, worth)
        } else {
            ours < CLEARLY_LESS * theirs
                && theirs - ours > worth
                && nowhere_more(scene, [&other, model], axes, worth)
        };
        let is_best = best.as_ref().is_none_or(|best| other.fit.cost < best.fit.cost);
        if is_better && is_best {
            best = Some(other);
        }
    }
    Ok(best)
}

/// Whether the first of two models leaves clearly more of axes (a mask) than the second in no recording: what is the right one is so everywhere,
/// while one recording of fast edges may tell of integrators.
fn nowhere_more(scene: &Scene, models: [&Model; 2], axes: u32, worth: f64) -> bool {
    (0..scene.tracks.len()).all(|track| {
        let [ours, theirs] = models.map(|model| {
            let rows = model.fit.stack.iter().zip(&scene.channels);
            rows.filter(|(_, c)| c.track == track && axes >> c.axis & 1 == 1)
                .filter_map(|(row, c)| row.as_ref().map(|row| dot(row, row) - c.noise_cost()))
                .sum::<f64>()
        });
        ours < MORE * theirs.max(0.0) + worth
    })
}

/// Axes that the effects of a model change, as a mask.
fn reach(rig: &Rig, model: &Model) -> u32 {
    let places = model.terms.iter().flat_map(|term| term.places.iter().map(move |&p| (term, p)));
    places.fold(0, |axes, (term, place)| axes | axes_seen(rig, term.effect, place))
}

/// What a person is told of a model whose last term is a stranger that stands where the causes of these names were; `is_loose`: with a drift without
/// a period among them.
fn sentence(model: &Model, gone: &[&str], is_loose: bool) -> String {
    let last = model.terms.len() - 1;
    let term = &model.terms[last];
    let info = term.effect.info();
    let mut places: Vec<usize> = (0..term.places.len()).collect();
    places.sort_by_key(|&p| term.places[p]);
    let mut sizes = String::new();
    for p in places {
        let _ = write!(sizes, "{}: ", term.places[p]);
        let values = info.parameters.iter().zip(model.values(last, p));
        let told = values.filter(|(p, value)| p.role == Role::Shape || **value != p.zero);
        let told: Vec<String> =
            told.map(|(p, value)| format!("{} {value:.4} {}", p.name, p.unit)).collect();
        let _ = write!(sizes, "{}; ", told.join(", "));
    }
    let why = if gone.len() > 1 {
        "does so by itself"
    } else if is_loose {
        "does so with far fewer numbers"
    } else {
        "leaves clearly less"
    };
    format!(
        "{} would account for much of the gap, but {} {why} ({}). {} It is not in the catalogue, so no cause is named for it.",
        gone.join(" and "),
        info.name,
        sizes.trim_end_matches("; "),
        info.physics
    )
}
