//! Waveforms of the probe suite in volts, and the generator settings that make them.

use flexstage::GeneratorSettings;
use flexstage::generator::{Multisine, Wave};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

/// A waveform in volts.
#[derive(Clone, Debug, PartialEq)]
pub enum Waveform {
    /// To a voltage within a time, and stay.
    Ramp {
        /// Where, V.
        to_v: f64,
        /// Time, s.
        duration_s: f64,
    },
    /// Triangle from `low_v` up to `high_v` and back.
    Triangle {
        /// Bottom, V.
        low_v: f64,
        /// Top, V.
        high_v: f64,
        /// Periods per second.
        frequency_hz: f64,
    },
    /// Square wave with edges of finite slope.
    Square {
        /// Bottom, V.
        low_v: f64,
        /// Top, V.
        high_v: f64,
        /// Periods per second.
        frequency_hz: f64,
        /// Slope of the edges.
        slope_v_per_ms: f64,
    },
    /// Exponential sweep.
    Sweep {
        /// Centre, V.
        center_v: f64,
        /// Amplitude, V.
        amplitude_v: f64,
        /// First frequency.
        from_hz: f64,
        /// Last frequency.
        to_hz: f64,
        /// Time between them.
        duration_s: f64,
    },
    /// The experiment's table.
    Table {
        /// Centre, V.
        center_v: f64,
        /// Amplitude, V.
        amplitude_v: f64,
        /// Periods per second.
        frequency_hz: f64,
        /// Phase, turns.
        phase_turns: f64,
    },
    /// Sixteen tones of the generator's own multisine.
    Tones {
        /// Centre, V.
        center_v: f64,
        /// Peak, V.
        amplitude_v: f64,
        /// Base frequency.
        base_hz: f64,
        /// Lowest multiple of it.
        first: u16,
        /// Distance of multiples.
        stride: u16,
        /// Seed of the phases.
        seed: u32,
    },
}

impl Waveform {
    /// Lowest and highest voltage.
    pub fn range_v(&self) -> (f64, f64) {
        match *self {
            Self::Ramp { to_v, .. } => (to_v, to_v),
            Self::Triangle { low_v, high_v, .. } | Self::Square { low_v, high_v, .. } => {
                (low_v, high_v)
            }
            Self::Sweep { center_v, amplitude_v, .. }
            | Self::Table { center_v, amplitude_v, .. }
            | Self::Tones { center_v, amplitude_v, .. } => {
                (center_v - amplitude_v, center_v + amplitude_v)
            }
        }
    }

    /// The generator that makes these volts on an axis that turns micrometres into volts by `scale` (um per volt). A wave fades out towards
    /// its centre after `lasts_s` seconds, within its range: what replaces a fast one by another at full speed coasts on far beyond that.
    pub fn generator(&self, scale: f64, origin_um: f64, lasts_s: f64) -> GeneratorSettings {
        let um = |v: f64| (v * scale + origin_um) as f32;
        let size = |v: f64| (v * scale) as f32;
        let wave = |center_v: f64, amplitude_v: f64, frequency_hz: f64, phase_turns: f64| Wave {
            center_um: um(center_v),
            amplitude_um: size(amplitude_v),
            frequency_hz: frequency_hz as f32,
            phase_turns: phase_turns as f32,
            blend_s: 0.02,
            duration_s: lasts_s as f32,
        };
        let between =
            |low: f64, high: f64, hz: f64| wave((low + high) / 2.0, (high - low) / 2.0, hz, 0.75);
        match *self {
            Self::Ramp { to_v, duration_s } => {
                GeneratorSettings::Ramp { target_um: um(to_v), duration_s: duration_s as f32 }
            }
            Self::Triangle { low_v, high_v, frequency_hz } => {
                GeneratorSettings::Triangle(between(low_v, high_v, frequency_hz))
            }
            Self::Square { low_v, high_v, frequency_hz, slope_v_per_ms } => {
                GeneratorSettings::Square {
                    wave: between(low_v, high_v, frequency_hz),
                    slope_um_per_ms: size(slope_v_per_ms),
                }
            }
            Self::Sweep { center_v, amplitude_v, from_hz, to_hz, duration_s } => {
                GeneratorSettings::Sweep {
                    center_um: um(center_v),
                    amplitude_um: size(amplitude_v),
                    from_hz: from_hz as f32,
                    to_hz: to_hz as f32,
                    duration_s: duration_s as f32,
                    blend_s: 0.02,
                }
            }
            Self::Table { center_v, amplitude_v, frequency_hz, phase_turns } => {
                GeneratorSettings::Table(wave(center_v, amplitude_v, frequency_hz, phase_turns))
            }
            Self::Tones { center_v, amplitude_v, base_hz, first, stride, seed } => {
                GeneratorSettings::Multisine(Multisine {
                    center_um: um(center_v),
                    peak_um: size(amplitude_v),
                    base_hz: base_hz as f32,
                    first,
                    stride,
                    tones: 16,
                    seed,
                    blend_s: 0.1,
                    duration_s: lasts_s as f32,
                })
            }
        }
    }
}

/// Random-phase multisine of odd lines up to `highest`, every fourth odd line left out (where only a nonlinearity answers),
/// amplitude falling with the square root of frequency; 1024 points, peak 1.
pub fn odd_multisine(highest: usize, seed: u64) -> Vec<f32> {
    let mut rng = SmallRng::seed_from_u64(seed);
    let lines: Vec<(f64, f64, f64)> = (1..=highest)
        .step_by(2)
        .enumerate()
        .filter(|(i, _)| i % 4 != 3)
        .map(|(_, k)| {
            let phase = rng.random_range(0.0..std::f64::consts::TAU);
            (k as f64, 1.0 / (k as f64).sqrt(), phase)
        })
        .collect();
    let points: Vec<f64> = (0..flexstage::TABLE_POINTS)
        .map(|n| {
            let turn = std::f64::consts::TAU * n as f64 / flexstage::TABLE_POINTS as f64;
            lines.iter().map(|&(k, a, phase)| a * (k * turn + phase).sin()).sum()
        })
        .collect();
    let peak = points.iter().fold(1e-9f64, |m, x| m.max(x.abs()));
    points.iter().map(|x| (x / peak) as f32).collect()
}

/// Triangles of falling amplitude about a common bottom: outer loop first, then minor loops inside it; ends where it starts.
pub(super) fn nested_triangles() -> Vec<f32> {
    const LEVELS: [f32; 5] = [1.0, 0.75, 0.5, 0.3, 0.15];
    let n = flexstage::TABLE_POINTS;
    let total: f32 = LEVELS.iter().sum();
    let mut points = Vec::with_capacity(n);
    for (i, level) in LEVELS.iter().enumerate() {
        // Equal slopes: time in proportion to the level.
        let end = LEVELS[..=i].iter().sum::<f32>() / total * n as f32;
        let start = points.len();
        let length = (end as usize).min(n).saturating_sub(start).max(1);
        for j in 0..length {
            let turn = j as f32 / length as f32;
            let tri = 1.0 - (2.0 * turn - 1.0).abs();
            points.push(-1.0 + 2.0 * level * tri);
        }
    }
    points.resize(n, -1.0);
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_multisine_leaves_even_and_every_fourth_odd_line_out() {
        let points = odd_multisine(99, 3);
        let frf = crate::measure::frf::periodic(&points, &points, 1024.0, 1024);
        let lines: Vec<usize> =
            frf.points.iter().map(|p| p.frequency_hz.round() as usize).collect();
        assert!(lines.iter().all(|k| k % 2 == 1 && (k / 2) % 4 != 3), "{lines:?}");
        assert_eq!(lines.len(), 38);
        assert!(points.iter().all(|p| p.abs() <= 1.0));
    }

    #[test]
    fn nested_loops_shrink_and_close() {
        let points = nested_triangles();
        assert_eq!(points.len(), flexstage::TABLE_POINTS);
        // The last point is one step above the bottom, where the next period begins.
        assert!(points[0] == -1.0 && points[1023] < -0.97, "{}", points[1023]);
        assert!(points.iter().all(|p| (-1.0..=1.0).contains(p)));
    }
}
