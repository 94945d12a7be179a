//! When one more effect, or another one, is worth it.

use crate::fitting::model::{Model, Term};
use crate::judge::accept;
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::select::Search;
use crate::session::scene::Stack;

/// A further effect must remove this share of what the model before it leaves.
pub(crate) const WORTH_OF_LEFTOVER: f64 = 0.35;
/// ... and this share of the whole gap (whitened).
pub(crate) const WORTH_OF_GAP: f64 = 0.01;
/// ... or nearly all of what is left, if it is less than that.
const NEARLY_ALL: f64 = 0.8;
/// ... or this share of what is left on an axis,
const CLOSES_AXIS: f64 = 0.9;
/// where that is more than this multiple of the noise energy.
const CLEARLY: f64 = 1.0;
/// ... and this much cost in all, against noise.
pub(crate) const WORTH_ABSOLUTE: f64 = 60.0;

/// Numbers of a model, as a multiple of those of one that is far plainer.
const FAR_PLAINER: f64 = 1.5;

impl Search<'_> {
    /// The model of `size` effects that is worth it beyond what was worth it with fewer.
    pub(crate) fn chosen_of(&self, size: usize) -> Option<Model> {
        match size {
            0 => None,
            1 => self.best_of(1),
            _ => self.worth_it_beyond(&self.chosen_of(size - 1)?, size),
        }
    }

    /// The best model of `size` effects if it is worth it beyond `best`, or else the best one that has what that has on fewer axes.
    pub(crate) fn worth_it_beyond(&self, best: &Model, size: usize) -> Option<Model> {
        let is_worth_it = |model: &&Model| self.is_worth_more(best, model);
        let mut of_size = self.tried.iter().filter(|model| model.terms.len() == size);
        let first = of_size.next()?;
        let mut splits = of_size.filter(|model| model.splits(best));
        Some(first).filter(is_worth_it).or_else(|| splits.find(is_worth_it)).cloned()
    }

    /// Whether a model of one more effect is worth it. One that has each effect on fewer axes may even be the plainer one.
    pub(crate) fn is_worth_more(&self, smaller: &Model, larger: &Model) -> bool {
        let saved = smaller.fit.cost - larger.fit.cost;
        saved > self.worth_of_further(smaller.fit.cost - self.noise)
            || self.closes_much(smaller, larger, saved)
            || self.closes_an_axis(smaller, larger, saved)
            || (larger.numbers() <= smaller.numbers()
                && saved > self.worth_of_change(smaller.fit.cost - self.noise))
            || (larger.numbers() < smaller.numbers()
                && saved > self.worth_of_plainer(smaller.fit.cost - self.noise))
            || (larger.numbers() < smaller.numbers()
                && saved > NOISE_MARGIN - self.form_of(smaller)
                && (larger.splits(smaller) || is_far_plainer(larger, smaller)))
    }

    /// Whether a model takes nearly everything off what a smaller one leaves on one axis, more than its noise. Beside a large effect on all
    /// axes that is little.
    fn closes_an_axis(&self, smaller: &Model, larger: &Model, saved: f64) -> bool {
        let [before, after] = [smaller, larger].map(|m| accept::gaps(self.scene, &m.fit.stack));
        // What an effect of another law leaves is its own.
        let is_of_one_law = |axis: usize| {
            let mut here = smaller.terms.iter().filter(|term| term.axes().contains(&axis));
            here.all(|term| !accept::has_many_laws(term.name()))
        };
        saved > WORTH_ABSOLUTE
            && before.iter().zip(&after).enumerate().any(|(axis, (before, after))| {
                before.ratio > CLEARLY
                    && after.ratio < (1.0 - CLOSES_AXIS) * before.ratio
                    && is_of_one_law(axis)
            })
    }

    /// Whether a model leaves an axis open by more than its noise, however little that weighs: slow motion hardly does.
    pub(crate) fn is_clearly_open(&self, model: &Model) -> bool {
        accept::gaps(self.scene, &model.fit.stack).iter().any(|gap| gap.ratio > CLEARLY)
    }

    /// Cost that one more effect must remove where `leftover` is left.
    pub(crate) fn worth_of_further(&self, leftover: f64) -> f64 {
        let fair = (WORTH_OF_LEFTOVER * leftover).max(WORTH_OF_GAP * self.gap);
        // A small effect beside a large one: it must account for nearly all that the large one leaves.
        let rest = (NEARLY_ALL * leftover).max(0.1 * WORTH_OF_GAP * self.gap);
        WORTH_ABSOLUTE.max(fair.min(rest))
    }

    /// Whether a model takes as much off what a smaller one leaves in nanometres as is asked for in cost. A constant is many nanometres
    /// and little cost: there is one number of it in a recording, and thousands of the noise that all models leave.
    fn closes_much(&self, smaller: &Model, larger: &Model, saved: f64) -> bool {
        let left = |stack| self.scene.excess(stack);
        let (whole, before) = (left(&self.base), left(&smaller.fit.stack));
        let closed = before - left(&larger.fit.stack);
        saved > WORTH_ABSOLUTE
            && closed > WORTH_OF_LEFTOVER * before
            && closed > WORTH_OF_GAP * whole
    }

    /// Whether a model that leaves `there` of some recordings may do so even if it leaves nothing of the others.
    pub(crate) fn may_close_much(&self, smaller: &Model, there: &Stack) -> bool {
        let before = self.scene.excess(&smaller.fit.stack);
        before - self.scene.excess(there) > WORTH_OF_LEFTOVER * before
    }

    /// Cost that several effects of fewer numbers must remove in place of fewer effects, where `leftover` is left: a lag that relaxes in
    /// many ways takes in the small gain beside a plain one, which is next to nothing of the gap.
    fn worth_of_plainer(&self, leftover: f64) -> f64 {
        WORTH_ABSOLUTE.max(WORTH_OF_LEFTOVER * leftover)
    }

    /// Cost that another effect must remove in place of one, where `leftover` is left.
    pub(crate) fn worth_of_change(&self, leftover: f64) -> f64 {
        WORTH_ABSOLUTE.max(WORTH_OF_LEFTOVER * leftover).max(0.1 * WORTH_OF_GAP * self.gap)
    }
}

/// Whether a model has clearly fewer numbers than another, and laws that nature has no others for. One that leaves less as well is better in
/// both: a lag beside a stiffness, each with one number an axis, comes before the relaxation that has four, and how near that comes to the two
/// depends on where its fit stops.
fn is_far_plainer(model: &Model, other: &Model) -> bool {
    let has_one_law = |term: &Term| !accept::has_many_laws(term.name());
    FAR_PLAINER * model.numbers() as f64 <= other.numbers() as f64
        && model.terms.iter().all(has_one_law)
}
