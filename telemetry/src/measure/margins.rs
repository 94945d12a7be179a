//! Gain, phase and modulus margin of a loop from its measured frequency response L(f) (negative feedback).
//!
//! Margins are taken where they are defined, with log-frequency interpolation between measured points, and are `None`
//! when the crossing lies outside the measured band: a margin that was not measured is not reported as infinite.

use num_complex::Complex64;

use super::Frf;

/// Stability margins of a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Margins {
    /// Frequency at which the loop gain last falls through 1, hertz.
    pub crossover_hz: Option<f64>,
    /// Smallest phase margin over all gain crossings, degrees.
    pub phase_margin_deg: Option<f64>,
    /// Frequency of the smallest gain margin, hertz.
    pub phase_crossover_hz: Option<f64>,
    /// Smallest gain margin over all crossings of -180 degrees where the gain is below 1, decibels.
    pub gain_margin_db: Option<f64>,
    /// Smallest distance of L from -1; below 0.5 a loop is close to ringing.
    pub modulus_margin: Option<f64>,
    /// Frequency of that distance, hertz.
    pub modulus_margin_hz: Option<f64>,
}

/// Margins of a measured loop gain.
pub fn margins(loop_gain: &Frf) -> Margins {
    let points = &loop_gain.points;
    let phase = loop_gain.phase_deg();
    let mut out = Margins::default();
    for (i, pair) in points.windows(2).enumerate() {
        let (a, b) = (&pair[0], &pair[1]);
        let (db_a, db_b) = (a.magnitude_db(), b.magnitude_db());
        let at = |share: f64| {
            (a.frequency_hz.ln() + share * (b.frequency_hz / a.frequency_hz).ln()).exp()
        };
        if (db_a >= 0.0) != (db_b >= 0.0) {
            let share = db_a / (db_a - db_b);
            let here = phase[i] + share * (phase[i + 1] - phase[i]);
            // Distance to the nearest odd multiple of 180 degrees.
            let margin = (here.rem_euclid(360.0) - 180.0).abs();
            if out.phase_margin_deg.is_none_or(|m| margin < m) {
                out.phase_margin_deg = Some(margin);
            }
            if db_a >= 0.0 {
                out.crossover_hz = Some(at(share));
            }
        }
        let branch = |p: f64| ((p + 180.0) / 360.0).floor();
        if branch(phase[i]) != branch(phase[i + 1]) {
            let target = 360.0 * branch(phase[i]).max(branch(phase[i + 1])) - 180.0;
            let share = (target - phase[i]) / (phase[i + 1] - phase[i]);
            let db = db_a + share * (db_b - db_a);
            if db < 0.0 && out.gain_margin_db.is_none_or(|m| -db < m) {
                out.gain_margin_db = Some(-db);
                out.phase_crossover_hz = Some(at(share));
            }
        }
    }
    for p in points {
        let distance = (Complex64::new(1.0, 0.0) + p.response).norm();
        if out.modulus_margin.is_none_or(|m| distance < m) {
            out.modulus_margin = Some(distance);
            out.modulus_margin_hz = Some(p.frequency_hz);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::FrfPoint;
    use std::f64::consts::TAU;

    fn loop_of(l: impl Fn(Complex64) -> Complex64) -> Frf {
        let points = (0..4000)
            .map(|i| {
                let f = 0.01 * 10f64.powf(i as f64 / 1000.0);
                FrfPoint {
                    frequency_hz: f,
                    response: l(Complex64::new(0.0, TAU * f)),
                    coherence: 1.0,
                }
            })
            .collect();
        Frf { points }
    }

    #[test]
    fn third_order_textbook_loop() {
        // L = K / (s+1)^3: phase crossover at sqrt(3) rad/s, gain margin 8/K; here K = 4 gives 6.02 dB.
        let m = margins(&loop_of(|s| 4.0 / (s + 1.0).powi(3)));
        assert!((m.gain_margin_db.unwrap() - 20.0 * 2f64.log10()).abs() < 0.01, "{m:?}");
        assert!((m.phase_crossover_hz.unwrap() - 3f64.sqrt() / TAU).abs() < 1e-3);
        // |L| = 1 at w = sqrt(4^(2/3) - 1): phase margin 180 - 3 atan(w).
        let w = (4f64.powf(2.0 / 3.0) - 1.0).sqrt();
        assert!((m.phase_margin_deg.unwrap() - (180.0 - 3.0 * w.atan().to_degrees())).abs() < 0.05);
        assert!((m.crossover_hz.unwrap() - w / TAU).abs() < 1e-3);
    }

    #[test]
    fn an_integrator_with_delay() {
        // L = 2 pi fc / s * exp(-s T): phase margin 90 - 360 fc T, gain margin at f = 1 / (4 T).
        let (fc, t) = (1.0, 0.1);
        let m = margins(&loop_of(|s| TAU * fc / s * (-s * t).exp()));
        assert!((m.phase_margin_deg.unwrap() - (90.0 - 36.0)).abs() < 0.1, "{m:?}");
        assert!((m.gain_margin_db.unwrap() - 20.0 * 2.5f64.log10()).abs() < 0.05, "{m:?}");
    }

    #[test]
    fn what_was_not_measured_is_none() {
        let m = margins(&loop_of(|s| 0.1 / (s + 1.0)));
        assert_eq!((m.crossover_hz, m.phase_margin_deg, m.gain_margin_db), (None, None, None));
        assert!(m.modulus_margin.unwrap() > 0.9);
    }
}
