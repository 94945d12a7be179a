//! Which effects: forward selection over fitted models, with a beam, swaps and backward elimination, up to three effects.
//!
//! Costs are whitened (see [`crate::session::scene`]), so that one unit is one noise variance or one tolerated misfit. A further effect must
//! remove a fair share of what the better explained model leaves, not merely more than noise would: with 10^5 samples everything
//! is significant, and an effect whose form differs a little from the rig's leaves something that a second effect could always nibble at.

use host_sim::effects::Place;
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::{Effort, cost, fit};
use crate::fitting::guess::Ranges;
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::{Model, Term, knobs_of, start_terms};
use crate::judge::accept;
use crate::search::few::{Few, Line};
use crate::search::screen::{Gain, Screen, screen};
use crate::search::variety::has_other_laws;
use crate::search::worth::{WORTH_ABSOLUTE, WORTH_OF_GAP};
use crate::session::scene::{Channel, Scene, Stack, Wanted};

/// How many of the promising models a search fits.
#[derive(Debug, Clone, Copy)]
pub struct Breadth {
    /// Singles that are fitted after the screen.
    shortlist: usize,
    /// Models that the search for a further effect starts from.
    pub(crate) beam: usize,
    /// Partners that are fitted for each of them.
    pub(crate) partners: usize,
    /// Effects that are tried in the place of each one of the model chosen.
    pub(crate) swaps: usize,
    /// ... and how many of a single parameter beside them.
    pub(crate) plain: usize,
}

impl Breadth {
    /// For the session as a whole.
    pub const FULL: Self = Self { shortlist: 7, beam: 3, partners: 3, swaps: 3, plain: 2 };
    /// For what a full search has left open.
    pub const BRIEF: Self = Self { shortlist: 5, beam: 2, partners: 2, swaps: 1, plain: 1 };
}

/// Most effects in a model.
pub const MOST_EFFECTS: usize = 3;
/// The first effect must remove this share of the gap: three of less never make an explanation.
pub(crate) const WORTH_OF_FIRST: f64 = 0.05;
/// Share of the gap that the effects which a screen promised leave at most, or the others are fitted as well.
pub(crate) const MOSTLY_OPEN: f64 = 0.5;
/// Share of the gap below which no better start is looked for.
pub(crate) const CLOSED: f64 = 0.002;
/// Share of the gap that a single effect may leave for its fit to go on.
const FAIR: f64 = 0.3;
/// ... beside one that closes all of it,
const RIVAL: f64 = 0.03;
/// ... and as a multiple of what the best one leaves, in between.
const RIVAL_OF_SINGLE: f64 = 5.0;

/// Share of the gap that an effect beside others may leave for its fit to go on,
const BESIDE: f64 = 0.02;
/// ... and as a multiple of what a model leaves that closes the gap on every axis.
const RIVAL_OF_CLEAN: f64 = 10.0;

/// The search: scene, nominal rig, screen of the catalogue and what the whole gap costs.
pub struct Search<'a> {
    /// Session.
    pub scene: &'a Scene,
    /// Rig as it was given.
    pub nominal: &'a Rig,
    /// Whitened nominal residuals of the fitted channels.
    pub base: Stack,
    /// Directions of the catalogue.
    pub screen: Screen,
    /// Cost of the nominal model beyond noise.
    pub gap: f64,
    /// Cost that noise alone leaves.
    pub noise: f64,
    /// Every model that was fitted, best first.
    pub tried: Vec<Model>,
    /// What the session offers.
    pub ranges: Ranges,
    /// How much to try.
    pub breadth: Breadth,
    /// Terms with their values that another look at this session came to.
    pub(crate) known: Vec<(Term, Vec<f64>)>,
    /// Bit mask of the axes where something is missing.
    pub(crate) loud: u32,
    /// Recordings that tell most models from the right one.
    pub(crate) few: Option<Few>,
    pub(crate) include: &'a (dyn Fn(&Channel) -> bool + Sync),
    tick: &'a (dyn Fn() + Sync),
}

impl<'a> Search<'a> {
    /// Screen `effects` on the channels that `include` lets through.
    pub fn new(
        scene: &'a Scene,
        nominal: &'a Rig,
        effects: &[EffectRef],
        ranges: &Ranges,
        include: &'a (dyn Fn(&Channel) -> bool + Sync),
        tick: &'a (dyn Fn() + Sync),
    ) -> Result<Self, Error> {
        let base = scene.residuals_at(nominal, Wanted::ALL, include)?;
        let noise = scene.noise_on(&base, u32::MAX);
        let gap = cost(&base) - noise;
        let loud = accept::loud_axes(scene, &base);
        let few = Few::new(scene, &base, loud);
        let screen = screen(scene, nominal, (&base, loud), effects, ranges, include, tick)?;
        Ok(Self {
            scene,
            nominal,
            base,
            screen,
            gap,
            noise,
            tried: Vec::new(),
            ranges: ranges.clone(),
            breadth: Breadth::FULL,
            known: Vec::new(),
            loud,
            few,
            include,
            tick,
        })
    }

    /// Whether this diagnosis has simulated as much as it may: what was found so far has to do.
    pub(crate) fn is_spent(&self) -> bool {
        self.scene.work.is_spent()
    }

    /// Find the model. `None` when no single effect is worth anything.
    pub fn run(&mut self) -> Result<Option<Model>, Error> {
        let nominal_gains = self.screen.test(self.scene, &self.base, None);
        let singles = self.shortlist(&nominal_gains, &[], usize::MAX);
        for (nth, (effect, gains)) in singles.into_iter().enumerate() {
            // A screen is a straight line, and some effects are not. Where none that it promised accounts for most of the gap, all others
            // get a chance.
            let is_closed = |best: &Model| best.fit.cost - self.noise <= MOSTLY_OPEN * self.gap;
            let is_enough = self.tried.first().is_some_and(is_closed) || self.is_spent();
            if nth >= self.breadth.shortlist && is_enough {
                break;
            }
            let model = self.fit_terms((&[], &self.base), effect, &gains)?;
            self.remember(model);
        }
        self.of_each_axis(&nominal_gains)?;
        self.beside_what_others_have()?;
        if let Some(model) = self.law_beside_elements()? {
            return Ok(Some(model));
        }
        if let Some(model) = self.law_of_an_axis(&nominal_gains)? {
            return Ok(Some(model));
        }
        for size in 2..=MOST_EFFECTS {
            self.compose(size)?;
        }
        self.go_on_from_known()?;
        let had_any_loop = self.ranges.any_loop;
        let plain = self.select()?;
        if self.ranges.any_loop && !had_any_loop {
            return Ok(plain);
        }
        self.with_any_loop(plain, None)
    }

    /// Fit what another look came to: a resonance that it found and this one missed is not lost, and what this one shows can be added.
    fn go_on_from_known(&mut self) -> Result<(), Error> {
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) =
            std::mem::take(&mut self.known).into_iter().unzip();
        if !terms.is_empty() {
            let model = self.fit_model(terms, start.concat(), self.effort())?;
            self.remember(model);
        }
        Ok(())
    }

    /// The best model of those that were fitted and of what can be added to them.
    pub(crate) fn select(&mut self) -> Result<Option<Model>, Error> {
        let mut best: Option<Model> = None;
        for size in 1..=MOST_EFFECTS {
            if size > 1 {
                self.compose(size)?;
                if self.beside_own(size)? {
                    self.compose(size)?;
                }
            }
            let candidate = match &best {
                None => self.best_of(size).filter(|single| {
                    let saved = self.gap - (single.fit.cost - self.noise);
                    saved > WORTH_ABSOLUTE.max(WORTH_OF_FIRST * self.gap)
                }),
                Some(best) => self.worth_it_beyond(best, size),
            };
            let Some(candidate) = candidate else { break };
            let left = candidate.fit.cost - self.noise;
            let is_closed = accept::is_clean(self.scene, &candidate.fit.stack);
            let weighs_nothing = left < WORTH_ABSOLUTE.max(0.1 * WORTH_OF_GAP * self.gap);
            let is_done = is_closed || weighs_nothing && !self.is_clearly_open(&candidate);
            best = Some(candidate);
            if size == MOST_EFFECTS || is_done {
                break;
            }
            let two = best.clone().filter(|best| best.terms.len() == 2);
            let any = two.map(|two| self.two_with_any_loop(&two)).transpose()?.flatten();
            if any.is_some() {
                return Ok(any);
            }
            // What suits different axes may account for everything already.
            let is_done = |m: Model| accept::is_clean(self.scene, &m.fit.stack);
            if self.best_of(size + 1).is_some_and(is_done) || self.is_spent() {
                continue;
            }
            self.widen(size)?;
        }
        match best {
            Some(model) => {
                let model = self.swap(model)?;
                let known = model.key();
                let mut model = self.trade(model)?;
                if model.key() != known {
                    model = self.swap(model)?;
                }
                let model = self.fewer(model)?;
                let pruned = self.prune(model)?;
                // What it is left with may be no less than what a plainer one leaves that was tried on the way.
                let pruned = match self.plainest(pruned.clone()) {
                    plain if plain.numbers() < pruned.numbers() => self.prune(plain)?,
                    _ => pruned,
                };
                let (terms, start): (Vec<Term>, Vec<Vec<f64>>) =
                    start_terms(&pruned).into_iter().unzip();
                let iterations = if self.is_spent() { 3 } else { 6 };
                let effort = Effort { iterations, tolerance: 3.0e-3, ..self.effort() };
                let fitted = self.fit_model(terms, start.concat(), effort)?;
                Ok(Some(self.without_idle(fitted)?))
            }
            None => Ok(None),
        }
    }

    /// Best effects by predicted gain, with the places that are worth fitting.
    pub(crate) fn shortlist(
        &self,
        gains: &[Vec<Gain>],
        taken: &[&str],
        most: usize,
    ) -> Vec<(EffectRef, Vec<Gain>)> {
        let mut ranked: Vec<(f64, EffectRef, Vec<Gain>)> = gains
            .iter()
            .zip(&self.screen.effects)
            .filter(|(_, effect)| !taken.contains(&effect.info().name))
            .filter_map(|(gains, &effect)| {
                let top = gains.iter().map(|g| g.gain).fold(0.0, f64::max);
                let kept: Vec<Gain> = gains
                    .iter()
                    .filter(|g| {
                        g.gain > (0.5 * crate::search::prune::WORTH_OF_PLACE).max(1.0e-4 * top)
                    })
                    .cloned()
                    .collect();
                let total: f64 = kept.iter().map(|g| g.gain).sum();
                (total > WORTH_ABSOLUTE).then_some((total, effect, kept))
            })
            .collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked.truncate(most);
        ranked.into_iter().map(|(_, effect, gains)| (effect, gains)).collect()
    }

    /// Fit `effect` at the places of `gains`, jointly with `known` terms that start at their values and leave `left` without it.
    pub fn fit_terms(
        &self,
        (known, left): (&[(Term, Vec<f64>)], &Stack),
        effect: EffectRef,
        gains: &[Gain],
    ) -> Result<Model, Error> {
        let mut terms: Vec<Term> = known.iter().map(|(t, _)| t.clone()).collect();
        let mut places: Vec<Place> = gains.iter().map(|g| g.place).collect();
        let starts = gains.iter().map(|g| g.start.clone()).collect();
        // Where another effect accounts for nearly all, no frequency that a screen missed will do better.
        let closed = |m: &Model| m.fit.cost - self.noise < CLOSED * self.gap;
        let starts = if known.is_empty() && self.tried.first().is_some_and(closed) {
            starts
        } else {
            self.tuned((known, left), effect, &places, starts)?
        };
        let mut start = self.joint_start(known, effect, gains, &starts)?;
        // An axis where no setting of the screen came near enough to gain anything starts from what suits the others best;
        // pruning takes it out again if it needs none.
        if let Some(best) = gains.iter().max_by(|a, b| a.gain.total_cmp(&b.gain))
            && effect.info().threshold
        {
            for axis in self.loud_axes() {
                if matches!(best.place, Place::Axis(_)) && !places.contains(&Place::Axis(axis)) {
                    places.push(Place::Axis(axis));
                    start.extend_from_slice(&best.start);
                }
            }
        }
        terms.push(Term { effect, places });
        let best = self.tried.first().map_or(f64::INFINITY, |m| m.fit.cost);
        // With a good model at hand, one that is still far behind after two iterations is not worth more of them.
        let hopeless = if known.is_empty() {
            self.noise + (3.0 * (best - self.noise)).max(self.may_leave_alone(effect) * self.gap)
        } else {
            best.max(self.noise + self.may_leave() * self.gap) + 0.05 * (best - self.noise).max(0.0)
        };
        let further = self.tried.first().filter(|first| terms.len() > first.terms.len());
        let worth = further.map_or(f64::INFINITY, |first| {
            first.fit.cost - self.worth_of_further(first.fit.cost - self.noise)
        });
        let effort = Effort { iterations: 8, tolerance: 2.0e-2, hopeless, worth, ..self.effort() };
        let line = if known.is_empty() {
            Line::ALONE.of_gap_at_most(self.may_leave_alone(effect))
        } else {
            Line::BESIDE.of_gap_at_most(self.may_leave())
        };
        if let Some(values) = self.hopeless_on_few(&terms, &start, effort, line)? {
            return self.fit_model(terms, values, Effort { iterations: 0, ..effort });
        }
        let model = self.fit_model(terms, start.clone(), effort)?;
        let model = self.every_pair(model, effort)?;
        let (model, start) = self.without_runaways(model, start, left, effort)?;
        let model = self.resonating_alike(model, left, effort)?;
        let model = self.other_variety(model, effort)?;
        let model = self.rippled(model, effort)?;
        let model = self.other_law(model, &start, effort)?;
        let model = self.further_mode(model, effort)?;
        let model = self.wandering(model, effort)?;
        self.even_out(model, effort)
    }

    /// Share of the gap that a single effect may leave for its fit to go on. The larger one of two that are missing leaves what the smaller
    /// one does, and no other does so much better; beside one that closes everything only what comes near to that is of interest:
    /// what else it could be. One of several laws is not known before it was begun with each of them.
    fn may_leave_alone(&self, effect: EffectRef) -> f64 {
        let left = |best: &Model| (best.fit.cost - self.noise) / self.gap;
        let Some(left) = self.tried.first().map(left) else { return FAIR };
        if left >= CLOSED && has_other_laws(effect) {
            return FAIR;
        }
        (RIVAL_OF_SINGLE * left).clamp(RIVAL, FAIR)
    }

    /// Share of the gap that an effect beside others may leave for its fit to go on. Once a model leaves no gap at all, only what comes near
    /// to it is of interest: what else it could be.
    fn may_leave(&self) -> f64 {
        let best = self.tried.first().filter(|m| accept::is_clean(self.scene, &m.fit.stack));
        let left = |m: &Model| (m.fit.cost - self.noise).max(WORTH_ABSOLUTE) / self.gap;
        best.map_or(BESIDE, |best| (RIVAL_OF_CLEAN * left(best)).min(BESIDE))
    }

    /// Axes may have run into different local minima: start all of them from the values of each other, and keep what is better.
    fn even_out(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let saves = cost(&self.base) - model.fit.cost;
        let left = model.fit.cost - self.noise;
        if model.fit.cost > effort.hopeless
            || saves < WORTH_OF_FIRST * self.gap
            || left < CLOSED * self.gap
        {
            return Ok(model);
        }
        let last = model.terms.len() - 1;
        let term = &model.terms[last];
        if term.places.len() < 2 || !term.places.iter().all(|p| matches!(p, Place::Axis(_))) {
            return Ok(model);
        }
        let uneven = (0..term.effect.info().parameters.len()).any(|k| {
            let values: Vec<f64> =
                (0..term.places.len()).map(|p| model.values(last, p)[k]).collect();
            let (low, high) = values
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
            high - low > 0.25 * high.abs().max(low.abs())
        });
        if !uneven {
            return Ok(model);
        }
        let left = |stack: &Stack, axis: usize| self.scene.cost_on(stack, 1 << axis);
        let axis_of = |p: &Place| match *p {
            Place::Axis(a) => a,
            Place::Pair { on, .. } => on,
        };
        // The axis that lost the largest share of its cost leads.
        let gained: Vec<f64> = term
            .places
            .iter()
            .map(|p| {
                1.0 - left(&model.fit.stack, axis_of(p)) / left(&self.base, axis_of(p)).max(1.0)
            })
            .collect();
        let leader =
            (0..gained.len()).max_by(|&a, &b| gained[a].total_cmp(&gained[b])).unwrap_or(0);
        let mut start = model.fit.values.clone();
        let range = model.knob_range(last);
        let width = range.len() / term.places.len();
        let lead = model.values(last, leader).to_vec();
        for p in 0..term.places.len() {
            start[range.start + p * width..range.start + (p + 1) * width].copy_from_slice(&lead);
        }
        let hopeless = model.fit.cost;
        let other = self.fit_model(
            model.terms.clone(),
            start,
            Effort { iterations: 4, hopeless, ..effort },
        )?;
        Ok(if other.fit.cost < model.fit.cost { other } else { model })
    }

    /// How to fit on this session.
    pub fn effort(&self) -> Effort {
        Effort { tolerance: 1.0e-2, floor: self.noise, ..Effort::default() }
    }

    /// Fit given terms from given values.
    pub fn fit_model(
        &self,
        terms: Vec<Term>,
        start: Vec<f64>,
        effort: Effort,
    ) -> Result<Model, Error> {
        let knobs = knobs_of(&terms, &self.ranges);
        let fit =
            fit(self.scene, self.nominal, knobs, start, effort, Some(&self.base), self.include)?;
        (self.tick)();
        Ok(Model { terms, fit, ranges: self.ranges.clone() })
    }

    /// Keep a fitted model for what follows, and as a rival.
    pub(crate) fn remember(&mut self, model: Model) {
        self.tried.push(model);
        self.tried.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    }

    /// Best model with exactly `size` effects.
    pub fn best_of(&self, size: usize) -> Option<Model> {
        self.tried
            .iter()
            .filter(|m| m.terms.len() == size)
            .min_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost))
            .cloned()
    }
}
