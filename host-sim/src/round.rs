//! Rounding without a library call: processors of the baseline that the program is built for have no instruction for it.

/// Adding this to a number below 2^51 leaves no bits for a fraction.
const NO_FRACTION: f64 = 1.5 * (1_u64 << 52) as f64;

/// The nearest whole number, ties to even.
#[inline]
pub fn nearest(x: f64) -> f64 {
    if x.abs() < (1_u64 << 51) as f64 {
        (x + NO_FRACTION) - NO_FRACTION
    } else {
        x.round_ties_even()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn as_the_library_has_it(
            x in prop_oneof![any::<f64>(), -1.0e6..1.0e6_f64, (-1_000_i32..1_000).prop_map(|n| f64::from(n) * 0.5)],
        ) {
            let (own, library) = (nearest(x), x.round_ties_even());
            prop_assert!(own == library || own.is_nan() && library.is_nan(), "{x}: {own}, not {library}");
        }
    }
}
