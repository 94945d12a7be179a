//! Power spectral density by Welch's method: Hann windows, half overlap, mean removed from each segment.
//!
//! One-sided, unit²/Hz; scaled so that the integral over frequency is the variance (P. D. Welch, IEEE Trans. Audio
//! Electroacoust. 15, 1967; scaling as in G. Heinzel et al., "Spectrum and spectral density estimation", 2002, eq. 22).

use realfft::RealFftPlanner;

/// A one-sided power spectral density.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Psd {
    /// Frequencies, hertz, without zero.
    pub frequency_hz: Vec<f64>,
    /// Density, unit² per hertz.
    pub density: Vec<f64>,
    /// Segments averaged.
    pub segments: usize,
}

impl Psd {
    /// Root mean square of everything at and above each frequency: how much is left when all below it is removed.
    pub fn rms_above(&self) -> Vec<f64> {
        let df = self.spacing_hz();
        let mut sum = 0.0;
        let mut out: Vec<f64> = self
            .density
            .iter()
            .rev()
            .map(|d| {
                sum += d * df;
                sum.sqrt()
            })
            .collect();
        out.reverse();
        out
    }

    /// Root mean square of everything up to each frequency.
    pub fn rms_below(&self) -> Vec<f64> {
        let df = self.spacing_hz();
        let mut sum = 0.0;
        self.density
            .iter()
            .map(|d| {
                sum += d * df;
                sum.sqrt()
            })
            .collect()
    }

    /// Total root mean square.
    pub fn rms(&self) -> f64 {
        self.rms_below().last().copied().unwrap_or(0.0)
    }

    /// Lines that stand out of their surroundings by at least `factor` in amplitude: (frequency, rms amplitude), the
    /// strongest first. Mains hum shows up here.
    pub fn lines(&self, factor: f64) -> Vec<(f64, f64)> {
        const REACH: usize = 12;
        let df = self.spacing_hz();
        let n = self.density.len();
        let mut out = Vec::new();
        for i in 3..n.saturating_sub(3) {
            let here = self.density[i];
            if here < self.density[i - 1] || here < self.density[i + 1] {
                continue;
            }
            let mut around: Vec<f64> = (i.saturating_sub(REACH)..(i + REACH + 1).min(n))
                .filter(|j| j.abs_diff(i) > 2)
                .map(|j| self.density[j])
                .collect();
            around.sort_by(f64::total_cmp);
            let Some(&floor) = around.get(around.len() / 2) else { continue };
            if floor > 0.0 && here > floor * factor * factor {
                // A Hann window spreads a line over three bins.
                let power: f64 = self.density[i - 1..=i + 1].iter().map(|d| (d - floor) * df).sum();
                out.push((self.frequency_hz[i], power.max(0.0).sqrt()));
            }
        }
        out.sort_by(|a, b| b.1.total_cmp(&a.1));
        out
    }

    fn spacing_hz(&self) -> f64 {
        self.frequency_hz.first().copied().unwrap_or(0.0)
    }
}

/// Hann window of `n` points (periodic form, which overlaps to a constant).
pub(crate) fn hann(n: usize) -> Vec<f64> {
    (0..n).map(|i| 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / n as f64).cos()).collect()
}

/// Spectral density of a signal. Segments that hold a NaN (lost ticks) are left out.
///
/// `segment` is the number of samples a segment, so the resolution is `sample_rate_hz / segment`. Returns an empty
/// spectrum when the signal is shorter than one segment.
pub fn welch(signal: &[f32], sample_rate_hz: f64, segment: usize) -> Psd {
    if segment < 8 || signal.len() < segment {
        return Psd::default();
    }
    let fft = RealFftPlanner::<f64>::new().plan_fft_forward(segment);
    let window = hann(segment);
    let window_power: f64 = window.iter().map(|w| w * w).sum();
    let mut buffer = fft.make_input_vec();
    let mut spectrum = fft.make_output_vec();
    let mut sum = vec![0.0; segment / 2];
    let mut segments = 0;
    let mut start = 0;
    while start + segment <= signal.len() {
        let part = &signal[start..start + segment];
        start += segment / 2;
        let mean = part.iter().map(|&x| f64::from(x)).sum::<f64>() / segment as f64;
        if !mean.is_finite() {
            continue;
        }
        for ((b, &x), w) in buffer.iter_mut().zip(part).zip(&window) {
            *b = (f64::from(x) - mean) * w;
        }
        if fft.process(&mut buffer, &mut spectrum).is_err() {
            continue;
        }
        for (k, s) in sum.iter_mut().enumerate() {
            // The Nyquist bin of an even segment has no mirror image.
            let sides = if segment.is_multiple_of(2) && k + 1 == segment / 2 { 1.0 } else { 2.0 };
            *s += sides * spectrum[k + 1].norm_sqr() / (sample_rate_hz * window_power);
        }
        segments += 1;
    }
    if segments == 0 {
        return Psd::default();
    }
    let df = sample_rate_hz / segment as f64;
    Psd {
        frequency_hz: (1..=segment / 2).map(|k| k as f64 * df).collect(),
        density: sum.into_iter().map(|s| s / segments as f64).collect(),
        segments,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::SmallRng};

    #[test]
    fn the_integral_is_the_variance_of_white_noise() {
        let mut rng = SmallRng::seed_from_u64(1);
        let signal: Vec<f32> = (0..200_000).map(|_| rng.random_range(-1.0..1.0)).collect();
        let psd = welch(&signal, 10_000.0, 2048);
        let expected = (1.0f64 / 3.0).sqrt();
        assert!((psd.rms() / expected - 1.0).abs() < 0.01, "{}", psd.rms());
        // White: half of the power below a quarter of the rate.
        let half = psd.rms_below()[psd.density.len() / 2] / psd.rms();
        assert!((half - 0.5f64.sqrt()).abs() < 0.01, "{half}");
        assert!(psd.lines(4.0).is_empty());
    }

    #[test]
    fn a_sine_has_its_amplitude_and_is_named_a_line() {
        let mut rng = SmallRng::seed_from_u64(2);
        let signal: Vec<f32> = (0..100_000)
            .map(|i| {
                (0.3 * (std::f64::consts::TAU * 50.0 * i as f64 / 10_000.0).sin()) as f32
                    + rng.random_range(-0.01..0.01)
            })
            .collect();
        let psd = welch(&signal, 10_000.0, 10_000);
        let lines = psd.lines(5.0);
        assert!((lines[0].0 - 50.0).abs() < 1.1, "{lines:?}");
        assert!((lines[0].1 / (0.3 / 2f64.sqrt()) - 1.0).abs() < 0.02, "{lines:?}");
    }

    #[test]
    fn lost_ticks_spoil_only_their_segments() {
        let mut signal = vec![1.0f32; 8192];
        signal[100] = f32::NAN;
        let psd = welch(&signal, 1000.0, 1024);
        assert!(psd.segments > 10 && psd.rms() < 1e-9);
    }
}
