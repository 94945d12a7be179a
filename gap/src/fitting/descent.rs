//! Where a fit stands, and how it takes a step: damped per part, for axes that nothing ties together.

use host_sim::effects::Place;
use host_sim::rig::Rig;
use nalgebra::{DMatrix, DVector};

use crate::Error;
use crate::fitting::fit::{Sensitivities, free_step, from_step, rig_with, to_step};
use crate::fitting::knobs::Knob;
use crate::session::scene::{Channel, Scene, Stack, Wanted, dot};

/// Channels that any of the knobs can change. A coupling carries what happens on one axis to others.
fn reach(base: &Rig, knobs: &[Knob]) -> Wanted {
    let coupled = knobs.iter().any(Knob::couples)
        || base.effects.iter().any(|s| matches!(s.place, Place::Pair { .. }));
    if coupled {
        return Wanted::ALL;
    }
    Wanted {
        axes: knobs.iter().fold(0, |mask, k| mask | k.wanted(base).axes),
        monitors: knobs.iter().any(|k| k.wanted(base).monitors),
    }
}

/// Residuals of a rig whose knobs reach `wanted`; what they do not reach is that of the rig without them.
fn residuals_within(
    scene: &Scene,
    rig: &Rig,
    wanted: Wanted,
    untouched: Option<&Stack>,
    include: &(dyn Fn(&Channel) -> bool + Sync),
) -> Result<Stack, Error> {
    let Some(untouched) = untouched else {
        return scene.residuals_at(rig, Wanted::ALL, include);
    };
    let mut stack = scene.residuals_at(rig, wanted, include)?;
    for (row, there) in stack.iter_mut().zip(untouched) {
        if row.is_none() {
            row.clone_from(there);
        }
    }
    Ok(stack)
}

/// Dampings that a part tries before it stays where it is.
const TRIALS: usize = 4;

/// Where a fit stands.
pub(crate) struct Descent<'a> {
    scene: &'a Scene,
    base: &'a Rig,
    knobs: &'a [Knob],
    include: &'a (dyn Fn(&Channel) -> bool + Sync),
    reach: Wanted,
    of_axis: Vec<usize>,
    of_knob: Vec<usize>,
    /// Damping of each part.
    lambda: Vec<f64>,
    /// Cost of each part.
    best: Vec<f64>,
    pub(crate) values: Vec<f64>,
    /// Residuals there.
    pub(crate) stack: Stack,
}

impl<'a> Descent<'a> {
    /// At `values`; see [`crate::fitting::fit::fit`].
    pub(crate) fn start(
        scene: &'a Scene,
        base: &'a Rig,
        knobs: &'a [Knob],
        values: Vec<f64>,
        untouched: Option<&Stack>,
        include: &'a (dyn Fn(&Channel) -> bool + Sync),
    ) -> Result<Self, Error> {
        let reach = reach(base, knobs);
        let rig = rig_with(base, knobs, &values)?;
        let stack = residuals_within(scene, &rig, reach, untouched, include)?;
        let (of_axis, of_knob, parts) = independent_parts(scene, base, knobs);
        let best = costs(scene, &stack, knobs, &values, &of_axis, &of_knob, parts);
        let lambda = vec![1.0e-3; parts];
        Ok(Self {
            scene,
            base,
            knobs,
            include,
            reach,
            of_axis,
            of_knob,
            lambda,
            best,
            values,
            stack,
        })
    }

    /// Cost here.
    pub(crate) fn cost(&self) -> f64 {
        self.best.iter().sum()
    }

    /// Cost of each part here.
    pub(crate) fn parts(&self) -> &[f64] {
        &self.best
    }

    /// Normal matrix and gradient here, priors included.
    pub(crate) fn normal(&self, sensitivities: &Sensitivities) -> (DMatrix<f64>, DVector<f64>) {
        let (mut matrix, mut gradient) = sensitivities.normal(self.scene, &self.stack);
        for (k, knob) in self.knobs.iter().enumerate() {
            if let Some(prior) = knob.prior {
                matrix[(k, k)] += 1.0 / (prior.sd * prior.sd);
                gradient[k] += (to_step(knob, self.values[k]) - to_step(knob, prior.centre))
                    / (prior.sd * prior.sd);
            }
        }
        (matrix, gradient)
    }

    /// One damped step, each part with its own damping, which grows until the part improves.
    pub(crate) fn step(
        &mut self,
        matrix: &DMatrix<f64>,
        gradient: &DVector<f64>,
    ) -> Result<(), Error> {
        let (scene, knobs) = (self.scene, self.knobs);
        let start = self.values.clone();
        let mut open: Vec<usize> =
            (0..self.best.len()).filter(|p| self.of_knob.contains(p)).collect();
        for _ in 0..TRIALS {
            let damping: Vec<f64> = self.of_knob.iter().map(|&p| self.lambda[p]).collect();
            let Some(wanted) = step(knobs, &start, matrix, gradient, &damping) else { break };
            // Parts that have already improved keep what they have.
            let trial: Vec<f64> = (0..knobs.len())
                .map(|k| if open.contains(&self.of_knob[k]) { wanted[k] } else { self.values[k] })
                .collect();
            let candidate = rig_with(self.base, knobs, &trial)?;
            // Axes that have taken their step already are not simulated again.
            let coupled = self.reach == Wanted::ALL;
            let still = Wanted {
                axes: (0..self.of_axis.len())
                    .filter(|&a| coupled || open.contains(&self.of_axis[a]))
                    .fold(0, |mask, a| mask | 1 << a)
                    & self.reach.axes,
                ..self.reach
            };
            let Ok(moved) =
                residuals_within(scene, &candidate, still, Some(&self.stack), self.include)
            else {
                self.lambda.iter_mut().for_each(|l| *l *= 10.0);
                continue;
            };
            let parts = self.best.len();
            let after = costs(scene, &moved, knobs, &trial, &self.of_axis, &self.of_knob, parts);
            let better: Vec<usize> =
                open.iter().copied().filter(|&p| after[p] < self.best[p]).collect();
            for (c, row) in moved.into_iter().enumerate() {
                if better.contains(&self.of_axis[scene.channels[c].axis]) {
                    self.stack[c] = row;
                }
            }
            for &p in &open {
                if better.contains(&p) {
                    self.best[p] = after[p];
                    self.lambda[p] = (self.lambda[p] * 0.1).max(1.0e-9);
                } else {
                    self.lambda[p] = (self.lambda[p] * 8.0).max(1.0e-2);
                }
            }
            for ((value, tried), part) in self.values.iter_mut().zip(&trial).zip(&self.of_knob) {
                if better.contains(part) {
                    *value = *tried;
                }
            }
            open.retain(|p| !better.contains(p));
            if open.is_empty() {
                break;
            }
        }
        Ok(())
    }
}

/// Axes that no knob ties together are parts of their own: each takes or refuses a step by itself.
/// Returns the part of each axis and of each knob, and their number.
fn independent_parts(scene: &Scene, rig: &Rig, knobs: &[Knob]) -> (Vec<usize>, Vec<usize>, usize) {
    let axes = scene.position_noise.len();
    let mut part: Vec<usize> = (0..axes).collect();
    let masks: Vec<u32> = knobs.iter().map(|k| k.wanted(rig).axes).collect();
    let coupled = knobs.iter().any(Knob::couples);
    for &mask in &masks {
        let seen: Vec<usize> = (0..axes).filter(|&a| coupled || mask >> a & 1 == 1).collect();
        if let Some(&first) = seen.first() {
            let joined: Vec<usize> = seen.iter().map(|&a| part[a]).collect();
            let into = part[first];
            for p in part.iter_mut().filter(|p| joined.contains(p)) {
                *p = into;
            }
        }
    }
    let of_knob = masks
        .iter()
        .map(|mask| (0..axes).find(|a| mask >> a & 1 == 1).map_or(0, |axis| part[axis]))
        .collect();
    (part, of_knob, axes)
}

/// Cost of each part, priors included.
fn costs(
    scene: &Scene,
    stack: &Stack,
    knobs: &[Knob],
    values: &[f64],
    of_axis: &[usize],
    of_knob: &[usize],
    parts: usize,
) -> Vec<f64> {
    let mut sums = vec![0.0; parts];
    for (row, channel) in stack.iter().zip(&scene.channels) {
        if let Some(row) = row {
            sums[of_axis[channel.axis]] += dot(row, row);
        }
    }
    for (k, knob) in knobs.iter().enumerate() {
        sums[of_knob[k]] += prior_cost(std::slice::from_ref(knob), &values[k..=k]);
    }
    // A model that runs away is as bad as can be.
    sums.into_iter().map(|sum| if sum.is_finite() { sum } else { f64::INFINITY }).collect()
}

/// What the priors add to the cost.
fn prior_cost(knobs: &[Knob], values: &[f64]) -> f64 {
    knobs
        .iter()
        .zip(values)
        .filter_map(|(k, &v)| {
            k.prior.map(|p| ((to_step(k, v) - to_step(k, p.centre)) / p.sd).powi(2))
        })
        .sum()
}

/// One damped step, knobs at a bound that want to leave it frozen.
fn step(
    knobs: &[Knob],
    values: &[f64],
    matrix: &DMatrix<f64>,
    gradient: &DVector<f64>,
    lambda: &[f64],
) -> Option<Vec<f64>> {
    let free: Vec<usize> = (0..knobs.len())
        .filter(|&k| {
            let down = gradient[k] > 0.0;
            matrix[(k, k)] > 1.0e-12
                && !(down && values[k] <= knobs[k].min)
                && (down || values[k] < knobs[k].max)
        })
        .collect();
    if free.is_empty() {
        return None;
    }
    let coordinates: Vec<f64> = knobs.iter().zip(values).map(|(k, v)| to_step(k, *v)).collect();
    let delta = within_ranges(knobs, &coordinates, free, matrix, gradient, lambda)?;
    let moved = |k: usize| {
        if delta[k] == 0.0 {
            return values[k];
        }
        // A log step beyond a factor of e^1.5 or four natural sizes leaves the region where the slope means anything.
        let limit = match (knobs[k].fixed_step, knobs[k].log) {
            (Some(_), false) => 20.0,
            (Some(step), true) => 20.0 * step,
            (None, true) => 1.5,
            (None, false) => 4.0 * coordinates[k].abs().max(1.0),
        };
        from_step(&knobs[k], coordinates[k] + delta[k].clamp(-limit, limit))
    };
    Some((0..knobs.len()).map(moved).collect())
}

/// Step of all knobs of which those that are `free` take part. One that would leave its range goes to the end of it, and the others make up for
/// that: without that two knobs that do nearly the same stand still where one of them is at its end.
fn within_ranges(
    knobs: &[Knob],
    coordinates: &[f64],
    mut free: Vec<usize>,
    matrix: &DMatrix<f64>,
    gradient: &DVector<f64>,
    lambda: &[f64],
) -> Option<Vec<f64>> {
    let mut delta = vec![0.0; knobs.len()];
    while !free.is_empty() {
        let mut damped = DMatrix::zeros(free.len(), free.len());
        let mut rhs = DVector::zeros(free.len());
        for (i, &a) in free.iter().enumerate() {
            let ended = delta.iter().enumerate().filter(|(k, _)| !free.contains(k));
            rhs[i] = -gradient[a] - ended.map(|(k, delta)| matrix[(a, k)] * delta).sum::<f64>();
            for (j, &b) in free.iter().enumerate() {
                damped[(i, j)] = matrix[(a, b)];
            }
            damped[(i, i)] *= 1.0 + lambda[a];
            damped[(i, i)] += 1.0e-9;
        }
        let solved = damped.cholesky()?.solve(&rhs);
        free.iter().zip(solved.iter()).for_each(|(&k, &solved)| delta[k] = solved);
        let within = |k: usize, delta: f64| {
            let reached = from_step(&knobs[k], coordinates[k] + delta);
            (reached != free_step(&knobs[k], coordinates[k] + delta))
                .then(|| to_step(&knobs[k], reached) - coordinates[k])
        };
        let before = free.len();
        free.retain(|&k| match within(k, delta[k]) {
            Some(end) => {
                delta[k] = end;
                false
            }
            None => true,
        });
        if free.len() == before {
            break;
        }
    }
    Some(delta)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fitting::knobs::Target;

    fn knob(min: f64) -> Knob {
        let target = Target::Nominal {
            axis: 0,
            write: |_, _, _, _| {},
            element: 0,
            own_gauge: true,
            monitors: false,
            name: "",
            unit: "1",
        };
        let (max, origin, scale) = (10.0, 0.0, 1.0);
        Knob { target, min, max, origin, scale, log: false, fixed_step: None, prior: None }
    }

    /// The first one is at its end, would gain by going inwards and is pushed outwards by the second one, which does nearly the same.
    #[test]
    fn a_step_goes_to_the_least_within_the_ranges() {
        let knobs = [knob(0.0), knob(-10.0)];
        let matrix = DMatrix::from_row_slice(2, 2, &[1.0, 0.9, 0.9, 1.0]);
        let gradient = DVector::from_row_slice(&[-0.1, -1.0]);
        let moved = step(&knobs, &[0.0, 1.0], &matrix, &gradient, &[0.0; 2]).expect("a step");
        assert_eq!(moved[0], 0.0);
        assert!((moved[1] - 2.0).abs() < 1.0e-6, "{moved:?}");
    }
}
