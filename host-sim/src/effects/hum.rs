//! What the hum of amplifier and gauge share: a mains frequency with its second and third harmonic.

use super::Parameter;
use super::walk::Walk;

/// A hum on the session's clock.
#[derive(Debug)]
pub(super) struct Hum {
    /// Parts in phase with the clock and a quarter period behind, fundamental first.
    parts: [(f64, f64); 3],
    rate_per_s: f64,
    ahead_turns: Walk,
    turning: Turning,
}

/// Sine and cosine of an angle that goes on in steps of about the same size, each turned from the one before. A diagnosis asks for them
/// of every tick of many sessions.
#[derive(Debug)]
struct Turning {
    /// Angle that the sine and the cosine are of, rad.
    angle: f64,
    sin: f64,
    cos: f64,
    /// Angle that was last asked for, rad: not farther from it than [`Self::FAR`].
    asked: f64,
    /// Size of a step, rad, with its sine and cosine.
    step: f64,
    step_sin: f64,
    step_cos: f64,
    /// Steps that may still be taken before rounding is done away with.
    left: u32,
}

impl Turning {
    /// Farthest that a step may end from where it was asked for, rad: of the line that goes there 5e-13 is left out.
    const FAR: f64 = 1.0e-6;
    /// Steps that are taken from one exact angle.
    const STEPS: u32 = 64;

    /// Nowhere yet.
    const NOWHERE: Self = Self {
        angle: f64::INFINITY,
        sin: 0.0,
        cos: 1.0,
        asked: f64::INFINITY,
        step: 0.0,
        step_sin: 0.0,
        step_cos: 1.0,
        left: 0,
    };

    /// Sine and cosine of an angle.
    #[inline]
    fn sin_cos(&mut self, angle: f64) -> (f64, f64) {
        let there = self.angle + self.step;
        let beyond = angle - there;
        let near = -Self::FAR..=Self::FAR;
        let before = std::mem::replace(&mut self.asked, angle);
        if self.left == 0 || !near.contains(&beyond) {
            return self.begin_again(angle, angle - before);
        }
        let sin = self.sin * self.step_cos + self.cos * self.step_sin;
        let cos = self.cos * self.step_cos - self.sin * self.step_sin;
        (self.angle, self.sin, self.cos, self.left) = (there, sin, cos, self.left - 1);
        (sin + beyond * cos, cos - beyond * sin)
    }

    /// Exactly, and from there in steps of a size.
    fn begin_again(&mut self, angle: f64, step: f64) -> (f64, f64) {
        let (sin, cos) = angle.sin_cos();
        let step = if step.is_finite() { step } else { 0.0 };
        let (step_sin, step_cos) = step.sin_cos();
        let asked = angle;
        *self = Self { angle, sin, cos, asked, step, step_sin, step_cos, left: Self::STEPS };
        (sin, cos)
    }
}

/// Terms of the walk that its phase goes.
const WANDERS: usize = 12;
/// Number of parameters.
pub(super) const COUNT: usize = 8 + WANDERS;

impl Hum {
    /// From the values of [`parameters`].
    pub(super) fn new(values: &[f64]) -> Self {
        let parts = std::array::from_fn(|n| (values[2 * n], values[2 * n + 1]));
        let ahead_turns = Walk::new(&values[7..7 + WANDERS], values[7 + WANDERS]);
        let rate_per_s = std::f64::consts::TAU * values[6];
        Self { parts, rate_per_s, ahead_turns, turning: Turning::NOWHERE }
    }

    /// At a time of the session.
    pub(super) fn at(&mut self, time_s: f64) -> f64 {
        let ahead = std::f64::consts::TAU * self.ahead_turns.at(time_s);
        let angle = self.rate_per_s * time_s + ahead;
        // cos(n a + a) and sin(n a + a) from those of n a: one call for all of them.
        let (sin, cos) = self.turning.sin_cos(angle);
        let (mut c, mut s) = (cos, sin);
        let mut sum = 0.0;
        for (along, behind) in self.parts {
            sum += along * c + behind * s;
            (c, s) = (c * cos - s * sin, s * cos + c * sin);
        }
        sum
    }
}

/// Parameters of a hum: six sizes, the frequency, and the walk of its phase.
pub(super) const fn parameters(
    names: [&'static str; 6],
    unit: &'static str,
    most: f64,
    typical: f64,
) -> [Parameter; COUNT] {
    const ABOUT: [&str; 6] = [
        "part in phase with the session's clock",
        "part a quarter period behind",
        "the same of the second harmonic",
        "a quarter period of it behind",
        "the same of the third harmonic",
        "a quarter period of it behind",
    ];
    let [a, b, c, d, e, f] = names;
    let [about_a, about_b, about_c, about_d, about_e, about_f] = ABOUT;
    [
        Parameter::size(a, unit, 0.0, (-most, most), typical, about_a),
        Parameter::size(b, unit, 0.0, (-most, most), typical, about_b),
        Parameter::size(c, unit, 0.0, (-most, most), typical, about_c),
        Parameter::size(d, unit, 0.0, (-most, most), typical, about_d),
        Parameter::size(e, unit, 0.0, (-most, most), typical, about_e),
        Parameter::size(f, unit, 0.0, (-most, most), typical, about_f),
        Parameter::shape("frequency_hz", "Hz", (1.0, 5.0e3), 50.0, "frequency of the fundamental"),
        ahead(
            "ahead_1_turns",
            "how far the grid runs ahead of that frequency: sine of one quarter turn over wander_s",
        ),
        ahead("ahead_2_turns", "... sine of 3 quarter turns"),
        ahead("ahead_3_turns", "... sine of 5 quarter turns"),
        ahead("ahead_4_turns", "... sine of 7 quarter turns"),
        ahead("ahead_5_turns", "... sine of 9 quarter turns"),
        ahead("ahead_6_turns", "... sine of 11 quarter turns"),
        ahead("ahead_7_turns", "... sine of 13 quarter turns"),
        ahead("ahead_8_turns", "... sine of 15 quarter turns"),
        ahead("ahead_9_turns", "... sine of 17 quarter turns"),
        ahead("ahead_10_turns", "... sine of 19 quarter turns"),
        ahead("ahead_11_turns", "... sine of 21 quarter turns"),
        ahead("ahead_12_turns", "... sine of 23 quarter turns"),
        Parameter::shape(
            "wander_s",
            "s",
            (1.0, 1.0e6),
            60.0,
            "time over which that is described: the session's",
        )
        .by_ratio(),
    ]
}

/// A part of the walk of its phase.
const fn ahead(name: &'static str, about: &'static str) -> Parameter {
    Parameter::size(name, "turns", 0.0, (-100.0, 100.0), 0.2, about)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hum_is_the_sum_of_its_harmonics() {
        let mut values = [0.0; COUNT];
        values[..7].copy_from_slice(&[0.3, -0.7, 0.2, 0.1, -0.05, 0.4, 49.7]);
        values[7..10].copy_from_slice(&[1.3, -0.4, 0.2]);
        values[COUNT - 1] = 20.0;
        let exact = |t: f64| {
            let quarter = 0.5 * std::f64::consts::PI * t / 20.0;
            let turns = [(1.3, 1.0), (-0.4, 3.0), (0.2, 5.0)];
            let ahead: f64 = turns.iter().map(|(a, k)| a * (k * quarter).sin()).sum();
            let angle = std::f64::consts::TAU * (49.7 * t + ahead);
            let harmonics = [(0.3, -0.7), (0.2, 0.1), (-0.05, 0.4)];
            (1..=3).zip(harmonics).fold(0.0, |sum, (order, (cos, sin))| {
                let (s, c) = (f64::from(order) * angle).sin_cos();
                sum + cos * c + sin * s
            })
        };
        let mut hum = Hum::new(&values);
        // In order, at ticks that come close to one another and at some that do not, and back.
        let times = (0..4000).map(|n| f64::from(n) * if n < 3000 { 1.0e-4 } else { 4.7e-3 });
        for t in times.clone().chain(times.rev()) {
            let (told, sum) = (hum.at(t), exact(t));
            assert!((told - sum).abs() < 1.0e-11, "{t} s: {told}, {sum} expected");
        }
    }
}
