//! What the hum of amplifier and gauge share: a mains frequency with its second and third harmonic.

use super::Parameter;
use super::walk::Walk;

/// Multiples of the fundamental.
const ORDERS: [f64; 3] = [1.0, 2.0, 3.0];

/// A hum on the session's clock.
#[derive(Debug)]
pub(super) struct Hum {
    /// Parts in phase with the clock and a quarter period behind, fundamental first.
    parts: [(f64, f64); 3],
    rate_per_s: f64,
    ahead_turns: Walk,
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
        Self { parts, rate_per_s: std::f64::consts::TAU * values[6], ahead_turns }
    }

    /// At a time of the session.
    pub(super) fn at(&self, time_s: f64) -> f64 {
        let ahead = std::f64::consts::TAU * self.ahead_turns.at(time_s);
        let angle = self.rate_per_s * time_s + ahead;
        let part = |((cos, sin), order): (&(f64, f64), f64)| {
            if (*cos, *sin) == (0.0, 0.0) {
                return 0.0;
            }
            let (s, c) = (order * angle).sin_cos();
            cos * c + sin * s
        };
        self.parts.iter().zip(ORDERS).map(part).sum()
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
