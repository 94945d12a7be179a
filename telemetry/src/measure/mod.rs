//! What a measurement says: spectra, frequency responses, loop margins, step metrics, noise floor.
//!
//! Everything here works on plain slices, so that a live window, a command and a file use the same code.

pub mod campaign;
pub mod frf;
pub mod margins;
pub mod psd;
pub mod step;

use num_complex::Complex64;

/// One point of a frequency response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrfPoint {
    /// Frequency, hertz.
    pub frequency_hz: f64,
    /// Output over input.
    pub response: Complex64,
    /// Part of the output that the input explains at this frequency, 0 to 1.
    pub coherence: f64,
}

impl FrfPoint {
    /// Magnitude in decibels (20 log10).
    pub fn magnitude_db(&self) -> f64 {
        20.0 * self.response.norm().log10()
    }
}

/// A measured frequency response, frequencies ascending.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frf {
    /// The points.
    pub points: Vec<FrfPoint>,
}

impl Frf {
    /// Phase in degrees, unwrapped from the lowest frequency on.
    pub fn phase_deg(&self) -> Vec<f64> {
        let mut out: Vec<f64> = Vec::with_capacity(self.points.len());
        for point in &self.points {
            let raw = point.response.arg().to_degrees();
            let phase = match out.last() {
                Some(&last) => raw + 360.0 * ((last - raw) / 360.0).round(),
                None => raw,
            };
            out.push(phase);
        }
        out
    }

    /// The response with each point multiplied by `factor(frequency_hz)`.
    pub fn map(&self, factor: impl Fn(f64) -> Complex64) -> Frf {
        let mut out = self.clone();
        for point in &mut out.points {
            point.response *= factor(point.frequency_hz);
        }
        out
    }

    /// Only points with at least this coherence.
    pub fn coherent(&self, at_least: f64) -> Frf {
        Frf { points: self.points.iter().copied().filter(|p| p.coherence >= at_least).collect() }
    }

    /// Static gain: the median magnitude of the lowest few points, less moved by one bad line than the first point.
    pub fn static_gain(&self) -> Option<f64> {
        let mut low: Vec<f64> = self
            .points
            .iter()
            .take(5)
            .map(|p| p.response.norm())
            .filter(|m| m.is_finite())
            .collect();
        low.sort_by(f64::total_cmp);
        low.get(low.len() / 2).copied()
    }

    /// First frequency at which the magnitude has fallen by 3 dB from the static gain, and stays there for the next
    /// point, hertz. A deep notch of one line does not count.
    pub fn bandwidth_hz(&self) -> Option<f64> {
        let limit = self.static_gain()? * std::f64::consts::FRAC_1_SQRT_2;
        let below = |p: &FrfPoint| p.response.norm() < limit;
        self.points.windows(2).find(|w| w.iter().all(below)).map(|w| w[0].frequency_hz)
    }

    /// Frequency and magnitude of the highest peak, when it stands at least 3 dB above the static gain.
    pub fn resonance(&self) -> Option<(f64, f64)> {
        let floor = self.static_gain()? * std::f64::consts::SQRT_2;
        self.points
            .iter()
            .map(|p| (p.frequency_hz, p.response.norm()))
            .filter(|&(_, m)| m > floor)
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }
}
