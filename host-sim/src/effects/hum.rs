//! What the hum of amplifier and gauge share: a mains frequency with its second and third harmonic.

use super::Parameter;

/// Multiples of the fundamental.
const ORDERS: [f64; 3] = [1.0, 2.0, 3.0];

/// A hum on the session's clock.
#[derive(Debug)]
pub(super) struct Hum {
    /// Parts in phase with the clock and a quarter period behind, fundamental first.
    parts: [(f64, f64); 3],
    rate_per_s: f64,
}

impl Hum {
    /// From the values of [`parameters`].
    pub(super) fn new(values: &[f64]) -> Self {
        let parts = std::array::from_fn(|n| (values[2 * n], values[2 * n + 1]));
        Self { parts, rate_per_s: std::f64::consts::TAU * values[6] }
    }

    /// At a time of the session.
    pub(super) fn at(&self, time_s: f64) -> f64 {
        let angle = self.rate_per_s * time_s;
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

/// Parameters of a hum: six sizes and the frequency.
pub(super) const fn parameters(
    names: [&'static str; 6],
    unit: &'static str,
    most: f64,
    typical: f64,
) -> [Parameter; 7] {
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
    ]
}
