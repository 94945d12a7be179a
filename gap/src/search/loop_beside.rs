//! A loop of Bouc and Wen's law in place of a share of a stack's elements.
//!
//! Elements of any law close their minor loops or forget them, and nine numbers of them bend to what was recorded of a loop that does neither:
//! they close 0.97 of what is fitted, and half of what is not. A fit gets to the other law from nominal elements only, of which the loop
//! takes the place of a share. That is tried where a loop by itself accounts for most of its axes and leaves something,
//! or where nothing else accounts for much.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::{Effort, fit};
use crate::fitting::model::{Model, knobs_of};
use crate::judge::accept;
use crate::search::loops::{HALF, LOOP, begun_with};
use crate::search::select::{CLOSED, Search};

/// Where a fit begins, but for the loop's size: nominal elements.
const NOMINAL: [(&str, f64); 8] = [
    ("slip", 1.0),
    ("tilt", 0.0),
    ("bend", 0.0),
    ("skew", 0.0),
    ("imprint_v", 0.0),
    ("yield", 0.0),
    ("spread", 0.0),
    ("recoil", 1.0),
];
/// Shape of the loop there.
const SHAPE: [(&str, f64); 2] = [("beside_exponent", 1.5), ("beside_recoil", 0.0)];
/// Its charge, as a share of that in which the last element slips.
const CHARGE: f64 = 0.5;
/// Shares of the elements that it takes the place of.
const SHARES: [f64; 3] = [0.05, 0.12, 0.35];
/// Iterations of a fit, and the multiple of what is left without the loop that the one of everything may leave on its way.
const ITERATIONS: usize = 20;
const ON_THE_WAY: f64 = 5.0;
/// Share of what is left without it that may be left with it: it has four numbers of its own.
const LEAVES: f64 = 0.8;
/// Share of the gap that all else leaves at least where it is tried although a loop by itself accounts for little.
const LITTLE: f64 = 0.3;
/// Multiple of what the best single effect leaves that a plain loop may leave for it to be tried at once,
const LEADS: f64 = 1.25;
/// and share of what that effect leaves that may be left with it there.
const FAR_LESS: f64 = 0.2;

impl Search<'_> {
    /// A loop of any law by itself, or the same with one of Bouc and Wen's law in place of a share of its elements, if that leaves less.
    pub(super) fn with_loop_beside(&self, freed: Model) -> Result<Model, Error> {
        let is_alone = freed.terms.len() == 1 && self.has_elements(&freed);
        // Elements that give way have the height and the width of this law, and the wrong minor loops: they may account for little.
        let is_worth_it = self.is_mostly_a_loop(&freed) || self.knows_little();
        if !is_alone || !is_worth_it || !self.scene.work.grants() {
            return Ok(freed);
        }
        let left = freed.fit.cost - self.noise;
        let line = self.noise + LEAVES * left;
        let beside = self.scene.work.grant(|| {
            let nominal = self.beside_elements(&freed)?;
            if accept::is_clean(self.scene, &nominal.fit.stack) {
                return Ok(nominal);
            }
            let hopeless = self.noise + ON_THE_WAY * left;
            let effort = Effort { iterations: ITERATIONS, hopeless, ..self.effort() };
            self.fit_model(freed.terms.clone(), nominal.fit.values, effort)
        })?;
        Ok(if beside.fit.cost < line { beside } else { freed })
    }

    /// The model of a search gone on from such a loop, where it leaves far less than any single effect, of which none does better than a plain
    /// loop. Pairs of a plain loop and what makes up for its law would use up what a search may spend.
    pub(crate) fn law_beside_elements(&mut self) -> Result<Option<Model>, Error> {
        let left = |m: &Model| m.fit.cost - self.noise;
        let is_single = |m: &&Model| m.terms.len() == 1;
        let best = self.tried.iter().find(is_single).map_or(f64::INFINITY, left);
        let leads = |m: &&Model| m.key() == [LOOP] && left(m) < LEADS * best;
        let Some(plain) = self.tried.iter().find(leads).cloned() else { return Ok(None) };
        let says_nothing = best < CLOSED * self.gap || best > (1.0 - HALF) * self.gap;
        let is_first_look = self.known.is_empty() && !self.ranges.any_loop;
        if !is_first_look || says_nothing || !self.has_elements(&plain) || self.is_spent() {
            return Ok(None);
        }
        self.ranges.any_loop = true;
        let beside = self.beside_elements(&plain);
        self.ranges.any_loop = false;
        let beside = beside?;
        if left(&beside) < FAR_LESS * best { self.beside_laws(vec![beside]) } else { Ok(None) }
    }

    /// Whether every loop of a model is of a stack with elements.
    fn has_elements(&self, model: &Model) -> bool {
        let hysteresis = |place: &Place| &self.nominal.axes[place.on()].piezo.hysteresis;
        model.terms[0].places.iter().all(|place| !hysteresis(place).limit_v.is_empty())
    }

    /// Such a loop fitted in the places of `model`, a loop by itself.
    fn beside_elements(&self, model: &Model) -> Result<Model, Error> {
        let begun = |share: f64| {
            begun_with(model, |place| {
                let elements = &self.nominal.axes[place.on()].piezo.hysteresis;
                let own = [
                    ("strength", 1.0 - share),
                    ("beside_v", share * elements.limit_v.iter().sum::<f64>()),
                    ("beside_c", CHARGE * elements.full_slip_charge_c()),
                ];
                [&NOMINAL[..], &SHAPE, &own].concat()
            })
        };
        let only_look = Effort { iterations: 0, ..self.effort() };
        let looks = SHARES.map(|share| self.beside_nominal(model, begun(share), only_look));
        let mut starts = looks.into_iter().collect::<Result<Vec<_>, _>>()?;
        starts.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
        // The start is far off, and the way long.
        let effort = Effort { iterations: ITERATIONS, ..self.effort() };
        self.beside_nominal(model, starts.swap_remove(0).fit.values, effort)
    }

    /// `freed` fitted from these values with its elements as they are nominally, but for their strength: they and the loop can take each other's
    /// place, and all at once a fit ends where they do, right in what it was fitted to and wrong elsewhere.
    fn beside_nominal(
        &self,
        freed: &Model,
        start: Vec<f64>,
        effort: Effort,
    ) -> Result<Model, Error> {
        let mut knobs = knobs_of(&freed.terms, &self.ranges);
        for (knob, value) in knobs.iter_mut().zip(&start) {
            let stays = |name: &str| NOMINAL.iter().any(|(nominal, _)| *nominal == name);
            if knob.parameter().is_some_and(stays) {
                (knob.min, knob.max) = (*value, *value);
            }
        }
        let (base, include) = (Some(&self.base), self.include);
        let fit = fit(self.scene, self.nominal, knobs, start, effort, base, include)?;
        Ok(Model { terms: freed.terms.clone(), fit, ranges: self.ranges.clone() })
    }

    /// Whether nothing that was tried accounts for most of the gap.
    fn knows_little(&self) -> bool {
        self.tried.first().is_none_or(|best| best.fit.cost - self.noise > LITTLE * self.gap)
    }

    /// Whether a loop accounts for most of what there is on its axes: what fades from a reading is a loop to some extent, and the more of one the
    /// more numbers it has.
    fn is_mostly_a_loop(&self, freed: &Model) -> bool {
        let axes = freed.terms[0].places.iter().fold(0, |axes, place| axes | 1 << place.on());
        self.left_on(&freed.fit.stack, axes) < HALF * self.left_on(&self.base, axes)
    }
}
