//! The noise floor, measured from the recordings.
//!
//! Three independent estimates for every axis: first differences where no drive moves (zero-input), fourth differences
//! everywhere (smooth motion cancels, white noise does not), and the difference of successive periods where the
//! excitation is periodic. Each of them can only be too high, but for chance: those that agree with the lowest reliable one are pooled. The lowest
//! by itself is too low by half a per cent, which is a hundredth of the noise energy of a session, more than many an effect leaves. What
//! differs from period to period is kept level by level as well, because no model can explain it.

use host_sim::rig::Rig;

use crate::session::intake::Track;
use crate::session::pyramid::{Levels, transform};
use crate::session::scene::METRES_TO_UM;

/// A quantity that was measured along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// Gauge position, micrometres.
    Position,
    /// Amplifier output, volts.
    Monitor,
}

impl Kind {
    /// Noise of an axis that the rig file states, in the unit of the channel (root mean square); 0 where it says nothing.
    pub(crate) fn stated(self, rig: &Rig, axis: usize) -> f64 {
        match self {
            Self::Position => rig.axes[axis].sensor.noise_rms_m * METRES_TO_UM,
            Self::Monitor => rig.axes[axis].monitor.as_ref().map_or(0.0, |m| m.noise_rms_v),
        }
    }
}

/// Noise of one axis and kind over the session.
#[derive(Debug, Clone, Copy, Default)]
pub struct Noise {
    /// What the tool works with, in the unit of the channel (micrometres or volts, root mean square).
    pub sigma: f64,
    /// From stretches of constant drive.
    pub quiet: Option<f64>,
    /// From fourth differences: recordings that agree with their lower quartile.
    pub high_pass: Option<f64>,
    /// From successive periods.
    pub periodic: Option<f64>,
}

/// Shortest stretch of constant drive that counts as zero input, seconds.
const QUIET_S: f64 = 0.05;

/// Standard errors of a level of white noise, as a share of it, times the square root of the number of samples: from first and from fourth
/// differences, of which neighbours share their samples, and from samples that do not.
const OF_FIRST: f64 = 0.87;
const OF_FOURTH: f64 = 1.15;
const OF_SAMPLES: f64 = 0.71;
/// Multiple of their standard errors within which two levels agree.
const AGREES: f64 = 3.0;

/// A level of white noise.
#[derive(Debug, Clone, Copy)]
struct Level {
    /// Root mean square, in the unit of the channel.
    sigma: f64,
    /// Its standard error, as a share of it.
    error: f64,
}

impl Level {
    fn of(values: &mut [f64], error: f64) -> Self {
        Self { sigma: spread(values), error: error / (values.len().max(1) as f64).sqrt() }
    }

    /// Mean of those of `levels` that agree with this one, itself among them.
    fn pooled(self, levels: &[Self]) -> Self {
        let agrees = |other: &&Self| {
            (other.sigma / self.sigma - 1.0).abs() <= AGREES * other.error.hypot(self.error)
        };
        let (mut weights, mut energy) = (0.0, 0.0);
        for level in levels.iter().filter(agrees) {
            let weight = level.error.powi(-2);
            weights += weight;
            energy += weight * level.sigma.powi(2);
        }
        if weights > 0.0 {
            Self { sigma: (energy / weights).sqrt(), error: weights.powf(-0.5) }
        } else {
            self
        }
    }
}

/// Median of absolute values as a standard deviation of a normal distribution.
pub fn robust_sd(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    for v in values.iter_mut() {
        *v = v.abs();
    }
    let middle = values.len() / 2;
    let (_, median, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    1.4826 * *median
}

/// White-noise level of a series from its fourth differences. Steps and edges are few and do not move a median.
fn high_pass(series: &[f32], present: &[bool]) -> Option<Level> {
    let mut values: Vec<f64> = series
        .windows(5)
        .zip(present.windows(5))
        .filter(|(_, p)| p.iter().all(|&p| p))
        .map(|(w, _)| {
            let w: Vec<f64> = w.iter().map(|&x| f64::from(x)).collect();
            w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4]
        })
        .collect();
    // Variance of the fourth difference of unit white noise: the central binomial coefficient C(8, 4).
    (values.len() >= 200).then(|| {
        let level = Level::of(&mut values, OF_FOURTH);
        Level { sigma: level.sigma / 70.0_f64.sqrt(), ..level }
    })
}

/// Standard deviation without the few large values: those within five robust deviations count. The median alone would be
/// too coarse for samples that are rounded to an eighth of their noise.
fn spread(values: &mut [f64]) -> f64 {
    let mut limit = 5.0 * robust_sd(values);
    let mean_square = |limit: f64, values: &[f64]| {
        let (mut sum, mut n) = (0.0, 0_usize);
        for &v in values.iter().filter(|v| v.abs() <= limit) {
            sum += v * v;
            n += 1;
        }
        if n == 0 { 0.0 } else { (sum / n as f64).sqrt() }
    };
    if limit == 0.0 {
        // More than half of the values are equal: rounding is coarser than the noise.
        limit = f64::INFINITY;
    }
    mean_square(limit, values)
}

/// First differences over the square root of two where no drive has moved for a while.
fn quiet_differences(track: &Track, series: &[f32]) -> Vec<f64> {
    let need = (QUIET_S * track.rate_hz).ceil().max(20.0) as usize;
    let mut differences = Vec::new();
    let mut still = 0_usize;
    for i in 1..track.len() {
        let moved = track.drive_v.iter().any(|d| d[i] != d[i - 1]);
        still = if moved { 0 } else { still + 1 };
        if still > need && track.present[i] && track.present[i - 1] {
            differences
                .push((f64::from(series[i]) - f64::from(series[i - 1])) / std::f64::consts::SQRT_2);
        }
    }
    differences
}

/// What does not repeat from one period to the next.
pub struct Unrepeated {
    /// Difference between the last two periods, halved in energy; zero where either sample was lost.
    pub difference: Vec<f32>,
    /// Where neither was.
    present: Vec<bool>,
}

impl Unrepeated {
    /// Differences of samples that were recorded.
    pub fn recorded(&self) -> impl Iterator<Item = f64> {
        let both = self.difference.iter().zip(&self.present);
        both.filter(|&(_, &present)| present).map(|(&x, _)| f64::from(x))
    }
}

/// What does not repeat in the last two periods of a column, if there are two.
pub fn unrepeated(track: &Track, series: &[f32]) -> Option<Unrepeated> {
    let period = (track.period_s? * track.rate_hz).round() as usize;
    let n = track.len();
    if period < 64 || n < 2 * period {
        return None;
    }
    // The first fifth of the earlier period may still hold the transient of the start.
    let skip = if n < 3 * period { period / 5 } else { 0 };
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let later = n - period + skip..n;
    let present: Vec<bool> =
        later.clone().map(|k| track.present[k] && track.present[k - period]).collect();
    let difference = later
        .zip(&present)
        .map(|(k, &is_there)| if is_there { (series[k] - series[k - period]) * half } else { 0.0 })
        .collect();
    Some(Unrepeated { difference, present })
}

/// What was measured of it in a recording.
pub(super) fn column(track: &Track, axis: usize, kind: Kind) -> Option<&Vec<f32>> {
    match kind {
        Kind::Position => track.position_um[axis].as_ref(),
        Kind::Monitor => track.monitor_v[axis].as_ref(),
    }
}

/// Noise of one axis over the session; `None` where nothing was measured. `stated` is the rig's own figure and
/// serves only where the recordings allow no estimate.
pub fn noise(tracks: &[Track], axis: usize, kind: Kind, stated: f64) -> Option<Noise> {
    let mut quiet = Vec::new();
    let mut high = Vec::new();
    let mut periodic = Vec::new();
    let mut any = false;
    for track in tracks {
        let Some(series) = column(track, axis, kind) else { continue };
        any = true;
        quiet.extend(quiet_differences(track, series));
        high.extend(high_pass(series, &track.present));
        if let Some(unrepeated) = unrepeated(track, series) {
            let mut d: Vec<f64> = unrepeated.recorded().collect();
            if !d.is_empty() {
                periodic.push(Level::of(&mut d, OF_SAMPLES));
            }
        }
    }
    if !any {
        return None;
    }
    // About the lower quartile: some recordings hold fast motion that no difference cancels.
    let low = |mut levels: Vec<Level>| -> Option<Level> {
        levels.retain(|level| level.sigma.is_finite());
        levels.sort_by(|a, b| a.sigma.total_cmp(&b.sigma));
        levels.get(levels.len() / 4).map(|low| low.pooled(&levels))
    };
    let quiet = (quiet.len() >= 500).then(|| Level::of(&mut quiet, OF_FIRST));
    let (high_pass, periodic) = (low(high), low(periodic));
    let levels: Vec<Level> = [quiet, high_pass, periodic].into_iter().flatten().collect();
    let lowest = levels.iter().min_by(|a, b| a.sigma.total_cmp(&b.sigma));
    let measured = lowest.map_or(f64::NAN, |lowest| lowest.pooled(&levels).sigma);
    let sigma = if measured.is_finite() && measured > 0.0 {
        measured
    } else if stated > 0.0 {
        stated
    } else {
        1.0e-4
    };
    let [quiet, high_pass, periodic] = [quiet, high_pass, periodic].map(|of| of.map(|l| l.sigma));
    Some(Noise { sigma, quiet, high_pass, periodic })
}

/// Variance that does not repeat, level by level, in units of `sigma` squared; at least one.
pub fn unrepeatable_levels(
    track: &Track,
    axis: usize,
    kind: Kind,
    sigma: f64,
    levels: &Levels,
) -> Vec<f64> {
    let mut floor = vec![1.0; levels.count()];
    let Some(unrepeated) = column(track, axis, kind).and_then(|s| unrepeated(track, s)) else {
        return floor;
    };
    let own = Levels::new(unrepeated.difference.len());
    let coefficients = transform(&unrepeated.difference, &own);
    // Lost samples differ by nothing: the others have to make up for them.
    let present = unrepeated.recorded().count().max(1) as f64 / unrepeated.difference.len() as f64;
    for level in 0..levels.count().min(own.count()) {
        let part = &coefficients[own.range(level)];
        // Fewer than a dozen values do not make a variance.
        if part.len() >= 12 {
            let energy: f64 = part.iter().map(|&x| f64::from(x).powi(2)).sum();
            let mean = energy / (present * part.len() as f64);
            floor[level] = (mean / (sigma * sigma)).max(1.0);
        }
    }
    floor
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Three periods of 1000 samples that repeat to the last bit but for noise of one unit.
    fn track(lost: impl Fn(usize) -> bool) -> Track {
        let mut rng = StdRng::seed_from_u64(1);
        let mut noise = move || (rng.random::<f32>() - 0.5) * 12.0_f32.sqrt();
        let mut held = 0.0;
        let series = (0..3000).map(|i| {
            let value = 1.0e3 * (i as f32 * std::f32::consts::TAU / 1000.0).sin() + noise();
            // What stands in for a lost sample is the one before.
            held = if lost(i) { held } else { value };
            held
        });
        Track {
            file: String::new(),
            experiment: String::new(),
            rate_hz: 1000.0,
            start_s: 0.0,
            period_s: Some(1.0),
            drive_v: vec![vec![0.0; 3000]],
            lively: vec![0.0],
            monitor_v: vec![None],
            position_um: vec![Some(series.collect())],
            settle: 0,
            lead_in: 0,
            present: (0..3000).map(|i| !lost(i)).collect(),
            lost: (0..3000).filter(|&i| lost(i)).count() as u64,
            first_tick: 0,
            holes: Vec::new(),
            replaced: Default::default(),
            closed_loop: false,
            past: vec![Vec::new().into()],
        }
    }

    #[test]
    fn the_level_is_not_too_low_by_chance() {
        let levels = (0..40).map(|seed| {
            let mut rng = StdRng::seed_from_u64(seed);
            let tracks: Vec<Track> = (0..4)
                .map(|_| {
                    let uniform = || (rng.random::<f32>() - 0.5) * 12.0_f32.sqrt();
                    let series: Vec<f32> = std::iter::repeat_with(uniform).take(3000).collect();
                    Track { position_um: vec![Some(series)], ..track(|_| false) }
                })
                .collect();
            noise(&tracks, 0, Kind::Position, 0.0).expect("a level").sigma
        });
        // Of twelve thousand samples with a standard error of 0.5 %, forty times: 0.08 %. The lowest of the estimates is 1 % too low.
        let mean = levels.sum::<f64>() / 40.0;
        assert!((mean - 1.0).abs() < 0.004, "{mean}");
    }

    #[test]
    fn what_stands_in_for_lost_samples_is_no_noise() {
        for lost in [0, 40, 400] {
            // In the last period only, where the drive is fastest.
            let track = track(|i| (2480..2480 + lost).contains(&i));
            let found = noise(std::slice::from_ref(&track), 0, Kind::Position, 0.0).unwrap();
            let periodic = found.periodic.unwrap();
            // Of 600 samples at least: 3 % rms.
            assert!((periodic - 1.0).abs() < 0.1, "{lost} lost: {periodic}");
            let levels = Levels::new(track.len());
            let floor = unrepeatable_levels(&track, 0, Kind::Position, 1.0, &levels);
            // The mean of twelve squares exceeds 3 once in six thousand times.
            assert!(floor.iter().all(|&f| f < 3.0), "{lost} lost: {floor:?}");
        }
    }
}
