//! A random walk over a session by the first terms of its Karhunen-Loeve series: sum of a_k sin((k - 1/2) pi t/T) (Loeve, Probability Theory,
//! 1955, section 34). Between what is known it goes straight, if the a_k are held to what they are expected to be: 1/(k - 1/2).

use std::f64::consts::PI;

/// A walk, in the unit of its sizes.
#[derive(Debug)]
pub struct Walk {
    /// One size a term; none of a walk that goes nowhere.
    sizes: Vec<f64>,
    over_s: f64,
}

impl Walk {
    /// From the sizes of its terms, slowest first, and the time that they are for, s.
    pub fn new(sizes: &[f64], over_s: f64) -> Self {
        let goes = sizes.iter().any(|size| *size != 0.0);
        Self { sizes: if goes { sizes.to_vec() } else { Vec::new() }, over_s }
    }

    /// Where it is at a time on the session's clock, s. Beyond the end it stays where it is, which is where a random walk is expected.
    #[inline]
    pub fn at(&self, time_s: f64) -> f64 {
        if self.sizes.is_empty() {
            return 0.0;
        }
        // sin((k + 1) a) = 2 cos(a) sin(k a) - sin((k - 1) a), in steps of two quarter turns.
        let (sin, cos) = (0.5 * PI * (time_s / self.over_s).min(1.0)).sin_cos();
        let twice = 2.0 * (cos * cos - sin * sin);
        let (mut before, mut now) = (-sin, sin);
        let mut sum = 0.0;
        for size in &self.sizes {
            sum += size * now;
            (before, now) = (now, twice * now - before);
        }
        sum
    }
}
