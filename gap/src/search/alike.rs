//! Resonances of axes that are built alike.
//!
//! A fit finds a resonance only from near it, and an axis that rings little, or is braked, does not show where it is. A stage carries much
//! the same on all of its axes: the one that was met best tells where the others are. Where gauges read several axes no residual is of one
//! of them, and nothing is done. What effects that do not resonate make worse on an axis is left to pruning: beside more of them it may be
//! mended.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::model::{Model, Term, start_terms};
use crate::search::resonance::Mode;
use crate::search::select::Search;
use crate::search::worth::WORTH_ABSOLUTE;
use crate::session::scene::Stack;

/// Iterations for a resonance once what ran away has been begun again, or has left, or another frequency does better.
const RESTARTED: usize = 3;
/// Share of its axis that a resonance leaves which may be a wrong one, and how many times that of the best axis.
const LAGS: (f64, f64) = (0.02, 3.0);
/// Frequencies that are tried there: so many steps of this share about the one at which the values of the best axis ring. Masses that differ by a
/// fifth ring a tenth apart, and so do stiffnesses.
const ABOUT: (std::ops::RangeInclusive<i32>, f64) = (-16..=16, 0.01);

impl Search<'_> {
    /// `model` without those places of its last effect, if it resonates, where a fit ran away: they leave more of their axis than what was
    /// `left` before. A resonance that was begun far from where it is does, and the axes where it was met would go down with it. Places
    /// that ran away are begun once more from the one that gained most: a stage carries much the same on all axes. Beside the model the
    /// values where a fit of the effect by itself began, for the places that stay.
    pub(crate) fn without_runaways(
        &self,
        model: Model,
        begun: Vec<f64>,
        left: &Stack,
        effort: Effort,
    ) -> Result<(Model, Vec<f64>), Error> {
        let Some((last, _)) = self.resonance(&model) else { return Ok((model, begun)) };
        let lost = |model: &Model, place: &Place| match *place {
            Place::Axis(axis) => {
                let cost = |stack| self.scene.cost_on(stack, 1 << axis);
                cost(&model.fit.stack) - cost(left)
            }
            Place::Pair { .. } => 0.0,
        };
        let ran_away = |model: &Model| -> Vec<bool> {
            last.places.iter().map(|place| lost(model, place) > WORTH_ABSOLUTE).collect()
        };
        let away = ran_away(&model);
        if !away.contains(&true) || !away.contains(&false) {
            return Ok((model, begun));
        }
        let effort = Effort { iterations: RESTARTED, ..effort };
        let nth = model.terms.len() - 1;
        let by_loss = |&a: &usize, &b: &usize| {
            lost(&model, &last.places[a]).total_cmp(&lost(&model, &last.places[b]))
        };
        let lead = (0..away.len()).min_by(by_loss).map_or(&[][..], |lead| model.values(nth, lead));
        let width = lead.len();
        let mut start = model.fit.values.clone();
        let own = &mut start[model.knob_range(nth)];
        for (values, _) in own.chunks_mut(width).zip(&away).filter(|(_, away)| **away) {
            values.copy_from_slice(lead);
        }
        let again = self.fit_model(model.terms.clone(), start, effort)?;
        let again = if again.fit.cost < model.fit.cost { again } else { model.clone() };
        let away = ran_away(&again);
        if !away.contains(&true) {
            return Ok((again, begun));
        }
        if !away.contains(&false) {
            return Ok((model, begun));
        }
        let stays =
            |place: &Place| last.places.iter().zip(&away).any(|(p, away)| p == place && !away);
        let kept = again.part(|term, alone| term.name() != last.name() || stays(&alone.places[0]));
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = kept.into_iter().unzip();
        let began = begun.chunks(width).zip(&away);
        let begun = if nth == 0 {
            began.filter(|(_, away)| !**away).flat_map(|(b, _)| b.to_vec()).collect()
        } else {
            begun
        };
        Ok((self.fit_model(terms, start.concat(), effort)?, begun))
    }

    /// The last effect of a model, if it resonates, with what sets its frequency at each place.
    fn resonance<'m>(&self, model: &'m Model) -> Option<(&'m Term, Vec<Mode>)> {
        let last = model.terms.last().filter(|_| self.nominal.output_map.is_none())?;
        let mode = |place: &Place| Mode::of(last.name(), &self.nominal.axes[place.on()]);
        Some((last, last.places.iter().map(mode).collect::<Option<_>>()?))
    }

    /// `model` with the resonances of its last effect that leave much of their axis at the frequency that does best there, about the one of
    /// the axis that was met best, if that leaves less. `left`: what there was without the effect.
    pub(crate) fn resonating_alike(
        &self,
        model: Model,
        left: &Stack,
        effort: Effort,
    ) -> Result<Model, Error> {
        let Some((last, modes)) = self.resonance(&model) else { return Ok(model) };
        let nth = model.terms.len() - 1;
        if modes.len() < 2 || model.fit.cost > effort.hopeless {
            return Ok(model);
        }
        // What there was of each axis, and what is left of it.
        let open: Vec<[f64; 2]> = last
            .places
            .iter()
            .map(|place| [left, &model.fit.stack].map(|stack| self.left_on(stack, 1 << place.on())))
            .collect();
        let share = |p: usize| open[p][1].max(0.0) / open[p][0].max(WORTH_ABSOLUTE);
        let gained = |p: usize| open[p][0] - open[p][1];
        let by_gain = |&a: &usize, &b: &usize| gained(a).total_cmp(&gained(b));
        let Some(lead) = (0..open.len()).max_by(by_gain) else { return Ok(model) };
        let most = LAGS.0.max(LAGS.1 * share(lead));
        let lags = |p: usize| share(p) > most && open[p][1] > WORTH_ABSOLUTE;
        if !(0..open.len()).any(lags) {
            return Ok(model);
        }
        let offers: Vec<Vec<Vec<f64>>> = (0..last.places.len())
            .map(|p| {
                let own = model.values(nth, p).to_vec();
                let like =
                    |k: i32| modes[p].moved(model.values(nth, lead), 1.0 + f64::from(k) * ABOUT.1);
                let others = lags(p).then(|| ABOUT.0.map(like)).into_iter().flatten();
                std::iter::once(own).chain(others).collect()
            })
            .collect();
        let mut known = start_terms(&model);
        known.truncate(nth);
        let telling = self.telling(&model.fit.stack);
        let place = (last.effect, &last.places[..]);
        if !self.affords(&known, place, &offers, &telling)? {
            return Ok(model);
        }
        let best = self.best_of_offers(&known, place, &offers, &telling)?;
        if best.iter().zip(&offers).all(|(best, offers)| *best == offers[0]) {
            return Ok(model);
        }
        let start = known.into_iter().flat_map(|(_, values)| values).chain(best.concat()).collect();
        let hopeless = model.fit.cost;
        let effort = Effort { iterations: RESTARTED, hopeless, ..effort };
        let other = self.fit_model(model.terms.clone(), start, effort)?;
        Ok(if other.fit.cost < model.fit.cost { other } else { model })
    }
}
