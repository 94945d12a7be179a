//! The guard: commands and why they are refused, and the watch over each axis' gauge and amplifier.
//!
//! Conditions that may be noise for a tick are counted over consecutive ticks. A fault is latched, brings all axes into
//! [`State::Fault`](crate::State::Fault) and returns their drives at a fixed slow rate to the safe voltage: a stack is never stepped.

use crate::generator::Generator;
use crate::record::Faults;
use crate::units::{Quantity, Um, Volt};

/// What the outside may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Close the loop at the measured position.
    Arm,
    /// Open the loop and return slowly to the safe voltage.
    Disarm,
    /// Bring every reference to rest and hold it.
    Hold,
    /// Keep a waveform for one axis (from 0) until it is started.
    Stage {
        /// Axis, from 0.
        axis: u8,
        /// The waveform.
        generator: Generator,
    },
    /// Start the staged waveforms of these axes (bit 0 = axis 0), all at the same tick.
    Start {
        /// One bit an axis.
        axes: u8,
    },
    /// Forget latched faults; the loop stays open.
    ClearFaults,
    /// Nothing, but the command timeout starts anew.
    KeepAlive,
}

/// Why a command had no effect.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema,
)]
pub enum Refusal {
    /// Already armed.
    AlreadyArmed,
    /// Needs an armed controller.
    NotArmed,
    /// Needs to wait until arming is complete.
    StillArming,
    /// Faults are latched; clear them first.
    Faulted,
    /// The drives are still returning to the safe voltage.
    NotParked,
    /// A gauge is railed or jumps.
    GaugeFault,
    /// No such axis.
    NoSuchAxis,
    /// No waveform is staged for an axis that should start.
    NothingStaged,
}

impl Refusal {
    /// In words.
    pub const fn describe(self) -> &'static str {
        match self {
            Refusal::AlreadyArmed => "the controller is armed already",
            Refusal::NotArmed => "the controller is not armed",
            Refusal::StillArming => "arming is not complete yet: wait for state hold",
            Refusal::Faulted => "faults are latched: read them and clear them first",
            Refusal::NotParked => {
                "the drives are still returning to the safe voltage: wait until they are parked"
            }
            Refusal::GaugeFault => {
                "a gauge reads the end of its range or jumps: check its wiring and the conditioner"
            }
            Refusal::NoSuchAxis => "there is no such axis: axes are numbered 1 to 3",
            Refusal::NothingStaged => "no waveform is staged for an axis that should start",
        }
    }
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.describe())
    }
}

impl core::error::Error for Refusal {}

/// Good ticks that wash out the worst series of jumps, beyond the time that makes them a fault: 0.1 s.
const JUMP_MEMORY: u32 = 1_000;

/// Thresholds of one axis, in the tick's terms. A count of 0 ticks switches a watch off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Watch {
    /// The highest code that is in range; the lowest is 1.
    pub(crate) last_code: i32,
    pub(crate) gauge_ticks: u32,
    pub(crate) max_step: Um,
    pub(crate) stuck_drive: Volt,
    pub(crate) travel: [Um; 2],
    pub(crate) following: Um,
    pub(crate) following_ticks: u32,
    pub(crate) monitor: Volt,
    pub(crate) monitor_ticks: u32,
}

/// Counters of one axis.
#[derive(Clone, Copy, Debug)]
pub struct WatchState {
    railed: u32,
    jumping: u32,
    outside: u32,
    following: u32,
    monitor: u32,
    code: i32,
    code_drive: Volt,
    position: Um,
    /// Some counter is not zero.
    counting: bool,
}

/// What a watch looks at in one tick.
#[derive(Clone, Copy)]
pub(crate) struct Seen {
    pub(crate) code: i32,
    pub(crate) position: Um,
    pub(crate) reference: Um,
    /// Drive that acts now.
    pub(crate) drive: Volt,
    pub(crate) monitor: Volt,
    pub(crate) active: bool,
}

/// Count up while a condition lasts, and say whether it has lasted for `ticks` (0 = never).
#[inline(always)]
fn lasts(counter: &mut u32, condition: bool, ticks: u32) -> bool {
    *counter = if condition { counter.saturating_add(1) } else { 0 };
    ticks != 0 && *counter >= ticks
}

impl WatchState {
    /// Nothing seen yet.
    pub const REST: Self = Self {
        railed: 0,
        jumping: 0,
        outside: 0,
        following: 0,
        monitor: 0,
        code: i32::MIN,
        code_drive: Volt::ZERO,
        position: Um::ZERO,
        counting: false,
    };

    /// One tick. Faults of the gauge are found in every state, the others only while the loop is closed.
    ///
    /// As a rule nothing is wrong and nothing was: then a tick compares and remembers, and counts nothing. Each condition is a
    /// margin, negative beyond its limit, so that one test of the sign of all of them together is enough.
    #[inline(always)]
    pub(crate) fn step(&mut self, watch: &Watch, seen: Seen) -> Faults {
        let code_before = self.code;
        let railed = seen.code.saturating_sub(1) | watch.last_code.saturating_sub(seen.code);
        let jump = margin(seen.position - self.position, watch.max_step);
        self.position = seen.position;
        if seen.code != code_before || !seen.active {
            self.code = seen.code;
            self.code_drive = seen.drive;
        }
        let stuck = margin(seen.drive - self.code_drive, watch.stuck_drive);
        let [low, high] = watch.travel;
        let outside = (seen.position - low).to_bits() | (high - seen.position).to_bits();
        let lost = margin(seen.reference - seen.position, watch.following);
        let unlike = margin(seen.monitor - seen.drive, watch.monitor);
        let closed = if seen.active { outside | lost | unlike } else { 0 };
        if railed | jump | stuck | closed >= 0 && !self.counting {
            return Faults::NONE;
        }
        self.count(
            watch,
            Wrong {
                railed: railed < 0,
                // There is nothing to jump from at the first sample.
                jump: jump < 0 && code_before != i32::MIN,
                stuck: stuck < 0,
                outside: seen.active && outside < 0,
                lost: seen.active && lost < 0,
                unlike: seen.active && unlike < 0,
            },
        )
    }

    /// Counts how long what is wrong has lasted.
    #[inline(always)]
    fn count(&mut self, watch: &Watch, wrong: Wrong) -> Faults {
        let mut faults =
            Faults::RAILED.when(lasts(&mut self.railed, wrong.railed, watch.gauge_ticks));
        // A jump is held against the gauge for as long as good samples take to wash it out, but not for ever.
        self.jumping = if wrong.jump {
            let most = watch.gauge_ticks.saturating_add(JUMP_MEMORY);
            self.jumping.saturating_add(8).min(most)
        } else {
            self.jumping.saturating_sub(1)
        };
        let broken = watch.gauge_ticks != 0 && self.jumping > watch.gauge_ticks;
        faults = faults
            .with(Faults::DISCONNECTED.when(broken))
            .with(Faults::STUCK.when(wrong.stuck))
            .with(Faults::TRAVEL.when(lasts(&mut self.outside, wrong.outside, watch.gauge_ticks)))
            .with(Faults::FOLLOWING_ERROR.when(lasts(
                &mut self.following,
                wrong.lost,
                watch.following_ticks,
            )))
            .with(Faults::MONITOR.when(lasts(
                &mut self.monitor,
                wrong.unlike,
                watch.monitor_ticks,
            )));
        self.counting = self.jumping != 0
            || self.railed | self.outside | self.following | self.monitor != 0
            || wrong.stuck;
        faults
    }
}

/// What is wrong in one tick.
struct Wrong {
    railed: bool,
    jump: bool,
    stuck: bool,
    outside: bool,
    lost: bool,
    unlike: bool,
}

/// Distance of a magnitude from a limit (not negative): negative beyond it. One unit in the last place more is allowed below zero.
#[inline(always)]
fn margin<Q: Quantity>(value: Q, limit: Q) -> i32 {
    let value = value.to_bits();
    limit.to_bits().wrapping_sub(value ^ (value >> 31))
}
