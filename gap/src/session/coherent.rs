//! The frequency whose phase runs on over a whole session: single recordings are too short to tell it.

use crate::session::floor::Kind;
use crate::session::scene::{Scene, Stack};
use crate::session::spectra::envelope;

/// Length of the blocks whose phases are compared, s.
const BLOCK_S: f64 = 0.1;
/// How far from the first guess is searched, Hz.
const REACH_HZ: f64 = 0.6;
/// Longest time that is searched at once, s. The steps get finer with it, and there are more of them: days would never end.
const AT_ONCE_S: f64 = 900.0;
/// Most by which the time is widened at once. Recordings that lie farther apart than this times what is known so far cannot be brought into
/// phase: each of very many frequencies would do as well.
const WIDEN: f64 = 2_000.0;
/// Parts of what is known so far that are taken for one block each when it is widened.
const PARTS: f64 = 8.0;

/// A block of the residual: middle (s), in phase with the first guess, and a quarter period ahead of it.
type Block = (f64, f64, f64);

/// Frequency near `hz` whose phase runs on over the session. Where the session is longer than is searched at once, the fullest part of it is
/// searched and what is found there refined with what lies farther and farther away, as far as the phase can be followed.
pub(crate) fn coherent(scene: &Scene, raw: &Stack, kind: Kind, hz: f64) -> f64 {
    let axes = scene.position_noise.len();
    let mut blocks: Vec<Vec<Block>> = vec![Vec::new(); axes];
    for (c, channel) in scene.channels.iter().enumerate() {
        let Some(row) = raw[c].as_ref().filter(|_| channel.kind == kind) else { continue };
        for block in envelope(scene, channel, row, hz, (BLOCK_S, |_| 1.0)) {
            blocks[channel.axis].push((block.time_s, block.re, block.im));
        }
    }
    hz + shift(&blocks)
}

/// By how much the phase of the blocks of all axes runs, Hz.
fn shift(blocks: &[Vec<Block>]) -> f64 {
    let mut times: Vec<f64> = blocks.iter().flatten().map(|block| block.0).collect();
    times.sort_by(f64::total_cmp);
    let Some((first, last)) = times.first().copied().zip(times.last().copied()) else { return 0.0 };
    if last - first <= AT_ONCE_S {
        return strongest(blocks, REACH_HZ, last - first);
    }
    let (mut from, mut to) = fullest(&times);
    let mut found = strongest(&within(blocks, (from, to)), REACH_HZ, to - from);
    loop {
        let known_s = (to - from).max(1.0);
        let before = times[..times.partition_point(|&t| t < from)].last().map(|t| from - t);
        let after = times.get(times.partition_point(|&t| t <= to)).map(|t| t - to);
        let Some(nearest) = before.into_iter().chain(after).reduce(f64::min) else { return found };
        if nearest > WIDEN * known_s {
            return found;
        }
        let by = nearest.max(0.5 * known_s);
        let inside = &times
            [times.partition_point(|&t| t < from - by)..times.partition_point(|&t| t <= to + by)];
        (from, to) = (inside[0], inside[inside.len() - 1]);
        // What was known is right to a small part of a turn over the time that it was known from.
        let reach = 1.0 / (4.0 * known_s);
        let turned: Vec<Vec<Block>> = within(blocks, (from, to))
            .iter()
            .map(|blocks| turned(blocks, found, known_s / PARTS))
            .collect();
        found += strongest(&turned, reach, to - from);
    }
}

/// The time, no longer than what is searched at once, in which most of the blocks lie.
fn fullest(times: &[f64]) -> (f64, f64) {
    let count = |first: usize| times.partition_point(|&t| t <= times[first] + AT_ONCE_S) - first;
    // The first of several that are as full.
    let first = (0..times.len()).rev().max_by_key(|&first| count(first)).unwrap_or(0);
    (times[first], times[first + count(first) - 1])
}

fn within(blocks: &[Vec<Block>], (from, to): (f64, f64)) -> Vec<Vec<Block>> {
    let inside = |block: &&Block| (from..=to).contains(&block.0);
    blocks.iter().map(|blocks| blocks.iter().filter(inside).copied().collect()).collect()
}

/// Blocks against a frequency that lies `shift` from theirs, Hz, those of `length_s` in one.
fn turned(blocks: &[Block], shift: f64, length_s: f64) -> Vec<Block> {
    let is_near = |a: &Block, b: &Block| (b.0 - a.0).abs() < BLOCK_S * 1.5;
    let at_once = (length_s / BLOCK_S).max(1.0) as usize;
    blocks
        .chunk_by(is_near)
        .flat_map(|run| run.chunks(at_once))
        .map(|part| {
            let add = |sum: Block, &(t, x, y): &Block| {
                let (sin, cos) = (std::f64::consts::TAU * shift * t).sin_cos();
                (
                    sum.0 + t / part.len() as f64,
                    sum.1 + x * cos + y * sin,
                    sum.2 + y * cos - x * sin,
                )
            };
            part.iter().fold((0.0, 0.0, 0.0), add)
        })
        .collect()
}

/// Shift of no more than `reach`, Hz, at which the blocks, `span_s` from first to last, add up to most.
fn strongest(blocks: &[Vec<Block>], reach: f64, span_s: f64) -> f64 {
    let tau = std::f64::consts::TAU;
    let step = 1.0 / (8.0 * span_s.max(1.0));
    let steps = (reach / step) as i64;
    (-steps..=steps)
        .map(|k| {
            let shift = k as f64 * step;
            let power: f64 = blocks
                .iter()
                .map(|blocks| {
                    let (mut re, mut im) = (0.0, 0.0);
                    for &(t, x, y) in blocks {
                        let (sin, cos) = (tau * shift * t).sin_cos();
                        re += x * cos + y * sin;
                        im += y * cos - x * sin;
                    }
                    re * re + im * im
                })
                .sum();
            (shift, power)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(0.0, |(shift, _)| shift)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of a tone that lies `off_hz` beside the guess, over `length_s` from each of some times on.
    fn tone(off_hz: f64, starts_s: &[f64], length_s: f64) -> Vec<Vec<Block>> {
        let block = |t: f64| {
            let (sin, cos) = (std::f64::consts::TAU * off_hz * t).sin_cos();
            (t, cos, sin)
        };
        let count = (length_s / BLOCK_S) as usize;
        let times =
            starts_s.iter().flat_map(|start| (0..count).map(move |k| start + k as f64 * BLOCK_S));
        vec![times.map(block).collect()]
    }

    #[test]
    fn as_far_as_the_phase_can_be_followed() {
        let off_hz = 0.123_456_7;
        // Minutes, then an hour, then a day later: each brings it nearer.
        for (starts_s, nearer_hz) in [
            (&[0.0, 60.0][..], 1.0e-3),
            (&[0.0, 60.0, 3_600.0], 2.0e-5),
            (&[0.0, 60.0, 3_600.0, 90_000.0], 1.0e-6),
            // A month and an age later: what is near each other tells it.
            (&[0.0, 60.0, 2.6e6], 1.0e-3),
            (&[0.0, 60.0, 2.6e6, 1.0e12], 1.0e-3),
            (&[-1.0e15, 0.0, 60.0], 1.0e-3),
        ] {
            let found = shift(&tone(off_hz, starts_s, 8.0));
            assert!((found - off_hz).abs() < nearer_hz, "{starts_s:?}: {found}");
        }
        assert_eq!(shift(&[Vec::new(), Vec::new()]), 0.0);
    }

    /// One recording longer than is searched at once.
    #[test]
    fn a_long_recording() {
        let found = shift(&tone(-0.31, &[5.0], 2_400.0));
        assert!((found + 0.31).abs() < 1.0e-5, "{found}");
    }
}
