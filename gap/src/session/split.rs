//! Which recordings are fitted and which only score.
//!
//! Recordings are described by how much drive each axis gets in each band. The ones that have a near relative in the session are held out, up to
//! two fifths, so that no kind of excitation is lost to the fit. A session of one or two recordings is cut into blocks.

use std::ops::Range;

use crate::session::energy::HAS_GAP;
use crate::session::intake::Track;
use crate::session::pyramid::{Levels, transform};
use crate::session::scene::{Channel, Scene, Stack};

/// Share of the recordings that are held out.
const HELD_OUT: f64 = 0.4;
/// Fewest recordings for a split by file.
const FILES: usize = 3;
/// Blocks that a recording is cut into when there are fewer, and which of them are held out.
const BLOCKS: [bool; 5] = [false, false, true, false, true];

/// Drive of every axis in factor-of-four bands of frequency that do not depend on the sample rate, as log10 volts.
fn fingerprint(track: &Track) -> Vec<f64> {
    const BANDS: usize = 9;
    let mut print = Vec::new();
    for drive in &track.drive_v {
        let mut bands = [0.0_f64; BANDS];
        let series: Vec<f32> = drive[track.settle..].iter().map(|&v| v as f32).collect();
        let levels = Levels::new(series.len());
        let coefficients = transform(&series, &levels);
        for level in 0..levels.count() {
            let energy: f64 =
                coefficients[levels.range(level)].iter().map(|&x| f64::from(x).powi(2)).sum();
            let band = if level + 1 == levels.count() {
                BANDS - 1
            } else {
                let hz = track.rate_hz / 4.0 / 4.0_f64.powi(level as i32);
                ((2500.0 / hz).log(4.0).round().max(0.0) as usize).min(BANDS - 2)
            };
            bands[band] += energy / series.len() as f64;
        }
        print.extend(bands.iter().map(|e| 0.5 * (e + 1.0e-4).log10()));
    }
    print
}

/// What a reader should know where `split` cuts recordings into blocks, which it does with fewer than three of them.
pub(crate) fn blocks_note(scene: &Scene) -> Option<String> {
    let (which, of_what, other) = match scene.tracks.len() {
        1 => (format!("{} is the only recording", scene.tracks[0].file), "it", "another recording"),
        n if n < FILES => (format!("There are {n} recordings only"), "each", "others"),
        _ => return None,
    };
    Some(format!(
        "{which}: two fifths of {of_what}, in two parts, were held out, and the rest was fitted. That the causes fit both is a weaker promise than a whole \
         recording that was not fitted would be, and says nothing of {other} with other drives."
    ))
}

/// Mark channels as held out; `keep` recordings stay in the fit whatever they look like.
pub fn split(scene: &mut Scene, keep: &[usize]) {
    let n = scene.tracks.len();
    if n < FILES {
        split_blocks(scene);
        return;
    }
    let prints: Vec<Vec<f64>> = scene.tracks.iter().map(fingerprint).collect();
    let distance = |a: usize, b: usize| -> f64 {
        prints[a].iter().zip(&prints[b]).map(|(x, y)| (x - y).powi(2)).sum::<f64>()
    };
    let most = ((n as f64 * HELD_OUT).round() as usize).clamp(1, n - 1);
    let mut held: Vec<usize> = Vec::new();
    while held.len() < most {
        let fit: Vec<usize> = (0..n).filter(|t| !held.contains(t)).collect();
        let next = fit
            .iter()
            .filter(|t| !keep.contains(t))
            .map(|&t| {
                let near = fit
                    .iter()
                    .filter(|&&o| o != t)
                    .map(|&o| distance(t, o))
                    .fold(f64::INFINITY, f64::min);
                (t, near)
            })
            // Of two relatives the one that moves less goes: the fit keeps the louder.
            .min_by(|a, b| {
                a.1.total_cmp(&b.1)
                    .then_with(|| loudness(&prints[a.0]).total_cmp(&loudness(&prints[b.0])))
            });
        match next {
            Some((track, _)) => held.push(track),
            None => break,
        }
    }
    for channel in &mut scene.channels {
        channel.held_out = held.contains(&channel.track);
    }
}

fn loudness(print: &[f64]) -> f64 {
    print.iter().map(|l| 10.0_f64.powf(2.0 * l)).sum()
}

/// Hold out two of the five parts of every recording.
pub(crate) fn split_blocks(scene: &mut Scene) {
    cut(scene, |_, length| {
        let at = |block: usize| length * block / BLOCKS.len();
        let blocks = BLOCKS.iter().enumerate();
        blocks.map(|(block, &held_out)| (at(block)..at(block + 1), held_out)).collect()
    });
}

/// Hold out the last third of every recording: what a calibration is checked on.
pub fn hold_out_last_third(scene: &mut Scene) {
    cut(scene, |_, length| in_two(2 * length / 3, length));
}

/// Share of a recording that is held out at least, and samples.
const LEAST_PART: f64 = 0.02;
const FEWEST: usize = 32;

/// Hold out the end of every recording, from where two thirds of what is missing there have gone by: a resonance that a sweep reaches in
/// its last second is fitted as well as checked. `raw` are residuals over time in units of the noise; without a gap in them the last third
/// goes.
pub(crate) fn hold_out_last_third_of_gap(scene: &mut Scene, raw: &Stack) {
    let at: Vec<usize> =
        raw.iter().map(|row| row.as_ref().map_or(0, |row| two_thirds(row))).collect();
    cut(scene, |channel, length| in_two(at[channel].min(length), length));
}

/// Where two thirds of the energy beyond noise have gone by.
fn two_thirds(row: &[f32]) -> usize {
    // Lost samples are zero.
    let beyond = |x: &f32| if *x == 0.0 { 0.0 } else { f64::from(*x).powi(2) - 1.0 };
    let whole: f64 = row.iter().map(beyond).sum();
    let length = row.len();
    if whole < HAS_GAP * length as f64 {
        return 2 * length / 3;
    }
    // What shows the gap at its beginning is fitted for long enough to tell what it is.
    let least = ((LEAST_PART * length as f64) as usize).max(FEWEST).min(length / 3);
    let mut gone = 0.0;
    let at = row.iter().position(|x| {
        gone += beyond(x);
        gone > 2.0 / 3.0 * whole
    });
    at.unwrap_or(length).clamp(length / 3, length - least)
}

/// Two parts of so many samples, the second one held out.
fn in_two(at: usize, length: usize) -> Vec<(Range<usize>, bool)> {
    vec![(0..at, false), (at..length, true)]
}

/// Cut every channel into the parts that `parts` gives for its number and length, held out or not.
fn cut(scene: &mut Scene, parts: impl Fn(usize, usize) -> Vec<(Range<usize>, bool)>) {
    let mut channels = Vec::new();
    for (nth, channel) in scene.channels.iter().enumerate() {
        let track = &scene.tracks[channel.track];
        let start = channel.range.start;
        for (part, held_out) in parts(nth, channel.range.len()) {
            let range = start + part.start..start + part.end;
            let (axis, kind, sigma) = (channel.axis, channel.kind, channel.sigma);
            let mut part = Channel::new(channel.track, track, axis, kind, sigma, range);
            part.held_out = held_out;
            channels.push(part);
        }
    }
    scene.channels = channels;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_at_the_very_end_is_in_both_parts() {
        // A thousand samples of unit noise, and a ringing in the last tenth.
        let noise = |k: usize| if k.is_multiple_of(2) { 1.0_f32 } else { -1.0 };
        let quiet: Vec<f32> = (0..1000).map(noise).collect();
        assert_eq!(two_thirds(&quiet), 666);
        let ringing: Vec<f32> =
            (0..1000).map(|k| noise(k) * if k < 900 { 1.0 } else { 5.0 }).collect();
        // 100 samples of 24 variances beyond the noise: two thirds of that have gone by with the 67th.
        assert_eq!(two_thirds(&ringing), 966);
        // Where everything happens in the last instant, 32 samples are held out.
        let mut click = quiet;
        click[999] = 1.0e3;
        assert_eq!(two_thirds(&click), 968);
    }
}
