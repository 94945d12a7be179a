//! Few recordings, which show that a model is wrong.
//!
//! What a model cannot do on some recordings it cannot do on all of them. Most models that a search tries are wrong, and a part of the
//! session's time shows it. Recordings are taken by how much gap they hold a second, so that half a minute of holding at a low
//! rate, which costs a simulation as much as everything else, comes last.

use crate::Error;
use crate::fitting::fit::{Effort, fit};
use crate::fitting::knobs::Knob;
use crate::fitting::model::{Term, knobs_from};
use crate::search::select::Search;
use crate::session::scene::{Channel, Scene, Stack, dot};

/// Share of the gap of every axis with one that the few recordings hold.
const HELD: f64 = 0.8;
/// Share of the time recorded that is few.
const IS_FEW: f64 = 0.5;
/// Numbers on one axis that make a fit worth trying on few recordings.
const MANY_NUMBERS: usize = 3;
/// Share of what the best model leaves of everything that a model may leave of few recordings.
const OF_WHOLE: f64 = 0.3;

/// What a model may leave of few recordings to be fitted to all of them: the larger one of these.
#[derive(Clone, Copy)]
pub(crate) struct Line {
    /// As a multiple of what the best model leaves there.
    of_best: f64,
    /// As a share of the gap there.
    of_gap: f64,
}

impl Line {
    /// For effects alone: the best of them may be no cause.
    pub(crate) const ALONE: Self = Self { of_best: 3.0, of_gap: 0.3 };
    /// For effects beside others.
    pub(crate) const BESIDE: Self = Self { of_best: 1.5, of_gap: 0.004 };

    /// The same with no more than this share of the gap.
    pub(crate) fn of_gap_at_most(self, share: f64) -> Self {
        Self { of_gap: self.of_gap.min(share), ..self }
    }
}

/// Few recordings of a session.
pub(crate) struct Few {
    /// Which ones.
    tracks: Vec<usize>,
    /// Nominal residuals there.
    base: Stack,
    /// Cost that noise alone leaves there.
    noise: f64,
    /// Cost of the gap there, beyond noise.
    gap: f64,
}

impl Few {
    /// The recordings that hold enough of the gap `base` on the axes in the mask `loud`; `None` if it takes most of the session.
    pub(crate) fn new(scene: &Scene, base: &Stack, loud: u32) -> Option<Self> {
        let axes: Vec<usize> =
            (0..scene.position_noise.len()).filter(|axis| loud >> axis & 1 == 1).collect();
        let of_tracks = |tracks: &[usize]| -> Stack {
            let rows = base.iter().zip(&scene.channels);
            rows.map(|(row, c)| row.clone().filter(|_| tracks.contains(&c.track))).collect()
        };
        let excess = |stack: &Stack, mask: u32| {
            (scene.cost_on(stack, mask) - scene.noise_on(stack, mask)).max(0.0)
        };
        let used: Vec<usize> = (0..scene.tracks.len())
            .filter(|&t| base.iter().zip(&scene.channels).any(|(r, c)| r.is_some() && c.track == t))
            .collect();
        let gaps: Vec<Vec<f64>> = used
            .iter()
            .map(|&track| {
                let stack = of_tracks(&[track]);
                axes.iter().map(|&axis| excess(&stack, 1 << axis)).collect()
            })
            .collect();
        let whole: Vec<f64> =
            (0..axes.len()).map(|a| gaps.iter().map(|gaps| gaps[a]).sum()).collect();
        let seconds = |n: usize| scene.tracks[used[n]].len() as f64 / scene.tracks[used[n]].rate_hz;
        let mut held = vec![0.0; axes.len()];
        let mut taken: Vec<usize> = Vec::new();
        // What an axis has enough of does not count any more.
        let gain = |n: usize, held: &[f64]| -> f64 {
            let open = (0..axes.len()).filter(|&a| held[a] < HELD * whole[a]);
            open.map(|a| gaps[n][a] / whole[a]).sum::<f64>() / seconds(n)
        };
        while (0..axes.len()).any(|a| held[a] < HELD * whole[a]) {
            let next = (0..used.len())
                .filter(|n| !taken.contains(n))
                .max_by(|&a, &b| gain(a, &held).total_cmp(&gain(b, &held)))?;
            taken.push(next);
            held.iter_mut().zip(&gaps[next]).for_each(|(held, gap)| *held += gap);
        }
        let time: f64 = taken.iter().map(|&n| seconds(n)).sum();
        if taken.is_empty() || time > IS_FEW * (0..used.len()).map(seconds).sum::<f64>() {
            return None;
        }
        let tracks: Vec<usize> = taken.into_iter().map(|n| used[n]).collect();
        let base = of_tracks(&tracks);
        let noise = scene.noise_on(&base, u32::MAX);
        let gap = held.iter().sum();
        Some(Self { tracks, base, noise, gap })
    }
}

impl Search<'_> {
    /// Whether a channel is one of few recordings, or of any where there are none.
    pub(crate) fn is_of_few(&self, channel: &Channel) -> bool {
        let is_there = |few: &Few| few.tracks.contains(&channel.track);
        (self.include)(channel) && self.few.as_ref().is_none_or(is_there)
    }

    /// Values of a fit of `terms` to few recordings alone, if they leave so much there that nothing will come of the model. What they
    /// are fitted to so narrowly is no start for a fit to all recordings: that begins where this one did.
    pub(crate) fn hopeless_on_few(
        &self,
        terms: &[Term],
        start: &[f64],
        effort: Effort,
        line: Line,
    ) -> Result<Option<Vec<f64>>, Error> {
        let knobs = knobs_from(terms, start, &self.ranges);
        let few = match &self.few {
            Some(few) if self.most_numbers(&knobs) >= MANY_NUMBERS => few,
            _ => return Ok(None),
        };
        let include = |c: &Channel| self.is_of_few(c);
        let Some(best) = self.tried.first() else { return Ok(None) };
        let rows = best.fit.stack.iter().zip(&few.base).filter(|(_, base)| base.is_some());
        let there: f64 = rows.filter_map(|(row, _)| row.as_ref()).map(|row| dot(row, row)).sum();
        let left_by_best = best.fit.cost - self.noise;
        // Few recordings may be where the best one does best.
        let there = (there - few.noise).max(OF_WHOLE * left_by_best);
        let open = (line.of_best * there).max(line.of_gap * few.gap);
        let effort =
            Effort { floor: few.noise, hopeless: few.noise + open, worth: f64::INFINITY, ..effort };
        let base = Some(&few.base);
        let fit = fit(self.scene, self.nominal, knobs, start.to_vec(), effort, base, &include)?;
        let left = fit.cost - few.noise;
        // One more effect has to take its share off everything, or off the nanometres: it leaves no less of everything than of this.
        let is_further = terms.len() > best.terms.len();
        let is_worthless = is_further
            && left > left_by_best - self.worth_of_further(left_by_best)
            && !self.may_close_much(best, &fit.stack);
        Ok((left > open || is_worthless).then_some(fit.values))
    }

    /// Most knobs that turn on one axis.
    fn most_numbers(&self, knobs: &[Knob]) -> usize {
        let axes = self.nominal.axes.len();
        let turned = |axis: usize| {
            let here =
                |knob: &&Knob| !knob.is_frozen() && knob.wanted(self.nominal).axes >> axis & 1 == 1;
            knobs.iter().filter(here).count()
        };
        (0..axes).map(turned).max().unwrap_or(0)
    }
}
