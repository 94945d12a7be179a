//! The multisine, sixteen ticks at a time: what the tick does for it, and what is made ready for the tick.
//!
//! # Design
//! Time is cut into blocks of [`BLOCK_TICKS`]. A block's centre lies between two ticks, at phase c, and its ticks lie in pairs around
//! it, at c + d and c - d with d = 1/2, 3/2, .. 15/2 ticks. With s_k = 1 or -1 and n_k = first + k stride,
//!
//! ```text
//! sum of s_k A sin(n_k (c +- d)) = sum of S_k (s_k cos(n_k d)) +- sum of C_k (s_k sin(n_k d)),
//! S_k = A sin(n_k c), C_k = A cos(n_k c).
//! ```
//!
//! What stands in brackets, the factors of a pair, never changes: it comes with the waveform. So two values take 32
//! multiplications, where each would take a recurrence over all tones and three sines. While the second half of a block is put
//! out, a tick computes a pair of the next block, which takes the places of two values that are out already; in its first half S and C
//! are found: sine and cosine of two angles, a tick each, and from these those of all tones by rotation. All of it follows from the
//! phase at the block's centre, which is a whole number of 2^-32 turns further in each block: nothing drifts, and periods are exact for
//! ever.
//!
//! A waveform's factors, and the values of its first block, are 1 088 bytes: they come in [`PARTS`] commands of a bounded cost each
//! ([`Generator::staging`]), into the one of an axis' two banks that does not run. The start exchanges the banks.
//!
//! # Limits
//! Error below 1e-6 of all tones, most of it the sine's (3e-8) times the number of a tone: 10 pm at 10 um.

use core::ops::Range;
use core::sync::atomic::{Ordering, compiler_fence};

use super::{Generator, Shape};
use crate::MAX_TONES;
use crate::math::{add_high, high, mul_q30, sin_q30};
use crate::units::{clamp_bits, plus};

/// Ticks of a block.
pub const BLOCK_TICKS: usize = 16;
/// Pairs of ticks in a block.
const PAIRS: usize = BLOCK_TICKS / 2;
/// Most tones.
const TONES: usize = MAX_TONES as usize;
/// Words of a part: what a command to the tick brings at once.
pub const PART_WORDS: usize = 16;
/// Parts of a multisine: two with the factors of each pair, and one with the values of the first block.
pub const PARTS: usize = 2 * PAIRS + 1;

/// One part.
pub type Part = [i32; PART_WORDS];

const _: () = assert!(PART_WORDS == BLOCK_TICKS && PART_WORDS == TONES && PARTS < 256);

/// Phase of `multiple` times `half_ticks` / 2 ticks. The half is taken of all of it, so that no more than 2^-32 turns are lost.
const fn phase_after(multiple: u32, step: u32, half_ticks: u32) -> u32 {
    ((multiple as u64 * step as u64).wrapping_mul(half_ticks as u64) >> 1) as u32
}

/// The way of a phase through one block.
const fn block_step(multiple: u32, step: u32) -> u32 {
    multiple.wrapping_mul(step).wrapping_mul(BLOCK_TICKS as u32)
}

/// The tones of one multisine at the centre of a block.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Tones {
    /// Sines and cosines, times the amplitude, Q1.30.
    sin: Part,
    cos: Part,
    /// Phase of the first tone there, and how much further each tone is than the one before.
    first: u32,
    stride: u32,
    /// Their ways through one block.
    first_step: u32,
    stride_step: u32,
    /// Cosine and sine of `stride`, Q0.31.
    turn: [i32; 2],
    /// Of a tone, Q1.30.
    amplitude: i32,
}

/// One multisine. What each tick needs first: two words there are one load.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Bank {
    /// Of the next block.
    tones: Tones,
    /// Tick in the block.
    tick: usize,
    /// Factors of the pairs from the centre outwards; then the values that are put out, Q1.30.
    parts: [Part; PARTS],
}

/// The multisines of one axis: the one that runs, and the one that waits.
#[derive(Clone, Copy, Debug)]
pub struct Multisines {
    banks: [Bank; 2],
    /// Which one runs: 0 or 1.
    running: usize,
    /// Parts that the other one still lacks: the last ones.
    missing: usize,
}

impl Tones {
    const NONE: Self = Self {
        sin: [0; TONES],
        cos: [0; TONES],
        first: 0,
        stride: 0,
        first_step: 0,
        stride_step: 0,
        turn: [0; 2],
        amplitude: 0,
    };

    /// To the centre of a waveform's first block. The tones themselves stay what they are.
    #[inline(always)]
    const fn begin(&mut self, generator: &Generator) {
        if let Shape::Multisine { first, stride, amplitude, .. } = generator.shape {
            let (first, stride) = (first as u32, stride as u32);
            self.first = phase_after(first, generator.step, BLOCK_TICKS as u32 - 1);
            self.stride = phase_after(stride, generator.step, BLOCK_TICKS as u32 - 1);
            self.first_step = block_step(first, generator.step);
            self.stride_step = block_step(stride, generator.step);
            self.amplitude = amplitude;
        }
    }

    /// One of the [`PAIRS`] steps to the centre of the next block.
    #[inline(always)]
    fn step(&mut self, tick: usize) {
        match tick {
            0..=3 => self.turn_on(tick),
            // Five a tick, from the one before them.
            5.. => self.rotate(5 * tick - 25..5 * tick - 19),
            _ => {}
        }
    }

    /// The rotation from tone to tone and the first tone are four sines, one a tick.
    #[inline(always)]
    fn turn_on(&mut self, tick: usize) {
        if tick == 0 {
            self.first = self.first.wrapping_add(self.first_step);
            self.stride = self.stride.wrapping_add(self.stride_step);
        }
        let phase = if tick < 2 { self.stride } else { self.first };
        // Cosines in even ticks.
        let value =
            sin_q30(if tick.is_multiple_of(2) { phase.wrapping_add(1 << 30) } else { phase });
        let [turn_cos, turn_sin] = &mut self.turn;
        let ([first_sin, ..], [first_cos, ..]) = (&mut self.sin, &mut self.cos);
        match tick {
            0 => *turn_cos = plus(value, value),
            1 => *turn_sin = plus(value, value),
            2 => *first_cos = mul_q30(value, self.amplitude),
            _ => *first_sin = mul_q30(value, self.amplitude),
        }
    }

    /// Each of some tones, but the first, from the one before it.
    #[inline(always)]
    fn rotate(&mut self, tones: Range<usize>) {
        let (Some([sin, sines @ ..]), Some([cos, cosines @ ..])) =
            (self.sin.get_mut(tones.clone()), self.cos.get_mut(tones))
        else {
            return;
        };
        let (mut sin, mut cos) = (*sin, *cos);
        for (next_sin, next_cos) in sines.iter_mut().zip(cosines) {
            let [turn_cos, turn_sin] = self.turn;
            // A product of Q1.30 and Q0.31 has 29 fraction bits in its upper word.
            let sum = add_high(high(sin, turn_cos), cos, turn_sin);
            let difference = high(cos, turn_cos).wrapping_sub(high(sin, turn_sin));
            (sin, cos) = (plus(sum, sum), plus(difference, difference));
            (*next_sin, *next_cos) = (sin, cos);
            // Loaded anew, the turn is not widened to 64 bits once and for all, which would take twice the multiplications.
            compiler_fence(Ordering::SeqCst);
        }
    }
}

impl Bank {
    const EMPTY: Self = Self { tones: Tones::NONE, tick: 0, parts: [[0; PART_WORDS]; PARTS] };

    /// One tick: the value, Q1.30, and a share of the next block.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    fn step(&mut self) -> i32 {
        let tick = self.tick % BLOCK_TICKS;
        self.tick = tick + 1;
        let [factors @ .., values] = &mut self.parts;
        let (early, late) = values.split_at_mut(PAIRS);
        let Some(pair) = tick.checked_sub(PAIRS) else {
            self.tones.step(tick);
            return early.get(tick).copied().unwrap_or(0);
        };
        let (factors, _) = factors.as_chunks::<2>();
        let (Some(factors), Some(early), Some(late)) =
            (factors.get(pair), early.get_mut(PAIRS - 1 - pair), late.get_mut(pair))
        else {
            return 0;
        };
        let [before, after] = around(factors, &self.tones);
        *early = before;
        core::mem::replace(late, after)
    }
}

/// The values before and after the centre, Q1.30.
#[inline(always)]
fn around([cosines, sines]: &[Part; 2], tones: &Tones) -> [i32; 2] {
    // The upper word of a product has 28 fraction bits. All tones together stay below 6: of n tones, none is larger than the
    // square root of 2/n. One sum after the other: of two at a time the compiler keeps all words on the stack.
    let even = add_products(0, cosines, &tones.sin);
    let after = add_products(even, sines, &tones.cos);
    let before = even.wrapping_add(even).wrapping_sub(after);
    let q30 = |value: i32| clamp_bits::<29>(value) << 2;
    [q30(before), q30(after)]
}

/// `sum` and the upper words of the products of all tones.
#[inline(always)]
fn add_products(sum: i32, factors: &Part, tones: &Part) -> i32 {
    let ((factors, _), (tones, _)) = (factors.as_chunks::<4>(), tones.as_chunks::<4>());
    // Written out: a loop's own instructions would be half as many as a tone's.
    if let ([f0, f1, f2, f3], [t0, t1, t2, t3]) = (factors, tones) {
        let sum = add_four(sum, *f0, *t0);
        let sum = add_four(sum, *f1, *t1);
        let sum = add_four(sum, *f2, *t2);
        return add_four(sum, *f3, *t3);
    }
    sum
}

/// The same of four tones. The fence keeps their words together, which are then loaded two by two.
#[inline(always)]
fn add_four(sum: i32, factors: [i32; 4], tones: [i32; 4]) -> i32 {
    compiler_fence(Ordering::SeqCst);
    let ([fa, fb, fc, fd], [ta, tb, tc, td]) = (factors, tones);
    add_high(add_high(add_high(add_high(sum, fa, ta), fb, tb), fc, tc), fd, td)
}

impl Multisines {
    /// None.
    pub const NONE: Self = Self { banks: [Bank::EMPTY; 2], running: 0, missing: 0 };

    /// Makes ready for a waveform's parts. Whether it is complete: it has none.
    #[inline(always)]
    pub(crate) fn stage(&mut self, generator: &Generator) -> bool {
        self.missing = 0;
        if let Shape::Multisine { .. } = generator.shape
            && let Some(bank) = self.banks.get_mut(1 - self.running % 2)
        {
            bank.tones.begin(generator);
            bank.tick = 0;
            self.missing = PARTS;
        }
        self.missing == 0
    }

    /// Takes the next part of the waveform that waits. Whether it is complete now, or `None` where another part comes next, or none.
    #[inline(always)]
    pub(crate) fn take(&mut self, part: usize, words: &Part) -> Option<bool> {
        let [one, other] = &mut self.banks;
        let bank = if self.running == 0 { other } else { one };
        let place = bank.parts.get_mut(part)?;
        if part + self.missing != PARTS {
            return None;
        }
        crate::math::copy(place, words);
        self.missing -= 1;
        Some(self.missing == 0)
    }

    /// The one that waited runs.
    #[inline(always)]
    pub(crate) fn start(&mut self) {
        self.running = 1 - self.running % 2;
    }

    /// The value of the one that runs, Q1.30; the tick moves on.
    #[inline(always)]
    pub(crate) fn step(&mut self) -> i32 {
        let [one, other] = &mut self.banks;
        if self.running == 0 { one } else { other }.step()
    }
}

impl Generator {
    /// Parts that follow the staging of this waveform.
    pub(super) const fn parts(&self) -> usize {
        if matches!(self.shape, Shape::Multisine { .. }) { PARTS } else { 0 }
    }

    /// One of these parts. Some hundred sines for the last one: off the hot path.
    pub(super) fn part(&self, part: usize) -> Part {
        if part + 1 == PARTS {
            self.first_block()
        } else {
            self.factors(part / 2, 1 - part as u32 % 2)
        }
    }

    /// Cosines (`quarter` 1) or sines (0) of a pair, from the centre outwards.
    fn factors(&self, pair: usize, quarter: u32) -> Part {
        let mut part = [0; PART_WORDS];
        let Shape::Multisine { first, stride, tones, signs, .. } = self.shape else { return part };
        for (k, factor) in (0..u32::from(tones)).zip(&mut part) {
            let multiple = u32::from(first) + u32::from(stride) * k;
            let phase = phase_after(multiple, self.step, 2 * pair as u32 + 1);
            let value = sin_q30(phase.wrapping_add(quarter << 30));
            *factor = if signs >> k & 1 == 0 { value } else { -value };
        }
        part
    }

    /// The values of the first block, found as the tick finds those of all others.
    fn first_block(&self) -> Part {
        let mut tones = Tones::NONE;
        tones.begin(self);
        tones.first = tones.first.wrapping_sub(tones.first_step);
        tones.stride = tones.stride.wrapping_sub(tones.stride_step);
        for tick in 0..PAIRS {
            tones.step(tick);
        }
        let mut values = [0; BLOCK_TICKS];
        for pair in 0..PAIRS {
            let factors = [self.factors(pair, 1), self.factors(pair, 0)];
            let [before, after] = around(&factors, &tones);
            let (early, late) = values.split_at_mut(PAIRS);
            if let (Some(early), Some(late)) = (early.get_mut(PAIRS - 1 - pair), late.get_mut(pair))
            {
                (*early, *late) = (before, after);
            }
        }
        values
    }
}

#[cfg(test)]
mod tests;
