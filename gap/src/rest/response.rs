//! What linear models of the drives would leave of the remainder.
//!
//! Four of them, from the poorest to the richest: one gain from each axis's own drive, gains from all drives, a frequency response
//! from its own drive, frequency responses from all drives. Gains are fitted to slow motion and judged there; responses are fitted
//! line by line, with a straight line through the neighbours (local polynomial method). Fitted recordings make them, held-out ones
//! judge them.

use nalgebra::DMatrix;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use serde::{Deserialize, Serialize};

use super::SLOW_SHARE;
use super::waves::{Block, Line, Waves};

/// Lines to each side that a response is fitted with.
const NEIGHBOURS: usize = 3;
/// Singular values below this share of the largest are drives that do not move.
const STILL: f64 = 1.0e-4;

/// A figure for models that know an axis's own drive and for those that know all drives.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct OwnOrAll {
    /// From the own drive of each axis.
    pub own: f64,
    /// From the drives of all axes.
    pub all: f64,
}

/// Root-mean-square figures in nm over the axes of the held-out recordings of one level, in one band.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct BandLeft {
    /// Edges of the band, Hz.
    pub band_hz: [f64; 2],
    /// Drive level of the recordings, root mean square, V.
    pub level_v: f64,
    /// Measured motion.
    pub measured_nm: f64,
    /// Gap with the rig as given.
    pub before_nm: f64,
    /// Gap with the causes.
    pub after_nm: f64,
    /// Left by gains; slow bands only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gains_nm: Option<OwnOrAll>,
    /// Left by frequency responses.
    pub responses_nm: OwnOrAll,
    /// What does not repeat.
    pub floor_nm: f64,
}

impl BandLeft {
    fn is_slow(&self) -> bool {
        self.gains_nm.is_some()
    }
}

/// What is taken off the remainder of a block, axis by axis and line by line.
type Prediction = Vec<Line>;

/// Figures of every octave and level.
pub(super) fn bands(waves: &Waves) -> Vec<BandLeft> {
    let Some(first) = waves.blocks.first() else { return Vec::new() };
    let axes = first.measured.len();
    let lines = first.measured[0].len();
    let fitted: Vec<&Block> = waves.blocks.iter().filter(|b| !b.held_out).collect();
    let held: Vec<&Block> = waves.blocks.iter().filter(|b| b.held_out).collect();
    if fitted.is_empty() || held.is_empty() {
        return Vec::new();
    }
    let inputs = |axis: usize, all: bool| if all { (0..axes).collect() } else { vec![axis] };
    let slow = ((lines as f64 * SLOW_SHARE) as usize).max(2);
    let predict = |gains: bool, all: bool| -> Vec<Prediction> {
        let by_axis: Vec<Vec<Vec<Complex<f64>>>> = (0..axes)
            .map(|axis| {
                let from = inputs(axis, all);
                if gains {
                    let gain = fit_gains(&fitted, axis, &from, 1..slow);
                    vec![gain.into_iter().map(Complex::from).collect(); lines]
                } else {
                    (0..lines).into_par_iter().map(|k| fit_line(&fitted, axis, &from, k)).collect()
                }
            })
            .collect();
        held.iter()
            .map(|block| {
                (0..axes)
                    .map(|axis| {
                        let from = inputs(axis, all);
                        let at = |k: usize| -> Complex<f64> {
                            let terms = from.iter().zip(&by_axis[axis][k]);
                            terms.map(|(&i, g)| g * block.drive[i][k]).sum()
                        };
                        (0..lines).map(at).collect()
                    })
                    .collect()
            })
            .collect()
    };
    let gains = [predict(true, false), predict(true, true)];
    let responses = [predict(false, false), predict(false, true)];
    let mut out = Vec::new();
    for (level, &level_v) in waves.levels_v.iter().enumerate() {
        for band in octaves(lines, slow) {
            let count = held.iter().filter(|b| b.level == level).count() * axes;
            if count == 0 {
                continue;
            }
            let rms = |energy: &dyn Fn(usize, usize, usize) -> f64| -> f64 {
                let blocks = (0..held.len()).filter(|&b| held[b].level == level);
                let sum: f64 = blocks
                    .flat_map(|b| (0..axes).map(move |axis| (b, axis)))
                    .map(|(b, axis)| band.clone().map(|k| energy(b, axis, k)).sum::<f64>())
                    .sum();
                (sum * waves.to_mean_square / count as f64).sqrt()
            };
            let left = |of: &[Vec<Prediction>; 2]| -> OwnOrAll {
                let [own, all] = [0, 1].map(|n| {
                    rms(&|b, axis, k| (held[b].after[axis][k] - of[n][b][axis][k]).norm_sqr())
                });
                OwnOrAll { own, all }
            };
            out.push(BandLeft {
                band_hz: [band.start, band.end].map(|k| k as f64 * waves.step_hz),
                level_v,
                measured_nm: rms(&|b, axis, k| held[b].measured[axis][k].norm_sqr()),
                before_nm: rms(&|b, axis, k| held[b].before[axis][k].norm_sqr()),
                after_nm: rms(&|b, axis, k| held[b].after[axis][k].norm_sqr()),
                gains_nm: (band.end <= slow).then(|| left(&gains)),
                responses_nm: left(&responses),
                floor_nm: rms(&|b, axis, k| held[b].noise[axis][k]),
            });
        }
    }
    out
}

/// Octaves of lines, from the first one up, with an edge at `slow`.
fn octaves(lines: usize, slow: usize) -> Vec<std::ops::Range<usize>> {
    let mut edges = vec![slow];
    while edges[0] > 16 {
        edges.insert(0, edges[0] / 2);
    }
    if edges[0] > 1 {
        edges.insert(0, 1);
    }
    let mut last = slow;
    while last < lines {
        // The line at half the sample rate is no octave of its own.
        last = if 2 * last + 1 < lines { 2 * last } else { lines };
        edges.push(last);
    }
    edges.windows(2).map(|e| e[0]..e[1]).collect()
}

/// Gains from the drives of `from` to what is left of `axis`, nm/V, by least squares over `lines`.
fn fit_gains(
    blocks: &[&Block],
    axis: usize,
    from: &[usize],
    lines: std::ops::Range<usize>,
) -> Vec<f64> {
    let mut rows = Vec::new();
    let mut right = Vec::new();
    for block in blocks {
        for k in lines.clone() {
            rows.extend(from.iter().map(|&i| block.drive[i][k].re));
            right.push(block.after[axis][k].re);
            rows.extend(from.iter().map(|&i| block.drive[i][k].im));
            right.push(block.after[axis][k].im);
        }
    }
    let a = DMatrix::from_row_slice(right.len(), from.len(), &rows);
    solve(&a, &DMatrix::from_column_slice(right.len(), 1, &right))
}

/// Response from the drives of `from` to what is left of `axis` at line `k`, nm/V.
fn fit_line(blocks: &[&Block], axis: usize, from: &[usize], k: usize) -> Vec<Complex<f64>> {
    let lines = blocks[0].drive[0].len();
    let near = k.saturating_sub(NEIGHBOURS).max(1)..(k + NEIGHBOURS + 1).min(lines);
    let mut rows = Vec::new();
    let mut right = Vec::new();
    for block in blocks {
        for at in near.clone() {
            let off = (at as f64 - k as f64) / NEIGHBOURS as f64;
            rows.extend(from.iter().map(|&i| block.drive[i][at]));
            rows.extend(from.iter().map(|&i| block.drive[i][at] * off));
            right.push(block.after[axis][at]);
        }
    }
    if right.len() < 4 * from.len() {
        return vec![Complex::ZERO; from.len()];
    }
    let a = DMatrix::from_row_slice(right.len(), 2 * from.len(), &rows);
    let mut all = solve(&a, &DMatrix::from_column_slice(right.len(), 1, &right));
    all.truncate(from.len());
    all
}

/// Least squares that leaves alone what does not move; zeros where there is no answer.
fn solve<T: nalgebra::ComplexField<RealField = f64>>(a: &DMatrix<T>, b: &DMatrix<T>) -> Vec<T> {
    let svd = a.clone().svd(true, true);
    let still = STILL * svd.singular_values.max();
    match svd.solve(b, still) {
        Ok(x) if still > 0.0 => x.iter().cloned().collect(),
        _ => vec![T::zero(); a.ncols()],
    }
}

/// A linear model accounts for the remainder if it closes this share of its energy beyond what repeats.
const LINEAR: f64 = 0.9;
/// ... and one that closes less than this says little about it.
const NOT_LINEAR: f64 = 0.5;
/// Other drives matter if leaving them out leaves this many times the energy.
const ACROSS: f64 = 3.0;

/// What follows from the figures, in words. `None` where they do not say anything clearly.
pub(super) fn words(bands: &[BandLeft]) -> Option<String> {
    let energy = |of: &dyn Fn(&BandLeft) -> f64, slow_only: bool| -> f64 {
        bands
            .iter()
            .filter(|b| !slow_only || b.is_slow())
            .map(|b| of(b).powi(2) - b.floor_nm.powi(2))
            .sum::<f64>()
    };
    let left = energy(&|b| b.after_nm, false);
    if bands.is_empty() || left <= energy(&|b| b.floor_nm, false) {
        return None;
    }
    let closed = |of: &dyn Fn(&BandLeft) -> f64| 1.0 - energy(of, false).max(0.0) / left;
    let (own, all) = (closed(&|b| b.responses_nm.own), closed(&|b| b.responses_nm.all));
    let percent = |share: f64| (100.0 * share).clamp(0.0, 100.0);
    if all >= LINEAR && 1.0 - own > ACROSS * (1.0 - all) {
        Some(format!(
            "dynamic coupling (a frequency response of every axis to every drive closes {:.1} % of it, one to its own drive {:.1} %)",
            percent(all),
            percent(own)
        ))
    } else if own.max(all) >= LINEAR {
        Some(format!(
            "linear dynamics of the axes themselves (a frequency response to the own drive closes {:.1} % of it)",
            percent(own.max(all))
        ))
    } else if own.max(all) < NOT_LINEAR {
        Some(format!(
            "nothing that is linear in the drives (frequency responses of any order close {:.0} % of it)",
            percent(own.max(all))
        ))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    const LINES: usize = 400;

    /// Two axes, six fitted and two held-out blocks of random drives; `rest` makes the remainder of an axis at a line from both drives.
    fn waves(rest: impl Fn(usize, usize, [Complex<f64>; 2], &mut StdRng) -> Complex<f64>) -> Waves {
        let mut draw = StdRng::seed_from_u64(11);
        let complex = |draw: &mut StdRng| {
            Complex::new(draw.random_range(-1.0..1.0), draw.random_range(-1.0..1.0))
        };
        let blocks = (0..8)
            .map(|n| {
                let drive: Vec<Line> =
                    (0..2).map(|_| (0..LINES).map(|_| complex(&mut draw)).collect()).collect();
                let after: Vec<Line> = (0..2)
                    .map(|axis| {
                        (0..LINES)
                            .map(|k| rest(axis, k, [drive[0][k], drive[1][k]], &mut draw))
                            .collect()
                    })
                    .collect();
                Block {
                    held_out: n > 5,
                    level: 0,
                    drive,
                    measured: after.clone(),
                    before: after.clone(),
                    after,
                    noise: vec![vec![1.0e-6; LINES]; 2],
                }
            })
            .collect();
        Waves { step_hz: 1.0, periodic: true, to_mean_square: 1.0, levels_v: vec![1.0], blocks }
    }

    /// Response of a resonance in the middle of the band.
    fn resonance(k: usize) -> Complex<f64> {
        let w = k as f64 / (0.5 * LINES as f64);
        Complex::from(1.0) / Complex::new(1.0 - w * w, 0.3 * w)
    }

    #[test]
    fn a_resonance_of_the_neighbour_is_dynamic_coupling() {
        let coupled = waves(|axis, k, u, _| resonance(k) * (u[axis] + u[1 - axis] * 0.8));
        let said = words(&bands(&coupled)).expect("words");
        assert!(said.starts_with("dynamic coupling"), "{said}");
    }

    #[test]
    fn a_resonance_of_the_axis_is_not_coupling() {
        let own = waves(|axis, k, u, _| resonance(k) * u[axis]);
        let said = words(&bands(&own)).expect("words");
        assert!(said.starts_with("linear dynamics of the axes themselves"), "{said}");
    }

    #[test]
    fn what_does_not_follow_the_drives_is_not_called_linear() {
        let noise = waves(|_, _, _, draw| Complex::new(draw.random_range(-1.0..1.0), 0.0));
        let said = words(&bands(&noise)).expect("words");
        assert!(said.starts_with("nothing that is linear"), "{said}");
    }

    #[test]
    fn gains_suffice_where_there_are_no_dynamics() {
        let bands = bands(&waves(|axis, _, u, _| u[axis] * 3.0 - u[1 - axis]));
        let slow = bands.iter().find(|b| b.is_slow()).expect("slow motion");
        let gains = slow.gains_nm.expect("gains");
        assert!(gains.all < 1.0e-6 * slow.after_nm && gains.own > 0.2 * slow.after_nm, "{slow:?}");
    }

    /// A drive that never moves must not get a response made of rounding.
    #[test]
    fn a_still_drive_gets_no_response() {
        let mut still = waves(|axis, k, u, _| if axis == 0 { resonance(k) * u[0] } else { u[0] });
        for block in &mut still.blocks {
            block.drive[1].iter_mut().for_each(|u| *u = Complex::ZERO);
        }
        for band in bands(&still) {
            assert!(band.responses_nm.all < 0.1 * band.after_nm, "{band:?}");
        }
    }
}
