//! Reference waveforms: what a person asks for ([`GeneratorSettings`]), and what the tick evaluates ([`Generator`]).
//!
//! Every waveform is `center + amplitude * w(phase)` with w in Q1.30 and a 32-bit phase accumulator, so that periods are
//! exact for ever. [`crate::trajectory`] starts, stops and changes them without a jump in position or velocity.

use crate::guard::Command;
use crate::math::{self, phase_of_turns, sin_q30};
use crate::settings::{Check, SettingsError};
use crate::units::Um;
use crate::{MAX_TONES, TICK_HZ, TICK_S};

mod multisine;
mod table;
mod waves;

pub use multisine::{BLOCK_TICKS, Multisines, PART_WORDS, PARTS, Part};
pub use table::Table;
pub(crate) use waves::PeakSearch;
use waves::{clip_q30, multisine_signs, staircase_q30, triangle_q30};

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
    /// Sum of equally strong sines at multiples of a base frequency, with signs drawn from a seed.
    Multisine(Multisine),
    /// Sine whose frequency grows or falls exponentially, once; then it fades out at its last frequency, and the centre is held.
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
        /// Time over which it fades in, and out after `duration_s`, s.
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
    /// Time over which it fades in from the present position, and out at the end, s.
    pub blend_s: f32,
    /// Time after which it fades out, and the centre is held, s; 0 = never.
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

/// A multisine with random signs: phases 0 and half a turn, so that it starts and ends at its centre.
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
    /// Seed of the signs: the same seed gives the same signal on every machine.
    pub seed: u32,
    /// Time over which it fades in, and out at the end, s.
    pub blend_s: f32,
    /// Time after which it fades out, and the centre is held, s; 0 = never.
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
    /// `amplitude` of a tone (Q1.30) with which the peak is 1.
    Multisine {
        first: u16,
        stride: u16,
        tones: u8,
        signs: u32,
        amplitude: i32,
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
    /// Ticks until it fades out to the centre; 0 = never.
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
        let mut generator = Self::outline(settings)?;
        let mut search = PeakSearch::NEW;
        while !generator.scale(&mut search) {}
        Ok(generator)
    }

    /// All of [`Generator::build`] that is quick: what is left is [`Generator::scale`].
    pub(crate) fn outline(settings: &GeneratorSettings) -> Result<Self, SettingsError> {
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
                // Tones at one frequency may cancel.
                let closest = if m.tones > 1 { 1.0 } else { 0.0 };
                check.range(
                    "stride",
                    f32::from(m.stride),
                    closest,
                    4_096.0,
                    "multiples of base_hz",
                )?;
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
                        signs: multisine_signs(m.seed),
                        amplitude: 0,
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

    /// A share of finding how large a multisine's tones may be; true once they are, and at once for everything else.
    pub(crate) fn scale(&mut self, search: &mut PeakSearch) -> bool {
        let Shape::Multisine { first, stride, tones, signs, amplitude } = &mut self.shape else {
            return true;
        };
        let found = search.go_on(*first, *stride, *tones, *signs);
        *amplitude = found.unwrap_or_default();
        found.is_some()
    }

    /// Whether it ends in rest by itself.
    #[inline(always)]
    pub(crate) const fn rests(&self) -> bool {
        matches!(self.shape, Shape::Stop | Shape::Go { .. })
    }

    /// The commands, one a tick, after which this waveform waits for its start on an axis (from 0): a multisine brings numbers that
    /// would take a tick too long to find, and too long to copy at once.
    pub fn staging(self, axis: u8) -> impl Iterator<Item = Command> {
        let parts = (0..self.parts()).map(move |part| Command::StagePart {
            axis,
            part: part as u8,
            words: self.part(part),
        });
        core::iter::once(Command::Stage { axis, generator: self }).chain(parts)
    }

    /// The waveform at a phase, Q1.30. Not a multisine's: see [`Multisines`].
    #[inline(always)]
    pub(crate) fn wave(&self, table: Option<&Table>, phase: u32) -> i32 {
        match self.shape {
            Shape::Sine | Shape::Sweep { .. } => sin_q30(phase),
            _ => self.other_wave(table, phase),
        }
    }

    /// All others; the sine then needs no memory on the stack.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    fn other_wave(&self, table: Option<&Table>, phase: u32) -> i32 {
        match self.shape {
            Shape::Stop
            | Shape::Go { .. }
            | Shape::Sine
            | Shape::Sweep { .. }
            | Shape::Multisine { .. } => 0,
            Shape::Triangle => triangle_q30(phase),
            Shape::Square { steepness } => {
                let steep = (triangle_q30(phase) as i64 * steepness as i64) >> 16;
                clip_q30(steep)
            }
            Shape::Staircase { steps, steepness } => staircase_q30(phase, steps, steepness),
            Shape::Table => match table {
                Some(table) => table.at(phase),
                None => 0,
            },
        }
    }
}

#[cfg(test)]
mod tests;
