//! Reference waveforms: what a person asks for ([`GeneratorSettings`]), and what the tick evaluates ([`Generator`]).
//!
//! Every waveform is `center + amplitude * w(phase)` with w in Q1.30 and a 32-bit phase accumulator, so that periods are
//! exact for ever. [`crate::trajectory`] starts, stops and changes them without a jump in position or velocity.

use crate::math::{self, ONE_Q30, phase_of_turns, sin_q30};
use crate::settings::{Check, SettingsError};
use crate::units::Um;
use crate::{MAX_TONES, TABLE_POINTS, TICK_HZ, TICK_S};

/// A reference waveform in physical units. Amplitudes are peak values about the centre: a 10 um stroke has amplitude 5 um.
#[derive(
    Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema,
)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum GeneratorSettings {
    /// Stay where the reference is now, coasting to rest from the present velocity.
    Stop,
    /// Go to a position and stay there.
    Hold {
        /// Where, um.
        position_um: f32,
        /// Time to get there, s; the path has no corner.
        blend_s: f32,
    },
    /// Go to a position at constant velocity, with rounded ends, and stay there.
    Ramp {
        /// Where, um.
        target_um: f32,
        /// Time to get there, s.
        duration_s: f32,
    },
    /// Triangle wave.
    Triangle(Wave),
    /// Sine wave.
    Sine(Wave),
    /// Square wave whose edges are ramps.
    Square {
        /// Centre, amplitude, frequency, phase.
        wave: Wave,
        /// Slope of the edges, um/ms.
        slope_um_per_ms: f32,
    },
    /// Steps up from the lowest to the highest position and down again.
    Staircase {
        /// Centre, amplitude, frequency (of the whole way up and down), phase.
        wave: Wave,
        /// Steps on the way up, and as many on the way down.
        steps: u16,
        /// Slope of the edges, um/ms.
        slope_um_per_ms: f32,
    },
    /// Sum of equally strong sines at multiples of a base frequency, with phases drawn from a seed.
    Multisine(Multisine),
    /// Sine whose frequency grows or falls exponentially, once; then the centre is held.
    Sweep {
        /// Centre, um.
        center_um: f32,
        /// Amplitude, um.
        amplitude_um: f32,
        /// First frequency, Hz.
        from_hz: f32,
        /// Last frequency, Hz.
        to_hz: f32,
        /// Time from the first to the last, s.
        duration_s: f32,
        /// Time over which it fades in, s.
        blend_s: f32,
    },
    /// The arbitrary waveform in the controller's [`Table`], passed at the given rate with cubic interpolation.
    Table(Wave),
}

/// What periodic waveforms share.
#[derive(
    Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema,
)]
#[serde(deny_unknown_fields)]
pub struct Wave {
    /// Centre, um.
    pub center_um: f32,
    /// Peak deviation from the centre, um.
    pub amplitude_um: f32,
    /// Periods per second.
    pub frequency_hz: f32,
    /// Phase at the start, in turns: 0 rises through the centre, 0.75 starts at the bottom.
    pub phase_turns: f32,
    /// Time over which it fades in from the present position, s.
    pub blend_s: f32,
    /// Time after which the centre is held instead, s; 0 = never.
    pub duration_s: f32,
}

impl Wave {
    /// A wave from `low_um` to `high_um` that starts at the bottom, fades in within 10 ms and never ends.
    pub const fn between(low_um: f32, high_um: f32, frequency_hz: f32) -> Self {
        Self {
            center_um: (low_um + high_um) / 2.0,
            amplitude_um: (high_um - low_um) / 2.0,
            frequency_hz,
            phase_turns: 0.75,
            blend_s: 0.01,
            duration_s: 0.0,
        }
    }
}

/// A random-phase multisine.
#[derive(
    Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, postcard_schema::Schema,
)]
#[serde(deny_unknown_fields)]
pub struct Multisine {
    /// Centre, um.
    pub center_um: f32,
    /// Largest deviation from the centre over a whole period, um.
    pub peak_um: f32,
    /// Base frequency, Hz: the whole repeats at this rate.
    pub base_hz: f32,
    /// Lowest tone, in multiples of the base frequency.
    pub first: u16,
    /// Distance of tones, in multiples of the base frequency.
    pub stride: u16,
    /// Number of tones, 1 to 16.
    pub tones: u8,
    /// Seed of the phases: the same seed gives the same signal on every machine.
    pub seed: u32,
    /// Time over which it fades in, s.
    pub blend_s: f32,
    /// Time after which the centre is held instead, s; 0 = never.
    pub duration_s: f32,
}

/// Waveform in the tick's terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    /// Stay at the (coasting) start point.
    Stop,
    /// Blend to `center` and stay: smooth or ramp blend.
    Go {
        ramp: bool,
    },
    Triangle,
    Sine,
    /// Triangle times `steepness` (Q16.16), clipped.
    Square {
        steepness: i32,
    },
    Staircase {
        steps: i32,
        steepness: i32,
    },
    /// `scale` (Q6.25) turns sum/16 into a waveform with peak 1.
    Multisine {
        first: u16,
        stride: u16,
        tones: u8,
        seed: u32,
        scale: i32,
    },
    /// Relative growth of the frequency per tick in 2^-40.
    Sweep {
        growth: i32,
    },
    Table,
}

/// A waveform ready for the tick. Built off the hot path by [`Generator::build`]; small enough to be copied in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Generator {
    pub(crate) shape: Shape,
    pub(crate) center: Um,
    pub(crate) amplitude: Um,
    pub(crate) phase: u32,
    /// Phase per tick, in 2^-32 turns.
    pub(crate) step: u32,
    /// Blend per tick, in 2^-32.
    pub(crate) blend: u32,
    /// Ticks until the centre is held; 0 = never.
    pub(crate) duration: u32,
}

impl Generator {
    /// Coast to rest.
    pub const STOP: Self = Self {
        shape: Shape::Stop,
        center: Um::ZERO,
        amplitude: Um::ZERO,
        phase: 0,
        step: 0,
        blend: u32::MAX,
        duration: 0,
    };

    /// Check the settings and turn them into integers.
    pub fn build(settings: &GeneratorSettings) -> Result<Self, SettingsError> {
        let check = Check::new("generator");
        let ticks = |seconds: f32| (seconds * TICK_HZ as f32 + 0.5) as u32;
        let blend = |seconds: f32| {
            check.range("blend_s", seconds, 0.0, 1.0e5, "s").map(|s| match ticks(s) {
                0 | 1 => u32::MAX,
                n => (4_294_967_295.0f64 / n as f64) as u32,
            })
        };
        let position = |name, um: f32| check.range(name, um, -100.0, 100.0, "um").map(Um::from_f32);
        let amplitude = |name, um: f32| check.range(name, um, 0.0, 100.0, "um").map(Um::from_f32);
        let step = |name, hz: f32| {
            check
                .range(name, hz, 0.0, TICK_HZ as f32 / 4.0, "Hz")
                .map(|hz| (hz as f64 * 429_496.729_6 + 0.5) as u32)
        };
        let duration =
            |seconds: f32| check.range("duration_s", seconds, 0.0, 4.0e5, "s").map(ticks);
        let periodic = |shape, wave: &Wave| {
            check.range("phase_turns", wave.phase_turns, -1.0, 1.0, "turns")?;
            Ok(Self {
                shape,
                center: position("center_um", wave.center_um)?,
                amplitude: amplitude("amplitude_um", wave.amplitude_um)?,
                phase: phase_of_turns(wave.phase_turns),
                step: step("frequency_hz", wave.frequency_hz)?,
                blend: blend(wave.blend_s)?,
                duration: duration(wave.duration_s)?,
            })
        };
        // Slope of an edge over the slope of the triangle that it is cut from, at least 1, in Q16.16.
        let steepness = |slope: f32, triangle_slope: f32| {
            check.range("slope_um_per_ms", slope, 1.0e-6, 1.0e3, "um/ms").map(|slope| {
                let ratio = slope / triangle_slope.max(1.0e-9);
                (ratio.clamp(1.0, 32_000.0) * 65_536.0) as i32
            })
        };
        match settings {
            GeneratorSettings::Stop => Ok(Self::STOP),
            GeneratorSettings::Hold { position_um, blend_s } => Ok(Self {
                shape: Shape::Go { ramp: false },
                center: position("position_um", *position_um)?,
                blend: blend(*blend_s)?,
                ..Self::STOP
            }),
            GeneratorSettings::Ramp { target_um, duration_s } => Ok(Self {
                shape: Shape::Go { ramp: true },
                center: position("target_um", *target_um)?,
                blend: blend(check.range("duration_s", *duration_s, TICK_S, 1.0e5, "s")?)?,
                ..Self::STOP
            }),
            GeneratorSettings::Triangle(wave) => periodic(Shape::Triangle, wave),
            GeneratorSettings::Sine(wave) => periodic(Shape::Sine, wave),
            GeneratorSettings::Table(wave) => periodic(Shape::Table, wave),
            GeneratorSettings::Square { wave, slope_um_per_ms } => {
                let triangle = 4.0e-3 * wave.amplitude_um * wave.frequency_hz;
                periodic(Shape::Square { steepness: steepness(*slope_um_per_ms, triangle)? }, wave)
            }
            GeneratorSettings::Staircase { wave, steps, slope_um_per_ms } => {
                check.range("steps", f32::from(*steps), 1.0, 1_000.0, "steps")?;
                let triangle = 4.0e-3 * wave.amplitude_um * wave.frequency_hz;
                let steepness = steepness(*slope_um_per_ms, triangle)?;
                periodic(Shape::Staircase { steps: i32::from(*steps), steepness }, wave)
            }
            GeneratorSettings::Multisine(m) => {
                check.range("tones", f32::from(m.tones), 1.0, f32::from(MAX_TONES), "tones")?;
                check.range("first", f32::from(m.first), 1.0, 4_096.0, "multiples of base_hz")?;
                check.range("stride", f32::from(m.stride), 0.0, 4_096.0, "multiples of base_hz")?;
                let highest = u32::from(m.first) + u32::from(m.stride) * u32::from(m.tones - 1);
                check.range(
                    "first",
                    highest as f32,
                    1.0,
                    4_096.0,
                    "multiples of base_hz at the highest tone",
                )?;
                let base = check.range("base_hz", m.base_hz, 0.0, 1.0e3, "Hz")?;
                check.range(
                    "base_hz",
                    base * highest as f32,
                    0.0,
                    TICK_HZ as f32 / 4.0,
                    "Hz at the highest tone",
                )?;
                Ok(Self {
                    shape: Shape::Multisine {
                        first: m.first,
                        stride: m.stride,
                        tones: m.tones,
                        seed: m.seed,
                        scale: multisine_scale(m.first, m.stride, m.tones, m.seed, highest),
                    },
                    center: position("center_um", m.center_um)?,
                    amplitude: amplitude("peak_um", m.peak_um)?,
                    phase: 0,
                    step: step("base_hz", m.base_hz)?,
                    blend: blend(m.blend_s)?,
                    duration: duration(m.duration_s)?,
                })
            }
            GeneratorSettings::Sweep {
                center_um,
                amplitude_um,
                from_hz,
                to_hz,
                duration_s,
                blend_s,
            } => {
                let from = check.range("from_hz", *from_hz, 1.0e-3, TICK_HZ as f32 / 4.0, "Hz")?;
                let to = check.range("to_hz", *to_hz, 1.0e-3, TICK_HZ as f32 / 4.0, "Hz")?;
                let seconds = check.range("duration_s", *duration_s, 0.01, 1.0e5, "s")?;
                // exp(growth * ticks) = to / from; per tick the frequency is multiplied by 1 + x, x = e^growth - 1.
                let growth = math::ln(to / from) / (seconds * TICK_HZ as f32);
                let per_tick = growth + 0.5 * growth * growth;
                let per_tick = check.range(
                    "duration_s",
                    per_tick,
                    -1.9e-3,
                    1.9e-3,
                    "relative change of frequency per tick",
                )?;
                Ok(Self {
                    shape: Shape::Sweep { growth: (per_tick as f64 * (1u64 << 40) as f64) as i32 },
                    center: position("center_um", *center_um)?,
                    amplitude: amplitude("amplitude_um", *amplitude_um)?,
                    phase: 0,
                    step: step("from_hz", from)?,
                    blend: blend(*blend_s)?,
                    duration: ticks(seconds),
                })
            }
        }
    }

    /// Whether it ends in rest by itself.
    #[inline(always)]
    pub(crate) const fn rests(&self) -> bool {
        matches!(self.shape, Shape::Stop | Shape::Go { .. })
    }

    /// The waveform at a phase, Q1.30.
    #[inline(always)]
    pub(crate) fn wave(&self, table: &Table, phase: u32) -> i32 {
        match self.shape {
            Shape::Stop | Shape::Go { .. } => 0,
            Shape::Sine | Shape::Sweep { .. } => sin_q30(phase),
            Shape::Triangle => triangle_q30(phase),
            Shape::Square { steepness } => {
                let steep = (triangle_q30(phase) as i64 * steepness as i64) >> 16;
                clip_q30(steep)
            }
            Shape::Staircase { steps, steepness } => staircase_q30(phase, steps, steepness),
            Shape::Multisine { first, stride, tones, seed, scale } => {
                let sum = multisine_sum(phase, first, stride, tones, seed);
                clip_q30((sum as i64 * scale as i64) >> 25)
            }
            Shape::Table => table.at(phase),
        }
    }
}

/// Q1.30 with a little room: waveforms stay within +-1.
#[inline(always)]
const fn clip_q30(x: i64) -> i32 {
    if x > ONE_Q30 as i64 {
        ONE_Q30
    } else if x < -(ONE_Q30 as i64) {
        -ONE_Q30
    } else {
        x as i32
    }
}

/// 0 at phase 0, 1 at a quarter, -1 at three quarters.
#[inline(always)]
const fn triangle_q30(phase: u32) -> i32 {
    let turn = phase as i32;
    if turn > ONE_Q30 || turn < -ONE_Q30 { i32::MIN.wrapping_sub(turn) } else { turn }
}

#[inline(always)]
const fn staircase_q30(phase: u32, steps: i32, steepness: i32) -> i32 {
    // Height in steps, Q16: 0 at the bottom, `steps` at the top.
    let height = ((triangle_q30(phase) as i64 + ONE_Q30 as i64) * steps as i64) >> 15;
    let height = height as i32;
    let whole = height >> 16;
    let part = (height & 0xffff) - 0x8000;
    let edge = ((part as i64 * steepness as i64) >> 16) + 0x8000;
    let edge = if edge < 0 {
        0
    } else if edge > 0x1_0000 {
        0x1_0000
    } else {
        edge as i32
    };
    // (whole + edge) / steps, to -1..1. One 32-bit division (`udiv`) instead of a table; steps >= 1.
    let level = (whole << 16).wrapping_add(edge);
    let divisor = if steps < 1 { 1 } else { steps as u32 };
    let fraction = (level as u32) / divisor; // Q16
    clip_q30(((fraction as i64) << 15) - ONE_Q30 as i64)
}

/// Phase of tone `k`: a hash of seed and number, so that no table is needed.
#[inline(always)]
const fn tone_phase(seed: u32, k: u32) -> u32 {
    // Finaliser of MurmurHash3 (public domain, A. Appleby).
    let mut h = seed.wrapping_add(k.wrapping_mul(0x9e37_79b9));
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// Sum of the tones over 16, Q1.30.
#[inline(always)]
fn multisine_sum(phase: u32, first: u16, stride: u16, tones: u8, seed: u32) -> i32 {
    let mut sum = 0i32;
    let mut tone = phase.wrapping_mul(first as u32);
    let distance = phase.wrapping_mul(stride as u32);
    for k in 0..u32::from(if tones > MAX_TONES { MAX_TONES } else { tones }) {
        sum = sum.wrapping_add(sin_q30(tone.wrapping_add(tone_phase(seed, k))) >> 4);
        tone = tone.wrapping_add(distance);
    }
    sum
}

/// Q6.25 factor that brings the largest value over a period to 1 (less a thousandth for what lies between the samples).
fn multisine_scale(first: u16, stride: u16, tones: u8, seed: u32, highest: u32) -> i32 {
    let samples = 16 * highest;
    let step = u32::MAX / samples;
    let peak = (0..samples)
        .map(|n| multisine_sum(n.wrapping_mul(step), first, stride, tones, seed).unsigned_abs())
        .max()
        .unwrap_or(0)
        .max(1 << 20);
    ((1u64 << 55) as f64 * 0.98 / peak as f64) as i32
}

/// Arbitrary waveform: up to 1024 points over one period.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    points: [i32; TABLE_POINTS],
    len: u32,
}

impl Table {
    /// A flat line.
    pub const EMPTY: Self = Self { points: [0; TABLE_POINTS], len: 0 };

    /// Take over the points of one period, each from -1 to 1. Nothing changes if one of them is not.
    pub fn set(&mut self, points: &[f32]) -> Result<(), SettingsError> {
        let check = Check::new("table");
        check.range("points", points.len() as f32, 4.0, TABLE_POINTS as f32, "points")?;
        self.write(0, points)?;
        self.set_len(points.len())
    }
    /// Take over some points, each from -1 to 1, from index `offset` on; the number of points in use stays. Nothing changes if one
    /// of them cannot be used.
    pub fn write(&mut self, offset: usize, points: &[f32]) -> Result<(), SettingsError> {
        let check = Check::new("table");
        let end = offset.saturating_add(points.len());
        check.range("points", end as f32, 0.0, TABLE_POINTS as f32, "points")?;
        for point in points {
            check.range("points", *point, -1.0, 1.0, "of the amplitude")?;
        }
        for (to, from) in self.points.iter_mut().skip(offset).zip(points) {
            *to = (from * ONE_Q30 as f32) as i32;
        }
        Ok(())
    }
    /// Use this many points.
    pub fn set_len(&mut self, len: usize) -> Result<(), SettingsError> {
        let check = Check::new("table");
        check.range("points", len as f32, 4.0, TABLE_POINTS as f32, "points")?;
        self.len = len as u32;
        Ok(())
    }
    /// Number of points.
    pub fn len(&self) -> usize {
        self.len as usize
    }
    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    #[inline(always)]
    fn point(&self, index: u32) -> i64 {
        let index = if index >= self.len { index.wrapping_sub(self.len) } else { index };
        match self.points.get(index as usize) {
            Some(point) => *point as i64,
            None => 0,
        }
    }

    /// Catmull-Rom interpolation: through every point, velocity continuous.
    #[inline(always)]
    fn at(&self, phase: u32) -> i32 {
        let place = phase as u64 * self.len as u64;
        let index = (place >> 32) as u32;
        let t = ((place as u32) >> 2) as i64; // Q30
        let p0 = self.point(index.wrapping_add(self.len).wrapping_sub(1));
        let p1 = self.point(index);
        let p2 = self.point(index.wrapping_add(1));
        let p3 = self.point(index.wrapping_add(2));
        // Horner of p1 + t/2 (p2 - p0 + t (2p0 - 5p1 + 4p2 - p3 + t (3p1 - p0 - 3p2 + p3))); each bracket < 2^34.
        let c3 = 3 * (p1 - p2) + p3 - p0;
        let c2 = 2 * p0 - 5 * p1 + 4 * p2 - p3;
        // Operands are reduced to 33 bits before the products, which therefore fit 63.
        let inner = c2 + (((c3 >> 2) * t) >> 28);
        let slope = (p2 - p0) + (((inner >> 2) * t) >> 28);
        clip_q30(p1 + (((slope >> 2) * t) >> 29))
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;
    use std::vec::Vec;

    use super::*;

    fn range(generator: &Generator, table: &Table) -> (f64, f64) {
        let values = (0..100_000u32)
            .map(|n| generator.wave(table, n.wrapping_mul(42_949)) as f64 / ONE_Q30 as f64);
        values.fold((9.0, -9.0), |(low, high), x| (x.min(low), x.max(high)))
    }

    #[test]
    fn every_waveform_fills_its_amplitude_and_no_more() {
        let wave = Wave::between(0.0, 10.0, 1.0);
        let mut table = Table::EMPTY;
        let points: Vec<f32> =
            (0..64).map(|i| (i as f32 / 64.0 * std::f32::consts::TAU).sin()).collect();
        table.set(&points).unwrap();
        for settings in [
            GeneratorSettings::Triangle(wave),
            GeneratorSettings::Sine(wave),
            GeneratorSettings::Square { wave, slope_um_per_ms: 1.0 },
            GeneratorSettings::Staircase { wave, steps: 5, slope_um_per_ms: 1.0 },
            GeneratorSettings::Table(wave),
        ] {
            let (low, high) = range(&Generator::build(&settings).unwrap(), &table);
            assert!(
                (high - 1.0).abs() < 1e-3 && (low + 1.0).abs() < 1e-3,
                "{settings:?}: {low} {high}"
            );
        }
        let multisine = GeneratorSettings::Multisine(Multisine {
            center_um: 5.0,
            peak_um: 4.0,
            base_hz: 1.0,
            first: 3,
            stride: 7,
            tones: 16,
            seed: 7,
            blend_s: 0.1,
            duration_s: 0.0,
        });
        let (low, high) = range(&Generator::build(&multisine).unwrap(), &table);
        assert!(high.max(-low) > 0.97 && high.max(-low) <= 1.0, "{low} {high}");
    }

    #[test]
    fn a_table_is_followed_between_its_points() {
        let mut table = Table::EMPTY;
        let points: Vec<f32> =
            (0..64).map(|i| (i as f32 / 64.0 * std::f32::consts::TAU).sin()).collect();
        table.set(&points).unwrap();
        for n in 0..10_000u32 {
            let phase = n.wrapping_mul(429_497);
            let exact = (phase as f64 / 4_294_967_296.0 * std::f64::consts::TAU).sin();
            assert!((table.at(phase) as f64 / ONE_Q30 as f64 - exact).abs() < 2e-4);
        }
        assert!(table.set(&[0.0, 2.0, 0.0, 0.0]).is_err());
        assert_eq!(table.len(), 64, "a refused table leaves the old one");
    }

    #[test]
    fn staircase_has_flat_treads() {
        let wave = Wave::between(0.0, 10.0, 1.0);
        let g = Generator::build(&GeneratorSettings::Staircase {
            wave,
            steps: 4,
            slope_um_per_ms: 1.0,
        })
        .unwrap();
        let mut levels: Vec<i32> = Vec::new();
        let mut previous = g.wave(&Table::EMPTY, 0);
        for n in 1..10_000u32 {
            let w = g.wave(&Table::EMPTY, n.wrapping_mul(429_497));
            if w == previous && !levels.contains(&w) {
                levels.push(w);
            }
            previous = w;
        }
        assert_eq!(levels.len(), 5, "{levels:?}");
    }

    #[test]
    fn bad_settings_are_refused_by_name() {
        let wave = Wave { frequency_hz: f32::NAN, ..Wave::between(0.0, 1.0, 1.0) };
        let error = Generator::build(&GeneratorSettings::Sine(wave)).unwrap_err();
        assert_eq!(error.field, "frequency_hz");
        assert!(error.to_string().contains("generator.frequency_hz"), "{error}");
    }
}
