//! The soft corner of effects that bend.

/// Beyond it the corner is its two straight lines to the last bit: e^-37 is less than half a unit in the last place of 1.
const STRAIGHT: f64 = 37.0;

/// ln(1 + e^x) and its slope 1/(1 + e^-x): zero far below zero, x far above. Most samples lie far from the corner, and an exponential that
/// underflows is slower than any other.
pub(super) fn softplus(x: f64) -> (f64, f64) {
    if x.abs() > STRAIGHT {
        return if x > 0.0 { (x, 1.0) } else { (0.0, 0.0) };
    }
    let e = (-x.abs()).exp();
    let slope = if x > 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) };
    (x.max(0.0) + e.ln_1p(), slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_is_smooth_and_ends_in_its_lines() {
        for k in -400..=400 {
            let x = f64::from(k) * 0.1;
            let (value, slope) = softplus(x);
            assert!((value - (1.0 + x.exp()).ln()).abs() < 1.0e-14 * value.max(1.0), "at {x}");
            let h = 1.0e-4;
            let difference = (softplus(x + h).0 - softplus(x - h).0) / (2.0 * h);
            assert!((slope - difference).abs() < 1.0e-8, "at {x}: {slope}, {difference}");
        }
        assert_eq!(softplus(1.0e300), (1.0e300, 1.0));
        assert_eq!(softplus(-1.0e300), (0.0, 0.0));
    }
}
