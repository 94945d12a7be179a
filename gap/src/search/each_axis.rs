//! Axes for their own sake: what suits one of them is little beside what the others lack.
//!
//! A screen ranks effects by what they promise on all axes together. Where axes lack different things, the effect that one of them needs
//! may come behind a dozen that all the others like. So the likeliest effects of every axis are fitted there alone, and
//! [`crate::search::compose`] puts together what suits each of them.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::{Model, Term, start_terms};
use crate::search::screen::Gain;
use crate::search::select::{CLOSED, MOSTLY_OPEN, Search, WORTH_OF_FIRST};
use crate::search::worth::WORTH_ABSOLUTE;
use crate::session::scene::Stack;

/// Effects that are fitted on an axis for its own sake.
const OF_EACH_AXIS: usize = 2;

impl Search<'_> {
    /// Axes where something is missing.
    pub(super) fn loud_axes(&self) -> impl Iterator<Item = usize> {
        let loud = self.loud;
        (0..self.nominal.axes.len()).filter(move |axis| loud >> axis & 1 == 1)
    }

    /// Effects that are `wanted` and promise something at a place, most first.
    pub(super) fn likeliest_at(
        &self,
        place: Place,
        gains: &[Vec<Gain>],
        wanted: impl Fn(EffectRef, &Gain) -> bool,
    ) -> Vec<(EffectRef, Gain)> {
        let here = |(gains, &effect): (&Vec<Gain>, &EffectRef)| {
            let gain = gains.iter().find(|gain| gain.place == place)?;
            wanted(effect, gain).then(|| (effect, gain.clone()))
        };
        let mut likely: Vec<(EffectRef, Gain)> =
            gains.iter().zip(&self.screen.effects).filter_map(here).collect();
        likely.sort_by(|a, b| b.1.gain.total_cmp(&a.1.gain));
        likely
    }

    /// Fit what promises most on each axis there alone, unless an effect was found that closes it.
    pub(crate) fn of_each_axis(&mut self, gains: &[Vec<Gain>]) -> Result<(), Error> {
        let loud: Vec<usize> = self.loud_axes().collect();
        if loud.len() < 2 {
            return Ok(());
        }
        for axis in loud {
            let place = Place::Axis(axis);
            let open = CLOSED * self.left_on(&self.base, 1 << axis);
            if self.tried.iter().any(|m| self.left_on(&m.fit.stack, 1 << axis) < open) {
                continue;
            }
            let mut likely = self.likeliest_at(place, gains, |_, gain| gain.gain > WORTH_ABSOLUTE);
            likely.truncate(OF_EACH_AXIS);
            let name = |effect: EffectRef| effect.info().name;
            let is_it = |m: &&Model, effect: EffectRef| m.key() == [name(effect)];
            likely.retain(|&(effect, _)| {
                let mut alone = self.tried.iter().filter(|m| is_it(m, effect));
                !alone.any(|m| m.terms[0].places.contains(&place))
            });
            for (effect, gain) in likely {
                let start = self.tuned((&[], &self.base), effect, &[place], vec![gain.start])?;
                // What was fitted on another axis stays there: two axes that have it tell what the third one has.
                let known = self.tried.iter().find(|m| is_it(m, effect)).map(start_terms);
                let known = known.and_then(|terms| terms.into_iter().next());
                let (mut places, mut values) =
                    known.map_or_else(Default::default, |(term, values)| (term.places, values));
                places.push(place);
                values.extend(start.concat());
                let effort = Effort { tolerance: 2.0e-2, ..self.effort() };
                let model = self.fit_model(vec![Term { effect, places }], values, effort)?;
                self.remember(model);
            }
        }
        Ok(())
    }

    /// Whether every effect of the catalogue was fitted alone and none of them took a fair share off an axis. What one leaves there does not
    /// depend on the other axes, so that a search of this axis alone would come to the same.
    pub(crate) fn knows_nothing_of(&self, axis: usize) -> bool {
        let gap = self.left_on(&self.base, 1 << axis);
        let is_enough = |cost: f64| cost - self.noise <= MOSTLY_OPEN * self.gap;
        let does_little =
            |stack: &Stack| self.left_on(stack, 1 << axis) > (1.0 - WORTH_OF_FIRST) * gap;
        self.tried.iter().all(|m| !is_enough(m.fit.cost) && does_little(&m.fit.stack))
    }
}
