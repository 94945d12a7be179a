//! Where a fit of one more effect starts, beside effects that were fitted without it.
//!
//! What a screen promises for an effect holds once the others have made room for it: two gains that differ in a loop only promise a
//! tenth each, one up and one down. Started there alone, the fit would begin a hundred times farther from the recordings than without
//! the effect, and might not find back. So every axis begins with what leaves least on it, or all of them together where an effect ties
//! them: the effect's start as it is, the start with the others moved as the same linear prediction has it, or a tenth of the effect.

use host_sim::effects::{Parameter, Role};
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::{from_step, rig_with, to_step};
use crate::fitting::knobs::{EffectRef, Knob};
use crate::fitting::model::{Term, knobs_from, knobs_of};
use crate::search::screen::Gain;
use crate::search::select::Search;
use crate::session::scene::{Channel, Stack, Wanted};

/// Part of an effect that hardly disturbs what is known, and still shows where it leads.
const HINT: f64 = 0.1;

impl Search<'_> {
    /// Values of the `known` terms and of `effect` at the places of `gains`, which would start at `starts` (one set a gain).
    pub(crate) fn joint_start(
        &self,
        known: &[(Term, Vec<f64>)],
        effect: EffectRef,
        gains: &[Gain],
        starts: &[Vec<f64>],
    ) -> Result<Vec<f64>, Error> {
        let mut terms: Vec<Term> = known.iter().map(|(t, _)| t.clone()).collect();
        let values: Vec<f64> = known.iter().flat_map(|(_, v)| v.iter().copied()).collect();
        let whole = [values.clone(), starts.concat()].concat();
        if known.is_empty() {
            return Ok(whole);
        }
        let mut room = values.clone();
        let knobs = knobs_from(&terms, &values, &self.ranges);
        for (k, knob) in knobs.iter().enumerate() {
            let shift: f64 = gains.iter().filter_map(|g| g.shift.get(k)).sum();
            if shift != 0.0 && !knob.is_frozen() {
                room[k] = from_step(knob, to_step(knob, values[k]) + shift);
            }
        }
        let mut tries = vec![whole, [room, starts.concat()].concat()];
        if !effect.info().threshold {
            let hints = starts.iter().flat_map(|start| hint(effect.info().parameters, start));
            tries.push(values.iter().copied().chain(hints).collect());
        }
        terms.push(Term { effect, places: gains.iter().map(|g| g.place).collect() });
        self.best_by_axis(&terms, tries)
    }

    /// Of several sets of values the one that leaves least, chosen on every axis by itself if nothing ties them.
    fn best_by_axis(&self, terms: &[Term], tries: Vec<Vec<f64>>) -> Result<Vec<f64>, Error> {
        let knobs = knobs_of(terms, &self.ranges);
        let rigs: Vec<Rig> = tries
            .iter()
            .map(|values| rig_with(self.nominal, &knobs, values))
            .collect::<Result<_, _>>()?;
        let few = |c: &Channel| self.is_of_few(c);
        let left: Vec<Option<Stack>> =
            rigs.iter().map(|rig| self.scene.residuals_at(rig, Wanted::ALL, few).ok()).collect();
        let ties = knobs.iter().any(Knob::couples);
        let on_axis = |stack: &Option<Stack>, axis: usize| {
            let mask = if ties { u32::MAX } else { 1 << axis };
            stack.as_ref().map_or(f64::INFINITY, |stack| self.scene.cost_on(stack, mask))
        };
        let best: Vec<usize> = (0..self.nominal.axes.len())
            .map(|axis| {
                let left: Vec<f64> = left.iter().map(|stack| on_axis(stack, axis)).collect();
                (0..left.len()).min_by(|&a, &b| left[a].total_cmp(&left[b])).unwrap_or(0)
            })
            .collect();
        let of_term = |term: &Term| -> Vec<usize> {
            let width = term.effect.info().parameters.len();
            term.places.iter().flat_map(|place| vec![best[place.on()]; width]).collect()
        };
        let chosen: Vec<usize> = terms.iter().flat_map(of_term).collect();
        Ok(chosen.iter().enumerate().map(|(k, &t)| tries[t][k]).collect())
    }
}

/// `start` with a part of the effect.
fn hint(parameters: &[Parameter], start: &[f64]) -> Vec<f64> {
    let part = |(p, &value): (&Parameter, &f64)| match p.role {
        Role::Size if p.log => p.zero * (value / p.zero).powf(HINT),
        Role::Size => p.zero + HINT * (value - p.zero),
        _ => value,
    };
    parameters.iter().zip(start).map(part).collect()
}
