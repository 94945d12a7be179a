//! One measured quantity of one axis in one recording: its noise, its bands, and how its residuals are weighed.

use statrs::statistics::Statistics;

use crate::session::floor::{self, Kind};
use crate::session::intake::Track;
use crate::session::pyramid::{Levels, low_pass, share_kept, transform};

/// Share of the motion in a recording by which integrators may differ: on the edges of 100 V squares they do by about as much.
const SHARE_OF_MOTION: f64 = 5.0e-4;
/// ... and of its motion from sample to sample: half a step of an integrator that takes 16 a tick. Random binary drives and fast sweeps
/// show it.
const SHARE_OF_STEP: f64 = 0.03;

/// One measured quantity of one axis in one recording.
#[derive(Debug, Clone)]
pub struct Channel {
    /// Index of the recording.
    pub track: usize,
    /// Axis, from 0.
    pub axis: usize,
    /// Position or monitor.
    pub kind: Kind,
    /// Noise, micrometres or volts.
    pub sigma: f64,
    /// Scored samples.
    pub range: std::ops::Range<usize>,
    /// Bands of the scored samples.
    pub levels: Levels,
    /// Variance by which integrators may differ on what was measured, in units of `sigma` squared.
    pub(crate) of_integrators: f64,
    /// Share of the scored samples that were recorded: lost ones are zero in every residual, and hold neither gap nor noise.
    pub present_share: f64,
    /// Variance that nothing can explain, in units of `sigma` squared, band by band, over lost samples as well.
    pub unrepeatable: Vec<f64>,
    /// Weight of each band: one over the square root of its variance.
    pub weights: Vec<f32>,
    /// Directions that the unknown memory of the stack may take, units of the noise.
    pub(crate) memory: Vec<Vec<f32>>,
    /// The same, whitened and orthonormal.
    nuisance: Vec<Vec<f32>>,
    /// Held out from fits.
    pub held_out: bool,
    /// Share of the spectrum, from 0 Hz, that is looked at; 1 is all of it.
    pub kept_share: f64,
}

impl Channel {
    /// A channel weighed by its noise alone.
    pub fn new(
        track_index: usize,
        track: &Track,
        axis: usize,
        kind: Kind,
        sigma: f64,
        range: std::ops::Range<usize>,
    ) -> Self {
        let levels = Levels::new(range.len());
        let present = track.present[range.clone()].iter().filter(|&&present| present).count();
        let present_share = present.max(1) as f64 / range.len().max(1) as f64;
        let mut unrepeatable = floor::unrepeatable_levels(track, axis, kind, sigma, &levels);
        let of_integrators = present_share * of_integrators(track, axis, kind, sigma, &range);
        // What was recorded weighs as much beside lost samples as without.
        let weights = unrepeatable.iter().map(|v| (1.0 / v.sqrt()) as f32).collect();
        unrepeatable.iter_mut().for_each(|v| *v *= present_share);
        Self {
            track: track_index,
            axis,
            kind,
            sigma,
            range,
            levels,
            of_integrators,
            present_share,
            unrepeatable,
            weights,
            memory: Vec::new(),
            nuisance: Vec::new(),
            held_out: false,
            kept_share: 1.0,
        }
    }

    /// Band-weighted coefficients of a residual given in units of the noise, unknown memory removed.
    pub fn whiten(&self, residual: &[f32]) -> Vec<f32> {
        let mut out = if self.kept_share < 1.0 {
            transform(&low_pass(residual, self.kept_share), &self.levels)
        } else {
            transform(residual, &self.levels)
        };
        for (level, &weight) in self.weights.iter().enumerate() {
            if weight != 1.0 {
                for x in &mut out[self.levels.range(level)] {
                    *x *= weight;
                }
            }
        }
        for direction in &self.nuisance {
            let share = dot(&out, direction) as f32;
            for (x, d) in out.iter_mut().zip(direction) {
                *x -= share * d;
            }
        }
        out
    }

    /// Allow for a model of another form: `gap` is the mean square of the nominal residual in each band.
    pub fn weigh(&mut self, power: &[f64], tolerance: f64) {
        self.weights = power
            .iter()
            .zip(&self.unrepeatable)
            .map(|(p, u)| u + tolerance * tolerance * (p - u).max(0.0))
            .map(|variance| (self.present_share / variance).sqrt() as f32)
            .collect();
        self.orthonormalise();
    }

    /// Give the `fastest` bands no weight, and keep what is above them from leaking into the others.
    pub fn leave_out(&mut self, fastest: usize) {
        let last = self.levels.count() - 1;
        for weight in &mut self.weights[..fastest.min(last)] {
            *weight = 0.0;
        }
        self.kept_share = share_kept(fastest);
        self.orthonormalise();
    }

    /// Scored samples that were recorded.
    pub fn samples(&self) -> f64 {
        self.present_share * self.range.len() as f64
    }

    /// `true` where the unknown memory of the stack reaches into the scored part.
    pub fn has_memory(&self) -> bool {
        !self.nuisance.is_empty()
    }

    /// Least-squares removal of the memory directions from a raw residual.
    pub(super) fn remove_memory(&self, row: &mut [f32]) {
        if self.nuisance.is_empty() {
            return;
        }
        let mut basis: Vec<Vec<f32>> = Vec::new();
        for direction in &self.memory {
            let mut d = direction.clone();
            for b in &basis {
                let share = dot(&d, b) as f32;
                d.iter_mut().zip(b).for_each(|(x, y)| *x -= share * y);
            }
            let norm = dot(&d, &d).sqrt();
            if norm > 1.0e-3 * dot(direction, direction).sqrt() {
                d.iter_mut().for_each(|x| *x /= norm as f32);
                let share = dot(row, &d) as f32;
                row.iter_mut().zip(&d).for_each(|(x, y)| *x -= share * y);
                basis.push(d);
            }
        }
    }

    pub(crate) fn orthonormalise(&mut self) {
        self.nuisance.clear();
        for direction in std::mem::take(&mut self.memory) {
            let before = direction.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
            let mut row = self.whiten(&direction);
            let norm = dot(&row, &row).sqrt();
            if norm > 1.0e-3 * before && norm > 0.1 {
                for x in &mut row {
                    *x /= norm as f32;
                }
                self.nuisance.push(row);
            }
            self.memory.push(direction);
        }
    }

    /// Mean square of each band of whitened residual `row`, the weights undone, in units of the noise variance.
    pub fn band_power(&self, row: &[f32]) -> Vec<f64> {
        (0..self.levels.count())
            .map(|level| {
                let part = &row[self.levels.range(level)];
                let weight = f64::from(self.weights[level]);
                let energy: f64 = part.iter().map(|&x| f64::from(x).powi(2)).sum();
                // A band that was left out holds nothing.
                if weight == 0.0 {
                    0.0
                } else {
                    energy / (weight * weight) / part.len().max(1) as f64
                }
            })
            .collect()
    }

    /// Energy of a whitened row beyond what noise leaves there, the weights undone; units of the noise variance.
    pub fn excess(&self, row: &[f32]) -> f64 {
        self.band_power(row)
            .iter()
            .enumerate()
            .filter(|&(l, _)| self.weights[l] > 0.0)
            .map(|(l, p)| (p - self.unrepeatable[l]) * self.levels.range(l).len() as f64)
            .sum()
    }

    /// What noise alone leaves of a raw row: the sum of all samples' variances, in units of the noise variance.
    pub(crate) fn raw_floor(&self) -> f64 {
        let bands = self.unrepeatable.iter().enumerate();
        bands.map(|(l, v)| v * self.levels.range(l).len() as f64).sum()
    }

    /// Cost that noise alone would leave: the sum of all weights squared times the variance that cannot be explained.
    pub fn noise_cost(&self) -> f64 {
        let levels = self.unrepeatable.iter().zip(&self.weights).enumerate();
        levels
            .map(|(l, (v, w))| self.levels.range(l).len() as f64 * v * f64::from(*w).powi(2))
            .sum()
    }

    /// Energy of a whitened row beyond noise, that of the noise, and the standard deviation squared of the latter; weights undone.
    pub fn excess_of(&self, row: &[f32]) -> (f64, f64, f64) {
        let (mut floor, mut spread) = (0.0, 0.0);
        for (level, v) in
            self.unrepeatable.iter().enumerate().filter(|&(l, _)| self.weights[l] > 0.0)
        {
            let n = self.levels.range(level).len() as f64;
            floor += v * n;
            spread += 2.0 * v * v * n;
        }
        (self.excess(row), floor, spread)
    }
}

/// Variance by which integrators may differ on a stretch of what was measured, in units of `sigma` squared.
fn of_integrators(
    track: &Track,
    axis: usize,
    kind: Kind,
    sigma: f64,
    range: &std::ops::Range<usize>,
) -> f64 {
    let (measured, of_step) = match kind {
        Kind::Position => (&track.position_um[axis], SHARE_OF_STEP),
        Kind::Monitor => (&track.monitor_v[axis], 0.0),
    };
    let Some(measured) = measured else { return 0.0 };
    let present = |i: &usize| track.present[*i];
    let moved = range.clone().filter(present).map(|i| f64::from(measured[i]));
    let both = range.clone().skip(1).filter(|i| present(i) && present(&(i - 1)));
    let step = both.map(|i| f64::from(measured[i]) - f64::from(measured[i - 1]));
    let share = |share: f64, deviation: f64| {
        if deviation.is_finite() { (share * deviation / sigma).powi(2) } else { 0.0 }
    };
    share(SHARE_OF_MOTION, moved.population_std_dev()) + share(of_step, step.population_std_dev())
}

/// Inner product in double precision.
pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    // Chunks of single-precision sums vectorise; their totals are added in double precision.
    a.chunks(256)
        .zip(b.chunks(256))
        .map(|(a, b)| {
            let mut lanes = [0.0_f32; 8];
            let (a8, ar) = a.as_chunks::<8>();
            let (b8, br) = b.as_chunks::<8>();
            for (x, y) in a8.iter().zip(b8) {
                for k in 0..8 {
                    lanes[k] += x[k] * y[k];
                }
            }
            let tail: f32 = ar.iter().zip(br).map(|(x, y)| x * y).sum();
            f64::from(lanes.iter().sum::<f32>() + tail)
        })
        .sum()
}
