//! Where a threshold lies, before a fit: a clip or a limit of the current does nothing until it is reached, and then much.
//!
//! The screen takes what each effect promises by a straight line, and a straight line leads beyond a threshold: beside effects that are
//! known already, a limit that started there may cost a thousand times the gap, and a fit spends all of its iterations on the way back.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::rig_with;
use crate::fitting::guess::settings;
use crate::fitting::knobs::{EffectRef, axes_seen};
use crate::fitting::model::{Term, knobs_of};
use crate::search::select::Search;
use crate::session::scene::{Stack, Wanted};

/// Where a contact opens: a stage that is hardly there shows it only from close by.
const CONTACT: &str = "contact_m";
/// Multiples of its distance from the near end of the travel that are tried about the best setting of the screen, which are 1.5 to 4 times apart.
const ABOUT: [f64; 10] = [1.0, 0.5, 0.62, 0.75, 0.88, 1.15, 1.35, 1.6, 1.85, 2.2];

impl Search<'_> {
    /// Start values of `effect`, one set a place: those given, or the setting of the screen that leaves least beside the `known` terms
    /// where those given leave more than without the effect, with a contact moved to where it does best about there.
    pub(crate) fn within_threshold(
        &self,
        known: &[(Term, Vec<f64>)],
        effect: EffectRef,
        places: &[Place],
        mut starts: Vec<Vec<f64>>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let (terms, values): (Vec<Term>, Vec<Vec<f64>>) = known.iter().cloned().unzip();
        let axes = places.iter().fold(0, |m, &p| m | axes_seen(self.nominal, effect, p));
        let wanted = Wanted { axes, monitors: true };
        let alone = rig_with(self.nominal, &knobs_of(&terms, &self.ranges), &values.concat())?;
        let beside = |starts: &[Vec<f64>]| {
            let term = Term { effect, places: places.to_vec() };
            rig_with(&alone, &knobs_of(&[term], &self.ranges), &starts.concat())
        };
        let started = beside(&starts)?;
        let stacks = self.scene.residuals(&[(&alone, wanted), (&started, wanted)], self.include)?;
        let left = |stack: &Stack, place: Place| {
            self.scene.cost_on(stack, axes_seen(self.nominal, effect, place))
        };
        let too_far: Vec<usize> = (0..places.len())
            .filter(|&p| left(&stacks[1], places[p]) >= left(&stacks[0], places[p]))
            .collect();
        if too_far.is_empty() {
            return Ok(starts);
        }
        let telling = self.telling(&stacks[0]);
        let offers = settings(effect, &self.ranges);
        let rigs = offers
            .iter()
            .map(|offer| beside(&vec![offer.clone(); places.len()]))
            .collect::<Result<Vec<_>, _>>()?;
        let jobs: Vec<_> = rigs.iter().map(|rig| (rig, wanted)).collect();
        let stacks = self.scene.residuals(&jobs, self.include)?;
        for &p in &too_far {
            let nearest = stacks
                .iter()
                .zip(&offers)
                .min_by(|a, b| left(a.0, places[p]).total_cmp(&left(b.0, places[p])));
            if let Some((_, offer)) = nearest {
                starts[p].clone_from(offer);
            }
        }
        let Some(contact) = effect.info().parameters.iter().position(|p| p.name == CONTACT) else {
            return Ok(starts);
        };
        let (near_m, _) = self.ranges.travel_m;
        let about = |(p, start): (usize, &Vec<f64>)| {
            let moved = |ratio: &f64| {
                let mut values = start.clone();
                values[contact] = near_m + ratio * (values[contact] - near_m);
                values
            };
            let ratios = if too_far.contains(&p) { &ABOUT[..] } else { &ABOUT[..1] };
            ratios.iter().map(moved).collect()
        };
        let offers: Vec<Vec<Vec<f64>>> = starts.iter().enumerate().map(about).collect();
        self.best_of_offers(known, (effect, places), &offers, &telling)
    }
}
