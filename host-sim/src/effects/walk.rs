//! A random walk over a session by the first terms of its Karhunen-Loeve series: sum of a_k sin((k - 1/2) pi t/T) (Loeve, Probability Theory,
//! 1955, section 34). Between what is known it goes straight, if the a_k are held to what they are expected to be: 1/(k - 1/2).

use std::f64::consts::PI;

/// Segments that the time of a walk is cut into: the fastest of sixteen terms goes through 12 mrad in one, and a cubic through both ends with
/// their slopes is off by 5e-11 of that term.
const SEGMENTS: f64 = 4096.0;

/// A walk, in the unit of its sizes.
#[derive(Debug)]
pub struct Walk {
    /// One size a term; none of a walk that goes nowhere.
    sizes: Vec<f64>,
    over_s: f64,
    segment: Segment,
}

/// A cubic that the walk goes along for a part of its time.
#[derive(Debug, Clone, Copy)]
struct Segment {
    /// Which one; not a number before the first.
    number: f64,
    /// Coefficients by what part of the segment has gone by, constant first.
    cubic: [f64; 4],
}

impl Walk {
    /// From the sizes of its terms, slowest first, and the time that they are for, s.
    pub fn new(sizes: &[f64], over_s: f64) -> Self {
        let goes = sizes.iter().any(|size| *size != 0.0);
        let sizes = if goes { sizes.to_vec() } else { Vec::new() };
        Self { sizes, over_s, segment: Segment { number: f64::NAN, cubic: [0.0; 4] } }
    }

    /// Where it is at a time on the session's clock, s. Beyond the end it stays where it is, which is where a random walk is expected.
    #[inline]
    pub fn at(&mut self, time_s: f64) -> f64 {
        if self.sizes.is_empty() {
            return 0.0;
        }
        let segments = SEGMENTS * (time_s / self.over_s).min(1.0);
        let number = segments.floor();
        if number != self.segment.number {
            self.segment = self.segment(number);
        }
        let [a, b, c, d] = self.segment.cubic;
        let gone = segments - number;
        a + gone * (b + gone * (c + gone * d))
    }

    /// The cubic of a segment.
    fn segment(&self, number: f64) -> Segment {
        let [(from, leaves), (to, arrives)] = [number, number + 1.0].map(|n| self.exactly(n));
        let (far, bend) = (to - from, leaves + arrives);
        let cubic = [from, leaves, 3.0 * far - leaves - bend, bend - 2.0 * far];
        Segment { number, cubic }
    }

    /// Where it is after so many segments, and how far it would go at this speed in one.
    fn exactly(&self, segments: f64) -> (f64, f64) {
        let quarter = 0.5 * PI / SEGMENTS;
        // Of (k + 1) a from k a and (k - 1) a by 2 cos(a), in steps of two quarter turns.
        let (sin, cos) = (quarter * segments).sin_cos();
        let twice = 2.0 * (cos * cos - sin * sin);
        let (mut sines, mut cosines) = ((-sin, sin), (cos, cos));
        let (mut place, mut speed) = (0.0, 0.0);
        for (size, k) in self.sizes.iter().zip((1_u32..).step_by(2)) {
            place += size * sines.1;
            speed += size * f64::from(k) * quarter * cosines.1;
            sines = (sines.1, twice * sines.1 - sines.0);
            cosines = (cosines.1, twice * cosines.1 - cosines.0);
        }
        (place, speed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_is_the_sum_of_its_sines() {
        let sizes: Vec<f64> = (1..=16).map(|k| (f64::from(k) * 1.7).sin() / f64::from(k)).collect();
        let over_s = 37.0;
        let mut walk = Walk::new(&sizes, over_s);
        let exact = |t: f64| {
            let terms = sizes.iter().zip((1_u32..).step_by(2));
            let part = (t / over_s).min(1.0);
            terms.map(|(a, k)| a * (0.5 * PI * f64::from(k) * part).sin()).sum::<f64>()
        };
        let times = (-20..500).map(|n| f64::from(n) * 0.0913);
        // Backwards as well: times may come in any order.
        for t in times.clone().chain(times.rev()) {
            assert!((walk.at(t) - exact(t)).abs() < 1.0e-11, "{t} s: {} {}", walk.at(t), exact(t));
        }
        assert_eq!(walk.at(over_s), walk.at(2.0 * over_s));
        assert_eq!(Walk::new(&[0.0; 3], over_s).at(1.0), 0.0);
    }
}
