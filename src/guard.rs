//! The guard: commands and why they are refused, and the watch over each axis' gauge and amplifier.
//!
//! Conditions that may be noise for a tick are counted over consecutive ticks. A fault is latched, brings all axes into
//! [`State::Fault`](crate::State::Fault) and returns their drives at a fixed slow rate to the safe voltage: a stack is never stepped.

use crate::generator::{Generator, Part};
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
    /// Keep a waveform for one axis (from 0) until it is started. A multisine is staged once its parts have come too:
    /// [`Generator::staging`] yields all commands that it takes.
    Stage {
        /// Axis, from 0.
        axis: u8,
        /// The waveform.
        generator: Generator,
    },
    /// The next part of the waveform that was staged last.
    StagePart {
        /// Axis, from 0.
        axis: u8,
        /// Which part, below [`PARTS`](crate::generator::PARTS).
        part: u8,
        /// What it holds.
        words: Part,
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

impl Command {
    /// Whether it changes nothing that runs, and can therefore wait for some ticks.
    #[inline(always)]
    pub const fn is_staging(&self) -> bool {
        matches!(self, Self::Stage { .. } | Self::StagePart { .. })
    }
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
    /// The highest code that a gauge in order gives; the lowest is a 64th of it.
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
    /// Negative: some counter is not zero.
    counting: i32,
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
        counting: 0,
    };

    /// Whether nothing is wrong and nothing was: as a rule. Then a tick compares and remembers, and counts nothing. Each condition is a
    /// margin, negative beyond its limit, so that one test of the sign of all of them together is enough. If not all is well, nothing
    /// is remembered: [`WatchState::examine`] does.
    #[inline(always)]
    pub(crate) fn is_well(&mut self, watch: &Watch, seen: Seen) -> bool {
        let margins = Margins::of(self, watch, seen);
        if margins.all() | self.counting < 0 {
            return false;
        }
        self.remember(seen);
        true
    }

    #[inline(always)]
    fn remember(&mut self, seen: Seen) {
        self.position = seen.position;
        if seen.code != self.code {
            self.code = seen.code;
            self.code_drive = seen.drive;
        }
    }

    /// The loop is open and the drive goes its own way: a gauge that does not answer is not stuck.
    #[inline(always)]
    pub(crate) fn rest(&mut self, drive: Volt) {
        self.code_drive = drive;
    }

    /// Counts how long what is wrong has lasted. Faults of the gauge are found in every state, the others only while the loop is closed.
    /// Seldom, so out of the way.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(crate) fn examine(&mut self, watch: &Watch, seen: Seen, active: bool) -> Faults {
        let m = Margins::of(self, watch, seen);
        let wrong = Wrong {
            railed: m.railed < 0,
            // There is nothing to jump from at the first sample.
            jump: m.jump < 0 && self.code != i32::MIN,
            stuck: m.stuck < 0,
            outside: active && m.outside < 0,
            lost: active && m.lost < 0,
            unlike: active && m.unlike < 0,
        };
        self.remember(seen);
        self.count(watch, wrong)
    }

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
            .with(Faults::TRAVEL.when(lasts(
                &mut self.outside,
                wrong.outside,
                watch.gauge_ticks.max(1),
            )))
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
        let counting = self.jumping != 0
            || self.railed | self.outside | self.following | self.monitor != 0
            || wrong.stuck;
        self.counting = -i32::from(counting);
        faults
    }
}

/// Distances from the limits, negative beyond them.
struct Margins {
    railed: i32,
    jump: i32,
    stuck: i32,
    outside: i32,
    lost: i32,
    unlike: i32,
}

impl Margins {
    #[inline(always)]
    fn of(state: &WatchState, watch: &Watch, seen: Seen) -> Self {
        let ([low, high], last) = (watch.travel, watch.last_code);
        // A code that is new speaks for itself.
        let moved =
            if seen.code == state.code { seen.drive - state.code_drive } else { Volt::ZERO };
        Self {
            // Of the codes that wrap, one side or the other is negative all the same.
            railed: seen.code.wrapping_sub(last >> 6) | last.wrapping_sub(seen.code),
            jump: margin(seen.position - state.position, watch.max_step),
            stuck: margin(moved, watch.stuck_drive),
            outside: (seen.position - low).to_bits() | (high - seen.position).to_bits(),
            lost: margin(seen.reference - seen.position, watch.following),
            unlike: margin(seen.monitor - seen.drive, watch.monitor),
        }
    }

    /// Negative if one of them is.
    #[inline(always)]
    fn all(&self) -> i32 {
        self.railed | self.jump | self.stuck | self.outside | self.lost | self.unlike
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
