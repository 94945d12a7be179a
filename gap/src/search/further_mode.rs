//! A further part that swings.
//!
//! A platform and its links have more modes than one. Where a swinging mass is most of the answer, what it leaves rings at the frequency
//! of the next one, as lightly damped and as narrow as the first: a fit only gets there from close by. So frequencies that stand out in the
//! spectrum of what is left are tried for it.

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::model::{Model, start_terms};
use crate::search::select::{CLOSED, Search};
use crate::session::spectra::{push_apart, resonances};

/// The effect that this is about.
const MASS: &str = "second-mass";
/// Share of what the first part leaves that both of them may leave at most: what is missing besides a mass is nibbled at by a second one.
const MUCH_LESS: f64 = 0.3;
/// Share of the gap that the first part leaves at most.
const MOST: f64 = 0.75;
/// ... and as a multiple of what the best model leaves: two parts that swing would not catch up with it.
const BEHIND: f64 = 3.0;
/// Mass of the further part that is tried, as a share of the first one's.
const SHARES: [f64; 2] = [0.1, 0.4];
/// Its damping ratio.
const DAMPING: f64 = 0.02;
/// Frequencies that are tried about one that stands out, as steps beside it and their size: it lies below that with the axis held.
const AROUND: (std::ops::RangeInclusive<i32>, f64) = (-2..=6, 0.02);
/// Frequency beyond what samples tell, as a share of their rate: from there a part moves along as a mass that sits fast does, which would
/// otherwise be named beside the first one.
const BEYOND: f64 = 0.5;

impl Search<'_> {
    /// `model`, or the same with a further part where its last effect, a swinging mass, leaves a resonance, if that leaves much less.
    pub(crate) fn further_mode(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let last = model.terms.len() - 1;
        let term = &model.terms[last];
        let left = model.fit.cost - self.noise;
        let of_best = |best: &Model| (best.fit.cost - self.noise).max(0.0);
        if term.name() != MASS
            || left < CLOSED * self.gap
            || left > MOST * self.gap
            || self.tried.first().is_some_and(|best| left > BEHIND * of_best(best))
            || model.fit.cost > effort.hopeless
        {
            return Ok(model);
        }
        let raw = self.scene.raw(&model.fit.rig, self.include)?;
        // Axes are built alike: what stands out on one of them is tried on the others as well.
        let mut seen: Vec<f64> = Vec::new();
        let of_axes = resonances(self.scene, &raw, self.nominal.sample_rate_hz);
        of_axes.into_iter().flatten().for_each(|hz| push_apart(&mut seen, hz));
        let offers: Vec<Vec<Vec<f64>>> = (0..term.places.len())
            .map(|nth| {
                let plain = model.values(last, nth).to_vec();
                let around = |hz: f64| AROUND.0.map(move |k| hz * (1.0 + f64::from(k) * AROUND.1));
                let hz = seen.iter().flat_map(|&hz| around(hz));
                let with = |hz: f64| {
                    SHARES.map(|share| [&plain[..3], &[share * plain[0], hz, DAMPING]].concat())
                };
                let further: Vec<Vec<f64>> = hz.flat_map(with).collect();
                std::iter::once(plain).chain(further).collect()
            })
            .collect();
        let mut others = start_terms(&model);
        others.truncate(last);
        let telling = self.telling(&model.fit.stack);
        let mut starts =
            self.best_of_offers(&others, (term.effect, &term.places), &offers, &telling)?;
        // Where none of them is better, there may be one beyond them, for which the first part has to make room.
        if starts.iter().zip(&offers).all(|(start, offers)| *start == offers[0]) {
            for start in &mut starts {
                let further = [SHARES[0] * start[0], BEYOND * self.ranges.rate_hz, DAMPING];
                start[3..].copy_from_slice(&further);
            }
        }
        let mut start: Vec<f64> = others.into_iter().flat_map(|(_, values)| values).collect();
        start.extend(starts.concat());
        let line = self.noise + MUCH_LESS * left;
        let effort = Effort { hopeless: line, ..effort };
        let other = self.fit_model(model.terms.clone(), start, effort)?;
        let is_there = other.fit.cost < line;
        Ok(if is_there { other } else { model })
    }
}
