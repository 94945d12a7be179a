//! Noise of the position measurement, from the recording itself.
//!
//! A return is smooth over tens of samples: a cubic through each short block leaves the noise. Third differences, which
//! remove any parabola, give a second figure; where the two differ the noise has a memory or the motion is faster than
//! the blocks.

use nalgebra::{DMatrix, DVector};

use super::data::Return;

/// Samples in a block.
const BLOCK: usize = 25;
/// Coefficients of the cubic.
const COEFFICIENTS: usize = 4;

/// Noise of one recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Root mean square about block-wise cubics, m: the floor that a perfect model would leave.
    pub rms_m: f64,
    /// Root mean square from third differences, m (white noise only).
    pub differences_m: f64,
    /// Relative standard error of `rms_m`.
    pub relative_error: f64,
}

/// Measure the noise of a return.
pub fn measure(data: &Return) -> Noise {
    let rows: Vec<usize> = data.scored().collect();
    let mut energies = Vec::new();
    for block in rows.chunks_exact(BLOCK.min(rows.len())) {
        let middle = data.time_s[block[block.len() / 2]];
        let span = (data.time_s[block[block.len() - 1]] - data.time_s[block[0]]).max(1e-12);
        let design = DMatrix::from_fn(block.len(), COEFFICIENTS, |row, column| {
            ((data.time_s[block[row]] - middle) / span).powi(column as i32)
        });
        let values = DVector::from_iterator(block.len(), block.iter().map(|r| data.position_m[*r]));
        let Ok(fit) = design.clone().svd(true, true).solve(&values, 1e-12) else { continue };
        let residual = values - design * fit;
        energies.push(residual.norm_squared() / (block.len() - COEFFICIENTS) as f64);
    }
    // Blocks in which the motion is faster than a cubic (just after the release) stand out: leave out what lies far above
    // the median, as no noise of constant size does.
    let mut sorted = energies.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let kept: Vec<f64> = energies.into_iter().filter(|e| *e <= 3.0 * median).collect();
    let mean = kept.iter().sum::<f64>() / kept.len().max(1) as f64;
    let freedom = (kept.len() * (BLOCK.min(rows.len()) - COEFFICIENTS)).max(1) as f64;

    let mut differences = Vec::new();
    for window in rows.windows(4) {
        let steps: Vec<f64> =
            window.windows(2).map(|p| data.time_s[p[1]] - data.time_s[p[0]]).collect();
        if steps.iter().any(|step| (step / steps[0] - 1.0).abs() > 1e-6) {
            continue; // a lost sample
        }
        let at = |i: usize| data.position_m[window[i]];
        differences.push((at(3) - 3.0 * at(2) + 3.0 * at(1) - at(0)).powi(2) / 20.0);
    }
    let differences = differences.iter().sum::<f64>() / differences.len().max(1) as f64;
    Noise {
        rms_m: mean.sqrt().max(data.initial_m.abs() * 1e-7), // float32 cannot show less
        differences_m: differences.sqrt(),
        relative_error: (1.0 / (2.0 * freedom)).sqrt(),
    }
}

/// How many times more uncertain means are than for white noise: 1 + 2 Σ of the autocorrelation up to its first value
/// that is not above twice its own error. `residuals` in time order.
pub fn memory(residuals: &[f64]) -> f64 {
    let count = residuals.len();
    let mean = residuals.iter().sum::<f64>() / count.max(1) as f64;
    let centred: Vec<f64> = residuals.iter().map(|r| r - mean).collect();
    let energy: f64 = centred.iter().map(|r| r * r).sum();
    if energy <= 0.0 || count < 8 {
        return 1.0;
    }
    let mut factor = 1.0;
    for lag in 1..count / 4 {
        let correlation =
            centred[lag..].iter().zip(&centred).map(|(a, b)| a * b).sum::<f64>() / energy;
        if correlation < 2.0 / (count as f64).sqrt() {
            break;
        }
        factor += 2.0 * correlation;
    }
    factor
}
