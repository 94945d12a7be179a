//! Amplifier and resonance from fast excitation: linear least squares on spectra.
//!
//! The amplifier as sampled is `v(n+1) = p v(n) + c u(n)`, on spectra `M z = p M + c D`, with `p = exp(-1 / (rate tau))`. The mechanism is
//! `M = (1/g + j w b - w^2 h) X`: written from position to voltage, `b` and `h` are damping and mass over the transformer ratio,
//! times `1 + C s` with `s` the elastance of the slip elements that do not slip at this amplitude: they see the charge, and part of
//! it is that of the clamped capacitance. (Equation error on spectra: Pintelon and Schoukens,
//! System Identification, 2nd ed. 2012, chapter 8.) Each part of the session is fitted by itself, and they are averaged by
//! their standard errors, so that one that a linear model cannot follow (an amplifier at its current limit) counts little.

use std::ops::Range;

use nalgebra::{Complex, Matrix2, Matrix3, Vector2, Vector3};
use realfft::RealFftPlanner;

use super::series::Series;

/// Lowest frequency that is used, Hz: below, hysteresis and creep are more than the lag.
const LOWEST_HZ: f64 = 20.0;
/// Highest, over the sample rate.
const HIGHEST: f64 = 0.4;
/// A line counts from this power over that of the noise ...
const OVER_NOISE: f64 = 100.0;
/// ... and over that of the strongest line.
const OVER_STRONGEST: f64 = 1.0e-8;
/// What of a line a linear model may leave: hysteresis makes lines of its own.
const TOLERANCE: f64 = 0.02;
/// Fewest lines: more than there are unknowns.
const FEWEST_LINES: usize = 4;
/// A value is determined if its standard error is no more than this share of it.
const DETERMINED: f64 = 0.1;
/// A resonance is seen if the excitation reaches this share of its frequency.
const SEEN_FROM: f64 = 0.2;
/// Rounds in which the weights settle.
const ROUNDS: usize = 4;

/// A value with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Standard error.
    pub sd: f64,
}

impl Estimate {
    fn is_determined(self) -> bool {
        self.value > 0.0 && self.sd <= DETERMINED * self.value
    }
}

/// The moving mass as seen from the drive, at the amplitude of the excitation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Volts a micrometre, V/um.
    pub v_per_um: f64,
    /// Volts an acceleration, V s^2/um.
    pub inertia_v_s2_per_um: f64,
    /// Volts a velocity, V s/um.
    pub damping_v_s_per_um: f64,
    /// Resonance, Hz.
    pub resonance_hz: f64,
}

/// What fast excitation says about an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lag {
    /// Amplifier time constant, s.
    pub time_constant_s: Option<Estimate>,
    /// Resonance.
    pub mode: Option<Mode>,
    /// Highest frequency with excitation, Hz.
    pub highest_hz: f64,
}

/// Spectral line: frequency (rad/s), drive, output, position.
struct Line {
    omega: f64,
    drive: Complex<f64>,
    output: Complex<f64>,
    position: Complex<f64>,
}

/// Lines of a part and what noise adds to the power of output and position in each.
struct Spectrum {
    lines: Vec<Line>,
    output_noise: f64,
    position_noise: f64,
    rate_hz: f64,
    has_monitor: bool,
}

/// Fit.
pub(super) fn fit(series: &[Series]) -> Lag {
    let noise = |x: fn(&Series) -> &[f64]| {
        let all = series.iter().filter_map(|s| s.noise_variance(x(s)));
        all.min_by(f64::total_cmp).unwrap_or(0.0)
    };
    let noises = (noise(|s| &s.output_v), noise(|s| &s.position_um));
    let mut lag = Lag::default();
    let (mut constants, mut modes) = (Vec::new(), Vec::new());
    for series in series {
        for part in series.fast() {
            let Some(spectrum) = spectrum(series, part, noises) else { continue };
            let highest_hz =
                spectrum.lines.iter().map(|l| l.omega).fold(0.0, f64::max) / std::f64::consts::TAU;
            lag.highest_hz = lag.highest_hz.max(highest_hz);
            constants.extend(spectrum.time_constant().filter(|e| e.is_determined()));
            modes.extend(spectrum.mode().filter(|(_, inertia, _, stiffness)| {
                let resonance_hz = resonance_hz(*stiffness, inertia.value);
                inertia.is_determined()
                    && resonance_hz < 0.5 * series.rate_hz
                    && highest_hz > SEEN_FROM * resonance_hz
            }));
        }
    }
    lag.time_constant_s = average(constants.iter().copied());
    lag.mode = average(modes.iter().map(|m| m.1)).map(|inertia| {
        let stiffness = modes.iter().min_by(|a, b| a.1.sd.total_cmp(&b.1.sd)).map_or(0.0, |m| m.3);
        Mode {
            v_per_um: stiffness,
            inertia_v_s2_per_um: inertia.value,
            damping_v_s_per_um: average(modes.iter().map(|m| m.2))
                .map_or(0.0, |e| e.value.max(0.0)),
            resonance_hz: resonance_hz(stiffness, inertia.value),
        }
    });
    lag
}

fn resonance_hz(v_per_um: f64, inertia_v_s2_per_um: f64) -> f64 {
    (v_per_um / inertia_v_s2_per_um).max(0.0).sqrt() / std::f64::consts::TAU
}

/// Mean by standard errors.
fn average(values: impl Iterator<Item = Estimate>) -> Option<Estimate> {
    let (mut weight, mut sum) = (0.0, 0.0);
    for e in values {
        let w = e.sd.max(f64::MIN_POSITIVE.sqrt()).powi(-2);
        weight += w;
        sum += w * e.value;
    }
    (weight > 0.0).then(|| Estimate { value: sum / weight, sd: weight.sqrt().recip() })
}

fn spectrum(series: &Series, part: Range<usize>, noises: (f64, f64)) -> Option<Spectrum> {
    let rate_hz = series.rate_hz;
    // Whole periods of a periodic excitation have sharp lines; anything else is faded in and out.
    let (part, window) = match whole_periods(series, &part) {
        Some(whole) => (whole.clone(), vec![1.0; whole.len()]),
        None => {
            let n = part.len() as f64;
            let hann = |i: usize| 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / n).cos();
            (part.clone(), (0..part.len()).map(hann).collect())
        }
    };
    let fft = RealFftPlanner::<f64>::new().plan_fft_forward(part.len());
    let transform = |x: &[f64]| -> Option<Vec<Complex<f64>>> {
        let x = &x[part.clone()];
        let mean = x.iter().sum::<f64>() / x.len() as f64;
        let mut input: Vec<f64> = x.iter().zip(&window).map(|(x, w)| (x - mean) * w).collect();
        let mut output = fft.make_output_vec();
        fft.process(&mut input, &mut output).ok()?;
        Some(output)
    };
    let drive = transform(&series.drive_v)?;
    let output = transform(&series.output_v)?;
    let position = transform(&series.position_um)?;
    let energy: f64 = window.iter().map(|w| w * w).sum();
    let (output_noise, position_noise) = (noises.0 * energy, noises.1 * energy);
    let hz = |k: usize| k as f64 * rate_hz / part.len() as f64;
    let band: Vec<usize> =
        (0..drive.len()).filter(|&k| hz(k) >= LOWEST_HZ && hz(k) <= HIGHEST * rate_hz).collect();
    let strongest = band.iter().map(|&k| drive[k].norm_sqr()).fold(0.0, f64::max);
    let lines: Vec<Line> = band
        .into_iter()
        .filter(|&k| {
            drive[k].norm_sqr() > OVER_STRONGEST * strongest
                && output[k].norm_sqr() > OVER_NOISE * output_noise
                && position[k].norm_sqr() > OVER_NOISE * position_noise
        })
        .map(|k| Line {
            omega: std::f64::consts::TAU * hz(k),
            drive: drive[k],
            output: output[k],
            position: position[k],
        })
        .collect();
    let has_monitor = series.has_monitor;
    (lines.len() >= FEWEST_LINES).then_some(Spectrum {
        lines,
        output_noise,
        position_noise,
        rate_hz,
        has_monitor,
    })
}

/// The last whole periods of a part, without the first if there are several; `None` where the period is not known or not a
/// whole number of samples.
fn whole_periods(series: &Series, part: &Range<usize>) -> Option<Range<usize>> {
    let samples = series.period_s? * series.rate_hz;
    let period = samples.round();
    if (samples - period).abs() > 0.01 || period < 8.0 {
        return None;
    }
    let period = period as usize;
    let periods = part.len() / period;
    let used = if periods > 1 { periods - 1 } else { periods };
    (used > 0).then(|| part.end - used * period..part.end)
}

impl Spectrum {
    /// Of the amplifier, s.
    fn time_constant(&self) -> Option<Estimate> {
        if !self.has_monitor {
            return None;
        }
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        let equation = |line: &Line| {
            let shifted = line.output * Complex::from_polar(1.0, line.omega / self.rate_hz);
            let weight =
                1.0 / (TOLERANCE.powi(2) * line.output.norm_sqr() + 2.0 * self.output_noise);
            ([line.output, line.drive], shifted, weight)
        };
        for line in &self.lines {
            let (row, target, weight) = equation(line);
            for i in 0..2 {
                for j in 0..2 {
                    normal[(i, j)] += weight * (row[i].conj() * row[j]).re;
                }
                right[i] += weight * (row[i].conj() * target).re;
            }
        }
        let inverse: Matrix2<f64> = normal.try_inverse()?;
        let solution: Vector2<f64> = inverse * right;
        let left: f64 = self
            .lines
            .iter()
            .map(|line| {
                let (row, target, weight) = equation(line);
                weight * (target - row[0] * solution[0] - row[1] * solution[1]).norm_sqr()
            })
            .sum();
        let pole = solution[0];
        if !(pole > 0.0 && pole < 1.0) {
            return None;
        }
        let sd = (inverse[(0, 0)] * left / (2 * self.lines.len() - 2) as f64).max(0.0).sqrt();
        let value = -1.0 / (self.rate_hz * pole.ln());
        Some(Estimate { value, sd: sd * self.rate_hz * value * value / pole })
    }

    /// Highest line used, inertia, damping, and stiffness (V/um).
    fn mode(&self) -> Option<(f64, Estimate, Estimate, f64)> {
        // Frequencies over the highest keep the numbers near one.
        let scale = self.lines.iter().map(|l| l.omega).fold(0.0, f64::max);
        let mut solution = Vector3::<f64>::zeros();
        let mut found = None;
        for _ in 0..ROUNDS {
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            let equation = |line: &Line, solution: &Vector3<f64>| {
                let w = line.omega / scale;
                let factors =
                    [Complex::new(1.0, 0.0), Complex::new(0.0, w), Complex::new(-w * w, 0.0)];
                let per_um: Complex<f64> = factors.iter().zip(solution).map(|(f, s)| f * *s).sum();
                let variance = TOLERANCE.powi(2) * line.output.norm_sqr()
                    + self.output_noise
                    + per_um.norm_sqr() * self.position_noise;
                (factors.map(|f| f * line.position), line.output, 1.0 / variance)
            };
            for line in &self.lines {
                let (row, target, weight) = equation(line, &solution);
                for i in 0..3 {
                    for j in 0..3 {
                        normal[(i, j)] += weight * (row[i].conj() * row[j]).re;
                    }
                    right[i] += weight * (row[i].conj() * target).re;
                }
            }
            let inverse: Matrix3<f64> = normal.try_inverse()?;
            solution = inverse * right;
            let left: f64 = self
                .lines
                .iter()
                .map(|line| {
                    let (row, target, weight) = equation(line, &solution);
                    let model: Complex<f64> = row.iter().zip(&solution).map(|(r, s)| r * *s).sum();
                    weight * (target - model).norm_sqr()
                })
                .sum();
            let variance = left / (2 * self.lines.len() - 3) as f64;
            let estimate = |i: usize, unit: f64| Estimate {
                value: solution[i] / unit,
                sd: (inverse[(i, i)] * variance).max(0.0).sqrt() / unit,
            };
            found = Some((scale, estimate(2, scale * scale), estimate(1, scale), solution[0]));
        }
        found
    }
}
