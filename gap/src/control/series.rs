//! One axis in one recording, and which parts of it are good for what.
//!
//! A recording is split where samples are missing for long. A part counts as slow where the drive has next to nothing above 20 Hz:
//! inertia and the amplifier's lag then do nothing to what stiffness and hysteresis say.

use std::ops::Range;

use host_sim::rig::Axis;

use crate::session::intake::Track;

/// Length of the moving average that a slow drive does not differ from, s: -3 dB at 18 Hz.
const SMOOTH_S: f64 = 0.025;
/// Rms difference from it, over the span of all drives, that still counts as slow.
const SLOW: f64 = 0.01;
/// A drive that spans less than this in a block, over the span of all drives, is held: it says nothing of hysteresis.
const HELD: f64 = 0.002;
/// What is slow or not as a whole, s.
const BLOCK_S: f64 = 0.1;
/// Samples are averaged over this time for slow fits, s.
const ROW_S: f64 = 0.002;
/// Missing samples that end a stretch, s. Shorter holes are bridged with the last value.
const HOLE_S: f64 = 0.015;
/// Slow parts shorter than this between fast ones belong to them, s: the flat parts of a square wave.
const BRIDGE_S: f64 = 0.5;
/// Shortest fast part whose spectrum is taken, s.
const FAST_S: f64 = 0.4;

/// One axis, from one missing stretch of samples to the next.
pub(super) struct Series {
    pub rate_hz: f64,
    /// First sample on the session's clock, s.
    pub start_s: f64,
    /// Slow strains at the first sample, um: see `creep`.
    pub strains_um: Vec<f64>,
    /// Period of the excitation, s.
    pub period_s: Option<f64>,
    /// Samples that only settle the memory of the stack.
    pub settle: usize,
    /// Commanded, held from its sample to the next, V.
    pub drive_v: Vec<f64>,
    /// At the amplifier's output, V: measured, or else what the amplifier as known makes of the drive.
    pub output_v: Vec<f64>,
    /// Gauge reading less its offset, um.
    pub position_um: Vec<f64>,
    /// Whether there was a usable monitor.
    pub has_monitor: bool,
    /// Blocks of `block` samples: whether they are slow.
    slow: Vec<bool>,
    /// Blocks in which the drive is held.
    held: Vec<bool>,
    block: usize,
    row: usize,
}

/// Part of a motion: one row of slow motion, or one sample of fast motion.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// Mean position, um.
    pub um: f64,
    /// Mean amplifier output, V.
    pub v: f64,
    /// How long it lasts, s.
    pub lasts_s: f64,
    /// Slow but not held, and not of the settling part.
    pub scored: bool,
}

impl Series {
    /// The stretches of an axis in a recording; none without a gauge. `span_v` is that of the drive in the session.
    pub fn of(track: &Track, number: usize, axis: &Axis, span_v: f64) -> Vec<Self> {
        let Some(position) = &track.position_um[number] else { return Vec::new() };
        let offset_um = axis.sensor.offset_m * 1.0e6;
        let position: Vec<f64> = position.iter().map(|&x| f64::from(x) - offset_um).collect();
        let monitor = track.monitor_v[number]
            .as_ref()
            .map(|m| m.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>())
            .filter(|m| follows(m, &track.drive_v[number]));
        let stretches = stretches(&track.present, (HOLE_S * track.rate_hz).ceil() as usize);
        stretches
            .into_iter()
            .map(|part| {
                let present = &track.present[part.clone()];
                let bridged = |x: &[f64]| bridge(&x[part.clone()], present);
                let drive_v = track.drive_v[number][part.clone()].to_vec();
                let has_monitor = monitor.is_some();
                let output_v = match &monitor {
                    Some(monitor) => bridged(monitor),
                    None => lagged(&drive_v, track.rate_hz, axis.amplifier.time_constant_s),
                };
                let row = ((ROW_S * track.rate_hz).round() as usize).max(1);
                let block = row * ((BLOCK_S * track.rate_hz / row as f64).round() as usize).max(1);
                Self {
                    rate_hz: track.rate_hz,
                    start_s: track.start_s + part.start as f64 / track.rate_hz,
                    strains_um: Vec::new(),
                    period_s: track.period_s,
                    settle: track.settle.saturating_sub(part.start),
                    held: drive_v.chunks(block).map(|v| span(v) <= HELD * span_v).collect(),
                    slow: slow_blocks(&drive_v, track.rate_hz, block, SLOW * span_v),
                    position_um: bridged(&position),
                    drive_v,
                    output_v,
                    has_monitor,
                    block,
                    row,
                }
            })
            .collect()
    }

    /// The motion as its slow parts show it: rows where it is slow, every sample where it is not.
    pub fn steps(&self) -> Vec<Step> {
        let mut steps = Vec::new();
        for (block, (&slow, &held)) in self.slow.iter().zip(&self.held).enumerate() {
            let from = block * self.block;
            let to = (from + self.block).min(self.drive_v.len());
            let length = if slow { self.row } else { 1 };
            for start in (from..to).step_by(length) {
                let part = start..(start + length).min(to);
                let n = part.len() as f64;
                steps.push(Step {
                    um: self.position_um[part.clone()].iter().sum::<f64>() / n,
                    v: self.output_v[part.clone()].iter().sum::<f64>() / n,
                    lasts_s: n / self.rate_hz,
                    scored: slow && !held && start >= self.settle && part.len() == self.row,
                });
            }
        }
        steps
    }

    /// Mean drive and position of every row, and how long a row lasts (s).
    pub fn rows(&self) -> (Vec<f64>, Vec<f64>, f64) {
        let mean = |x: &[f64]| -> Vec<f64> {
            x.chunks_exact(self.row).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect()
        };
        (mean(&self.drive_v), mean(&self.position_um), self.row as f64 / self.rate_hz)
    }

    /// Parts with fast excitation that are long enough for a spectrum.
    pub fn fast(&self) -> Vec<Range<usize>> {
        let bridge = (BRIDGE_S * self.rate_hz) as usize;
        let mut parts: Vec<Range<usize>> = Vec::new();
        for (block, _) in self.slow.iter().enumerate().filter(|(_, slow)| !**slow) {
            let from = block * self.block;
            let to = (from + self.block).min(self.drive_v.len());
            match parts.last_mut() {
                Some(last) if from <= last.end + bridge => last.end = to,
                _ => parts.push(from..to),
            }
        }
        for part in &mut parts {
            part.start = part.start.max(self.settle);
        }
        parts.retain(|p| p.end > p.start + (FAST_S * self.rate_hz) as usize);
        parts
    }

    /// Variance of white noise in `x`, from the quietest of its slow blocks; `None` without any.
    pub fn noise_variance(&self, x: &[f64]) -> Option<f64> {
        let blocks = x.chunks_exact(self.block).zip(&self.slow).filter(|(_, slow)| **slow);
        blocks
            .filter(|(x, _)| x.len() > 2)
            // Second differences take off a ramp; their variance is six times that of the samples.
            .map(|(x, _)| {
                x.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).powi(2)).sum::<f64>()
                    / (6.0 * (x.len() - 2) as f64)
            })
            .min_by(f64::total_cmp)
    }
}

/// Whether a monitor is connected: where the drive moves, it moves by some of it too.
fn follows(monitor: &[f64], drive: &[f64]) -> bool {
    span(monitor) >= 0.1 * span(drive)
}

fn span(x: &[f64]) -> f64 {
    x.iter().copied().fold(f64::MIN, f64::max) - x.iter().copied().fold(f64::MAX, f64::min)
}

/// Parts between holes longer than `hole` samples.
fn stretches(present: &[bool], hole: usize) -> Vec<Range<usize>> {
    let mut parts: Vec<Range<usize>> = Vec::new();
    for (n, _) in present.iter().enumerate().filter(|(_, present)| **present) {
        match parts.last_mut() {
            Some(last) if n <= last.end + hole => last.end = n + 1,
            _ => parts.push(n..n + 1),
        }
    }
    parts
}

/// Values where they are present, else the last one that was.
fn bridge(x: &[f64], present: &[bool]) -> Vec<f64> {
    let mut last = x.first().copied().unwrap_or(0.0);
    x.iter()
        .zip(present)
        .map(|(&x, &present)| {
            if present {
                last = x;
            }
            last
        })
        .collect()
}

/// First-order lag of a held input, from rest at its first value.
fn lagged(drive_v: &[f64], rate_hz: f64, time_constant_s: f64) -> Vec<f64> {
    let pole = if time_constant_s > 0.0 { (-1.0 / (rate_hz * time_constant_s)).exp() } else { 0.0 };
    let mut v = drive_v.first().copied().unwrap_or(0.0);
    drive_v
        .iter()
        .map(|u| {
            let now = v;
            v = pole * v + (1.0 - pole) * u;
            now
        })
        .collect()
}

fn slow_blocks(drive_v: &[f64], rate_hz: f64, block: usize, limit_v: f64) -> Vec<bool> {
    let half = (0.5 * SMOOTH_S * rate_hz) as usize;
    let mut sums = Vec::with_capacity(drive_v.len() + 1);
    sums.push(0.0);
    for v in drive_v {
        sums.push(sums[sums.len() - 1] + v);
    }
    let squared: Vec<f64> = drive_v
        .iter()
        .enumerate()
        .map(|(n, v)| {
            // Symmetric, also at the ends, or a ramp would count as fast there.
            let reach = half.min(n).min(drive_v.len() - 1 - n);
            let mean = (sums[n + reach + 1] - sums[n - reach]) / (2 * reach + 1) as f64;
            (v - mean).powi(2)
        })
        .collect();
    squared
        .chunks(block)
        .map(|c| (c.iter().sum::<f64>() / c.len() as f64).sqrt() <= limit_v)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_is_slow_and_a_multisine_is_not() {
        let triangle: Vec<f64> =
            (0..10_000).map(|n| 90.0 * (1.0 - (2.0 * n as f64 / 10_000.0 - 1.0).abs())).collect();
        assert!(slow_blocks(&triangle, 10_000.0, 1_000, 0.9).iter().all(|slow| *slow));
        let tone: Vec<f64> = (0..10_000).map(|n| 3.0 * (0.3 * n as f64).sin()).collect();
        assert!(slow_blocks(&tone, 10_000.0, 1_000, 0.9).iter().all(|slow| !slow));
    }

    #[test]
    fn holes_are_bridged_or_split() {
        let mut present = vec![true; 100];
        present[10..13].fill(false);
        present[50..80].fill(false);
        assert_eq!(stretches(&present, 20), [0..50, 80..100]);
        assert_eq!(bridge(&[1.0, 0.0, 3.0], &[true, false, true]), [1.0, 1.0, 3.0]);
    }
}
