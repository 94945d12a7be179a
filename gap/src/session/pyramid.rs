//! Octave-pair bands of a residual by an orthonormal block transform.
//!
//! Blocks of four samples are split into their mean and what differs from it; the means go on to the next level. The
//! transform is orthonormal, so energy, noise and inner products carry over band by band, and a gap that sits in
//! one band can be weighed by the noise and the size of the gap in that band. Level 0 holds the fastest content
//! (above an eighth of the sample rate, roughly); the last one the mean.

use std::cell::RefCell;

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

/// Samples in a block.
pub const BLOCK: usize = 4;
/// Most levels: 4^10 samples are a minute and a half at 10 kHz.
pub const MAX_LEVELS: usize = 11;

/// Where the levels of a series of `len` samples start in its coefficients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Levels {
    /// `starts[l]..starts[l + 1]` are the coefficients of level `l`.
    pub starts: Vec<usize>,
}

impl Levels {
    /// Layout for a series of `len` samples.
    pub fn new(len: usize) -> Self {
        let mut starts = vec![0];
        let mut left = len;
        let mut at = 0;
        while left >= 2 * BLOCK && starts.len() < MAX_LEVELS {
            let means = left.div_ceil(BLOCK);
            // A full block has three details; the short block at the end keeps one less than it has samples.
            at += left - means;
            starts.push(at);
            left = means;
        }
        starts.push(at + left);
        Self { starts }
    }

    /// Number of levels, the means included.
    pub fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Coefficients of a level.
    pub fn range(&self, level: usize) -> std::ops::Range<usize> {
        self.starts[level]..self.starts[level + 1]
    }
}

/// Coefficients of `series`, level after level, and as many as there are samples.
pub fn transform(series: &[f32], levels: &Levels) -> Vec<f32> {
    let mut out = vec![0.0; series.len()];
    let mut means: Vec<f32> = Vec::new();
    for level in 0..levels.count() - 1 {
        let current = if level == 0 { series } else { &means };
        let detail = &mut out[levels.range(level)];
        let mut next = Vec::with_capacity(current.len().div_ceil(BLOCK));
        let mut at = 0;
        for block in current.chunks(BLOCK) {
            if let [a, b, c, d] = *block {
                // Haar over pairs of pairs: orthonormal, three details and one scaled mean.
                let half = std::f32::consts::FRAC_1_SQRT_2;
                let (s, t) = ((a + b) * half, (c + d) * half);
                detail[at] = (a - b) * half;
                detail[at + 1] = (c - d) * half;
                detail[at + 2] = (s - t) * half;
                next.push((s + t) * half);
                at += 3;
            } else {
                let (mean, details) = short_block(block);
                detail[at..at + details.len()].copy_from_slice(&details);
                next.push(mean);
                at += details.len();
            }
        }
        means = next;
    }
    let last = if levels.count() == 1 { series } else { &means };
    out[levels.range(levels.count() - 1)].copy_from_slice(last);
    out
}

/// Orthonormal split of a block of one to three samples into its scaled mean and the rest.
fn short_block(block: &[f32]) -> (f32, Vec<f32>) {
    let scale = (block.len() as f32).sqrt();
    let mut details = Vec::new();
    let mut sum = block[0];
    for (k, &value) in block.iter().enumerate().skip(1) {
        // Helmert's rows: the running mean against the next sample.
        let k = k as f32;
        details.push((sum / k - value) * (k / (k + 1.0)).sqrt());
        sum += value;
    }
    (sum / scale, details)
}

/// Centre frequency of a level in Hz, for people; the last level holds the mean and is reported as 0.
pub fn centre_hz(level: usize, levels: &Levels, rate_hz: f64) -> f64 {
    if level + 1 == levels.count() {
        0.0
    } else {
        rate_hz / 4.0 / (BLOCK as f64).powi(level as i32)
    }
}

/// Bands that may be left out, the fastest first: each is a factor of four in frequency.
pub const MOST_LEFT_OUT: usize = 3;

/// Share of the frequencies up to half the sample rate that is kept when the fastest bands are left out.
pub fn share_kept(left_out: usize) -> f64 {
    (BLOCK as f64).powi(-(left_out as i32))
}

/// What of a series is below a share of half its sample rate. Its bands are not sharp: without this a loud resonance reaches down
/// into the slow ones.
pub fn low_pass(series: &[f32], share: f64) -> Vec<f32> {
    thread_local! {
        static PLANNER: RefCell<RealFftPlanner<f64>> = RefCell::new(RealFftPlanner::new());
    }
    let n = series.len();
    let (forward, back) = PLANNER
        .with_borrow_mut(|planner| (planner.plan_fft_forward(n), planner.plan_fft_inverse(n)));
    let mut input: Vec<f64> = series.iter().map(|&x| f64::from(x)).collect();
    let mut spectrum = forward.make_output_vec();
    if forward.process(&mut input, &mut spectrum).is_err() {
        return series.to_vec();
    }
    let edge = ((spectrum.len() as f64 * share).ceil() as usize).min(spectrum.len());
    spectrum[edge..].fill(Complex::new(0.0, 0.0));
    if back.process(&mut spectrum, &mut input).is_err() {
        return series.to_vec();
    }
    input.iter().map(|&x| (x / n as f64) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_energy_and_inner_products_for_any_length() {
        for n in [8_usize, 9, 37, 64, 1001, 4099] {
            let a: Vec<f32> = (0..n).map(|i| (i as f32 * 0.37).sin() + 0.01 * i as f32).collect();
            let b: Vec<f32> = (0..n).map(|i| (i as f32 * 0.11).cos()).collect();
            let levels = Levels::new(n);
            assert_eq!(*levels.starts.last().unwrap(), n);
            let dot = |x: &[f32], y: &[f32]| -> f64 {
                x.iter().zip(y).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum()
            };
            let (ta, tb) = (transform(&a, &levels), transform(&b, &levels));
            assert!((dot(&a, &a) / dot(&ta, &ta) - 1.0).abs() < 1e-4, "{n}");
            assert!((dot(&a, &b) - dot(&ta, &tb)).abs() < 1e-3 * dot(&a, &a), "{n}");
        }
    }

    #[test]
    fn a_constant_sits_in_the_last_level() {
        let series = vec![2.0_f32; 1 << 10];
        let levels = Levels::new(series.len());
        let out = transform(&series, &levels);
        let last: f32 = out[levels.range(levels.count() - 1)].iter().map(|x| x * x).sum();
        assert!((last / (4.0 * 1024.0) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn low_pass_keeps_what_is_slow_and_nothing_else() {
        let tau = std::f64::consts::TAU;
        let wave = |cycles: f64| -> Vec<f32> {
            (0..1000).map(|i| (tau * cycles * f64::from(i) / 1000.0).sin() as f32).collect()
        };
        let (slow, fast) = (wave(20.0), wave(300.0));
        let both: Vec<f32> = slow.iter().zip(&fast).map(|(a, b)| a + 50.0 * b).collect();
        let left = low_pass(&both, 0.25);
        assert!(left.iter().zip(&slow).all(|(a, b)| (a - b).abs() < 1e-3));
    }
}
