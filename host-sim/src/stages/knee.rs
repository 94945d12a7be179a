//! An amplifier whose slope does not end at its limit in a corner, but by and by.
//!
//! What is left of a way after a part of a tick depends only on how much there was, as long as both are counted in what the limit covers
//! in one time constant: a table of it is integrated once, and looked up in every tick.

/// Longest step, in time constants, in which an approach with a knee is integrated: Runge-Kutta's error is then 1e-5 of the way.
const LONGEST_STEP: f64 = 0.25;
/// Entries of a table: with its cubics and the integration a tick is then 2e-5 of the way off at most (tests below).
const ENTRIES: usize = 256;
/// Time constants in a part beyond which nothing is left of a way that a knee could bend: its limit is a corner then.
const LONGEST: f64 = 64.0;
/// How far from the corner a knee bends nothing, in its own width: it takes less than 3e-9 there.
const BENDS: f64 = 20.0;

/// What a knee makes of a part of a tick.
#[derive(Debug, Clone)]
pub struct Knee {
    /// Length of the part, in time constants.
    length: f64,
    /// Slope asked for, in units of the limit, below which the knee bends nothing.
    unbent: f64,
    /// ... and from which the limit holds throughout.
    straight: f64,
    /// Logarithm of the slope at the first entry, and from one to the next.
    first: f64,
    per_entry: f64,
    /// Share of the way that is left, and its slope a step of the table.
    table: Vec<(f64, f64)>,
}

impl Knee {
    /// Of a softness from 0 to 1 and a part of so many time constants; none where there is nothing to bend.
    pub fn new(softness: f64, length: f64) -> Option<Self> {
        if !(softness > 0.0 && length > 0.0 && length < LONGEST) {
            return None;
        }
        let first = -BENDS * softness;
        // From beyond the corner by more than the part is long it does not get there.
        let straight = (BENDS * softness).exp() + length;
        let per_entry = (straight.ln() - first) / (ENTRIES - 1) as f64;
        let entry = |k: usize| {
            let asked = (first + per_entry * k as f64).exp();
            let left = approach(asked, softness, length);
            // Of two ways that follow each other what lies between them shrinks as the slopes do: d left / d asked is their ratio.
            let slope = soft_slope(left, softness) / soft_slope(asked, softness) - left / asked;
            (left / asked, slope * per_entry)
        };
        Some(Self {
            length,
            unbent: first.exp(),
            straight,
            first,
            per_entry,
            table: (0..ENTRIES).map(entry).collect(),
        })
    }

    /// Share of a way that is left at the end, which asks for `asked` times the limit at the start; none where nothing bends it.
    #[inline]
    pub fn left(&self, asked: f64) -> Option<f64> {
        // Also where neither way nor limit is left: not a number.
        if asked.is_nan() || asked < self.unbent {
            return None;
        }
        if asked >= self.straight {
            return Some(1.0 - self.length / asked);
        }
        let at = (asked.ln() - self.first) / self.per_entry;
        let k = (at as usize).min(ENTRIES - 2);
        let (t, (a, from), (b, to)) = (at - k as f64, self.table[k], self.table[k + 1]);
        // The cubic with both values and slopes.
        let u = 1.0 - t;
        let straight = a * u + b * t;
        Some(straight + t * u * (u * (from - (b - a)) + t * ((b - a) - to)))
    }
}

/// Slope, in units of the limit, where the first order asks for `asked` of it: `asked (1 + asked^(1/knee))^-knee`, which goes from the one
/// to the other, all the sharper the smaller the knee.
fn soft_slope(asked: f64, knee: f64) -> f64 {
    if asked <= 0.0 {
        return 0.0;
    }
    let bend = (-asked.ln().abs() / knee).exp();
    asked.min(1.0) * (-knee * bend.ln_1p()).exp()
}

/// What is left of a way after `length` time constants, both in units of what the limit covers in one.
fn approach(mut left: f64, knee: f64, length: f64) -> f64 {
    let steps = (length / LONGEST_STEP).ceil().max(1.0);
    let h = length / steps;
    for _ in 0..steps as usize {
        let slope = |left: f64| soft_slope(left.max(0.0), knee);
        let k1 = slope(left);
        let k2 = slope(left - 0.5 * h * k1);
        let k3 = slope(left - 0.5 * h * k2);
        let k4 = slope(left - h * k3);
        left -= h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4);
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_holds_what_was_integrated() {
        for softness in [0.02, 0.05, 0.2, 0.5, 1.0] {
            for length in [0.05, 0.33, 3.0] {
                let knee = Knee::new(softness, length).unwrap();
                for k in 0..4000 {
                    let asked = (knee.first + 1.0e-3 + 0.01 * f64::from(k)).exp();
                    let expected = approach(asked, softness, length) / asked;
                    let found = knee.left(asked).unwrap();
                    // The straight end is exact; the integration is not.
                    assert!(
                        (found - expected).abs() < 2.0e-5,
                        "{softness}, {length}, {asked}: {found} for {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_a_knee_does_not_bend_goes_exponentially() {
        for softness in [0.05, 0.2, 0.5, 1.0] {
            for length in [0.05, 0.25] {
                let asked = (-BENDS * softness).exp();
                let left = approach(asked, softness, length);
                let error = left / (asked * (-length).exp()) - 1.0;
                // That of the integration.
                assert!(error.abs() < 2.0e-5, "knee {softness}, {length}: {error:e}");
                let slope = soft_slope(asked, softness) / asked - 1.0;
                assert!(slope.abs() < 3.0e-9, "knee {softness}: {slope:e}");
            }
        }
    }

    #[test]
    fn a_slope_beyond_its_limit_is_the_limit() {
        for softness in [0.05, 0.3, 1.0] {
            for asked in [0.0, 1.0e-6, 0.3, 1.0, 2.0, 40.0, 1.0e6] {
                let root = |power: f64| power.powf(1.0 / softness);
                let expected = asked * (1.0 + root(asked)).powf(-softness);
                let found = soft_slope(asked, softness);
                if root(asked).is_finite() {
                    assert!((found - expected).abs() <= 1.0e-12 * expected, "{softness}, {asked}");
                }
                assert!((0.0..=1.0).contains(&found));
            }
        }
    }
}
