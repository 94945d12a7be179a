//! Which recordings are fitted and which only score.
//!
//! Recordings are described by how much drive each axis gets in each band. The ones that have a near relative in the session are held out, up to
//! two fifths, so that no kind of excitation is lost to the fit. A session of one or two recordings is cut into blocks.

use crate::session::intake::Track;
use crate::session::pyramid::{Levels, transform};
use crate::session::scene::{Channel, Scene};

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

fn split_blocks(scene: &mut Scene) {
    cut(scene, &BLOCKS.map(|held_out| (1, held_out)));
}

/// Hold out the last third of every recording: what a calibration is checked on.
pub fn hold_out_last_third(scene: &mut Scene) {
    cut(scene, &[(2, false), (1, true)]);
}

/// Cut every channel into parts of these relative lengths, held out or not.
fn cut(scene: &mut Scene, parts: &[(usize, bool)]) {
    let whole: usize = parts.iter().map(|(length, _)| length).sum();
    let mut channels = Vec::new();
    for channel in &scene.channels {
        let track = &scene.tracks[channel.track];
        let at = |gone: usize| channel.range.start + channel.range.len() * gone / whole;
        let mut gone = 0;
        for &(length, held_out) in parts {
            let range = at(gone)..at(gone + length);
            gone += length;
            let (axis, kind, sigma) = (channel.axis, channel.kind, channel.sigma);
            let mut part = Channel::new(channel.track, track, axis, kind, sigma, range);
            part.held_out = held_out;
            channels.push(part);
        }
    }
    scene.channels = channels;
}
