//! What one axis has beside the effect that all of them have.
//!
//! Stages are built alike, and what creeps or lags on two axes does so on the third. Where that one has a plain error of its own as well, the
//! common effect by itself accounts for little of it and is not gone on from: one that bends to both does better. So where an effect alone
//! accounts for every other axis, it is fitted to that one too, from where it stands there, beside each of the plain effects that the rest
//! asks for, and others where none of these will do. And where the best model has different effects on different axes, what it has elsewhere
//! is fitted beside its own effects of each axis that it leaves open. What this comes to is for [`crate::search::compose`] to take up.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::{Effort, Sensitivities, rig_with};
use crate::fitting::knobs::{EffectRef, is_plain, knobs_at};
use crate::fitting::model::{Model, Term, knobs_from};
use crate::judge::accept;
use crate::search::prune::WORTH_OF_PLACE;
use crate::search::screen::Gain;
use crate::search::select::Search;
use crate::search::worth::WORTH_ABSOLUTE;
use crate::session::scene::Wanted;

/// Other axes that have to show the effect.
const LEAST_SEEN: usize = 2;
/// Share of the gap of each of them that it leaves at most: a law of creep leaves 0.08 beside a gain on one axis (case 9 of the blind set 31313).
const ACCOUNTS: f64 = 0.1;
/// Share of the axis in question that the two leave at most, where the others are left with less than this.
const FORM: f64 = 0.02;
/// Share of the axis in question that the best effect alone leaves at least, or nothing is looked for: relaxation that takes in a lag and a
/// stiffness leaves 0.0008 (case 50 of 28282).
const OPEN: f64 = 0.0005;
/// Share of the whole gap that this axis has.
const COUNTS: f64 = 0.05;
/// Multiple of the share which an effect leaves of the one that it suits least of the others that it leaves of this one at least: what it lacks
/// everywhere is not of this axis.
const LAGS: f64 = 3.0;
/// Effects of all others that are fitted there.
const ALIKE: usize = 2;
/// Plain ones beside each of them,
const PARTNERS: usize = 3;
/// and others, where with none of the plain ones the two account for the axis.
const FURTHER_PARTNERS: usize = 2;

impl Search<'_> {
    /// Fit what other axes have, and another effect beside it, on each axis that asks for more.
    pub(crate) fn beside_what_others_have(&mut self) -> Result<(), Error> {
        // Where gauges read several axes no residual is of one of them.
        if self.nominal.output_map.is_some() {
            return Ok(());
        }
        let has_gap = |axis: &usize| self.left_on(&self.base, 1 << axis) > WORTH_ABSOLUTE;
        let loud: Vec<usize> = self.loud_axes().filter(has_gap).collect();
        for &axis in &loud {
            let others: Vec<usize> = loud.iter().copied().filter(|&other| other != axis).collect();
            let is_open = self.tried.iter().all(|m| self.share_left(m, axis) > OPEN);
            let counts = self.left_on(&self.base, 1 << axis) > COUNTS * self.gap;
            if others.len() < LEAST_SEEN || !counts || !is_open {
                continue;
            }
            for (effect, values, worst) in self.of_all_others(axis, &others) {
                let mut is_found = false;
                for (partner, start) in self.likely_beside(axis, effect, &values)? {
                    if self.is_spent() {
                        return Ok(());
                    }
                    if is_found && !is_plain(partner) {
                        break;
                    }
                    let places = || vec![Place::Axis(axis)];
                    let terms = vec![
                        Term { effect, places: places() },
                        Term { effect: partner, places: places() },
                    ];
                    let start = [values.clone(), start].concat();
                    let effort = Effort { tolerance: 2.0e-2, ..self.effort() };
                    let model = self.fit_model(terms, start, effort)?;
                    // What does not account for this axis as well may be where a fit got stuck, and keeps the two from being tried together.
                    let share = self.share_left(&model, axis);
                    let accounts = share < worst.max(FORM);
                    is_found |= accounts;
                    if accounts && self.tried.iter().all(|m| self.share_left(m, axis) > share) {
                        self.remember(model);
                    }
                }
            }
        }
        Ok(())
    }

    /// On each axis that the best model with different effects on different axes leaves open, of those of `size` effects, fit what it has elsewhere
    /// beside its own effects there. Whether anything was gained: what leaves less is for [`crate::search::compose`] to take up.
    pub(crate) fn beside_own(&mut self, size: usize) -> Result<bool, Error> {
        let is_on_axes = |place: &Place| matches!(place, Place::Axis(_));
        let differs = |m: &&Model| {
            m.terms.len() == size
                && m.terms.iter().all(|term| term.places.iter().all(is_on_axes))
                && m.terms.iter().any(|term| term.axes() != m.terms[0].axes())
        };
        let model = match self.tried.iter().find(differs) {
            Some(model) if self.nominal.output_map.is_none() => model.clone(),
            _ => return Ok(false),
        };
        if accept::is_clean(self.scene, &model.fit.stack) {
            return Ok(false);
        }
        let mut has_gained = false;
        for axis in self.loud_axes().collect::<Vec<_>>() {
            let place = Place::Axis(axis);
            let own = model.part(|_, here| here.places[0] == place);
            let left = self.left_on(&model.fit.stack, 1 << axis);
            let is_open = self.share_left(&model, axis) > OPEN && left > WORTH_OF_PLACE;
            if own.is_empty() || !is_open {
                continue;
            }
            for (t, other) in model.terms.iter().enumerate() {
                // One heavy effect on one axis is of that axis.
                let is_common = is_plain(other.effect)
                    || (other.places.len() >= LEAST_SEEN && !self.is_spent());
                if other.places.contains(&place) || !is_common {
                    continue;
                }
                let by_share = |&a: &usize, &b: &usize| {
                    let share = |p: usize| self.share_left(&model, other.places[p].on());
                    share(a).total_cmp(&share(b))
                };
                let Some(best) = (0..other.places.len()).min_by(by_share) else { continue };
                let mut terms = own.clone();
                terms.push((other.at(place), model.values(t, best).to_vec()));
                let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
                let iterations = if self.is_spent() { 3 } else { self.effort().iterations };
                let effort = Effort { iterations, ..self.effort() };
                let beside = self.fit_model(terms, start.concat(), effort)?;
                if self.left_on(&beside.fit.stack, 1 << axis) < left - WORTH_OF_PLACE {
                    has_gained = true;
                    self.remember(beside);
                }
            }
        }
        Ok(has_gained)
    }

    /// Effects that account for each of `others` alone and for less of `axis`, those that leave least first, with their values on the one
    /// that they suit best and the share that they leave of the one that they suit least.
    fn of_all_others(&self, axis: usize, others: &[usize]) -> Vec<(EffectRef, Vec<f64>, f64)> {
        let worst =
            |m: &Model| others.iter().map(|&other| self.share_left(m, other)).fold(0.0, f64::max);
        let accounts = |m: &&Model| {
            let places = m.terms.iter().flat_map(|term| &term.places);
            m.terms.len() == 1
                && places.into_iter().all(|place| matches!(place, Place::Axis(_)))
                && worst(m) < ACCOUNTS
                && self.share_left(m, axis) > OPEN.max(LAGS * worst(m))
        };
        let mut found: Vec<&Model> = self.tried.iter().filter(accounts).collect();
        found.sort_by(|a, b| worst(a).total_cmp(&worst(b)));
        let mut names: Vec<&str> = Vec::new();
        found.retain(|m| {
            let name = m.terms[0].name();
            let is_new = !names.contains(&name);
            names.push(name);
            is_new
        });
        let of_best = |m: &Model| {
            let by_share = |&&a: &&usize, &&b: &&usize| {
                self.share_left(m, a).total_cmp(&self.share_left(m, b))
            };
            let best = *others.iter().min_by(by_share)?;
            let term = &m.terms[0];
            let place = term.places.iter().position(|p| *p == Place::Axis(best))?;
            Some((term.effect, m.values(0, place).to_vec(), worst(m)))
        };
        found.into_iter().filter_map(of_best).take(ALIKE).collect()
    }

    /// Effects that promise most on an axis beside an effect of such values there, with what they start from: plain ones first.
    fn likely_beside(
        &self,
        axis: usize,
        effect: EffectRef,
        values: &[f64],
    ) -> Result<Vec<(EffectRef, Vec<f64>)>, Error> {
        let place = Place::Axis(axis);
        let knobs = knobs_at(effect, place, &self.ranges);
        let rig = rig_with(self.nominal, &knobs, values)?;
        let wanted = Wanted { axes: 1 << axis, monitors: true };
        let stack = self.scene.residuals_at(&rig, wanted, self.include)?;
        let term = Term { effect, places: vec![place] };
        let knobs = knobs_from(&[term], values, &self.ranges);
        let known =
            Sensitivities::at(self.scene, self.nominal, &knobs, values, &stack, self.include)?;
        let gains = self.screen.test(self.scene, &stack, Some(&known));
        let is_it = |other: EffectRef, _: &Gain| other.info().name != effect.info().name;
        let (mut likely, mut others): (Vec<_>, Vec<_>) = self
            .likeliest_at(place, &gains, is_it)
            .into_iter()
            .partition(|(effect, _)| is_plain(*effect));
        likely.truncate(PARTNERS);
        others.truncate(FURTHER_PARTNERS);
        likely.extend(others);
        Ok(likely.into_iter().map(|(effect, gain)| (effect, gain.start)).collect())
    }
}
