//! Frequency response with coherence from a recorded input and output.
//!
//! * [`periodic`]: a multisine. Only excited lines are kept; whole periods make it leakage-free; the spread from period
//!   to period gives the coherence (R. Pintelon, J. Schoukens, "System Identification", 2nd ed., sections 2.4-2.5).
//! * [`swept`]: anything broadband, by averaged cross-spectra (H1 estimator, J. S. Bendat, A. G. Piersol, "Random
//!   Data", 4th ed., section 6.1), bins merged to a logarithmic grid.
//!
//! In closed loop the plant is the ratio of two responses to the same outer excitation ([`ratio`]), which noise that
//! circulates in the loop does not bias (indirect method, same book, section 9.2).

use std::collections::BTreeMap;

use num_complex::Complex64;
use realfft::RealFftPlanner;

use super::psd::hann;
use super::{Frf, FrfPoint};

/// Spectrum of one period, amplitudes (so that a sine of amplitude 1 has norm 1), without line 0.
fn period_spectra(signal: &[f32], period: usize) -> Vec<Vec<Complex64>> {
    let fft = RealFftPlanner::<f64>::new().plan_fft_forward(period);
    let mut spectrum = fft.make_output_vec();
    signal
        .chunks_exact(period)
        .filter_map(|chunk| {
            let mut buffer: Vec<f64> = chunk.iter().map(|&x| f64::from(x)).collect();
            fft.process(&mut buffer, &mut spectrum).ok()?;
            let scale = 2.0 / period as f64;
            Some(spectrum.iter().map(|&x| x * scale).collect())
        })
        .collect()
}

/// Response of `output` to a periodic `input`, at the lines that the input excites.
///
/// `period` is in samples and must divide the sample clock exactly; both slices start at the same tick after the
/// transient has died out. Periods with a lost sample (NaN) are left out. A line counts as excited when it carries
/// at least `1e-3` of the strongest line's amplitude. Needs two clean periods for a coherence below 1.
pub fn periodic(input: &[f32], output: &[f32], sample_rate_hz: f64, period: usize) -> Frf {
    if period < 4 || input.len() < period || output.len() < period {
        return Frf::default();
    }
    let clean = |p: usize| {
        let range = p * period..(p + 1) * period;
        input[range.clone()].iter().chain(&output[range]).all(|x| x.is_finite())
    };
    let periods = input.len().min(output.len()) / period;
    let keep: Vec<bool> = (0..periods).map(clean).collect();
    let pick = |signal: &[f32]| -> Vec<Vec<Complex64>> {
        period_spectra(&signal[..periods * period], period)
            .into_iter()
            .zip(&keep)
            .filter(|(_, k)| **k)
            .map(|(s, _)| s)
            .collect()
    };
    let (u, y) = (pick(input), pick(output));
    if u.is_empty() {
        return Frf::default();
    }
    let n = u.len() as f64;
    let mean = |all: &[Vec<Complex64>], k: usize| all.iter().map(|s| s[k]).sum::<Complex64>() / n;
    let lines = period / 2;
    let u_mean: Vec<Complex64> = (0..lines).map(|k| mean(&u, k)).collect();
    let strongest = u_mean.iter().skip(1).map(|x| x.norm()).fold(0.0, f64::max);
    let df = sample_rate_hz / period as f64;
    let points = (1..lines)
        .filter(|&k| strongest > 0.0 && u_mean[k].norm() > 1e-3 * strongest)
        .map(|k| {
            let cross: Complex64 = u.iter().zip(&y).map(|(u, y)| y[k] * u[k].conj()).sum();
            let input_power: f64 = u.iter().map(|u| u[k].norm_sqr()).sum();
            let output_power: f64 = y.iter().map(|y| y[k].norm_sqr()).sum();
            let coherence = if output_power > 0.0 {
                cross.norm_sqr() / (input_power * output_power)
            } else {
                0.0
            };
            FrfPoint {
                frequency_hz: k as f64 * df,
                response: mean(&y, k) / u_mean[k],
                coherence: coherence.min(1.0),
            }
        })
        .collect();
    Frf { points }
}

/// Response of `output` to a broadband `input` such as a swept sine, between two frequencies.
///
/// `segment` samples a Hann segment, 3/4 overlap; bins are merged to at most `per_decade` points a decade.
pub fn swept(
    input: &[f32],
    output: &[f32],
    sample_rate_hz: f64,
    segment: usize,
    (from_hz, to_hz): (f64, f64),
    per_decade: usize,
) -> Frf {
    let n = input.len().min(output.len());
    if segment < 16 || n < segment {
        return Frf::default();
    }
    let fft = RealFftPlanner::<f64>::new().plan_fft_forward(segment);
    let window = hann(segment);
    let transform = |signal: &[f32]| -> Option<Vec<Complex64>> {
        let mean = signal.iter().map(|&x| f64::from(x)).sum::<f64>() / segment as f64;
        if !mean.is_finite() {
            return None;
        }
        let mut buffer: Vec<f64> =
            signal.iter().zip(&window).map(|(&x, w)| (f64::from(x) - mean) * w).collect();
        let mut spectrum = fft.make_output_vec();
        fft.process(&mut buffer, &mut spectrum).ok()?;
        Some(spectrum)
    };
    /// Sums of one logarithmic bin.
    #[derive(Default)]
    struct Bin {
        cross: Complex64,
        input: f64,
        output: f64,
        weighted_hz: f64,
    }
    let df = sample_rate_hz / segment as f64;
    let mut bins: BTreeMap<i64, Bin> = BTreeMap::new();
    let mut start = 0;
    while start + segment <= n {
        let range = start..start + segment;
        start += segment / 4;
        let (Some(u), Some(y)) = (transform(&input[range.clone()]), transform(&output[range]))
        else {
            continue;
        };
        for k in 1..segment / 2 {
            let f = k as f64 * df;
            if f < from_hz || f > to_hz {
                continue;
            }
            let slot = (f.log10() * per_decade as f64).round() as i64;
            let bin = bins.entry(slot).or_default();
            let power = u[k].norm_sqr();
            bin.cross += y[k] * u[k].conj();
            bin.input += power;
            bin.output += y[k].norm_sqr();
            bin.weighted_hz += f * power;
        }
    }
    let points = bins
        .into_values()
        .filter(|b| b.input > 0.0 && b.output > 0.0)
        .map(|b| FrfPoint {
            frequency_hz: b.weighted_hz / b.input,
            response: b.cross / b.input,
            coherence: (b.cross.norm_sqr() / (b.input * b.output)).min(1.0),
        })
        .collect();
    Frf { points }
}

/// `numerator / denominator` where both were measured at the same frequencies against the same excitation.
pub fn ratio(numerator: &Frf, denominator: &Frf) -> Frf {
    let points = numerator
        .points
        .iter()
        .filter_map(|n| {
            let d = denominator
                .points
                .iter()
                .find(|d| (d.frequency_hz - n.frequency_hz).abs() < 1e-6 * n.frequency_hz)?;
            Some(FrfPoint {
                frequency_hz: n.frequency_hz,
                response: n.response / d.response,
                coherence: n.coherence.min(d.coherence),
            })
        })
        .filter(|p| p.response.is_finite())
        .collect();
    Frf { points }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::SmallRng};
    use std::f64::consts::TAU;

    const FS: f64 = 10_000.0;

    /// First-order lag with pole `a`, one sample of delay: y[n] = a y[n-1] + (1-a) u[n-1].
    fn lag(u: &[f32], a: f64) -> Vec<f32> {
        let mut y = 0.0;
        let mut last = 0.0;
        u.iter()
            .map(|&u| {
                y = a * y + (1.0 - a) * last;
                last = f64::from(u);
                y as f32
            })
            .collect()
    }

    fn lag_response(f: f64, a: f64) -> Complex64 {
        let z = Complex64::from_polar(1.0, -TAU * f / FS);
        z * (1.0 - a) / (1.0 - a * z)
    }

    fn multisine(n: usize, period: usize) -> Vec<f32> {
        (0..n)
            .map(|i| {
                (1..200usize)
                    .step_by(2)
                    .map(|k| {
                        let phase = (k * k) as f64 * 1.7;
                        (TAU * k as f64 * i as f64 / period as f64 + phase).sin()
                    })
                    .sum::<f64>() as f32
            })
            .collect()
    }

    #[test]
    fn multisine_gives_the_lag_and_only_at_excited_lines() {
        let u = multisine(5000 * 4, 5000);
        let y = lag(&u, 0.9);
        let frf = periodic(&u[5000..], &y[5000..], FS, 5000);
        assert_eq!(frf.points.len(), 100);
        for p in &frf.points {
            let error = (p.response - lag_response(p.frequency_hz, 0.9)).norm();
            assert!(error < 1e-4, "{p:?}: {error}");
            assert!(p.coherence > 0.9999);
        }
        assert!((frf.static_gain().unwrap() - 1.0).abs() < 0.02);
    }

    #[test]
    fn noise_lowers_the_coherence_and_a_lost_sample_drops_its_period() {
        let u = multisine(5000 * 6, 5000);
        let mut rng = SmallRng::seed_from_u64(3);
        let mut y: Vec<f32> =
            lag(&u, 0.9).iter().map(|y| y + rng.random_range(-20.0..20.0)).collect();
        let noisy = periodic(&u, &y, FS, 5000);
        let mean = noisy.points.iter().map(|p| p.coherence).sum::<f64>() / 100.0;
        assert!((0.5..0.999).contains(&mean), "{mean}");
        y[7000] = f32::NAN;
        assert_eq!(periodic(&u, &y, FS, 5000).points.len(), 100);
    }

    #[test]
    fn a_sweep_gives_the_same_answer() {
        let n = 100_000;
        let (f0, f1) = (5.0f64, 2000.0f64);
        let t = n as f64 / FS;
        let k = (f1 / f0).ln() / t;
        let u: Vec<f32> = (0..n)
            .map(|i| (TAU * f0 / k * ((k * i as f64 / FS).exp() - 1.0)).sin() as f32)
            .collect();
        let y = lag(&u, 0.8);
        let frf = swept(&u, &y, FS, 4096, (20.0, 1500.0), 40);
        assert!(frf.points.len() > 50);
        for p in frf.points.iter().filter(|p| p.frequency_hz > 50.0) {
            let truth = lag_response(p.frequency_hz, 0.8);
            assert!((p.response - truth).norm() < 0.03 * truth.norm() + 0.005, "{p:?} {truth}");
        }
    }

    #[test]
    fn the_indirect_ratio_is_the_plant() {
        let r = multisine(5000 * 4, 5000);
        let u = lag(&r, 0.5);
        let y = lag(&u, 0.9);
        let from_r = |s: &[f32]| periodic(&r[5000..], &s[5000..], FS, 5000);
        for p in ratio(&from_r(&y), &from_r(&u)).points {
            assert!((p.response - lag_response(p.frequency_hz, 0.9)).norm() < 1e-4);
        }
    }
}
