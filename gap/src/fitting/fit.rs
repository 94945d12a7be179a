//! Joint output-error fit: Levenberg-Marquardt on whitened residuals of simulations.
//!
//! The normal equations are summed channel by channel, so that no Jacobian of millions of rows is ever stored, and knobs whose
//! channels do not overlap share one simulation per finite difference: three axes cost as much as one. That is why the dense solver of the
//! `levenberg-marquardt` crate (one column a knob, one simulation a column) is not used here. Marquardt 1963; bounds by active sets.

use host_sim::rig::Rig;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::Error;
use crate::fitting::descent::Descent;
use crate::fitting::knobs::{Knob, keep_laws};
use crate::session::scene::{Channel, Scene, Stack, Wanted, dot};

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

/// Iterations like the last one that a fit is hoped to have in it: what iterations sum up to that each take off three quarters of the one before.
const MOST_TO_COME: usize = 3;
/// Share of the cost that an axis began with: one that may come below it may close a gap there that is larger than its noise, and goes on,
/// whatever the sum of all axes comes to.
const AN_AXIS: f64 = 0.6;

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
    /// Give up once a few iterations more, each taking off as much as the last one, would not come to this cost.
    pub worth: f64,
}

impl Effort {
    /// What most fits take.
    pub const DEFAULT: Self = Self {
        iterations: 8,
        tolerance: 1.0e-3,
        floor: 0.0,
        hopeless: f64::INFINITY,
        worth: f64::INFINITY,
    };
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
pub(crate) fn to_step(knob: &Knob, value: f64) -> f64 {
    if knob.log { (value / knob.scale).ln() } else { (value - knob.origin) / knob.scale }
}

pub(crate) fn free_step(knob: &Knob, coordinate: f64) -> f64 {
    if knob.log { knob.scale * coordinate.exp() } else { knob.origin + knob.scale * coordinate }
}

pub(crate) fn from_step(knob: &Knob, coordinate: f64) -> f64 {
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
        // Products of the rows of one channel: with the residual, and with each other.
        let of_channel = |(c, channel): (usize, &Channel)| {
            let here = stack[c].as_ref()?;
            let rows: Vec<(usize, &Vec<f32>)> =
                (0..n).filter_map(|k| self.row(k, c, channel.axis).map(|row| (k, row))).collect();
            let along: Vec<f64> = rows.iter().map(|(_, row)| dot(row, here)).collect();
            let products = (0..rows.len())
                .map(|i| rows[..=i].iter().map(|(_, other)| dot(rows[i].1, other)).collect())
                .collect::<Vec<Vec<f64>>>();
            let knobs: Vec<usize> = rows.into_iter().map(|(k, _)| k).collect();
            Some((knobs, along, products))
        };
        let parts: Vec<_> = scene.channels.par_iter().enumerate().map(of_channel).collect();
        let mut matrix = DMatrix::zeros(n, n);
        let mut gradient = DVector::zeros(n);
        // Summed in one order, or two runs would differ.
        for (knobs, along, products) in parts.into_iter().flatten() {
            for (i, &a) in knobs.iter().enumerate() {
                gradient[a] += along[i];
                for (&b, &product) in knobs[..=i].iter().zip(&products[i]) {
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

/// Fit `knobs`, starting at `start`, to the channels that `include` lets through. `untouched`, if known, holds the residuals of
/// `base` there: what no knob reaches is then not simulated again.
pub fn fit(
    scene: &Scene,
    base: &Rig,
    mut knobs: Vec<Knob>,
    start: Vec<f64>,
    effort: Effort,
    untouched: Option<&Stack>,
    include: &(dyn Fn(&Channel) -> bool + Sync),
) -> Result<Fit, Error> {
    knobs.iter_mut().for_each(|knob| knob.keep_to_simulated(base));
    let values: Vec<f64> = start.iter().zip(&knobs).map(|(v, k)| v.clamp(k.min, k.max)).collect();
    keep_laws(&mut knobs, &values);
    let mut normal = DMatrix::zeros(knobs.len(), knobs.len());
    let mut descent = Descent::start(scene, base, &knobs, values, untouched, include)?;
    let mut falls_fast = true;
    let first = descent.parts().to_vec();
    for iteration in 0..effort.iterations {
        let before = descent.cost();
        let parts = descent.parts().to_vec();
        let hopeless = before > effort.hopeless && !falls_fast;
        // One of many that are tried may end in the middle; what is named is fitted to the end.
        let is_late = || effort.hopeless.is_finite() && scene.work.is_spent();
        if knobs.is_empty() || (iteration >= 2 && (hopeless || is_late())) {
            break;
        }
        let (values, stack) = (&descent.values, &descent.stack);
        let sensitivities = Sensitivities::at(scene, base, &knobs, values, stack, include)?;
        let (matrix, gradient) = descent.normal(&sensitivities);
        descent.step(&matrix, &gradient)?;
        normal = matrix;
        let now = descent.cost();
        falls_fast = before - now > FAST * (before - effort.floor);
        if before - now < (effort.tolerance * (before - effort.floor)).max(1.0) {
            break;
        }
        // Iterations take off less and less.
        let to_come = (effort.iterations - iteration - 1).min(MOST_TO_COME) as f64;
        let hoped = |before: f64, now: f64| now - to_come * (before - now);
        let closes_axis = parts
            .iter()
            .zip(descent.parts())
            .zip(&first)
            .any(|((&before, &now), &first)| hoped(before, now) < AN_AXIS * first);
        if iteration >= 1 && hoped(before, now) > effort.worth && !closes_axis {
            break;
        }
    }
    let cost = descent.cost();
    let Descent { values, stack, .. } = descent;
    let rig = rig_with(base, &knobs, &values)?;
    let at_bound = knobs
        .iter()
        .zip(&values)
        .map(|(k, &v)| {
            let slack = 1.0e-6 * (k.max - k.min).abs();
            !k.is_frozen() && (v <= k.min + slack || v >= k.max - slack)
        })
        .collect();
    Ok(Fit { knobs, values, rig, cost, stack, normal, at_bound })
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
