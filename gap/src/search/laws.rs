//! Loops of any law at once, where what was fitted says that no plain one will do.
//!
//! A search with plain loops may spend all it has on what makes up for the law of a loop before [`crate::search::loops`] lets one go. Two things say
//! early that it will: an axis of several of which no effect accounts for half, the plain loop for some of it and a loop let go for most;
//! and a plain loop beside friction, each of which takes back what the other one does. The search then goes on from the loop that was let
//! go, and what it comes to counts if it leaves no more than the form of a loop, or far less than all else. Otherwise nothing
//! has been said.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::{Model, Term};
use crate::search::loops::{COUNTS, FRICTION, HALF, LOOP, PLAIN_LOOP_AT_LEAST};
use crate::search::screen::Gain;
use crate::search::select::Search;
use crate::session::scene::Wanted;

/// Share of the gap of an axis that a loop of another law leaves there at most, where no effect accounts for half of it.
const MOST_OF_AN_AXIS: f64 = 0.2;
/// What a loop and friction that take back what the other one does have to take off an axis, as a multiple of its gap.
const FIGHTS: f64 = 2.0;
/// Share of the gap that the form of such a loop leaves at most, once what else is missing is told beside it.
const FORM_OF_ANY: f64 = 0.03;
/// ... or this share of what the best model with plain loops leaves.
const FORM_BESIDE_PLAIN: f64 = 0.1;

impl Search<'_> {
    /// The model of a search in which loops are let go at once, where one of several axes asks for it: no effect accounts for half of what it
    /// has by itself, the plain loop does for some of it and a loop of another law for most. What else is missing, there and elsewhere, is
    /// then told beside the loop that is; `None` where that leaves more than the form of the loop.
    pub(crate) fn law_of_an_axis(&mut self, gains: &[Vec<Gain>]) -> Result<Option<Model>, Error> {
        let axes: Vec<usize> = self.loud_axes().collect();
        // Where gauges read several axes no residual is of one of them.
        let are_tied = self.nominal.output_map.is_some();
        // Another look goes on from what the one before found, which may be no loop at all.
        let is_first_look = self.known.is_empty();
        if axes.len() < 2 || are_tied || self.ranges.any_loop || !is_first_look {
            return Ok(None);
        }
        let mut freed = Vec::new();
        for axis in axes {
            let gap = self.left_on(&self.base, 1 << axis);
            let closes = |m: &Model| self.left_on(&m.fit.stack, 1 << axis) <= HALF * gap;
            if gap < COUNTS * self.gap || self.tried.iter().any(closes) || self.is_spent() {
                continue;
            }
            let place = Place::Axis(axis);
            let of_loop = |effect: EffectRef, _: &Gain| effect.info().name == LOOP;
            let Some((effect, gain)) = self.likeliest_at(place, gains, of_loop).pop() else {
                continue;
            };
            let bound = self.fit_model(
                vec![Term { effect, places: vec![place] }],
                gain.start,
                self.effort(),
            )?;
            if self.left_on(&bound.fit.stack, 1 << axis) > (1.0 - PLAIN_LOOP_AT_LEAST) * gap {
                continue;
            }
            let free = self.let_go_whatever_it_leaves(&bound)?;
            if self.left_on(&free.fit.stack, 1 << axis) < MOST_OF_AN_AXIS * gap {
                freed.push(free);
            }
        }
        if freed.is_empty() { Ok(None) } else { self.beside_laws(freed) }
    }

    /// `bound` with its loop let go, in a search that has none otherwise.
    fn let_go_whatever_it_leaves(&mut self, bound: &Model) -> Result<Model, Error> {
        self.ranges.any_loop = true;
        let free = self.let_go(bound, f64::INFINITY, f64::INFINITY);
        self.ranges.any_loop = false;
        free
    }

    /// The model of a search gone on from loops that were let go, if there is one among its effects, friction is not, and what they leave is the
    /// form of a loop, or far less than all else.
    pub(super) fn beside_laws(&mut self, freed: Vec<Model>) -> Result<Option<Model>, Error> {
        let known = self.tried.clone();
        let left = |m: &Model| m.fit.cost - self.noise;
        let by_plain = known.first().map_or(0.0, left);
        let most = (FORM_OF_ANY * self.gap).max(FORM_BESIDE_PLAIN * by_plain);
        self.tried.retain(|model| !model.key().contains(&LOOP));
        freed.into_iter().for_each(|free| self.remember(free));
        self.ranges.any_loop = true;
        let any = self.select()?;
        let is_it = |m: &Model| {
            let key = m.key();
            key.contains(&LOOP) && !key.contains(&FRICTION) && m.fit.cost - self.noise < most
        };
        if any.as_ref().is_some_and(is_it) {
            return Ok(any);
        }
        self.ranges.any_loop = false;
        self.tried = known;
        Ok(None)
    }

    /// The model of a search gone on from a loop that was let go, where `two` are a plain loop and friction which take back on an axis what the
    /// other one does: each of them twice what is missing there or more. Both then make up for a law that neither has.
    pub(super) fn instead_of_two_that_fight(
        &mut self,
        two: &Model,
    ) -> Result<Option<Model>, Error> {
        let mut key = two.key();
        key.retain(|name| ![LOOP, FRICTION].contains(name));
        let alone = self.tried.iter().find(|m| m.key() == [LOOP]).cloned();
        let (true, Some(alone)) = (key.is_empty() && two.terms.len() == 2, alone) else {
            return Ok(None);
        };
        let mut fight = u32::MAX;
        for t in 0..2 {
            let rig = two.without(self.nominal, t, |_| true)?;
            let stack = self.scene.residuals_at(&rig, Wanted::ALL, self.include)?;
            let axes = two.terms[t].axes().into_iter();
            let takes_back = |axis: &usize| {
                let gap = self.left_on(&self.base, 1 << axis);
                let missing =
                    self.left_on(&stack, 1 << axis) - self.left_on(&two.fit.stack, 1 << axis);
                gap > COUNTS * self.gap && missing > FIGHTS * gap
            };
            fight &= axes.filter(takes_back).fold(0, |mask, axis| mask | 1 << axis);
        }
        if fight == 0 {
            return Ok(None);
        }
        let free = self.let_go_whatever_it_leaves(&alone)?;
        let most = MOST_OF_AN_AXIS * self.left_on(&self.base, fight);
        if self.left_on(&free.fit.stack, fight) < most {
            self.beside_laws(vec![free])
        } else {
            Ok(None)
        }
    }
}
