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

/// Thresholds of one axis, in the tick's terms. A count of 0 ticks switches a watch off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Watch {
    pub(crate) full_code: i32,
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
    /// As a rule nothing is wrong and nothing was: then a tick compares and remembers, and counts nothing.
    #[inline(always)]
    pub(crate) fn step(&mut self, watch: &Watch, seen: Seen) -> Faults {
        // Codes 1 to full - 1 are in range.
        let railed = (seen.code.wrapping_sub(1) as u32) >= (watch.full_code.wrapping_sub(1) as u32);
        let jump = beyond(seen.position - self.position, watch.max_step) && self.code != i32::MIN;
        self.position = seen.position;
        if seen.code != self.code || !seen.active {
            self.code = seen.code;
            self.code_drive = seen.drive;
        }
        let stuck = beyond(seen.drive - self.code_drive, watch.stuck_drive);
        let [low, high] = watch.travel;
        let outside = seen.position < low || seen.position > high;
        let lost = beyond(seen.reference - seen.position, watch.following);
        let unlike = beyond(seen.monitor - seen.drive, watch.monitor);
        let wrong = railed | jump | stuck | (seen.active & (outside | lost | unlike));
        if !wrong && !self.counting {
            return Faults::NONE;
        }
        let mut faults = Faults::RAILED.when(lasts(&mut self.railed, railed, watch.gauge_ticks));
        // A jump is held against the gauge for as long as good samples take to wash it out.
        self.jumping =
            if jump { self.jumping.saturating_add(8) } else { self.jumping.saturating_sub(1) };
        let broken = watch.gauge_ticks != 0 && self.jumping > watch.gauge_ticks;
        faults = faults
            .with(Faults::DISCONNECTED.when(broken))
            .with(Faults::STUCK.when(stuck))
            .with(Faults::TRAVEL.when(lasts(
                &mut self.outside,
                seen.active & outside,
                watch.gauge_ticks,
            )))
            .with(Faults::FOLLOWING_ERROR.when(lasts(
                &mut self.following,
                seen.active & lost,
                watch.following_ticks,
            )))
            .with(Faults::MONITOR.when(lasts(
                &mut self.monitor,
                seen.active & unlike,
                watch.monitor_ticks,
            )));
        self.counting = wrong || self.jumping != 0;
        faults
    }
}

/// Whether a magnitude is larger than a limit (not negative).
#[inline(always)]
fn beyond<Q: Quantity>(value: Q, limit: Q) -> bool {
    let (value, limit) = (value.to_bits(), limit.to_bits());
    value > limit || value < limit.wrapping_neg()
}
