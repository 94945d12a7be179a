//! Loops of any kind, where plain ones do not suffice.
//!
//! A loop of another height, width, fullness or symmetry about its centre takes four numbers. Loops of other laws (of Bouc and Wen's or Dahl's
//! kind, of Preisach's, of a continuum of plays, about another voltage) take five more, and with nine numbers an axis a loop bends to
//! much that is none: the half per cent of a gain, a drift. So a search is made with the plain loop first, but where `laws` is told
//! early that none will do. Only where that loop is a good
//! part of the answer, and the best model still leaves something, is it let go; and what it then explains counts if it is much more, or as much with
//! fewer effects.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::model::{Model, Term, join_terms, start_terms};
use crate::judge::accept;
use crate::search::select::{CLOSED, MOST_EFFECTS, Search};
use crate::session::scene::{Stack, Wanted};

/// The effect that this is about.
pub(super) const LOOP: &str = "hysteresis-shape";
/// Its parameters beyond the plain ones.
const FURTHER: [&str; 9] = [
    "bend",
    "imprint_v",
    "yield",
    "spread",
    "recoil",
    "beside_v",
    "beside_c",
    "beside_exponent",
    "beside_recoil",
];

/// Where a fit begins that did not get away from corners: what takes them off a loop. An element comes back as Dahl's, or half as Bouc and Wen's.
const GIVEN_WAY: [[(&str, f64); 3]; 2] = [
    [("yield", 0.3), ("spread", 0.3), ("recoil", 1.0)],
    [("yield", 0.3), ("spread", 0.3), ("recoil", 0.5)],
];
/// Share of the cost that a fit which got nowhere leaves.
const STUCK: f64 = 0.999;

/// The effect that other laws of a loop are most like: the same memory, of a force instead of a voltage.
pub(super) const FRICTION: &str = "friction";

/// Share of the gap of an axis that the plain loop must account for, alone or beside others, on an axis that counts.
const PLAIN_LOOP: f64 = 0.2;
/// ... or this one, where no other effect accounts for half of the gap.
pub(super) const PLAIN_LOOP_AT_LEAST: f64 = 0.03;
/// Share of the whole gap that makes an axis count.
pub(super) const COUNTS: f64 = 0.1;
/// Share of what the plain loop alone leaves on these axes that any loop alone may leave at most: else its law was not what was missing.
const ANOTHER_LAW: f64 = 0.8;
/// Share of what the model with a plain loop leaves that one with any loop may leave at most.
const MUCH_LESS: f64 = 0.65;
/// ... or this share with fewer effects, the loop on no more axes.
const AS_LITTLE: f64 = 1.1;
/// ... or this one, with friction gone from them: a further effect must remove a third of what the loop alone leaves.
const AS_FURTHER: f64 = 1.5;
/// ... or this share of the gap.
const NEXT_TO_NOTHING: f64 = 0.003;
/// Multiple of the numbers of a model in which nothing bends as a loop does from which any loop has to leave much less to take its place, however few
/// the effects.
const MANY_NUMBERS: usize = 2;
/// Share of what the model with a plain loop leaves that one of an effect more, any loop among them, may leave to be gone on from.
const LESS: f64 = 0.8;
/// Multiple of what a plain model leaves that a loop of any law may leave to be looked into.
const NEAR: f64 = 2.0;
/// Share of the gap that a model leaves at most whose loop is let go although another one was chosen.
pub(super) const HALF: f64 = 0.5;
/// Share of the gap that the form of a single right effect leaves.
const FORM_OF_ONE: f64 = 0.01;
/// ... and the share below which no loop is let go any more once a search has spent what it may.
const MOSTLY_CLOSED: f64 = 0.05;
/// Iterations of its fit.
const ITERATIONS: usize = 12;

/// Whether this parameter of an effect rests unless any kind of loop is allowed.
pub(crate) fn rests(effect: &str, parameter: &str) -> bool {
    effect == LOOP && FURTHER.contains(&parameter)
}

/// Values of a model with parameters of its loops set where a fit with another law begins: from one with corners a fit may not get to one without.
pub(super) fn begun_with(
    model: &Model,
    settings: impl Fn(Place) -> Vec<(&'static str, f64)>,
) -> Vec<f64> {
    let mut values = model.fit.values.clone();
    for (t, term) in model.terms.iter().enumerate().filter(|(_, term)| term.name() == LOOP) {
        let parameters = term.effect.info().parameters;
        for (at, &place) in model.knob_range(t).step_by(parameters.len()).zip(&term.places) {
            let settings = settings(place);
            for (value, parameter) in values[at..].iter_mut().zip(parameters) {
                if let Some((_, start)) = settings.iter().find(|(name, _)| *name == parameter.name)
                {
                    *value = *start;
                }
            }
        }
    }
    values
}

/// Whether an effect bends as a loop does: beside it, a loop is not told from it.
fn bends(term: &Term) -> bool {
    term.effect.info().confused_with.contains(&LOOP)
}

/// Axes with a loop of another kind.
fn places(model: &Model) -> usize {
    model.terms.iter().find(|term| term.name() == LOOP).map_or(usize::MAX, |term| term.places.len())
}

impl Search<'_> {
    /// The model of a search with a loop of any kind, if that is better than `plain`, the one with plain loops. `freed`: one whose loop has
    /// been let go already.
    pub(crate) fn with_any_loop(
        &mut self,
        plain: Option<Model>,
        freed: Option<Model>,
    ) -> Result<Option<Model>, Error> {
        let is_loop = |model: &&Model| model.key() == [LOOP];
        let alone = self.tried.iter().find(is_loop).cloned();
        let is_open = |m: &Model| m.fit.cost - self.noise > HALF * self.gap;
        let nothing_is_known = plain.as_ref().is_none_or(is_open);
        let share = if nothing_is_known { PLAIN_LOOP_AT_LEAST } else { PLAIN_LOOP };
        let own =
            alone.map(|alone| (self.axes_of_loop(&alone, &self.base, &self.base, share), alone));
        // What is loud and none of a loop hides one that stands beside it.
        let beside = plain.as_ref().and_then(|plain| {
            let beside = self.loop_beside_others(plain, |_| &self.base);
            beside.filter(|(axes, _)| *axes != 0).or_else(|| self.best_with_loop())
        });
        let bound: Vec<(u32, Model)> = own.into_iter().chain(beside).filter(|b| b.0 != 0).collect();
        let is_closed =
            |m: &Model| m.terms.len() < MOST_EFFECTS && accept::is_clean(self.scene, &m.fit.stack);
        let is_late = |m: &Model| {
            let is_closed = m.fit.cost - self.noise < MOSTLY_CLOSED * self.gap;
            freed.is_none() && is_closed && self.is_spent()
        };
        let is_done = |m: &Model| is_closed(m) || self.is_plainly_a_loop(m) || is_late(m);
        if bound.is_empty() || plain.as_ref().is_some_and(is_done) {
            return Ok(plain);
        }
        // Where one effect accounts for all but its form, a loop has to do as well by itself: with company it can take on any form.
        let is_enough =
            |m: &Model| m.terms.len() == 1 && m.fit.cost - self.noise < FORM_OF_ONE * self.gap;
        let enough = match &plain {
            Some(plain) if is_enough(plain) => plain.fit.cost,
            _ => f64::INFINITY,
        };
        let apart = plain.as_ref().map(|plain| self.loop_apart_from_friction(plain)).transpose()?;
        let apart = apart.flatten().filter(|apart| apart.0 != 0);
        let known = self.tried.clone();
        self.tried.retain(|model| !model.key().contains(&LOOP));
        self.ranges.any_loop = true;
        let mut is_another_law = false;
        let is_apart_first = apart.is_some();
        for (nth, (axes, bound)) in apart.into_iter().chain(bound).enumerate() {
            let worth = enough.min(self.noise + self.line_of_loop(&bound, plain.as_ref()));
            let known = freed.as_ref().filter(|freed| freed.key() == bound.key()).cloned();
            let freed = match known {
                Some(freed) => freed,
                None => self.let_go(&bound, enough, worth)?,
            };
            let before = self.left_on(&bound.fit.stack, axes).max(0.0);
            is_another_law = self.left_on(&freed.fit.stack, axes) < ANOTHER_LAW * before
                && freed.fit.cost < enough;
            if is_another_law {
                is_another_law = self.holds_up(&freed, plain.as_ref())?;
                self.remember(freed);
                // That friction stands apart is a guess: where it comes to nothing the loops by themselves are asked as well.
                if is_another_law || nth > 0 || !is_apart_first {
                    break;
                }
            }
        }
        if is_another_law {
            let any = self.select()?;
            // What is added to a loop of any law may not be worth it, and the loop by itself be.
            let most = any.as_ref().map_or(0, |any| any.terms.len());
            let smaller: Vec<Model> = (1..most).rev().filter_map(|n| self.best_of(n)).collect();
            let is_better = |any: &Model| self.is_better_loop(any, plain.as_ref());
            if let Some(any) = any.into_iter().chain(smaller).find(is_better) {
                return Ok(Some(any));
            }
        }
        self.tried = known;
        self.ranges.any_loop = false;
        Ok(plain)
    }

    /// `bound` with its loop let go, as far as it may come below these costs.
    pub(super) fn let_go(&self, bound: &Model, hopeless: f64, worth: f64) -> Result<Model, Error> {
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = start_terms(bound).into_iter().unzip();
        let effort = Effort { iterations: ITERATIONS, hopeless, worth, ..self.effort() };
        let mut freed = self.fit_model(terms.clone(), start.concat(), effort)?;
        if freed.fit.cost > STUCK * bound.fit.cost {
            let begun = |way: [(&'static str, f64); 3]| begun_with(bound, |_| way.to_vec());
            let [dahl, wen] =
                GIVEN_WAY.map(|way| self.fit_model(terms.clone(), begun(way), effort));
            let (dahl, wen) = (dahl?, wen?);
            freed = if wen.fit.cost < dahl.fit.cost { wen } else { dahl };
        }
        let left = freed.fit.cost - self.noise;
        if accept::is_clean(self.scene, &freed.fit.stack) || left < CLOSED * self.gap {
            return Ok(freed);
        }
        self.with_loop_beside(freed)
    }

    /// The search gone on with a loop of any law right after two effects, where that accounts for all that two with a plain loop leave: what
    /// a third effect would make up for is known then. Others in the place of either are tried there as well. Where the two are a loop and friction
    /// that fight, the loop by itself has to leave the form of one (`laws`).
    pub(crate) fn two_with_any_loop(&mut self, plain: &Model) -> Result<Option<Model>, Error> {
        let closed = CLOSED * self.gap;
        let left_by_plain = plain.fit.cost - self.noise;
        if self.ranges.any_loop || left_by_plain * MUCH_LESS < closed || self.is_spent() {
            return Ok(None);
        }
        if let Some(any) = self.instead_of_two_that_fight(plain)? {
            return Ok(Some(any));
        }
        let left = |m: &Model| m.fit.cost - self.noise;
        // Friction makes up for a law that the plain loop does not have.
        let is_pair = |m: &&Model| {
            let key = m.key();
            key.len() == 2 && key.contains(&LOOP) && !key.contains(&FRICTION)
        };
        let near = |m: &&Model| left(m) < NEAR * left_by_plain;
        let Some(bound) = self.tried.iter().filter(is_pair).find(near).cloned() else {
            return Ok(None);
        };
        self.ranges.any_loop = true;
        let line = self.noise + closed;
        let freed = self.let_go(&bound, line, line);
        self.ranges.any_loop = false;
        let Some(freed) = Some(freed?).filter(|freed| freed.fit.cost < line) else {
            return Ok(None);
        };
        let known = self.tried.clone();
        let any = self.with_any_loop(Some(bound), Some(freed))?;
        let any = any.filter(|any| self.ranges.any_loop && any.fit.cost < line);
        if any.is_none() {
            self.ranges.any_loop = false;
            self.tried = known;
        }
        Ok(any)
    }

    /// Whether a model leaves next to nothing with a plain loop and nothing that bends as one does: another law would change no name.
    fn is_plainly_a_loop(&self, model: &Model) -> bool {
        let has_loop = model.key().contains(&LOOP);
        let left = model.fit.cost - self.noise;
        has_loop && !model.terms.iter().any(bends) && left < CLOSED * self.gap
    }

    /// What a loop of any law may leave, by itself, beside a plain model of several effects to be looked into.
    fn near(&self, plain: &Model) -> f64 {
        NEAR * (plain.fit.cost - self.noise).max(NEXT_TO_NOTHING * self.gap)
    }

    /// Whether a model is several effects that leave no room for others beside them.
    fn is_several_and_all(&self, model: &Model) -> bool {
        model.terms.len() > 1 && model.fit.cost - self.noise < CLOSED * self.gap
    }

    /// What a loop of any law, let go from `bound`, has to come to for anything to follow from it: less than the bound one leaves, and
    /// near to what a plain model of several effects does that leaves no room for others beside it, or, with as many effects, much less.
    fn line_of_loop(&self, bound: &Model, plain: Option<&Model>) -> f64 {
        let left = |m: &Model| (m.fit.cost - self.noise).max(0.0);
        let Some(plain) = plain.filter(|m| self.is_several_and_all(m)) else { return left(bound) };
        if bound.terms.len() >= plain.terms.len() && !plain.key().contains(&FRICTION) {
            MUCH_LESS * left(plain)
        } else {
            self.near(plain)
        }
    }

    /// Whether a loop of any law may yet take the place of a plain model of several effects that accounts for all but its form. By itself, or
    /// beside what that has besides loops and friction, it has to come near: then only are others tried beside it.
    fn holds_up(&mut self, freed: &Model, plain: Option<&Model>) -> Result<bool, Error> {
        let left = |m: &Model| (m.fit.cost - self.noise).max(0.0);
        let Some(plain) = plain.filter(|m| m.terms.len() > 1) else { return Ok(true) };
        if self.is_several_and_all(plain) {
            return Ok(left(freed) < self.line_of_loop(freed, Some(plain)));
        }
        let line = self.near(plain);
        if left(plain) > FORM_OF_ONE * self.gap || left(freed) < line {
            return Ok(true);
        }
        let has_company = freed.key();
        let mut others = plain.part(|term, _| ![LOOP, FRICTION].contains(&term.name()));
        others.retain(|(term, _)| !has_company.contains(&term.name()));
        let size = freed.terms.len() + others.len();
        if others.is_empty() || size > MOST_EFFECTS {
            return Ok(false);
        }
        // With one effect more it has to leave much less in the end.
        let line = if size > plain.terms.len() { LESS * left(plain) } else { line };
        let mut all = start_terms(freed);
        join_terms(&mut all, others);
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = all.into_iter().unzip();
        let worth = self.noise + line;
        let effort = Effort { hopeless: worth, worth, ..self.effort() };
        let beside = self.fit_model(terms, start.concat(), effort)?;
        let holds_up = left(&beside) < line;
        self.remember(beside);
        Ok(holds_up)
    }

    /// Whether a model with a loop of any law takes the place of one with a plain loop at most.
    fn is_better_loop(&self, any: &Model, plain: Option<&Model>) -> bool {
        let left = |m: &Model| (m.fit.cost - self.noise).max(0.0);
        let has = |m: &Model, name| m.key().contains(&name);
        let suffices = plain.is_none_or(|plain| {
            let takes_many_numbers = any.numbers() > MANY_NUMBERS * plain.numbers()
                && !plain.terms.iter().any(|term| term.name() == LOOP || bends(term));
            let is_no_fewer = any.terms.len() >= plain.terms.len() || places(any) > places(plain);
            let share = if is_no_fewer || takes_many_numbers {
                MUCH_LESS
            } else if has(plain, FRICTION) && !has(any, FRICTION) {
                // Next to nothing is a matter of form.
                return left(any) < (AS_FURTHER * left(plain)).max(NEXT_TO_NOTHING * self.gap);
            } else {
                AS_LITTLE
            };
            left(any) < share * left(plain)
        });
        has(any, LOOP) && suffices
    }

    /// Cost beyond noise of a stack on the axes in a mask.
    pub(super) fn left_on(&self, stack: &Stack, axes: u32) -> f64 {
        self.scene.cost_on(stack, axes) - self.scene.noise_on(stack, axes)
    }

    /// Axes (a mask) on which the loop of a model, beside what leaves `without` it, is a good part of the answer to what `asks`.
    fn axes_of_loop(&self, model: &Model, without: &Stack, asks: &Stack, share: f64) -> u32 {
        let whole = self.left_on(asks, u32::MAX);
        (0..self.nominal.axes.len()).map(|axis| 1 << axis).fold(0, |axes, bit| {
            let gap = self.left_on(asks, bit);
            let saved = self.left_on(without, bit) - self.left_on(&model.fit.stack, bit);
            if gap > COUNTS * whole && saved > share * gap { axes | bit } else { axes }
        })
    }

    /// The best model of several effects with a plain loop among them, where that of what the search came to is no good part of the answer:
    /// what bends may have taken the place of a loop of another law. What the others account for says nothing of it.
    fn best_with_loop(&self) -> Option<(u32, Model)> {
        let is_one =
            |m: &&Model| m.terms.len() > 1 && m.key().contains(&LOOP) && !m.terms.iter().any(bends);
        let best = self.tried.iter().find(is_one)?;
        let closes = best.fit.cost - self.noise < HALF * self.gap;
        self.loop_beside_others(best, |without| without).filter(|_| closes)
    }

    /// `model` with friction on axes without a loop only, where it has it on both: there it is a cause of its own, while beside a loop it makes up
    /// for a law that the plain one does not have.
    fn loop_apart_from_friction(&self, model: &Model) -> Result<Option<(u32, Model)>, Error> {
        let places = |name: &str| model.terms.iter().find(|t| t.name() == name).map(|t| &t.places);
        let (Some(loops), Some(rubs)) = (places(LOOP), places(FRICTION)) else { return Ok(None) };
        let beside = rubs.iter().filter(|place| loops.contains(place)).count();
        if beside == 0 || beside == rubs.len() || self.is_spent() {
            return Ok(None);
        }
        let apart = model.part(|t, here| t.name() != FRICTION || !loops.contains(&here.places[0]));
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = apart.into_iter().unzip();
        let bound = self.fit_model(terms, start.concat(), self.effort())?;
        let Some(nth) = bound.terms.iter().position(|t| t.name() == LOOP) else { return Ok(None) };
        let without = bound.without(self.nominal, nth, |_| true)?;
        let without = self.scene.residuals_at(&without, Wanted::ALL, self.include)?;
        Ok(Some((self.axes_of_loop(&bound, &without, &self.base, PLAIN_LOOP), bound)))
    }

    /// A model of several effects with a loop among them that is a good part of the answer on some axes. Friction is left out: it makes
    /// up for a law that the plain loop does not have. `asks` picks what the loop has to be a part of the answer to, given what the others
    /// leave.
    fn loop_beside_others<'a>(
        &'a self,
        model: &Model,
        asks: impl Fn(&'a Stack) -> &'a Stack,
    ) -> Option<(u32, Model)> {
        // The best one comes first.
        let with = |names: &[&str]| self.tried.iter().find(|known| known.key() == names);
        let mut names = model.key();
        names.retain(|name| *name != FRICTION);
        let is_all = names.len() == model.terms.len();
        let bound = if is_all { model.clone() } else { with(&names)?.clone() };
        let at = names.iter().position(|name| *name == LOOP)?;
        names.remove(at);
        let without = if names.is_empty() { &self.base } else { &with(&names)?.fit.stack };
        let axes = self.axes_of_loop(&bound, without, asks(without), PLAIN_LOOP);
        (axes != 0).then_some((axes, bound))
    }
}
