//! Effects that all axes have alike, and one of them hides: what is at work there as well makes room for it.
//!
//! A loop takes in the gain of a gauge on its axis, and a preload the offset. Where all others have that effect alike, and the effects of the last axis,
//! fitted again beside it as it is elsewhere, leave as little as they do without it, it is taken to be there as well: stages are built alike. Of the pairs
//! that the truth generator drew with one effect on the last axis, the other one was on all three axes in 116 and on the first two in 9.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::{Effort, Fit, fit, rig_with};
use crate::fitting::model::{Model, Term, join_terms, knobs_from, start_terms};
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::last_axis::{ALIKE, mean_of_alike, sets_of};
use crate::search::prune::WORTH_OF_PLACE;
use crate::search::select::Search;
use crate::session::scene::Wanted;

/// Share of what is left of the axis that may be left more.
const AS_WELL: f64 = 0.05;
/// Iterations of a fit of its own effects beside the one that they hide, and of both of them.
const ITERATIONS: [usize; 2] = [12, 3];

/// Effects that others hide, and the axis (from 0) of each.
pub(crate) type Hidden = Vec<(&'static str, usize)>;

/// Terms with their values.
type Terms = Vec<(Term, Vec<f64>)>;

impl Search<'_> {
    /// `model` with term `t` on an axis more as it is on all others, if the effects that the axis has, or all of them but one, make room for it and the
    /// recordings agree as well.
    pub(super) fn hidden_on(
        &self,
        model: &Model,
        t: usize,
        axis: usize,
    ) -> Result<Option<Model>, Error> {
        let place = Place::Axis(axis);
        let term = model.terms[t].at(place);
        let own = model.part(|_, here| here.places[0] == place);
        let mean = mean_of_alike(term.effect, &sets_of(model, t), ALIKE);
        // Where gauges read several axes no residual is of one of them.
        let is_tied = self.nominal.output_map.is_some();
        let (Some(mean), false, false) = (mean, own.is_empty(), is_tied) else { return Ok(None) };
        let left = self.left_on(&model.fit.stack, 1 << axis);
        let most = left + NOISE_MARGIN + AS_WELL * left.max(0.0);
        let is_as_well = |fit: &Fit| self.left_on(&fit.stack, 1 << axis) < most;
        // A limit that this axis never comes to would be as well anywhere.
        let shown = knobs_from(std::slice::from_ref(&term), &mean, &model.ranges);
        let shown = rig_with(&model.fit.rig, &shown, &mean)?;
        let wanted = Wanted { axes: 1 << axis, monitors: true };
        let shown = self.scene.residuals_at(&shown, wanted, self.include)?;
        if (self.left_on(&shown, 1 << axis) - left).abs() < WORTH_OF_PLACE {
            return Ok(None);
        }
        // One of two may be there for want of it.
        let mut choices: Vec<Terms> = (0..own.len())
            .filter(|_| own.len() > 1)
            .map(|out| own.iter().enumerate().filter(move |(k, _)| *k != out))
            .map(|kept| kept.map(|(_, known)| known.clone()).collect())
            .collect();
        choices.push(own);
        for choice in choices {
            let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = choice.into_iter().unzip();
            let room = self.make_room((&term, &mean), &terms, start.concat(), model)?;
            let mut here: Terms = Vec::new();
            if is_as_well(&room) {
                let mut values = room.values.as_slice();
                for term in terms {
                    let (now, rest) = values.split_at(term.effect.info().parameters.len());
                    here.push((term, now.to_vec()));
                    values = rest;
                }
                here.push((term.clone(), mean.clone()));
            } else {
                let all = terms.into_iter().chain([term.clone()]).collect();
                let effort = Effort { iterations: ITERATIONS[1], ..self.effort() };
                let both = self.fit_model(all, [room.values, mean.clone()].concat(), effort)?;
                if !is_as_well(&both.fit) {
                    continue;
                }
                here.extend(start_terms(&both));
            }
            if let Some(other) = self.with_axis_of(model, &term, here, place)? {
                return Ok(Some(other));
            }
        }
        Ok(None)
    }

    /// The fit of `terms` beside another one of given values at the same place.
    fn make_room(
        &self,
        (term, values): (&Term, &[f64]),
        terms: &[Term],
        start: Vec<f64>,
        model: &Model,
    ) -> Result<Fit, Error> {
        let there = knobs_from(std::slice::from_ref(term), values, &model.ranges);
        let alike = rig_with(self.nominal, &there, values)?;
        let knobs = knobs_from(terms, &start, &model.ranges);
        let effort = Effort { iterations: ITERATIONS[0], ..self.effort() };
        fit(self.scene, &alike, knobs, start, effort, None, self.include)
    }

    /// `model` with `here` at a place in the place of what it has there, if `term` then is about the same on all of its axes and all recordings, not
    /// only those that are fitted, agree as well.
    fn with_axis_of(
        &self,
        model: &Model,
        term: &Term,
        here: Terms,
        place: Place,
    ) -> Result<Option<Model>, Error> {
        let mut terms = model.part(|_, here| here.places[0] != place);
        join_terms(&mut terms, here);
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
        let effort = Effort { iterations: 0, ..self.effort() };
        let other = self.fit_model(terms, start.concat(), effort)?;
        let nth = other.terms.iter().position(|known| known.name() == term.name());
        let sets = nth.map_or_else(Vec::new, |nth| sets_of(&other, nth));
        let is_alike = mean_of_alike(term.effect, &sets, ALIKE).is_some();
        let most = self.left_everywhere(model)?
            + NOISE_MARGIN
            + AS_WELL * self.left_on(&model.fit.stack, 1 << place.on()).max(0.0);
        Ok((is_alike && self.left_everywhere(&other)? < most).then_some(other))
    }
}
