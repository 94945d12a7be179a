//! Loops of any kind, where plain ones do not suffice.
//!
//! A loop of another height, width, fullness or symmetry about its centre takes four numbers. Loops of other laws (of Bouc and Wen's or Dahl's
//! kind, of Preisach's, of a continuum of plays, about another voltage) take four more, and with eight numbers an axis a loop bends to
//! much that is none: the half per cent of a gain, a drift. So a search is made with the plain loop first. Only where that loop is a good
//! part of the answer, and the best model still leaves something, is it let go; and what it then explains counts if it is much more, or as much with
//! fewer effects.

use crate::Error;
use crate::accept;
use crate::fit::Effort;
use crate::model::{Model, Term, start_terms};
use crate::select::{MOST_EFFECTS, Search};

/// The effect that this is about.
const LOOP: &str = "hysteresis-shape";
/// Its parameters beyond the plain ones.
const FURTHER: [&str; 4] = ["bend", "imprint_v", "yield", "spread"];

/// Share of the gap of an axis that the plain loop alone must account for, on an axis that counts.
const PLAIN_LOOP: f64 = 0.3;
/// Share of the whole gap that makes an axis count.
const COUNTS: f64 = 0.1;
/// Share of what the plain loop alone leaves on these axes that any loop alone may leave at most: else its law was not what was missing.
const ANOTHER_LAW: f64 = 0.8;
/// Share of what the model with a plain loop leaves that one with any loop may leave at most.
const MUCH_LESS: f64 = 0.65;
/// ... or this share with fewer effects.
const AS_LITTLE: f64 = 1.1;
/// Share of the gap that the form of a single right effect leaves.
const FORM_OF_ONE: f64 = 0.01;
/// Iterations of its fit.
const ITERATIONS: usize = 12;

/// Whether this parameter of an effect rests unless any kind of loop is allowed.
pub(crate) fn rests(effect: &str, parameter: &str) -> bool {
    effect == LOOP && FURTHER.contains(&parameter)
}

impl Search<'_> {
    /// The model of a search with a loop of any kind, if that is better than `plain`, the one with plain loops.
    pub(crate) fn with_any_loop(&mut self, plain: Option<Model>) -> Result<Option<Model>, Error> {
        let is_loop = |model: &&Model| model.key() == [LOOP];
        let Some(alone) = self.tried.iter().find(is_loop).cloned() else { return Ok(plain) };
        let axes = self.axes_of_loop(&alone);
        let is_closed = |m: &Model| {
            m.terms.len() < MOST_EFFECTS
                && accept::gaps(self.scene, &m.fit.stack).iter().all(|g| !g.counts)
        };
        if axes == 0 || plain.as_ref().is_some_and(is_closed) {
            return Ok(plain);
        }
        // Where one effect accounts for all but its form, a loop has to do as well by itself: with company it can take on any form.
        let is_enough =
            |m: &Model| m.terms.len() == 1 && m.fit.cost - self.noise < FORM_OF_ONE * self.gap;
        let enough = match &plain {
            Some(plain) if is_enough(plain) => plain.fit.cost,
            _ => f64::INFINITY,
        };
        let known = self.tried.clone();
        self.tried.retain(|model| !model.key().contains(&LOOP));
        self.ranges.any_loop = true;
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(&alone).into_iter().unzip();
        let effort = Effort { iterations: ITERATIONS, hopeless: enough, ..self.effort() };
        let freed = self.fit_model(terms, start.concat(), effort)?;
        let noise = self.noise;
        let left = |m: &Model| (m.fit.cost - noise).max(0.0);
        let is_another_law =
            self.left_on(&freed, axes) < ANOTHER_LAW * self.left_on(&alone, axes).max(0.0);
        let any = if is_another_law && freed.fit.cost < enough {
            self.remember(freed);
            self.select()?
        } else {
            None
        };
        let is_better = match (&any, &plain) {
            (Some(any), None) => any.key().contains(&LOOP),
            (Some(any), Some(plain)) => {
                let (few, many) = (any.terms.len(), plain.terms.len());
                let share = if few < many { AS_LITTLE } else { MUCH_LESS };
                let suffices = left(any) < share * left(plain);
                any.key().contains(&LOOP) && suffices
            }
            (None, _) => false,
        };
        if is_better {
            return Ok(any);
        }
        self.tried = known;
        self.ranges.any_loop = false;
        Ok(plain)
    }

    /// Cost beyond noise that a model leaves on the axes in a mask.
    fn left_on(&self, model: &Model, axes: u32) -> f64 {
        let stack = &model.fit.stack;
        self.scene.cost_on(stack, axes) - self.scene.noise_on(stack, axes)
    }

    /// Axes (a mask) on which a loop alone is a good part of the answer.
    fn axes_of_loop(&self, alone: &Model) -> u32 {
        (0..self.nominal.axes.len()).map(|axis| 1 << axis).fold(0, |axes, bit| {
            let gap = self.scene.cost_on(&self.base, bit) - self.scene.noise_on(&self.base, bit);
            let saved = gap - self.left_on(alone, bit);
            if gap > COUNTS * self.gap && saved > PLAIN_LOOP * gap { axes | bit } else { axes }
        })
    }
}
