//! The waveforms: a 32-bit phase in, Q1.30 out. Integers only, so that host and board agree to the bit.

use crate::MAX_TONES;
use crate::math::{ONE_Q30, sin_q30};

/// Q1.30 with a little room: waveforms stay within +-1.
#[inline(always)]
pub(super) const fn clip_q30(x: i64) -> i32 {
    if x > ONE_Q30 as i64 {
        ONE_Q30
    } else if x < -(ONE_Q30 as i64) {
        -ONE_Q30
    } else {
        x as i32
    }
}

/// 0 at phase 0, 1 at a quarter, -1 at three quarters.
#[inline(always)]
pub(super) const fn triangle_q30(phase: u32) -> i32 {
    let turn = phase as i32;
    if turn > ONE_Q30 || turn < -ONE_Q30 { i32::MIN.wrapping_sub(turn) } else { turn }
}

#[inline(always)]
pub(super) const fn staircase_q30(phase: u32, steps: i32, steepness: i32) -> i32 {
    // Height in steps, Q16: 0 at the bottom, `steps` at the top.
    let height = ((triangle_q30(phase) as i64 + ONE_Q30 as i64) * steps as i64) >> 15;
    let height = height as i32;
    let whole = height >> 16;
    let part = (height & 0xffff) - 0x8000;
    let edge = ((part as i64 * steepness as i64) >> 16) + 0x8000;
    let edge = if edge < 0 {
        0
    } else if edge > 0x1_0000 {
        0x1_0000
    } else {
        edge as i32
    };
    // (whole + edge) / steps, to -1..1. One 32-bit division (`udiv`) instead of a table; steps >= 1.
    let level = (whole << 16).wrapping_add(edge);
    let divisor = if steps < 1 { 1 } else { steps as u32 };
    let fraction = (level as u32) / divisor; // Q16
    clip_q30(((fraction as i64) << 15) - ONE_Q30 as i64)
}

/// Phase of the first tone: a hash of the seed.
#[inline(always)]
const fn first_phase(seed: u32) -> u32 {
    // Finaliser of MurmurHash3 (public domain, A. Appleby).
    let mut h = seed;
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// Phase of the next tone: one multiplication, no table (linear congruential generator; D. Knuth and H. Lewis).
#[inline(always)]
const fn next_phase(phase: u32) -> u32 {
    phase.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)
}

/// Sum of the tones over 16, Q1.30.
#[inline(always)]
pub(super) fn multisine_sum(phase: u32, first: u16, stride: u16, tones: u8, seed: u32) -> i32 {
    let mut sum = 0i32;
    let mut tone = phase.wrapping_mul(first as u32);
    let distance = phase.wrapping_mul(stride as u32);
    let mut offset = first_phase(seed);
    for _ in 0..if tones > MAX_TONES { MAX_TONES } else { tones } {
        sum = sum.wrapping_add(sin_q30(tone.wrapping_add(offset)) >> 4);
        tone = tone.wrapping_add(distance);
        offset = next_phase(offset);
    }
    sum
}

/// Q6.25 factor that brings the largest value over a period to 1 (less a thousandth for what lies between the samples).
pub(super) fn multisine_scale(first: u16, stride: u16, tones: u8, seed: u32, highest: u32) -> i32 {
    let samples = 16 * highest;
    let step = u32::MAX / samples;
    let peak = (0..samples)
        .map(|n| multisine_sum(n.wrapping_mul(step), first, stride, tones, seed).unsigned_abs())
        .max()
        .unwrap_or(0)
        .max(1 << 20);
    ((1u64 << 55) as f64 * 0.98 / peak as f64) as i32
}
