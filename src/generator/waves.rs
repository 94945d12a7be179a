//! The waveforms: a 32-bit phase in, Q1.30 out. Integers only, so that host and board agree to the bit.

use crate::MAX_TONES;
use crate::math::{ONE_Q30, add_high, cos_q30, high, sin_q30, sin_quarter_q30};

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

/// The signs of the tones, one a bit: a hash of the seed.
pub(super) const fn multisine_signs(seed: u32) -> u32 {
    // Finaliser of MurmurHash3 (public domain, A. Appleby).
    let mut h = seed;
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// One tone in the recurrence below.
const TONE: i32 = 1 << 20;

/// Sum of the tones over 16, Q1.30: of s_k sin(a + k x) for k below `tones`, a = `first` phases, x = `stride` phases, s_k = 1 or -1 by
/// the bits of `signs`. Error below 1e-6 of all 16. At any phase by itself: to find the peak, off the hot path, and to test what the tick
/// computes sixteen ticks at a time ([`Multisines`](super::Multisines)).
///
/// Clenshaw's recurrence, b_k = s_k + 2 cos(x) b_(k+1) - b_(k+2), takes one multiplication a tone instead of a sine. Near x = 0, where it
/// would cancel, Reinsch's form of it does not: the differences d_k = b_k - b_(k+1) = d_(k+1) + s_k - 4 sin^2(x/2) b_(k+1). Near
/// half a turn x is taken half a turn back, which turns every other sign. All of it follows from the phase alone: nothing drifts. (J. Stoer and R.
/// Bulirsch, "Introduction to Numerical Analysis", 2.3.2.)
#[inline(always)]
pub(super) fn multisine_sum(phase: u32, first: u16, stride: u16, tones: u8, signs: u32) -> i32 {
    let a = phase.wrapping_mul(first as u32);
    let mut x = phase.wrapping_mul(stride as u32) as i32;
    let mut signs = signs;
    if x ^ (x << 1) < 0 {
        x ^= i32::MIN;
        signs ^= 0xaaaa_aaaa;
    }
    let half = sin_quarter_q30(x >> 1);
    // -4 sin^2(x/2), -2 to 0: Q2.29, from the upper word of Q4.60.
    let bend = -(high(half, half) << 3);
    // |b| is at most 1 + 2 + .. + 16 = 136, |d| below 16 / cos(x/2) < 23. Differences have 20 fraction bits, sums 23: what the upper
    // word of a product with `bend` has.
    let (mut b, mut d) = (0i32, 0i32);
    let tones = if tones > MAX_TONES { MAX_TONES as u32 } else { tones as u32 };
    // The last tone's sign into the uppermost bit. Tones that it is set for are 1 - 2.
    let mut signs = signs << (32_u32.wrapping_sub(tones) & 31);
    let tone = |signs: u32, nth: u32| TONE.wrapping_sub((signs >> (10 - nth)) as i32 & (2 * TONE));
    // Four at a time, after those that are left over: a loop's own instructions are half as many as a tone's.
    for _ in 0..tones & 3 {
        d = add_high(d, bend, b).wrapping_add(tone(signs, 0));
        b = b.wrapping_add(d << 3);
        signs <<= 1;
    }
    for _ in 0..tones >> 2 {
        for nth in 0..4 {
            d = add_high(d, bend, b).wrapping_add(tone(signs, nth));
            b = b.wrapping_add(d << 3);
        }
        signs <<= 4;
    }
    // sum = b_0 sin(a) - b_1 sin(a - x) = 2 b_0 sin(x/2) cos(a - x/2) + d_0 sin(a - x).
    let back = a.wrapping_sub(x as u32);
    let ahead = a.wrapping_sub((x >> 1) as u32);
    // |2 b sin(x/2)| is as small as |d|: both in Q5.26 here, and their sum, at most 16, in Q5.24.
    let swing = high(b, half) << 6;
    high(swing, cos_q30(ahead)).wrapping_add(high(d << 6, sin_q30(back))) << 2
}

/// Phases that [`PeakSearch::go_on`] looks at in one go: 15 us on the board, less than the pause between two packets of the
/// fastest stream.
const SLICE: u32 = 8;

/// The search for a multisine's largest value over a period, in slices: all of it takes the board a tenth of a second, in which it has other
/// things to do.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PeakSearch {
    /// Phases that have been looked at.
    seen: u32,
    /// Largest value so far.
    peak: u32,
}

impl PeakSearch {
    /// Nothing has been looked at.
    pub(crate) const NEW: Self = Self { seen: 0, peak: 1 << 20 };

    /// Goes on; at the end the amplitude of a tone, Q1.30, with which the largest value is 1 (less a fiftieth for what lies between the
    /// phases).
    pub(super) fn go_on(&mut self, first: u16, stride: u16, tones: u8, signs: u32) -> Option<i32> {
        // Sixteen phases in a period of the highest tone.
        let highest = u32::from(first) + u32::from(stride) * u32::from(tones.saturating_sub(1));
        let phases = 16 * highest.max(1);
        let step = u32::MAX / phases;
        let end = phases.min(self.seen + SLICE);
        while self.seen < end {
            let sum = multisine_sum(self.seen.wrapping_mul(step), first, stride, tones, signs);
            self.peak = self.peak.max(sum.unsigned_abs());
            self.seen += 1;
        }
        // Of a sixteenth of the sum: 30 bits of the peak and 30 of the amplitude, less 4.
        let amplitude = || (((1u64 << 56) as f64 * 0.98 / self.peak as f64) as i32).min(ONE_Q30);
        (end == phases).then(amplitude)
    }
}
