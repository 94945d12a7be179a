//! What a fitted model does not need: effects and places that save too little to be named.

use host_sim::effects::Place;
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::knobs::axes_seen;
use crate::fitting::model::{Model, Term, start_terms};
use crate::judge::accept::{self, has_many_laws};
use crate::search::last_axis::{is_as_elsewhere, is_same_elsewhere};
use crate::search::select::Search;
use crate::search::worth::{WORTH_ABSOLUTE, WORTH_OF_GAP};
use crate::session::scene::{Wanted, dot};

/// A place of an effect must be worth this much cost to stay.
pub(crate) const WORTH_OF_PLACE: f64 = 40.0;
/// ... and this share of what the effect's best place is worth, unless it is this share of all that is missing on its axis, beside the
/// others as well: what ties axes together leaves little of a loud one on a quiet one.
const WORTH_OF_TOP: f64 = 0.004;
const MOST_OF_AXIS: f64 = 0.5;
/// ... and this share of what is left on its axis. Less is what the form of another effect there leaves.
const WORTH_OF_LEFT: f64 = 0.1;

/// ... and this share of what the others leave there if they are fitted without it, where one of them is of many laws: less trims its form.
const WORTH_OF_TRIM: f64 = 2.0 / 3.0;

/// Iterations of that fit.
const REFORMED: usize = 12;

/// How the names of lines end.
pub(crate) const HUM: &str = "-hum";

/// What a place of an effect is worth.
#[derive(Clone, Copy)]
struct Worth {
    /// Rise of the cost without it.
    cost: f64,
    /// Whether that would count as a gap.
    counts: bool,
}

impl Search<'_> {
    /// Take out terms and places that the model does not need, and fit the rest again.
    pub fn prune(&self, model: Model) -> Result<Model, Error> {
        let mut model = model;
        loop {
            let worth = self.worth(&model)?;
            let noticed = self.noticed(&model)?;
            let mut kept_terms = Vec::new();
            let mut start = Vec::new();
            let mut dropped = false;
            // Two that do not count apart may count together: one of them goes first, and the other one is asked again.
            let mut asked: u32 = 0;
            for (t, term) in model.terms.iter().enumerate() {
                let total: f64 = worth[t].iter().map(|place| place.cost).sum();
                let top = worth[t].iter().map(|place| place.cost).fold(0.0, f64::max);
                let mut places = Vec::new();
                for (p, &place) in term.places.iter().enumerate() {
                    let axes = axes_seen(self.nominal, term.effect, place);
                    let gap = self.left_on(&self.base, axes);
                    let is_one_of_several = term.places.len() > 1;
                    let left =
                        if is_one_of_several { self.left_on(&model.fit.stack, axes) } else { 0.0 };
                    let missing = gap.min(worth[t][p].cost + self.left_on(&model.fit.stack, axes));
                    let of_top = (WORTH_OF_TOP * top).min(MOST_OF_AXIS * missing);
                    let needed =
                        worth[t][p].cost > WORTH_OF_PLACE.max(of_top).max(WORTH_OF_LEFT * left);
                    let term_needed =
                        noticed[t] && total > WORTH_ABSOLUTE.max(0.1 * WORTH_OF_GAP * self.gap);
                    let counts = worth[t][p].counts || asked & axes != 0;
                    if !counts {
                        asked |= axes;
                    }
                    if needed && term_needed && counts {
                        places.push(place);
                        start.extend_from_slice(model.values(t, p));
                    } else {
                        dropped = true;
                    }
                }
                if !places.is_empty() {
                    kept_terms.push(Term { effect: term.effect, places });
                }
            }
            if kept_terms.is_empty() {
                return Ok(model);
            }
            if !dropped {
                return self.without_trims(model);
            }
            model = self.fit_model(kept_terms, start, Effort { iterations: 4, ..self.effort() })?;
        }
    }

    /// `model` without places that have come to nothing once all were fitted to the end: they made up for what others had not come to yet.
    pub(crate) fn without_idle(&self, model: Model) -> Result<Model, Error> {
        let worth = self.worth(&model)?;
        let is_idle = |t: usize, p: usize| worth[t][p].cost < WORTH_OF_PLACE;
        let is_kept = |term: &Term, here: &Term| {
            let nth = model.terms.iter().position(|known| known.name() == term.name());
            let place = term.places.iter().position(|known| *known == here.places[0]);
            nth.zip(place).is_none_or(|(t, p)| !is_idle(t, p))
        };
        let kept = model.part(is_kept);
        let places = |terms: &[Term]| terms.iter().map(|term| term.places.len()).sum::<usize>();
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = kept.into_iter().unzip();
        if terms.is_empty() || places(&terms) == places(&model.terms) {
            return Ok(model);
        }
        self.fit_model(terms, start.concat(), Effort { iterations: 3, ..self.effort() })
    }

    /// `model` without the places of effects on several axes that only trim the form of an effect of many laws: with that one fitted again they
    /// leave less than three times as much of their axis. What ties axes together brings its form to others.
    fn without_trims(&self, model: Model) -> Result<Model, Error> {
        let iterations = if self.is_spent() { 3 } else { 6 };
        let effort = Effort { iterations, ..self.effort() };
        let mut best = model;
        let mut is_fitted = false;
        for t in 0..best.terms.len() {
            for place in best.terms[t].places.clone() {
                let axes = axes_seen(self.nominal, best.terms[t].effect, place);
                // No form leaves a line of one frequency.
                let is_asked = matches!(place, Place::Axis(_))
                    && !best.terms[t].name().ends_with(HUM)
                    && best.terms[t].places.len() > 1
                    && self.has_form_of_another(&best, t, axes)
                    && !is_as_elsewhere(&best, t, place, |_| true)
                    && !is_same_elsewhere(&best, t, place);
                if !is_asked {
                    continue;
                }
                // As far as what it is compared with.
                if !is_fitted {
                    let (terms, start): (Vec<Term>, Vec<Vec<f64>>) =
                        start_terms(&best).into_iter().unzip();
                    best = self.fit_model(terms, start.concat(), effort)?;
                    is_fitted = true;
                }
                let name = best.terms[t].name();
                let rest = best.part(|term, here| term.name() != name || here.places[0] != place);
                let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = rest.into_iter().unzip();
                // The form has to find itself again without what trimmed it.
                let further = Effort { iterations: REFORMED, ..effort };
                let without = self.fit_model(terms, start.concat(), further)?;
                let [with, left] =
                    [&best, &without].map(|model| self.left_on(&model.fit.stack, axes));
                // What drifts is many nanometres and little cost: a resonance that is met to a percent leaves more of that. Most of an axis is no
                // trim.
                let energy = |stack| self.scene.excess_on(stack, axes);
                let saved = energy(&without.fit.stack) - energy(&best.fit.stack);
                if left - with < WORTH_OF_PLACE.max(WORTH_OF_TRIM * left)
                    && saved < MOST_OF_AXIS * energy(&self.base)
                {
                    best = without;
                }
            }
        }
        Ok(best)
    }

    /// Whether each effect takes off what by itself would count as a gap. With long recordings far less is significant: what another
    /// one's form leaves, which is no cause.
    fn noticed(&self, model: &Model) -> Result<Vec<bool>, Error> {
        if model.terms.len() < 2 {
            return Ok(vec![true; model.terms.len()]);
        }
        let rigs = (0..model.terms.len())
            .map(|t| model.without(self.nominal, t, |_| true))
            .collect::<Result<Vec<_>, _>>()?;
        let jobs: Vec<(&Rig, Wanted)> = rigs.iter().map(|rig| (rig, Wanted::ALL)).collect();
        let stacks = self.scene.residuals(&jobs, self.include)?;
        let counts = |without| accept::counts(self.scene, without, &model.fit.stack, u32::MAX);
        Ok(stacks.iter().map(counts).collect())
    }

    /// Rise of the cost when each place of each term is taken out, the rest left as it is, and whether it would count as a gap beside
    /// other terms: what the form of one of them leaves on an axis is no cause there.
    fn worth(&self, model: &Model) -> Result<Vec<Vec<Worth>>, Error> {
        let mut worth = Vec::new();
        for (t, term) in model.terms.iter().enumerate() {
            let mut row = vec![Worth { cost: 0.0, counts: true }; term.places.len()];
            // Places that reach different channels share a simulation.
            let mut groups: Vec<(Vec<usize>, u32)> = Vec::new();
            for (p, &place) in term.places.iter().enumerate() {
                let axes = axes_seen(self.nominal, term.effect, place);
                match groups.iter_mut().find(|(_, mask)| *mask & axes == 0) {
                    Some((members, mask)) => {
                        members.push(p);
                        *mask |= axes;
                    }
                    None => groups.push((vec![p], axes)),
                }
            }
            for (members, axes) in groups {
                let dropped: Vec<Place> = members.iter().map(|&p| term.places[p]).collect();
                let rig = model.without(self.nominal, t, |place| dropped.contains(&place))?;
                let wanted = Wanted { axes, monitors: true };
                let stack = self.scene.residuals_at(&rig, wanted, self.include)?;
                for &p in &members {
                    let mask = axes_seen(self.nominal, term.effect, term.places[p]);
                    row[p].counts = model.terms.len() < 2
                        || accept::counts(self.scene, &stack, &model.fit.stack, mask);
                    for (c, channel) in self.scene.channels.iter().enumerate() {
                        if mask >> channel.axis & 1 == 0 {
                            continue;
                        }
                        if let (Some(out), Some(with)) = (&stack[c], &model.fit.stack[c]) {
                            row[p].cost += dot(out, out) - dot(with, with);
                        }
                    }
                }
            }
            worth.push(row);
        }
        Ok(worth)
    }

    /// Whether what an effect of many laws, other than term `t`, leaves is seen on some of the `axes`: it acts there, or on an axis that is tied to one.
    fn has_form_of_another(&self, model: &Model, t: usize, axes: u32) -> bool {
        let places = model.terms.iter().flat_map(|term| &term.places);
        let tied = places.fold(axes, |tied, place| match *place {
            Place::Pair { on, from } if axes >> on & 1 == 1 || axes >> from & 1 == 1 => {
                tied | 1 << on | 1 << from
            }
            _ => tied,
        });
        let is_seen = |term: &Term| {
            let mut places = term.places.iter();
            places.any(|&place| axes_seen(self.nominal, term.effect, place) & tied != 0)
        };
        let mut others = model.terms.iter().enumerate().filter(|(other, _)| *other != t);
        others.any(|(_, term)| has_many_laws(term.name()) && is_seen(term))
    }
}
