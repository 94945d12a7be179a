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
use crate::search::loops::{HALF, begun_with};
use crate::search::select::Search;

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

impl Search<'_> {
    /// A loop of any law by itself, or the same with one of Bouc and Wen's law in place of a share of its elements, if that leaves less.
    pub(super) fn with_loop_beside(&self, freed: Model) -> Result<Model, Error> {
        let hysteresis = |place: Place| &self.nominal.axes[place.on()].piezo.hysteresis;
        let has_elements = |place: &Place| !hysteresis(*place).limit_v.is_empty();
        let is_alone = freed.terms.len() == 1 && freed.terms[0].places.iter().all(has_elements);
        // Elements that give way have the height and the width of this law, and the wrong minor loops: they may account for little.
        let is_worth_it = self.is_mostly_a_loop(&freed) || self.knows_little();
        if !is_alone || !is_worth_it || !self.scene.work.grants() {
            return Ok(freed);
        }
        let left = freed.fit.cost - self.noise;
        let line = self.noise + LEAVES * left;
        let begun = |share: f64| {
            begun_with(&freed, |place| {
                let elements = hysteresis(place);
                let own = [
                    ("strength", 1.0 - share),
                    ("beside_v", share * elements.limit_v.iter().sum::<f64>()),
                    ("beside_c", CHARGE * elements.full_slip_charge_c()),
                ];
                [&NOMINAL[..], &SHAPE, &own].concat()
            })
        };
        let beside = self.scene.work.grant(|| {
            let only_look = Effort { iterations: 0, ..self.effort() };
            let looks = SHARES.map(|share| self.beside_nominal(&freed, begun(share), only_look));
            let mut starts = looks.into_iter().collect::<Result<Vec<_>, _>>()?;
            starts.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
            // The start is far off, and the way long.
            let effort = Effort { iterations: ITERATIONS, ..self.effort() };
            let nominal = self.beside_nominal(&freed, starts.swap_remove(0).fit.values, effort)?;
            if accept::is_clean(self.scene, &nominal.fit.stack) {
                return Ok(nominal);
            }
            let hopeless = self.noise + ON_THE_WAY * left;
            let effort = Effort { hopeless, ..effort };
            self.fit_model(freed.terms.clone(), nominal.fit.values, effort)
        })?;
        Ok(if beside.fit.cost < line { beside } else { freed })
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
