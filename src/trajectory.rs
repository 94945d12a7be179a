//! The reference of one axis over time: waveforms joined without a jump, a little ahead of the present.
//!
//! A new waveform g starts at the reference's present position and velocity: the start point coasts to rest within a few
//! milliseconds, and x = start + s (g - start) with a blend s from 0 to 1 that begins and ends flat. Position and velocity
//! are therefore continuous whatever is joined to whatever. A waveform whose time is over fades out in the time that it took to
//! fade in, still running: its deviation from the centre is w times a weight from 1 to 0.
//!
//! The generator runs three ticks ahead. Drives computed now act from the next tick to the one after (one period of
//! delay, one of hold), and central differences need one more: feedforward gets position, velocity and acceleration at
//! n + 2, the record and the feedback get the position at n. All derivatives are differences of the same samples, so they
//! belong to the motion that is actually commanded, limits and blends included.

use core::sync::atomic::{Ordering, compiler_fence};

use crate::generator::{Generator, Multisines, Part, Shape, Table};
use crate::math::{ONE_Q30, mul_q30, rounded_ramp_q30, smoothstep_q30};
use crate::units::{Um, UmPer2Ticks, UmPer4Ticks2, clamp_bits, narrow};

/// Start points lose 2^-4 of their velocity each tick: at rest after some 5 ms.
const COAST_SHIFT: u32 = 4;

/// Position and its derivatives at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Motion {
    /// Position.
    pub position: Um,
    /// First derivative.
    pub velocity: UmPer2Ticks,
    /// Second derivative.
    pub acceleration: UmPer4Ticks2,
}

impl Motion {
    /// At zero, at rest.
    pub const REST: Self =
        Self { position: Um::ZERO, velocity: UmPer2Ticks::ZERO, acceleration: UmPer4Ticks2::ZERO };
}

/// Reference of one axis.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory {
    generator: Generator,
    staged: Generator,
    is_staged: bool,
    phase: u32,
    /// Phase per tick, Q32.32: a sweep changes it by less than one unit a tick.
    step: u64,
    age: u32,
    start: Um,
    /// um per tick, Q7.24.
    coast: i32,
    /// 0 to 2^32 - 1.
    blend: u32,
    /// x(n+3), x(n+2), x(n+1), x(n), x(n-1).
    ahead: [Um; 5],
    clipped: bool,
    /// Ticks for which the newest point has not changed, up to [`STILL`]; [`ASLEEP`]: nothing changes until something is started.
    still: u32,
}

/// Points ahead, and one more: then the difference of two motions is nothing too.
const STILL: u32 = 5;
/// At rest, and every point and difference of it with it.
const ASLEEP: u32 = STILL + 1;

impl Trajectory {
    /// At rest.
    pub const fn at(position: Um) -> Self {
        Self {
            generator: Generator::STOP,
            staged: Generator::STOP,
            is_staged: false,
            phase: 0,
            step: 0,
            age: 0,
            start: position,
            coast: 0,
            blend: u32::MAX,
            ahead: [position; 5],
            clipped: false,
            still: 0,
        }
    }

    /// Forget the waveform that waits.
    #[inline(always)]
    pub fn forget_staged(&mut self) {
        self.is_staged = false;
    }

    /// Forget all motion and stay at `position`; a waveform that waits still does.
    #[inline(always)]
    pub fn reset(&mut self, position: Um) {
        self.generator.shape = Shape::Stop;
        self.start = position;
        self.coast = 0;
        self.still = 0;
        for x in &mut self.ahead {
            *x = position;
        }
    }

    /// Keep a waveform for [`Trajectory::start_staged`]. A multisine waits once its parts have come too.
    #[inline(always)]
    pub fn stage(&mut self, multisines: &mut Multisines, generator: &Generator) {
        self.staged = *generator;
        // Where it is read again before it is copied, the copy is one without the first byte, and a call.
        compiler_fence(Ordering::SeqCst);
        self.is_staged = multisines.stage(&self.staged);
    }
    /// Keep a part of the multisine that was staged last. Whether it lacked this part.
    #[inline(always)]
    pub fn stage_part(&mut self, multisines: &mut Multisines, part: usize, words: &Part) -> bool {
        match multisines.take(part, words) {
            Some(is_complete) => {
                self.is_staged = is_complete;
                true
            }
            None => false,
        }
    }
    /// Whether a waveform waits, with all of its parts.
    #[inline(always)]
    pub const fn is_staged(&self) -> bool {
        self.is_staged
    }
    /// Begin the staged waveform, if there is one.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn start_staged(&mut self, multisines: &mut Multisines) {
        if self.is_staged {
            self.is_staged = false;
            self.generator = self.staged;
            if matches!(self.generator.shape, Shape::Multisine { .. }) {
                multisines.start();
            }
            self.join();
        }
    }
    /// Coast to rest.
    #[inline(always)]
    pub fn stop(&mut self) {
        self.generator.shape = Shape::Stop;
        self.join();
    }
    /// Whether the reference still moves, or will.
    #[inline(always)]
    pub const fn is_moving(&self) -> bool {
        !self.generator.rests()
            || (matches!(self.generator.shape, Shape::Go { .. }) && self.blend != u32::MAX)
            || self.coast >> COAST_SHIFT != 0
    }

    /// Start from the present motion.
    #[inline(always)]
    fn join(&mut self) {
        self.still = 0;
        let [newest, previous, ..] = self.ahead;
        self.start = newest;
        self.coast = (newest - previous).to_bits();
        self.blend = 0;
        self.age = 0;
        self.phase = self.generator.phase;
        self.step = (self.generator.step as u64) << 32;
    }

    /// Whether [`Trajectory::step`] would change nothing, unless the limits of the travel have changed.
    #[inline(always)]
    pub const fn is_asleep(&self) -> bool {
        self.still == ASLEEP
    }

    /// Nothing is asleep for the next few ticks (`STILL`).
    #[inline(always)]
    pub fn wake(&mut self) {
        self.still = 0;
    }

    /// One tick: returns the motion at n + 2. `multisine`: the next value of the multisine that runs.
    #[inline(always)]
    pub fn step(
        &mut self,
        table: Option<&Table>,
        multisine: impl FnOnce() -> i32,
        low: Um,
        high: Um,
    ) -> Motion {
        if self.coast != 0 {
            // Arithmetic shift rounds down; the nudge makes negative velocities end at zero too.
            let loss = self.coast >> COAST_SHIFT;
            self.coast = self.coast.wrapping_sub(if loss == 0 { self.coast } else { loss });
            self.start += Um::from_bits(self.coast);
        }
        let wanted = match self.generator.shape {
            Shape::Stop => self.start,
            _ => {
                let target = self.waveform(table, multisine);
                if self.blend == u32::MAX {
                    target
                } else {
                    self.blend = self.blend.saturating_add(self.generator.blend);
                    let u = (self.blend >> 2) as i32;
                    let s = match self.generator.shape {
                        Shape::Go { ramp: true } => rounded_ramp_q30(u),
                        _ => smoothstep_q30(u),
                    };
                    let way = (target - self.start).to_bits();
                    self.start + Um::from_bits(narrow::<30>(way as i64 * s as i64))
                }
            }
        };
        // As a rule it is within the travel: the signs of both distances tell.
        let is_within = (wanted - low).to_bits() | (high - wanted).to_bits() >= 0;
        let next = if is_within { wanted } else { cut(wanted, low, high) };
        self.clipped = !is_within;
        let [x3, x2, x1, x0, _] = self.ahead;
        self.ahead = [next, x3, x2, x1, x0];
        if next != x3 {
            self.still = 0;
        } else if self.still < STILL {
            self.still += 1;
        } else {
            self.still = if self.is_moving() { STILL } else { ASLEEP };
        }
        motion(next, x3, x2)
    }

    /// centre + amplitude * w, and the accumulators moved on.
    #[inline(always)]
    fn waveform(&mut self, table: Option<&Table>, multisine: impl FnOnce() -> i32) -> Um {
        if let Shape::Go { .. } = self.generator.shape {
            return self.generator.center;
        }
        let mut w = match self.generator.shape {
            Shape::Multisine { .. } => multisine(),
            _ => self.generator.wave(table, self.phase),
        };
        self.phase = self.phase.wrapping_add((self.step >> 32) as u32);
        if self.generator.duration != 0 {
            self.age = self.age.saturating_add(1);
            if let Shape::Sweep { growth } = self.generator.shape
                && self.age <= self.generator.duration
            {
                let change = ((self.step >> 32) as i64).wrapping_mul(growth as i64) >> 8;
                self.step = self.step.wrapping_add(change as u64);
            }
            // When its time is over it goes on while it fades: the way to the centre stays within the amplitude, where a start
            // point that coasts on with a fast wave's velocity would leave it.
            let after = self.age.saturating_sub(self.generator.duration);
            let faded = after.saturating_mul(self.generator.blend);
            if faded == u32::MAX {
                self.generator.shape = Shape::Go { ramp: false };
                return self.generator.center;
            }
            w = mul_q30(w, ONE_Q30 - smoothstep_q30((faded >> 2) as i32));
        }
        let swing = mul_q30(self.generator.amplitude.to_bits(), w);
        self.generator.center + Um::from_bits(swing)
    }

    /// Position at the present tick.
    #[inline(always)]
    pub const fn now(&self) -> Um {
        let [_, _, _, now, _] = self.ahead;
        now
    }
    /// Change over the last tick.
    #[inline(always)]
    pub fn last_change(&self) -> Um {
        let [_, _, _, now, before] = self.ahead;
        now - before
    }
    /// Whether the newest point was cut to the travel limits.
    #[inline(always)]
    pub const fn is_clipped(&self) -> bool {
        self.clipped
    }
}

/// The nearest position within the travel: seldom, so out of the way.
#[cold]
#[inline(never)]
#[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
fn cut(wanted: Um, low: Um, high: Um) -> Um {
    wanted.limit(low, high)
}

/// Central differences about the middle of three samples, a tick (0.1 ms) apart.
#[inline(always)]
fn motion(after: Um, here: Um, before: Um) -> Motion {
    let (rise, fall) = (after - here, here - before);
    // after - 2 here + before, as far as 4 bits more fit.
    let bend = clamp_bits::<28>((rise - fall).to_bits());
    Motion {
        position: here,
        velocity: UmPer2Ticks::from_bits((rise + fall).to_bits()),
        acceleration: UmPer4Ticks2::from_bits(bend << 4),
    }
}

const _: () = assert!(ONE_Q30 == 1 << 30 && crate::TICK_HZ == 10_000);

#[cfg(test)]
mod tests;
