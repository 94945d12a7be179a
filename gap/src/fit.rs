//! Joint output-error fit: Levenberg-Marquardt on whitened residuals of simulations.
//!
//! The normal equations are summed channel by channel, so that no Jacobian of millions of rows is ever stored, and knobs whose
//! channels do not overlap share one simulation per finite difference: three axes cost as much as one. That is why the dense solver of the
//! `levenberg-marquardt` crate (one column a knob, one simulation a column) is not used here. Marquardt 1963; bounds by projection.

use host_sim::effects::Place;
use host_sim::rig::Rig;
use nalgebra::{DMatrix, DVector};

use crate::Error;
use crate::knobs::Knob;
use crate::scene::{Channel, Scene, Stack, Wanted, dot};

/// A fitted set of knobs.
#[derive(Clone)]
pub struct Fit {
    /// What was turned.
    pub knobs: Vec<Knob>,
    /// Best values.
    pub values: Vec<f64>,
    /// The rig with them.
    pub rig: Rig,
    /// Sum of squared whitened residuals over the channels that were fitted.
    pub cost: f64,
    /// Whitened residuals there.
    pub stack: Stack,
    /// Normal matrix at the best point, in units of the knobs' steps.
    pub normal: DMatrix<f64>,
    /// `true` where a knob ended at a bound.
    pub at_bound: Vec<bool>,
}

/// Share of what is left that an iteration takes off while a fit is still on its way.
const FAST: f64 = 0.3;

/// How long and on what to fit.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Most iterations.
    pub iterations: usize,
    /// Stop when the cost falls by less than this share of what it was above `floor`.
    pub tolerance: f64,
    /// Cost that no model can go below: that of the noise.
    pub floor: f64,
    /// Give up after two iterations that leave more than this cost and no longer fall fast.
    pub hopeless: f64,
}

impl Effort {
    /// What most fits take.
    pub const DEFAULT: Self =
        Self { iterations: 8, tolerance: 1.0e-3, floor: 0.0, hopeless: f64::INFINITY };
}

impl Default for Effort {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Cost of a stack over the channels it holds.
pub fn cost(stack: &Stack) -> f64 {
    stack.iter().flatten().map(|row| dot(row, row)).sum()
}

/// Build the rig of a set of values.
pub fn rig_with(base: &Rig, knobs: &[Knob], values: &[f64]) -> Result<Rig, Error> {
    let mut rig = base.clone();
    for (knob, &value) in knobs.iter().zip(values) {
        knob.write(&mut rig, value)?;
    }
    Ok(rig)
}

/// Internal coordinate of a value: logarithm or multiple of its natural scale.
fn to_step(knob: &Knob, value: f64) -> f64 {
    if knob.log { (value / knob.scale).ln() } else { (value - knob.origin) / knob.scale }
}

fn free_step(knob: &Knob, coordinate: f64) -> f64 {
    if knob.log { knob.scale * coordinate.exp() } else { knob.origin + knob.scale * coordinate }
}

fn from_step(knob: &Knob, coordinate: f64) -> f64 {
    free_step(knob, coordinate).clamp(knob.min, knob.max)
}

/// Step of the finite difference in internal coordinates: large enough to see past kinks, small enough to be local.
fn difference(knob: &Knob, coordinate: f64) -> f64 {
    if let Some(step) = knob.fixed_step {
        return if knob.log { step } else { step / knob.scale };
    }
    let step = if knob.log { 0.05 } else { 0.05 * coordinate.abs().max(0.2) };
    // Step inwards at the upper bound.
    if free_step(knob, coordinate + step) > knob.max { -step } else { step }
}

/// Groups of knobs that share a simulation because their channels do not overlap.
fn groups(knobs: &[Knob], rig: &Rig) -> Vec<(Vec<usize>, Wanted)> {
    let mut groups: Vec<(Vec<usize>, Wanted)> = Vec::new();
    for (index, knob) in knobs.iter().enumerate().filter(|(_, knob)| !knob.is_frozen()) {
        let wanted = knob.wanted(rig);
        match groups
            .iter_mut()
            .find(|(_, w)| w.axes & wanted.axes == 0 && w.monitors == wanted.monitors)
        {
            Some((members, w)) => {
                members.push(index);
                w.axes |= wanted.axes;
            }
            None => groups.push((vec![index], wanted)),
        }
    }
    groups
}

/// Sensitivities at a point: one whitened stack a group of knobs, per internal step.
pub struct Sensitivities {
    groups: Vec<(Vec<usize>, Wanted)>,
    stacks: Vec<Stack>,
    wanted: Vec<Wanted>,
}

impl Sensitivities {
    /// Number of knobs.
    pub fn len(&self) -> usize {
        self.wanted.len()
    }

    /// `true` without knobs.
    pub fn is_empty(&self) -> bool {
        self.wanted.is_empty()
    }

    /// Change of channel `channel` (of axis `axis`) per internal step of knob `knob`; `None` where it has none.
    pub fn row(&self, knob: usize, channel: usize, axis: usize) -> Option<&Vec<f32>> {
        if self.wanted[knob].axes >> axis & 1 == 0 {
            return None;
        }
        let group = self.groups.iter().position(|(members, _)| members.contains(&knob))?;
        self.stacks[group][channel].as_ref()
    }

    /// Finite differences around `values`.
    pub fn at(
        scene: &Scene,
        base: &Rig,
        knobs: &[Knob],
        values: &[f64],
        stack: &Stack,
        include: &(dyn Fn(&Channel) -> bool + Sync),
    ) -> Result<Self, Error> {
        let groups = groups(knobs, base);
        let mut rigs = Vec::with_capacity(groups.len());
        let mut steps = vec![0.0; knobs.len()];
        for (members, _) in &groups {
            let mut moved = values.to_vec();
            for &k in members {
                let coordinate = to_step(&knobs[k], values[k]);
                let step = difference(&knobs[k], coordinate);
                moved[k] = from_step(&knobs[k], coordinate + step);
                steps[k] = to_step(&knobs[k], moved[k]) - coordinate;
            }
            rigs.push(rig_with(base, knobs, &moved)?);
        }
        let wanted: Vec<Wanted> = knobs.iter().map(|k| k.wanted(base)).collect();
        let jobs: Vec<(&Rig, Wanted)> =
            rigs.iter().zip(&groups).map(|(rig, (_, w))| (rig, *w)).collect();
        let mut stacks = scene.residuals(&jobs, include)?;
        for (moved, (members, _)) in stacks.iter_mut().zip(&groups) {
            for (c, row) in moved.iter_mut().enumerate() {
                let Some(changed) = row else { continue };
                let axis = scene.channels[c].axis;
                let Some(&knob) = members.iter().find(|&&k| wanted[k].axes >> axis & 1 == 1) else {
                    *row = None;
                    continue;
                };
                let Some(here) = &stack[c] else { continue };
                let scale = if steps[knob] == 0.0 { 0.0 } else { (1.0 / steps[knob]) as f32 };
                for (x, &h) in changed.iter_mut().zip(here) {
                    *x = (*x - h) * scale;
                }
            }
        }
        Ok(Self { groups, stacks, wanted })
    }

    /// Normal matrix and gradient over the channels of `stack`.
    pub fn normal(&self, scene: &Scene, stack: &Stack) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.wanted.len();
        let mut matrix = DMatrix::zeros(n, n);
        let mut gradient = DVector::zeros(n);
        for (c, channel) in scene.channels.iter().enumerate() {
            let Some(here) = &stack[c] else { continue };
            let rows: Vec<(usize, &Vec<f32>)> =
                (0..n).filter_map(|k| self.row(k, c, channel.axis).map(|row| (k, row))).collect();
            for (i, &(a, row)) in rows.iter().enumerate() {
                gradient[a] += dot(row, here);
                for &(b, other) in &rows[..=i] {
                    let product = dot(row, other);
                    matrix[(a, b)] += product;
                    if a != b {
                        matrix[(b, a)] += product;
                    }
                }
            }
        }
        (matrix, gradient)
    }
}

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
        return Ok(scene.residuals(&[(rig, Wanted::ALL)], include)?.remove(0));
    };
    let mut stack = scene.residuals(&[(rig, wanted)], include)?.remove(0);
    for (row, there) in stack.iter_mut().zip(untouched) {
        if row.is_none() {
            row.clone_from(there);
        }
    }
    Ok(stack)
}

/// Fit `knobs`, starting at `start`, to the channels that `include` lets through. `untouched`, if known, holds the residuals of
/// `base` there: what no knob reaches is then not simulated again.
pub fn fit(
    scene: &Scene,
    base: &Rig,
    knobs: Vec<Knob>,
    start: Vec<f64>,
    effort: Effort,
    untouched: Option<&Stack>,
    include: &(dyn Fn(&Channel) -> bool + Sync),
) -> Result<Fit, Error> {
    let mut values: Vec<f64> =
        start.iter().zip(&knobs).map(|(v, k)| v.clamp(k.min, k.max)).collect();
    let rig = rig_with(base, &knobs, &values)?;
    let reach = reach(base, &knobs);
    let mut stack = residuals_within(scene, &rig, reach, untouched, include)?;
    let (of_axis, of_knob, parts) = independent_parts(scene, base, &knobs);
    let mut best = costs(scene, &stack, &knobs, &values, &of_axis, &of_knob, parts);
    let mut lambda = vec![1.0e-3; parts];
    let mut normal = DMatrix::zeros(knobs.len(), knobs.len());
    let mut falls_fast = true;
    for iteration in 0..effort.iterations {
        let hopeless = best.iter().sum::<f64>() > effort.hopeless && !falls_fast;
        if knobs.is_empty() || (iteration >= 2 && hopeless) {
            break;
        }
        let sensitivities = Sensitivities::at(scene, base, &knobs, &values, &stack, include)?;
        let (mut matrix, mut gradient) = sensitivities.normal(scene, &stack);
        for (k, knob) in knobs.iter().enumerate() {
            if let Some(prior) = knob.prior {
                matrix[(k, k)] += 1.0 / (prior.sd * prior.sd);
                gradient[k] += (to_step(knob, values[k]) - to_step(knob, prior.centre))
                    / (prior.sd * prior.sd);
            }
        }
        normal = matrix.clone();
        let start = values.clone();
        let before: f64 = best.iter().sum();
        let mut open: Vec<usize> = (0..parts).filter(|&p| of_knob.contains(&p)).collect();
        for _ in 0..4 {
            let damping: Vec<f64> = of_knob.iter().map(|&p| lambda[p]).collect();
            let Some(wanted) = step(&knobs, &start, &matrix, &gradient, &damping) else { break };
            // Parts that have already improved keep what they have.
            let trial: Vec<f64> = (0..knobs.len())
                .map(|k| if open.contains(&of_knob[k]) { wanted[k] } else { values[k] })
                .collect();
            let candidate = rig_with(base, &knobs, &trial)?;
            // Axes that have taken their step already are not simulated again.
            let coupled = reach == Wanted::ALL;
            let still = Wanted {
                axes: (0..of_axis.len())
                    .filter(|&a| coupled || open.contains(&of_axis[a]))
                    .fold(0, |mask, a| mask | 1 << a)
                    & reach.axes,
                ..reach
            };
            let Ok(moved) = residuals_within(scene, &candidate, still, Some(&stack), include)
            else {
                lambda.iter_mut().for_each(|l| *l *= 10.0);
                continue;
            };
            let after = costs(scene, &moved, &knobs, &trial, &of_axis, &of_knob, parts);
            let better: Vec<usize> = open.iter().copied().filter(|&p| after[p] < best[p]).collect();
            for (c, row) in moved.into_iter().enumerate() {
                if better.contains(&of_axis[scene.channels[c].axis]) {
                    stack[c] = row;
                }
            }
            for &p in &open {
                if better.contains(&p) {
                    best[p] = after[p];
                    lambda[p] = (lambda[p] * 0.1).max(1.0e-9);
                } else {
                    lambda[p] = (lambda[p] * 8.0).max(1.0e-2);
                }
            }
            for k in 0..knobs.len() {
                if better.contains(&of_knob[k]) {
                    values[k] = trial[k];
                }
            }
            open.retain(|p| !better.contains(p));
            if open.is_empty() {
                break;
            }
        }
        let now: f64 = best.iter().sum();
        falls_fast = before - now > FAST * (before - effort.floor);
        if before - now < (effort.tolerance * (before - effort.floor)).max(1.0) {
            break;
        }
    }
    let rig = rig_with(base, &knobs, &values)?;
    let best: f64 = best.iter().sum();
    let at_bound = knobs
        .iter()
        .zip(&values)
        .map(|(k, &v)| {
            let slack = 1.0e-6 * (k.max - k.min).abs();
            !k.is_frozen() && (v <= k.min + slack || v >= k.max - slack)
        })
        .collect();
    Ok(Fit { knobs, values, rig, cost: best, stack, normal, at_bound })
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
    let mut damped = DMatrix::zeros(free.len(), free.len());
    let mut rhs = DVector::zeros(free.len());
    for (i, &a) in free.iter().enumerate() {
        rhs[i] = -gradient[a];
        for (j, &b) in free.iter().enumerate() {
            damped[(i, j)] = matrix[(a, b)];
        }
        damped[(i, i)] *= 1.0 + lambda[a];
        damped[(i, i)] += 1.0e-9;
    }
    let delta = damped.cholesky()?.solve(&rhs);
    let mut moved = values.to_vec();
    for (i, &k) in free.iter().enumerate() {
        let coordinate = to_step(&knobs[k], values[k]);
        // A log step beyond a factor of e^1.5 or four natural sizes leaves the region where the slope means anything.
        let limit = match (knobs[k].fixed_step, knobs[k].log) {
            (Some(_), false) => 20.0,
            (Some(step), true) => 20.0 * step,
            (None, true) => 1.5,
            (None, false) => 4.0 * coordinate.abs().max(1.0),
        };
        moved[k] = from_step(&knobs[k], coordinate + delta[i].clamp(-limit, limit));
    }
    Some(moved)
}

impl Fit {
    /// Standard deviations of the values. `inflate` multiplies the noise variance: correlated and model-form error.
    pub fn deviations(&self, inflate: f64) -> Vec<f64> {
        let n = self.knobs.len();
        let mut regular = self.normal.clone();
        for k in 0..n {
            regular[(k, k)] += 1.0e-12 + 1.0e-9 * regular[(k, k)];
        }
        let Some(inverse) = regular.try_inverse() else { return vec![f64::INFINITY; n] };
        (0..n)
            .map(|k| {
                if self.knobs[k].is_frozen() {
                    return 0.0;
                }
                let sd = (inverse[(k, k)].max(0.0) * inflate).sqrt();
                if self.knobs[k].log { sd * self.values[k].abs() } else { sd * self.knobs[k].scale }
            })
            .collect()
    }
}
