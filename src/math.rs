//! Fixed-point sine for the tick, and the few transcendental functions that building coefficients needs.
//!
//! The sine is a polynomial in integers, so that host and target agree bit for bit. The builders run off the hot path, on
//! the board too; they lean on `micromath`, whose approximations are sharpened here to what a filter coefficient needs.

use micromath::F32Ext;

/// 1.0 in the Q1.30 format of waveforms and blends.
pub const ONE_Q30: i32 = 1 << 30;

/// Upper 32 bits of a product: one `smmul` on the Cortex-M4.
#[inline(always)]
pub(crate) const fn high(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

/// `sum` and the upper 32 bits of a product, rounded: one `smmlar` on the Cortex-M4.
#[inline(always)]
pub(crate) const fn add_high(sum: i32, a: i32, b: i32) -> i32 {
    let wide = ((sum as i64) << 32).wrapping_add(a as i64 * b as i64).wrapping_add(1 << 31);
    (wide >> 32) as i32
}

/// Product of two Q1.30 numbers, truncated.
#[inline(always)]
pub const fn mul_q30(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 30) as i32
}

/// sin(2 pi `phase` / 2^32) in Q1.30, error below 3e-8 of full scale.
///
/// Odd polynomial of degree 9 on the folded quarter wave, near-minimax (fitted at Chebyshev nodes).
#[inline(always)]
pub const fn sin_q30(phase: u32) -> i32 {
    // Fold to +-quarter turn; as i32, a turn is 2^32 and a quarter 2^30. Beyond a quarter the two upper bits differ.
    let turn = phase as i32;
    sin_quarter_q30(if turn ^ (turn << 1) < 0 { i32::MIN.wrapping_sub(turn) } else { turn })
}

/// As [`sin_q30`], for a phase within a quarter turn of 0.
#[inline(always)]
pub(crate) const fn sin_quarter_q30(u: i32) -> i32 {
    let u2 = high(u, u) << 2;
    // Coefficients of sin(pi/2 u) in Q1.30 against u2 in Q30: high(c, u2) has 28 bits; keep Q30 by << 2.
    let mut p = SIN_C9;
    p = SIN_C7 + (high(p, u2) << 2);
    p = SIN_C5 + (high(p, u2) << 2);
    p = SIN_C3 + (high(p, u2) << 2);
    p = SIN_C1 + (high(p, u2) << 2);
    // p and u in Q30.
    mul_q30(p, u)
}

// Fitted offline by iteratively reweighted least squares on sin(pi u / 2); Q1.30. Error of the polynomial itself: 3.4e-9.
const SIN_C1: i32 = 843_314_837 << 1;
const SIN_C3: i32 = -346_798_938 << 1;
const SIN_C5: i32 = 42_782_427 << 1;
const SIN_C7: i32 = -2_508_383 << 1;
const SIN_C9: i32 = 80_971 << 1;

/// cos(2 pi `phase` / 2^32) in Q1.30.
#[inline(always)]
pub const fn cos_q30(phase: u32) -> i32 {
    sin_q30(phase.wrapping_add(1 << 30))
}

/// 3 u^2 - 2 u^3 for u in 0..=2^30 (Q1.30): from 0 to 1 with no velocity at either end.
#[inline(always)]
pub const fn smoothstep_q30(u: i32) -> i32 {
    let u2 = mul_q30(u, u);
    // u^2 (3 - 2u): 3 does not fit Q1.30, so the factor is halved (Q2.29) and the product doubled.
    let factor = 3 * (1 << 29) - u; // (3 - 2u) in Q2.29
    ((u2 as i64 * factor as i64) >> 29) as i32
}

/// Straight line from 0 to 1 whose first and last eighth are parabolas: a ramp without corners, `u` in Q1.30.
#[inline(always)]
pub const fn rounded_ramp_q30(u: i32) -> i32 {
    let mirrored = u > ONE_Q30 / 2;
    let u = if mirrored { ONE_Q30 - u } else { u };
    // 8/7 and 32/7 in Q4.27 (32/7 = 4.57).
    const SLOPE: i64 = (8 * (1 << 27)) / 7;
    const BEND: i64 = (32 * (1 << 27)) / 7;
    let s = if u < ONE_Q30 / 8 {
        ((mul_q30(u, u) as i64 * BEND) >> 27) as i32
    } else {
        (((u - ONE_Q30 / 16) as i64 * SLOPE) >> 27) as i32
    };
    if mirrored { ONE_Q30 - s } else { s }
}

/// exp(-x) for x >= 0. micromath's series is good to 1e-3 near 1 but to rounding for small arguments, so x is divided first.
pub(crate) fn exp_minus(x: f32) -> f32 {
    if x > 80.0 {
        return 0.0;
    }
    let mut parts = 1.0f32;
    let mut doublings = 0;
    while x / parts > 0.05 {
        parts *= 2.0;
        doublings += 1;
    }
    let mut y: f32 = F32Ext::exp(-x / parts);
    for _ in 0..doublings {
        y *= y;
    }
    y
}

/// Natural logarithm of x > 0: micromath's estimate and two Newton steps on exp.
pub(crate) fn ln(x: f32) -> f32 {
    let (x, sign) = if x < 1.0 { (1.0 / x, -1.0) } else { (x, 1.0) };
    let mut y: f32 = F32Ext::ln(x);
    for _ in 0..2 {
        y += x * exp_minus(y) - 1.0;
    }
    sign * y
}

/// sin and cos of 2 pi `turns`, for 0 <= turns < 1.
pub(crate) fn sin_cos_turns(turns: f32) -> (f32, f32) {
    let phase = phase_of_turns(turns);
    (sin_q30(phase) as f32 / ONE_Q30 as f32, cos_q30(phase) as f32 / ONE_Q30 as f32)
}

/// Fraction of a turn as a 32-bit phase; whole turns drop out.
pub(crate) fn phase_of_turns(turns: f32) -> u32 {
    let whole = turns as i32 as f32;
    let fraction = turns - whole;
    let fraction = if fraction < 0.0 { fraction + 1.0 } else { fraction };
    (fraction as f64 * 4_294_967_296.0) as u64 as u32
}

/// Sets all places to a value, one by one. The fence keeps the compiler from making a call to `memset` of it, which does not lie in
/// the memory that the board's interrupt runs from.
#[inline(always)]
pub(crate) fn fill<T: Copy>(places: &mut [T], value: T) {
    for place in places {
        *place = value;
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
    }
}

/// Copies words, four at a time, for the reason given at [`fill`]: more at once would be a call to `memcpy`.
#[inline(always)]
pub(crate) fn copy<const N: usize>(to: &mut [i32; N], from: &[i32; N]) {
    const { assert!(N.is_multiple_of(4)) };
    let ((to, _), (from, _)) = (to.as_chunks_mut::<4>(), from.as_chunks::<4>());
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
        core::sync::atomic::compiler_fence(core::sync::atomic::Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_is_accurate_and_odd() {
        let mut worst = 0.0f64;
        for i in 0..200_000u32 {
            let phase = i.wrapping_mul(21_474_871);
            let exact = (phase as f64 / 4_294_967_296.0 * std::f64::consts::TAU).sin();
            worst = worst.max((sin_q30(phase) as f64 / ONE_Q30 as f64 - exact).abs());
        }
        assert!(worst < 3e-8, "{worst}");
        assert_eq!(sin_q30(0), 0);
        assert!((sin_q30(1 << 30) - ONE_Q30).abs() < 16);
        assert!((sin_q30(3 << 30) + ONE_Q30).abs() < 16);
    }

    #[test]
    fn blends_start_and_end_flat() {
        for blend in [smoothstep_q30, rounded_ramp_q30] {
            assert_eq!(blend(0), 0);
            assert!((blend(ONE_Q30) - ONE_Q30).abs() <= 8);
            assert!((blend(ONE_Q30 / 2) - ONE_Q30 / 2).abs() <= 8);
            assert!(blend(1 << 20) < 1 << 13, "flat start");
            let mut last = 0;
            for u in (0..=ONE_Q30).step_by(1 << 16) {
                let s = blend(u);
                assert!(s >= last - 8);
                last = s;
            }
        }
    }

    #[test]
    fn builders_are_sharp_enough_for_coefficients() {
        for x in [1e-6f32, 1e-3, 0.1, 0.25, 1.0, 5.0, 30.0] {
            let exact = (-x as f64).exp();
            assert!(((exp_minus(x) as f64 - exact) / exact).abs() < 2e-5, "exp(-{x})");
        }
        for x in [1e-4f32, 0.1, 0.999, 1.0, 2.0, 1e4] {
            assert!(
                (ln(x) as f64 - (x as f64).ln()).abs() < 2e-5 * (1.0 + (x as f64).ln().abs()),
                "ln {x}"
            );
        }
    }
}
