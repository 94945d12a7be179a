//! Lag towards zero frequency, level by level: a dead time or a pole lags less the slower it goes, a loop lags at all speeds, and
//! more at larger strokes.
//!
//! In slow motion every reading is fitted with `u (A + i B + i w C + w^2 D)` of all drives `u`; `A^-1 B` is the lag at zero frequency
//! once the axes are told apart, `A^-1 C` the delay. A delay at the rising gain below a resonance leaves a few hundredths of a degree
//! in `B`, the same at every level: growth is what is judged, and a fifth term would make it a third more uncertain. What the
//! simulation has of it is taken off. Only periodic excitations with many lines are read: a triangle's harmonics carry the loop
//! itself.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::SLOW_SHARE;
use super::waves::{Block, Line, Waves};

/// Lag of one axis in the recordings of one level beyond what the simulation has.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct LagAtLevel {
    /// Drive level, root mean square, V.
    pub level_v: f64,
    /// Axis, from 1.
    pub axis: usize,
    /// Lag at zero frequency, degrees.
    pub lag_deg: f64,
    /// Its standard deviation, degrees.
    pub sd_deg: f64,
    /// Delay, microseconds.
    pub delay_us: f64,
}

/// Fewest driven lines in slow motion.
const FEWEST_LINES: usize = 40;
/// A line is driven if it holds this share of the strongest one's power.
const DRIVEN: f64 = 1.0e-3;

/// Lags of all levels and axes. Empty unless there are two levels or more.
pub(super) fn lags(waves: &Waves) -> Vec<LagAtLevel> {
    if !waves.periodic || waves.levels_v.len() < 2 {
        return Vec::new();
    }
    let mut out = Vec::new();
    for (level, &level_v) in waves.levels_v.iter().enumerate() {
        let blocks: Vec<&Block> = waves.blocks.iter().filter(|b| b.level == level).collect();
        let Some(slow) = driven(&blocks) else { return Vec::new() };
        let simulated = |b: &Block, axis: usize| -> Line {
            b.measured[axis].iter().zip(&b.before[axis]).map(|(m, r)| m - r).collect()
        };
        let measured = fit(&blocks, &slow, waves.step_hz, &|b, axis| b.measured[axis].clone());
        let nominal = fit(&blocks, &slow, waves.step_hz, &simulated);
        let (Some(measured), Some(nominal)) = (measured, nominal) else { return Vec::new() };
        for (axis, (m, s)) in measured.iter().zip(&nominal).enumerate() {
            out.push(LagAtLevel {
                level_v,
                axis: axis + 1,
                lag_deg: (m.lag - s.lag).to_degrees(),
                sd_deg: m.sd.to_degrees(),
                delay_us: (m.delay_s - s.delay_s) * 1.0e6,
            });
        }
    }
    out
}

/// Driven lines in slow motion; `None` if they are few.
fn driven(blocks: &[&Block]) -> Option<Vec<usize>> {
    let lines = blocks.first()?.drive[0].len();
    let slow = (lines as f64 * SLOW_SHARE) as usize;
    let power = |k: usize| -> f64 {
        blocks.iter().flat_map(|b| &b.drive).map(|drive| drive[k].norm_sqr()).sum()
    };
    let powers: Vec<f64> = (0..slow).map(power).collect();
    let most = powers.iter().copied().fold(0.0, f64::max);
    let driven: Vec<usize> = (1..slow).filter(|&k| powers[k] > DRIVEN * most).collect();
    (driven.len() >= FEWEST_LINES).then_some(driven)
}

/// Lag of an axis at zero frequency (rad), its standard deviation, and delay.
struct Lag {
    lag: f64,
    sd: f64,
    delay_s: f64,
}

/// Terms of the fit to every drive.
const TERMS: usize = 4;

/// `None` where the drives do not tell the axes apart.
fn fit(
    blocks: &[&Block],
    lines: &[usize],
    step_hz: f64,
    reading: &dyn Fn(&Block, usize) -> Line,
) -> Option<Vec<Lag>> {
    let axes = blocks.first()?.drive.len();
    let top_hz = *lines.last()? as f64 * step_hz;
    let rows = 2 * blocks.len() * lines.len();
    if rows <= 2 * TERMS * axes {
        return None;
    }
    let mut left = DMatrix::<f64>::zeros(rows, TERMS * axes);
    let mut right = DMatrix::<f64>::zeros(rows, axes);
    for (n, block) in blocks.iter().enumerate() {
        let readings: Vec<Line> = (0..axes).map(|axis| reading(block, axis)).collect();
        for (m, &k) in lines.iter().enumerate() {
            let row = 2 * (n * lines.len() + m);
            let w = k as f64 * step_hz / top_hz;
            for axis in 0..axes {
                let u = block.drive[axis][k];
                let terms: [(f64, f64); TERMS] = [(1.0, 0.0), (0.0, 1.0), (0.0, w), (w * w, 0.0)];
                for (term, (re, im)) in terms.into_iter().enumerate() {
                    left[(row, term * axes + axis)] = u.re * re - u.im * im;
                    left[(row + 1, term * axes + axis)] = u.re * im + u.im * re;
                }
                right[(row, axis)] = readings[axis][k].re;
                right[(row + 1, axis)] = readings[axis][k].im;
            }
        }
    }
    let covariance = (left.transpose() * &left).try_inverse()?;
    let solved = &covariance * left.transpose() * &right;
    let unexplained = &right - &left * &solved;
    let spread = unexplained.transpose() * &unexplained / (rows - TERMS * axes) as f64;
    // Terms of the drives by axes of the reading, so transposed to readings by drives.
    let part = |term: usize| solved.rows(term * axes, axes).transpose();
    let inverse = part(0).try_inverse()?;
    let (quadrature, slope) = (&inverse * part(1), &inverse * part(2));
    let spread = &inverse * spread * inverse.transpose();
    Some(
        (0..axes)
            .map(|axis| Lag {
                lag: -quadrature[(axis, axis)],
                sd: (spread[(axis, axis)] * covariance[(axes + axis, axes + axis)]).sqrt(),
                delay_s: -slope[(axis, axis)] / (std::f64::consts::TAU * top_hz),
            })
            .collect(),
    )
}

/// Standard deviations by which a lag has to grow.
const SURELY: f64 = 3.0;

/// Axes whose lag grows from the lowest to the highest level, in words.
pub(super) fn words(lags: &[LagAtLevel]) -> Option<String> {
    let axes = lags.iter().map(|l| l.axis).max()?;
    let grown: Vec<String> = (1..=axes)
        .filter_map(|axis| {
            let mut of_axis = lags.iter().filter(|l| l.axis == axis);
            let (low, high) = (of_axis.next()?, of_axis.next_back()?);
            let by = high.lag_deg - low.lag_deg;
            (low.lag_deg > -SURELY * low.sd_deg && by > SURELY * low.sd_deg.hypot(high.sd_deg))
                .then(|| {
                    format!(
                        "axis {axis} from {:.2} to {:.2} ± {:.2} degrees",
                        low.lag_deg, high.lag_deg, high.sd_deg
                    )
                })
        })
        .collect();
    let (low, high) = (lags.first()?.level_v, lags.last()?.level_v);
    (!grown.is_empty()).then(|| {
        format!(
            "hysteresis that grows with the level (lag at zero frequency at {low:.3} and {high:.3} V: {})",
            grown.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use realfft::num_complex::Complex;

    use super::*;

    const LINES: usize = 4097;
    const STEP_HZ: f64 = 0.78;
    const DELAY_S: f64 = 1.0e-4;

    /// Two mixed axes at two levels with a dead time, a resonance far above, and a lag in degrees of every level and axis.
    fn waves(lag_deg: [[f64; 2]; 2]) -> Waves {
        let mut draw = StdRng::seed_from_u64(5);
        let mut blocks = Vec::new();
        for n in 0..8 {
            let level = n / 4;
            let volts = [0.1, 0.3][level];
            let drive: Vec<Line> = (0..2)
                .map(|_| {
                    (0..LINES)
                        .map(|_| {
                            Complex::from_polar(
                                volts,
                                draw.random_range(0.0..std::f64::consts::TAU),
                            )
                        })
                        .collect()
                })
                .collect();
            let stroke = |axis: usize, k: usize| {
                let hz = k as f64 * STEP_HZ;
                let phase =
                    lag_deg[level][axis].to_radians() + std::f64::consts::TAU * hz * DELAY_S;
                drive[axis][k] * Complex::from_polar(1.0 + (hz / 1.0e3).powi(2), -phase)
            };
            let measured: Vec<Line> = [[2.0, 0.7], [-0.4, 3.0]]
                .into_iter()
                .map(|mix| {
                    (0..LINES)
                        .map(|k| {
                            let noise = Complex::new(
                                draw.random_range(-0.01..0.01),
                                draw.random_range(-0.01..0.01),
                            );
                            stroke(0, k) * mix[0] + stroke(1, k) * mix[1] + noise * volts
                        })
                        .collect()
                })
                .collect();
            // The simulation has neither lag nor mixing.
            let before: Vec<Line> = (0..2)
                .map(|axis| {
                    measured[axis].iter().zip(&drive[axis]).map(|(m, u)| m - u * 2.0).collect()
                })
                .collect();
            blocks.push(Block {
                held_out: false,
                level,
                drive,
                after: before.clone(),
                before,
                measured,
                noise: Vec::new(),
            });
        }
        Waves {
            step_hz: STEP_HZ,
            periodic: true,
            to_mean_square: 1.0,
            levels_v: vec![0.1, 0.3],
            blocks,
        }
    }

    #[test]
    fn a_lag_that_grows_on_one_axis_is_found_there_behind_mixing_and_dead_time() {
        let lags = lags(&waves([[1.0, 0.8], [1.0, 1.8]]));
        for (found, expected) in lags.iter().zip([1.0, 0.8, 1.0, 1.8]) {
            // A dead time of 7 degrees at the highest line under a gain that rises by 4 % leaves 0.07 degrees.
            assert!((found.lag_deg - expected).abs() < 0.1, "{lags:?}");
            assert!((found.delay_us - 1.0e6 * DELAY_S).abs() < 5.0, "{lags:?}");
        }
        for (axis, growth) in [0.0, 1.0].into_iter().enumerate() {
            let found = lags[axis + 2].lag_deg - lags[axis].lag_deg;
            assert!((found - growth).abs() < 0.02, "{lags:?}");
        }
        let said = words(&lags).expect("words");
        assert!(said.contains("axis 2 from 0.") && !said.contains("axis 1"), "{said}");
    }

    #[test]
    fn dead_time_alone_is_no_hysteresis() {
        assert_eq!(words(&lags(&waves([[0.0; 2]; 2]))), None);
    }

    #[test]
    fn one_level_tells_nothing() {
        let mut single = waves([[1.0; 2]; 2]);
        single.blocks.truncate(4);
        single.levels_v.truncate(1);
        assert!(lags(&single).is_empty());
    }
}
