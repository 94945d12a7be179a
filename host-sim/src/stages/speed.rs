//! Speed of a stage, or current of a stack, at the end of a tick, from its way in this tick and the one before.
//!
//! A force that goes with the speed acts at the end of a tick. The mean speed of the tick is half a tick late, an eighth of the force after
//! an edge that passes an amplifier of four ticks. Motion that grows or decays exponentially, the way an amplifier goes to its target, has
//! the end speed `travel r ln(r) / (r - 1)` a tick, r being the ratio of the two ways. Where motion begins or turns there is no such ratio,
//! and the mean is taken.

/// Ratio of two ways up to which motion is taken for exponential: more is a start.
const GROWS: f64 = 2.0;

/// What was gone in the tick before.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EndSpeed {
    /// In units of the travel.
    before: f64,
}

impl EndSpeed {
    /// Speed at the end (in units of the travel, a tick) after `travel` in this tick, and its slope with the travel, never negative.
    pub(crate) fn at(self, travel: f64) -> (f64, f64) {
        let r = travel / self.before;
        // Not a number where both are zero.
        if !(r > 0.0 && r.is_finite()) {
            return (travel, 1.0);
        }
        let (factor, slope) = factor(r.min(GROWS));
        if r <= GROWS {
            return (travel * factor, factor + r * slope);
        }
        // Back to the mean with the square of the ratio.
        let over = (factor - 1.0) * (GROWS / r).powi(2);
        (travel * (1.0 + over), 1.0 - over)
    }

    /// Whether the speed at the end is beyond `least` (units of the travel, a tick) for sure. Cheaper than asking for the speed.
    #[inline]
    pub(crate) fn is_beyond(self, travel: f64, least: f64) -> bool {
        // Where the ways fall a hundredfold the end speed is a twentieth of the mean one; of growing or turning motion it is no less.
        travel.abs() > (25.0 * least).max(0.01 * self.before.abs())
    }

    /// Accept the travel of a tick.
    pub(crate) fn commit(&mut self, travel: f64) {
        self.before = travel;
    }
}

/// `r ln(r) / (r - 1)` and its slope.
fn factor(r: f64) -> (f64, f64) {
    let more = r - 1.0;
    if more.abs() < 1.0e-3 {
        return (1.0 + more * (0.5 - more / 6.0), 0.5 - more / 3.0);
    }
    let log = r.ln();
    (r * log / more, (more - log) / (more * more))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponential_has_its_own_speed() {
        for decay in [-0.3_f64, 0.05, 0.25, 1.0] {
            let x = |tick: f64| (-decay * tick).exp();
            let mut speed = EndSpeed::default();
            speed.commit(x(1.0) - x(0.0));
            let found = speed.at(x(2.0) - x(1.0)).0;
            let expected = -decay * x(2.0);
            assert!((found / expected - 1.0).abs() < 1.0e-4, "{decay}: {found} for {expected}");
        }
    }

    #[test]
    fn the_slope_is_that_of_the_speed() {
        let mut speed = EndSpeed::default();
        speed.commit(1.0);
        for travel in [-0.5, 0.1, 0.7, 1.0002, 1.5, 3.0, 9.0] {
            let step = 1.0e-6;
            let found = (speed.at(travel + step).0 - speed.at(travel - step).0) / (2.0 * step);
            assert!((found - speed.at(travel).1).abs() < 1.0e-3, "{travel}: {found}");
        }
    }

    #[test]
    fn what_is_said_to_be_beyond_is() {
        for before in [-1.0, 0.0, 1.0e-3, 1.0] {
            let mut speed = EndSpeed::default();
            speed.commit(before);
            for k in -60..=60 {
                let travel = 10.0_f64.powf(f64::from(k) * 0.1);
                for least in [1.0e-3, 0.1, 10.0] {
                    if speed.is_beyond(travel, least) {
                        assert!(speed.at(travel).0 > least, "{before}, {travel}, {least}");
                    }
                }
            }
            assert!(speed.is_beyond(1.0, 0.01));
        }
    }

    #[test]
    fn what_begins_or_turns_goes_with_its_mean() {
        assert_eq!(EndSpeed::default().at(0.0), (0.0, 1.0));
        assert_eq!(EndSpeed::default().at(3.0), (3.0, 1.0));
        let mut speed = EndSpeed::default();
        speed.commit(-1.0);
        assert_eq!(speed.at(0.2), (0.2, 1.0));
    }
}
