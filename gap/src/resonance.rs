//! Where a resonance lies, before a fit: a lightly damped one is narrower than the step that a fit takes towards it.
//!
//! A mode with a quality of a hundred spans one per cent of its frequency. From three per cent beside it, a fit sees a hill that it can
//! only lower by damping the model's own mode away. So frequencies around the one that the screen liked are tried first.

use host_sim::effects::Place;

use crate::Error;
use crate::fit::rig_with;
use crate::knobs::{EffectRef, axes_seen};
use crate::model::{Term, knobs_of};
use crate::scene::{Channel, Stack, Wanted, dot};
use crate::select::Search;

/// Frequencies that are tried around a start, as steps beside it and their size: first the coarse ones, then between them.
const SCANS: [(i32, f64); 2] = [(7, 0.01), (3, 0.0025)];

/// Share of what is left that the recordings hold in which frequencies are tried.
const TELLING: f64 = 0.8;

impl Search<'_> {
    /// Start values of `effect` at `places`, one set a place, moved to the frequencies that suit the session best beside the
    /// `known` terms, which leave `left`, or within the reach of a threshold. Effects with neither stay as they are.
    pub(crate) fn tuned(
        &self,
        (known, left): (&[(Term, Vec<f64>)], &Stack),
        effect: EffectRef,
        places: &[Place],
        mut starts: Vec<Vec<f64>>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let moved: fn(&[f64], f64, f64) -> Vec<f64> = match effect.info().name {
            // The frequency goes with the root of the mass.
            "inertia" => |values, ratio, mass_kg| {
                let mut values = values.to_vec();
                values[0] = (mass_kg + values[0]) / (ratio * ratio) - mass_kg;
                values
            },
            "second-mass" => |values, ratio, _| {
                let mut values = values.to_vec();
                values[1] *= ratio;
                values
            },
            _ if effect.info().threshold => {
                return self.within_threshold(known, effect, places, starts);
            }
            _ => return Ok(starts),
        };
        let mass_kg = self.ranges.mass_kg;
        let telling = self.telling(left);
        let include = |c: &Channel| (self.include)(c) && telling.contains(&c.track);
        for (reach, step) in SCANS {
            let ratios: Vec<f64> = (-reach..=reach).map(|k| 1.0 + f64::from(k) * step).collect();
            let mut rigs = Vec::with_capacity(ratios.len());
            for &ratio in &ratios {
                let mut terms: Vec<Term> = known.iter().map(|(term, _)| term.clone()).collect();
                terms.push(Term { effect, places: places.to_vec() });
                let mut values: Vec<f64> =
                    known.iter().flat_map(|(_, v)| v.iter().copied()).collect();
                values.extend(starts.iter().flat_map(|start| moved(start, ratio, mass_kg)));
                rigs.push(rig_with(self.nominal, &knobs_of(&terms, &self.ranges), &values)?);
            }
            let axes = places.iter().fold(0, |m, &p| m | axes_seen(self.nominal, effect, p));
            let jobs: Vec<_> =
                rigs.iter().map(|rig| (rig, Wanted { axes, monitors: false })).collect();
            let stacks = self.scene.residuals(&jobs, include)?;
            for (start, &place) in starts.iter_mut().zip(places) {
                let mask = axes_seen(self.nominal, effect, place);
                let left = |stack: &Stack| self.scene.cost_on(stack, mask);
                let finite =
                    stacks.iter().map(left).zip(&ratios).filter(|(left, _)| left.is_finite());
                let best = finite.min_by(|a, b| a.0.total_cmp(&b.0));
                if let Some((_, &ratio)) = best {
                    *start = moved(start, ratio, mass_kg);
                }
            }
        }
        Ok(starts)
    }

    /// The recordings that hold most of what is left. A frequency that is off shows where the resonance rings, and costs a simulation
    /// of everything else.
    fn telling(&self, left: &Stack) -> Vec<usize> {
        let mut gaps = vec![0.0; self.scene.tracks.len()];
        for (row, channel) in left.iter().zip(&self.scene.channels) {
            if let Some(row) = row {
                gaps[channel.track] += dot(row, row) - channel.noise_cost();
            }
        }
        let mut order: Vec<usize> = (0..gaps.len()).filter(|&track| gaps[track] > 0.0).collect();
        order.sort_by(|&a, &b| gaps[b].total_cmp(&gaps[a]));
        let wanted = TELLING * gaps.iter().map(|gap| gap.max(0.0)).sum::<f64>();
        let mut held = 0.0;
        order.retain(|&track| {
            let is_needed = held < wanted;
            held += gaps[track];
            is_needed
        });
        order
    }
}
