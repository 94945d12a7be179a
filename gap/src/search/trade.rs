//! One axis, another cause: an effect that suits one axis may have been stretched over a second one where something else is at work.
//!
//! Terms take the axes where they gain anything, and a gain of the wrong kind is a gain too. So every place of a term that leaves its
//! axis open is taken out again, and what suits the residual of that axis alone is tried there instead.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::model::{Model, Term};
use crate::search::select::{MOST_EFFECTS, Search};
use crate::session::scene::Wanted;

/// Effects that are tried in each place.
const OFFERS: usize = 2;
/// Share of an axis' gap that may stay without looking further.
const CLOSED: f64 = 0.01;
/// ... and how many times the share that stays on the axis which the effect suits best: what it leaves everywhere alike is its form.
const ALIKE: f64 = 1.5;

impl Search<'_> {
    /// `model` with places traded for other effects where that leaves clearly less.
    pub(crate) fn trade(&mut self, model: Model) -> Result<Model, Error> {
        let mut best = model;
        for axis in 0..self.nominal.axes.len() {
            let place = Place::Axis(axis);
            let base = self.scene.on_axis(&self.base, axis);
            let noise = self.scene.noise_on(&self.base, 1 << axis);
            let gap = self.scene.cost_on(&self.base, 1 << axis) - noise;
            for t in 0..best.terms.len() {
                let Some(term) = best.terms.get(t) else { continue };
                let left = self.scene.cost_on(&best.fit.stack, 1 << axis) - noise;
                let needed = self.worth_of_change(left);
                let is_open = left >= CLOSED * gap && !self.is_spent();
                if term.places.len() < 2 || !term.places.contains(&place) || !is_open {
                    continue;
                }
                let shares = term.places.iter().map(|p| self.share_left(&best, p.on()));
                if left < ALIKE * gap * shares.fold(f64::INFINITY, f64::min) {
                    continue;
                }
                let name = term.name();
                let rig = best.without(self.nominal, t, |p| p == place)?;
                let wanted = Wanted { axes: 1 << axis, monitors: true };
                let stack = self.scene.residuals_at(&rig, wanted, self.include)?;
                let gains = self.screen.test(self.scene, &stack, None);
                for (effect, gains) in self.shortlist(&gains, &[name], OFFERS) {
                    let Some(gain) = gains.into_iter().find(|g| g.place == place) else { continue };
                    let mut terms =
                        best.part(|of, here| of.name() != name || here.places[0] != place);
                    let alone = (&[][..], &base);
                    let start = self.tuned(alone, effect, &[place], vec![gain.start])?.concat();
                    let full = terms.len() == MOST_EFFECTS;
                    match terms.iter_mut().find(|(known, _)| known.name() == effect.info().name) {
                        Some((known, _)) if known.places.contains(&place) => continue,
                        Some((known, values)) => {
                            known.places.push(place);
                            values.extend(start);
                        }
                        None if full => continue,
                        None => terms.push((Term { effect, places: vec![place] }, start)),
                    }
                    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
                    let effort = Effort { hopeless: best.fit.cost, ..self.effort() };
                    let other = self.fit_model(terms, start.concat(), effort)?;
                    if other.fit.cost < best.fit.cost - needed {
                        best = other.clone();
                    }
                    self.remember(other);
                    if best.terms.get(t).is_none_or(|term| term.name() != name) {
                        break;
                    }
                }
            }
        }
        Ok(best)
    }

    /// Share of the gap of an axis that a model leaves.
    pub(super) fn share_left(&self, model: &Model, axis: usize) -> f64 {
        let noise = self.scene.noise_on(&self.base, 1 << axis);
        let gap = self.scene.cost_on(&self.base, 1 << axis) - noise;
        (self.scene.cost_on(&model.fit.stack, 1 << axis) - noise) / gap.max(1.0)
    }
}
