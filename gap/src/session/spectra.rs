//! What stands out in the spectra of a session: lines of a hum, and resonances.

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;
use realfft::{RealFftPlanner, RealToComplex};

use crate::session::floor::Kind;
use crate::session::scene::{Channel, Scene, Stack};

/// Power spectra of rows of one length, with a Hann window.
struct Periodogram {
    fft: Arc<dyn RealToComplex<f64>>,
    window: Vec<f64>,
}

impl Periodogram {
    fn new(samples: usize) -> Self {
        let turn = |i: usize| std::f64::consts::TAU * i as f64 / samples as f64;
        Self {
            fft: RealFftPlanner::<f64>::new().plan_fft_forward(samples),
            window: (0..samples).map(|i| 0.5 - 0.5 * turn(i).cos()).collect(),
        }
    }

    /// Frequency step in Hz and density of each bin.
    fn of(&self, row: &[f32], rate_hz: f64) -> (f64, Vec<f64>) {
        let n = row.len();
        let mean = row.iter().map(|&x| f64::from(x)).sum::<f64>() / n as f64;
        let mut input: Vec<f64> = row
            .iter()
            .zip(&self.window)
            .map(|(&x, window)| (f64::from(x) - mean) * window)
            .collect();
        let mut output = self.fft.make_output_vec();
        if self.fft.process(&mut input, &mut output).is_err() {
            return (1.0, Vec::new());
        }
        // One-sided density; the Hann window keeps 3/8 of the power.
        let scale = 2.0 / (rate_hz * n as f64 * 0.375);
        (rate_hz / n as f64, output.iter().map(|c| c.norm_sqr() * scale).collect())
    }
}

/// Power spectrum of a row with a Hann window: frequency step in Hz and density of each bin.
pub fn spectrum(row: &[f32], rate_hz: f64) -> (f64, Vec<f64>) {
    Periodogram::new(row.len()).of(row, rate_hz)
}

/// Longest stretch of a recording that one spectrum is taken of where a resonance is looked for.
const STRETCH: usize = 8192;

/// Mean power spectrum of stretches that overlap by three quarters (Welch's method): frequency step in Hz and density of each bin. Stretches
/// begin before the recording and end behind it, so that all samples weigh the same: a sweep ends where it is fastest, and a window over the
/// whole of it takes that away.
fn mean_spectrum(row: &[f32], rate_hz: f64) -> (f64, Vec<f64>) {
    let hop = (STRETCH.min(row.len()) / 4).max(1);
    let mean = row.iter().sum::<f32>() / row.len().max(1) as f32;
    let mut padded = vec![0.0; 3 * hop];
    padded.extend(row.iter().map(|x| x - mean));
    padded.resize(padded.len().next_multiple_of(hop) + 3 * hop, 0.0);
    let mut sum: Vec<f64> = Vec::new();
    let mut step = 1.0;
    let periodogram = Periodogram::new(4 * hop);
    for start in (0..=padded.len() - 4 * hop).step_by(hop) {
        let (own, power) = periodogram.of(&padded[start..start + 4 * hop], rate_hz);
        step = own;
        sum.resize(power.len(), 0.0);
        sum.iter_mut().zip(&power).for_each(|(sum, power)| *sum += power);
    }
    // As many as there are hops in the recording: stretches at both ends are partly empty.
    let hops = row.len() as f64 / hop as f64;
    sum.iter_mut().for_each(|power| *power /= hops);
    (step, sum)
}

/// Slowest hum, Hz: railways have 16.7, mains and supplies more, and what stands out below is a harmonic of a slow drive, a nonlinearity.
pub(crate) const SLOWEST_HUM_HZ: f64 = 15.0;

/// Lines that are looked at for harmonics.
const MOST_LINES: usize = 8;

/// Whether one of the lines is this multiple of another one.
pub(crate) fn has_harmonic(lines: &[f64], order: f64) -> bool {
    lines.iter().any(|hz| lines.iter().any(|of| (hz - order * of).abs() < 0.6 * order))
}

/// Lines that stand out of their neighbourhood, the strongest first, summed over recordings on a grid of half a hertz.
pub(crate) fn lines(scene: &Scene, raw: &Stack, kind: Kind) -> Vec<f64> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    let of_channel = |(channel, row): (&Channel, &Option<Vec<f32>>)| {
        let row = row.as_ref().filter(|r| channel.kind == kind && r.len() >= 512)?;
        Some(spectrum(row, scene.tracks[channel.track].rate_hz))
    };
    let spectra: Vec<_> = scene.channels.par_iter().zip(raw).map(of_channel).collect();
    for (step, power) in spectra.into_iter().flatten() {
        let first = ((SLOWEST_HUM_HZ / step) as usize).max(4);
        for k in first..power.len().saturating_sub(40) {
            if power[k] < power[k - 1] || power[k] < power[k + 1] {
                continue;
            }
            let low = k.saturating_sub(30);
            let mut around: Vec<f64> = power[low..k + 31].to_vec();
            let middle = around.len() / 2;
            let (_, &mut median, _) = around.select_nth_unstable_by(middle, f64::total_cmp);
            // Of 10^5 bins of pure noise none stands out by a factor of forty over the median.
            if power[k] > 40.0 * median.max(1.0e-30) {
                // Parabola through the logarithms of three bins.
                let (a, b, c) =
                    (power[k - 1].max(1e-300).ln(), power[k].ln(), power[k + 1].max(1e-300).ln());
                let shift = if (a - 2.0 * b + c).abs() > 1.0e-9 {
                    0.5 * (a - c) / (a - 2.0 * b + c)
                } else {
                    0.0
                };
                let hz = (k as f64 + shift.clamp(-0.5, 0.5)) * step;
                // Every recording votes once a line: a line of the drive shows in one kind of recording only.
                match found.iter_mut().find(|(f, _)| (*f - hz).abs() < 0.6) {
                    Some(known) => known.1 += (power[k] / median).ln(),
                    None => found.push((hz, (power[k] / median).ln())),
                }
            }
        }
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.into_iter().take(MOST_LINES).map(|(hz, _)| hz).collect()
}

/// What is in a block of a recording at a frequency, on the session's clock: r = re cos(w t) - im sin(w t), in sums of samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Envelope {
    /// Middle of the block, s.
    pub time_s: f64,
    /// In phase with the clock.
    pub re: f64,
    /// A quarter period ahead of it.
    pub im: f64,
}

/// Envelope of a channel's residual about a frequency, in blocks of `block_s`, in which samples have a `weight` from one end of it (0) to the other (1).
pub(crate) fn envelope(
    scene: &Scene,
    channel: &Channel,
    row: &[f32],
    hz: f64,
    (block_s, weight): (f64, impl Fn(f64) -> f64),
) -> Vec<Envelope> {
    let track = &scene.tracks[channel.track];
    let length = ((block_s * track.rate_hz) as usize).max(1);
    let of_block = |(b, part): (usize, &[f32])| {
        let first = channel.range.start + b * length;
        let mean = part.iter().map(|&x| f64::from(x)).sum::<f64>() / part.len() as f64;
        let (mut re, mut im) = (0.0, 0.0);
        for (k, &x) in part.iter().enumerate() {
            let t = track.start_s + (first + k) as f64 / track.rate_hz;
            let (sin, cos) = (std::f64::consts::TAU * hz * t).sin_cos();
            let weighed = (f64::from(x) - mean) * weight((k as f64 + 0.5) / length as f64);
            re += weighed * cos;
            im -= weighed * sin;
        }
        let time_s = track.start_s + (first as f64 + 0.5 * part.len() as f64) / track.rate_hz;
        Envelope { time_s, re, im }
    };
    row.chunks(length).enumerate().map(of_block).collect()
}

/// Slowest resonance that is looked for, Hz: what stands out below is a harmonic of a slow drive.
const SLOWEST_MODE_HZ: f64 = 60.0;

/// Cells of an octave in which the answer to the drive is averaged.
const CELLS: f64 = 24.0;

/// Power over that of the noise from which a line is one.
const RINGS: f64 = 40.0;

/// Ratio up to which two resonances are one.
const SAME: f64 = 1.04;

/// Add a frequency, Hz, unless it is known.
pub(crate) fn push_apart(known: &mut Vec<f64>, hz: f64) {
    if known.iter().all(|f| (f / hz).max(hz / f) > SAME) {
        known.push(hz);
    }
}

/// Frequency up to which what rings is looked for by its alias, as a share of the loop's rate: a light mass on a stiff stack. Beyond it the alias
/// lies where the stage is driven.
const FASTEST_ALIAS: f64 = 0.9;

/// Where each axis answers most beyond its model, likeliest first: the peak of the ratio of measured to simulated power, where the
/// simulation moves by more than the noise, and the strongest line of what the model leaves, where it rings. A line may be the alias of a faster
/// one, up to nearly the rate of the loop, `loop_hz`: that comes last.
pub(crate) fn resonances(scene: &Scene, raw: &Stack, loop_hz: f64) -> Vec<Vec<f64>> {
    let axes = scene.position_noise.len();
    let mut answers: Vec<BTreeMap<i64, (f64, f64)>> = vec![BTreeMap::new(); axes];
    // Frequency, power, and the rate of the recording.
    let mut rings: Vec<(f64, f64, f64)> = vec![(0.0, 0.0, 0.0); axes];
    let fastest = scene.tracks.iter().map(|track| track.rate_hz).fold(0.0, f64::max);
    // Of what was measured, of the model, and of what the model leaves.
    let of_channel = |(channel, row): (&Channel, &Option<Vec<f32>>)| {
        let row = row.as_ref().filter(|r| channel.kind == Kind::Position && r.len() >= 512)?;
        let track = &scene.tracks[channel.track];
        let position = track.position_um[channel.axis].as_ref()?;
        let measured: Vec<f32> =
            channel.range.clone().map(|i| position[i] / channel.sigma as f32).collect();
        let simulated: Vec<f32> = measured.iter().zip(row).map(|(m, r)| m - r).collect();
        let of = |row: &[f32]| mean_spectrum(row, track.rate_hz);
        // A slow recording shows the alias of what rings.
        let left = (track.rate_hz > 0.5 * fastest).then(|| of(row).1);
        let ((step, power), (_, model)) = (of(&measured), of(&simulated));
        Some((channel.axis, track.rate_hz, step, power, model, left))
    };
    let spectra: Vec<_> = scene.channels.par_iter().zip(raw).map(of_channel).collect();
    for (axis, rate_hz, step, power, model, left) in spectra.into_iter().flatten() {
        let noise = 2.0 / rate_hz;
        for (k, (&p, &m)) in power.iter().zip(&model).enumerate().skip(1) {
            let hz = k as f64 * step;
            if hz > SLOWEST_MODE_HZ && m > 3.0 * noise {
                let cell =
                    answers[axis].entry((hz.log2() * CELLS).round() as i64).or_insert((0.0, 0.0));
                cell.0 += (p / m).min(1.0e4).ln();
                cell.1 += 1.0;
            }
        }
        let ring = &mut rings[axis];
        for (k, &p) in left.iter().flatten().enumerate() {
            let hz = k as f64 * step;
            if hz > SLOWEST_MODE_HZ && p > ring.1.max(RINGS * noise) {
                *ring = (hz, p, rate_hz);
            }
        }
    }
    let peak = |cells: BTreeMap<i64, (f64, f64)>| {
        cells
            .into_iter()
            .filter(|(_, (_, n))| *n >= 3.0)
            .map(|(cell, (log_ratio, n))| (2.0_f64.powf(cell as f64 / CELLS), log_ratio / n))
            .filter(|(_, log_ratio)| *log_ratio > 0.3)
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(hz, _)| hz)
    };
    answers
        .into_iter()
        .zip(rings)
        .map(|(cells, (ring_hz, power, rate_hz))| {
            let mut found: Vec<f64> = peak(cells).into_iter().collect();
            if power > 0.0 {
                push_apart(&mut found, ring_hz);
                if rate_hz - ring_hz < FASTEST_ALIAS * loop_hz {
                    push_apart(&mut found, rate_hz - ring_hz);
                }
            }
            found
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tone in the last 3 % alone.
    #[test]
    fn what_comes_last_weighs_as_much_as_what_comes_first() {
        const COUNT: usize = 40_000;
        const RATE_HZ: f64 = 10_000.0;
        let tone = |first: usize| -> Vec<f32> {
            let is_on = |i: usize| i >= first && i < first + 1_200;
            let value = |i: usize| (std::f64::consts::TAU * 1_690.0 * i as f64 / RATE_HZ).sin();
            (0..COUNT).map(|i| if is_on(i) { value(i) as f32 } else { 0.0 }).collect()
        };
        let power = |row: &[f32]| {
            let (step, power) = mean_spectrum(row, RATE_HZ);
            step * power.iter().sum::<f64>()
        };
        let is = 0.5 * 1_200.0 / COUNT as f64;
        for first in [0, 17_000, COUNT - 1_200] {
            let found = power(&tone(first));
            assert!((found / is - 1.0).abs() < 0.05, "from {first}: {found} of {is}");
        }
    }
}
