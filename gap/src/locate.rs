//! Where the gap lies, before anything is named: axis, band, level, direction, time since the last step, stage.
//!
//! Energies are those of the nominal residual beyond noise. The stage is decided by what each further measurement explains: the monitor
//! (drive and amplifier against the rest), motion of the drive (environment and a restless gauge need none), jumps that no motion can make
//! (the gauge), and in the end by the accepted causes.

use std::collections::BTreeMap;

use crate::diagnosis::{Cause, Location};
use crate::judge::strangers::Masked;
use crate::session::floor::Kind;
use crate::session::pyramid::centre_hz;
use crate::session::scene::{Scene, Stack};

/// Shares of the gap energy in different cuts.
#[derive(Debug, Clone, Default)]
pub struct Cuts {
    /// Energy beyond noise of each axis, nm^2 times samples.
    pub axis: Vec<f64>,
    /// Band centre (Hz; 0: mean) and energy of each axis there.
    pub band: Vec<(f64, Vec<f64>)>,
    /// Drive level (V, lower edge of a bin of a tenth of the range) and root mean square residual, nm, of each axis that was there.
    pub level: Vec<(f64, Vec<Option<f64>>)>,
    /// Root mean square residual (nm) while the drive rises, falls, and stands still, where it does.
    pub direction: [Option<f64>; 3],
    /// Seconds since the drive last jumped (decade bins) and root mean square residual, nm.
    pub since_step: Vec<(f64, f64)>,
}

/// Cut the raw residuals `raw` (units of the noise) of all positions.
pub fn cuts(scene: &Scene, raw: &Stack, white: &Stack) -> Cuts {
    let axes = scene.position_noise.len();
    let mut cuts = Cuts { axis: vec![0.0; axes], ..Cuts::default() };
    let mut bands: BTreeMap<i64, (f64, Vec<f64>)> = BTreeMap::new();
    let mut levels: BTreeMap<i64, Vec<(f64, f64)>> = BTreeMap::new();
    let mut direction = [(0.0, 0.0); 3];
    let mut since: BTreeMap<i64, (f64, f64)> = BTreeMap::new();
    let span = scene
        .tracks
        .iter()
        .flat_map(|t| t.drive_v.iter().flatten())
        .fold((0.0_f64, 0.0_f64), |(low, high), &v| (low.min(v), high.max(v)));
    let bin = ((span.1 - span.0) / 10.0).max(1.0e-9);
    for (c, channel) in scene.channels.iter().enumerate() {
        let (Kind::Position, Some(raw), Some(white)) = (channel.kind, &raw[c], &white[c]) else {
            continue;
        };
        let track = &scene.tracks[channel.track];
        let nm = (channel.sigma * 1.0e3).powi(2);
        for (level, power) in channel.band_power(white).iter().enumerate() {
            let energy = nm
                * ((power - channel.unrepeatable[level])
                    * channel.levels.range(level).len() as f64)
                    .max(0.0);
            cuts.axis[channel.axis] += energy;
            let hz = centre_hz(level, &channel.levels, track.rate_hz);
            let key = if hz > 0.0 { (hz.log2()).round() as i64 } else { i64::MIN };
            bands.entry(key).or_insert_with(|| (hz, vec![0.0; axes])).1[channel.axis] += energy;
        }
        let drive = &track.drive_v[channel.axis];
        let mut last_jump: Option<usize> = None;
        for (k, i) in channel.range.clone().enumerate() {
            let here = f64::from(raw[k]).powi(2) * nm;
            let slot = ((drive[i] - span.0) / bin).floor() as i64;
            let cell =
                &mut levels.entry(slot).or_insert_with(|| vec![(0.0, 0.0); axes])[channel.axis];
            cell.0 += here;
            cell.1 += 1.0;
            let moved = if i == 0 { 0.0 } else { drive[i] - drive[i - 1] };
            let way = if moved > 0.0 {
                0
            } else if moved < 0.0 {
                1
            } else {
                2
            };
            direction[way].0 += here;
            direction[way].1 += 1.0;
            if moved.abs() > 0.5 * bin {
                last_jump = Some(i);
            }
            if let Some(jump) = last_jump {
                let decade =
                    (((i - jump).max(1) as f64 / track.rate_hz).log10() * 2.0).floor() as i64;
                let cell = since.entry(decade).or_insert((0.0, 0.0));
                cell.0 += here;
                cell.1 += 1.0;
            }
        }
    }
    cuts.band = bands.into_values().collect();
    cuts.level = levels
        .into_iter()
        .map(|(slot, cells)| (span.0 + slot as f64 * bin, cells.into_iter().map(rms).collect()))
        .collect();
    cuts.direction = direction.map(rms);
    cuts.since_step = since
        .into_iter()
        .filter_map(|(decade, cell)| Some((10.0_f64.powf(decade as f64 / 2.0), rms(cell)?)))
        .collect();
    cuts
}

/// Root mean square of an energy over a number of samples: none is no gap of zero.
fn rms((energy, count): (f64, f64)) -> Option<f64> {
    (count > 0.0).then(|| (energy / count).sqrt())
}

/// Share of the position gap of each axis that comes with the drive and amplifier, from the monitors: how much of the
/// monitor's own gap there is. `None` without a monitor.
pub fn electrical(scene: &Scene, base: &Stack) -> Vec<Option<bool>> {
    let axes = scene.position_noise.len();
    let mut worst: Vec<Option<f64>> = vec![None; axes];
    for (c, channel) in scene.channels.iter().enumerate() {
        let (Kind::Monitor, Some(row)) = (channel.kind, &base[c]) else { continue };
        let excess = channel.excess(row);
        let entry = worst[channel.axis].get_or_insert(0.0);
        *entry = entry.max(excess / (2.0 * row.len() as f64).sqrt());
    }
    // Ten standard deviations of a chi-square sum.
    worst.into_iter().map(|w| w.map(|z| z > 10.0)).collect()
}

/// Take out the mean.
fn centre(values: &mut [f64]) {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter_mut().for_each(|v| *v -= mean);
}

/// Root mean square of the raw residual (units of the noise) at rest and under drive, of one axis.
fn rest_against_drive(scene: &Scene, raw: &Stack, axis: usize) -> (f64, f64) {
    let mut rest = (0.0, 0.0);
    let mut driven = (0.0, 0.0);
    for (c, channel) in scene.channels.iter().enumerate() {
        let (Kind::Position, Some(row)) = (channel.kind, &raw[c]) else { continue };
        if channel.axis != axis {
            continue;
        }
        let track = &scene.tracks[channel.track];
        let own = &track.drive_v[axis][channel.range.clone()];
        let still = own.iter().all(|&v| v == own[0]);
        // The mean of a resting file may be its memory, and what follows a neighbour's drive is coupling: neither is unrest.
        let mut residual: Vec<f64> = row.iter().map(|&x| f64::from(x)).collect();
        centre(&mut residual);
        for (_, drive) in track.drive_v.iter().enumerate().filter(|(other, _)| *other != axis) {
            let mut along = drive[channel.range.clone()].to_vec();
            centre(&mut along);
            let power: f64 = along.iter().map(|v| v * v).sum();
            if power > 0.0 {
                let share = along.iter().zip(&residual).map(|(a, r)| a * r).sum::<f64>() / power;
                residual.iter_mut().zip(&along).for_each(|(r, a)| *r -= share * a);
            }
        }
        let energy: f64 = residual.iter().map(|x| x * x).sum();
        let cell = if still { &mut rest } else { &mut driven };
        cell.0 += energy;
        cell.1 += channel.samples();
    }
    let rms = |(e, n): (f64, f64)| if n > 0.0 { (e / n - 1.0).max(0.0).sqrt() } else { 0.0 };
    (rms(rest), rms(driven))
}

/// Jumps of a reading that are no accident.
const SOME_JUMPS: usize = 3;
/// Noise (standard deviations) that a jump from sample to sample must exceed: 5.7 of the difference of two samples.
const BEYOND_NOISE: f64 = 8.0;
/// ... and how many times the fastest motion that the rig has according to its model, about then.
const BEYOND_MOTION: f64 = 3.0;
/// Samples in which the fastest motion is looked for; those of the blocks before and after count too.
const ABOUT_THEN: usize = 32;

/// How often the reading of an axis jumps from one sample to the next by more than the stage can move: a loose contact, a bit that
/// sticks, a reading that freezes and comes back. Whatever is wrong with amplifier, stack or mechanism, the stage has to travel.
fn reading_jumps(scene: &Scene, raw: &Stack, axis: usize) -> usize {
    let mut jumps = 0;
    for (c, channel) in scene.channels.iter().enumerate() {
        let (Kind::Position, Some(row)) = (channel.kind, &raw[c]) else { continue };
        let track = &scene.tracks[channel.track];
        let Some(position) = track.position_um[axis].as_ref().filter(|_| channel.axis == axis)
        else {
            continue;
        };
        let is_whole = |k: usize| track.present[channel.range.start + k];
        let measured: Vec<f64> = position[channel.range.clone()]
            .iter()
            .map(|&um| f64::from(um) / channel.sigma)
            .collect();
        let travel: Vec<f64> = (1..row.len())
            .map(|k| {
                let simulated = |k: usize| measured[k] - f64::from(row[k]);
                (simulated(k) - simulated(k - 1)).abs()
            })
            .collect();
        let fastest: Vec<f64> = travel
            .chunks(ABOUT_THEN)
            .map(|block| block.iter().copied().fold(0.0, f64::max))
            .collect();
        jumps += (1..row.len())
            .filter(|&k| is_whole(k) && is_whole(k - 1))
            .filter(|&k| {
                let block = (k - 1) / ABOUT_THEN;
                let about = &fastest[block.saturating_sub(1)..(block + 2).min(fastest.len())];
                let motion = about.iter().copied().fold(0.0, f64::max);
                (measured[k] - measured[k - 1]).abs() > BEYOND_NOISE + BEYOND_MOTION * motion
            })
            .count();
    }
    jumps
}

/// Stage of what no cause accounts for, axis by axis.
fn leftover_stage(
    scene: &Scene,
    raw: &Stack,
    electrical: &[Option<bool>],
    axis: usize,
) -> &'static str {
    if electrical[axis] == Some(true) {
        return "amplifier";
    }
    let (rest, driven) = rest_against_drive(scene, raw, axis);
    if rest > 0.3 * driven.max(0.5) {
        let others = (0..electrical.len()).filter(|&a| a != axis).any(|a| {
            let (r, _) = rest_against_drive(scene, raw, a);
            r > 0.5 * rest
        });
        return if others { "environment" } else { "sensor" };
    }
    if reading_jumps(scene, raw, axis) >= SOME_JUMPS {
        return "sensor";
    }
    // Slow and fast halves of the driven gap: a stack loses memory at all speeds, a mechanism at its own.
    let (mut slow, mut fast) = (0.0, 0.0);
    for (c, channel) in scene.channels.iter().enumerate() {
        let (Kind::Position, Some(row)) = (channel.kind, &raw[c]) else { continue };
        if channel.axis != axis {
            continue;
        }
        let coefficients = crate::session::pyramid::transform(row, &channel.levels);
        for level in 0..channel.levels.count() {
            let part = &coefficients[channel.levels.range(level)];
            let energy =
                part.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() - part.len() as f64;
            if centre_hz(level, &channel.levels, scene.tracks[channel.track].rate_hz) > 100.0 {
                fast += energy.max(0.0);
            } else {
                slow += energy.max(0.0);
            }
        }
    }
    if fast > slow { "mechanism" } else { "piezo" }
}

/// Shares of the explainable gap by axis and stage. Causes claim their part of their axes; the rest is attributed by signature.
/// `claimed[cause][axis]` is the gap energy that a cause closes on an axis.
pub(crate) fn locations(
    scene: &Scene,
    cuts: &Cuts,
    raw_after: &Stack,
    (electrical, masked): (&[Option<bool>], Option<&Masked>),
    (causes, claimed): (&[Cause], &[Vec<f64>]),
) -> Vec<Location> {
    let total: f64 = cuts.axis.iter().sum();
    if total <= 0.0 {
        return Vec::new();
    }
    let mut out: Vec<Location> = Vec::new();
    let mut add = |axis: usize, stage: &str, energy: f64| {
        let share = energy / total;
        if share < 0.005 {
            return;
        }
        match out.iter_mut().find(|l| l.axis == axis + 1 && l.stage == stage) {
            Some(known) => known.share += share,
            None => out.push(Location { axis: axis + 1, stage: stage.into(), share }),
        }
    };
    for (axis, &energy) in cuts.axis.iter().enumerate() {
        let claims: Vec<f64> = claimed.iter().map(|c| c[axis].max(0.0)).collect();
        let sum: f64 = claims.iter().sum();
        let scale = if sum > energy { energy / sum } else { 1.0 };
        for (cause, claim) in causes.iter().zip(&claims) {
            add(axis, &cause.stage, claim * scale);
        }
        let rest = energy - sum * scale;
        if rest > 0.0 {
            // What a cause of nearly the right form leaves belongs to the stage of that cause.
            let main = claims
                .iter()
                .enumerate()
                .max_by(|a, b| a.1.total_cmp(b.1))
                .filter(|c| *c.1 > 0.5 * energy);
            let stage = match main {
                Some((cause, _)) => causes[cause].stage.clone(),
                None => match masked.filter(|masked| masked.axes.contains(&axis)) {
                    Some(masked) => masked.stage.to_string(),
                    None => leftover_stage(scene, raw_after, electrical, axis).to_string(),
                },
            };
            add(axis, &stage, rest);
        }
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bin_without_samples_has_no_gap() {
        assert_eq!([(0.0, 0.0), (0.0, 3.0), (12.0, 3.0)].map(rms), [None, Some(0.0), Some(2.0)]);
    }
}
