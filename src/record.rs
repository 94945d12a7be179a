//! What goes into a tick and what comes out of it: [`Sample`], [`Record`] and the bits of its status word.

use crate::AXES;
use crate::units::{Um, Volt};

/// Raw converter codes of one tick, all sampled at the same instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sample {
    /// Gauge codes, one an axis; the configuration says what they mean in micrometres.
    pub gauge: [i32; AXES],
    /// Amplifier monitor codes; the configuration says what they mean in volts.
    pub monitor: [i32; AXES],
    /// The caller saw that a tick was missed or that the one before took too long.
    pub overrun: bool,
}

/// One axis of a [`Record`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisRecord {
    /// Where the axis should have been when `position` was sampled.
    pub reference: Um,
    /// Measured position.
    pub position: Um,
    /// Voltage commanded by this tick, after all limits; it acts from the next tick on.
    pub drive: Volt,
    /// Measured amplifier output.
    pub monitor: Volt,
    /// DAC code for `drive`.
    pub dac: u16,
}

/// Everything that a tick decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Record {
    /// Sample number since start, wrapping after 119 hours.
    pub tick: u32,
    /// State, limits and faults.
    pub flags: Flags,
    /// One entry an axis.
    pub axes: [AxisRecord; AXES],
}

/// State of the guard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum State {
    /// Drives are at, or on their slow way to, the safe voltage. Nothing is controlled.
    #[default]
    Off = 0,
    /// The loop is closed at the measured position; the difference to the parked drive fades out.
    Arming = 1,
    /// Generators run.
    Run = 2,
    /// Position is held.
    Hold = 3,
    /// As off, and latched until faults are cleared.
    Fault = 4,
}

impl State {
    /// One word.
    pub const fn name(self) -> &'static str {
        match self {
            State::Off => "off",
            State::Arming => "arming",
            State::Run => "run",
            State::Hold => "hold",
            State::Fault => "fault",
        }
    }
    /// Whether the loop is closed.
    #[inline(always)]
    pub const fn is_active(self) -> bool {
        matches!(self, State::Arming | State::Run | State::Hold)
    }
}

macro_rules! bits {
    ($(#[$doc:meta])* $name:ident: $word:ty { $($(#[$bit_doc:meta])* $bit:ident = $value:expr, $words:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        pub struct $name($word);
        impl $name {
            /// None of them.
            pub const NONE: Self = Self(0);
            $($(#[$bit_doc])* pub const $bit: Self = Self(1 << $value);)*
            /// Every bit with its name and what it means in words.
            pub const TABLE: &'static [(Self, &'static str, &'static str)] = &[$((Self::$bit, stringify!($bit), $words)),*];
            /// From the bit pattern; unknown bits are kept.
            #[inline(always)]
            pub const fn from_bits(bits: $word) -> Self {
                Self(bits)
            }
            /// The bit pattern.
            #[inline(always)]
            pub const fn to_bits(self) -> $word {
                self.0
            }
            /// Both.
            #[inline(always)]
            pub const fn with(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }
            /// `self` if `condition`, else none.
            #[inline(always)]
            pub const fn when(self, condition: bool) -> Self {
                if condition { self } else { Self(0) }
            }
            /// Whether all bits of `other` are set.
            #[inline(always)]
            pub const fn contains(self, other: Self) -> bool {
                self.0 & other.0 == other.0
            }
            /// Whether any bit of `other` is set.
            #[inline(always)]
            pub const fn any_of(self, other: Self) -> bool {
                self.0 & other.0 != 0
            }
            /// Whether no bit is set.
            #[inline(always)]
            pub const fn is_empty(self) -> bool {
                self.0 == 0
            }
            /// The set bits, in words.
            pub fn describe(self) -> impl Iterator<Item = &'static str> {
                Self::TABLE.iter().filter(move |(bit, _, _)| self.contains(*bit)).map(|(_, _, words)| *words)
            }
            /// The names of the set bits.
            pub fn names(self) -> impl Iterator<Item = &'static str> {
                Self::TABLE.iter().filter(move |(bit, _, _)| self.contains(*bit)).map(|(_, name, _)| *name)
            }
        }
    };
}

bits! {
    /// Why an output or a reference is not what the control law asked for. Not a fault: the loop goes on.
    Limits: u8 {
        /// Drive at its upper limit.
        VOLTAGE_HIGH = 0, "the drive is at its upper voltage limit: the wanted position or disturbance is out of reach";
        /// Drive at its lower limit.
        VOLTAGE_LOW = 1, "the drive is at its lower voltage limit: the wanted position or disturbance is out of reach";
        /// Drive changes as fast as allowed.
        SLEW = 2, "the drive changes as fast as allowed: the motion is faster than the amplifier's current or the slew limit";
        /// Reference cut to the travel limits.
        TRAVEL = 3, "the reference was cut to the travel limits";
        /// Integral term at its limit.
        INTEGRAL = 4, "the integral term is at its limit: a large disturbance, or feedforward with wrong parameters";
    }
}

bits! {
    /// Why the guard gave up. Latched until cleared; the drives return slowly to the safe voltage.
    Faults: u16 {
        /// Gauge at an end of its converter.
        RAILED = 0, "a gauge reads the end of its range: check the conditioner's gain, offset and supply";
        /// Gauge does not answer the drive.
        STUCK = 1, "a gauge does not change although the drive does: check its wiring and the conditioner";
        /// Gauge jumps more than a stack can.
        DISCONNECTED = 2, "a gauge jumps more than a stack can move: check for a broken wire or connector";
        /// Position too far from the reference for too long.
        FOLLOWING_ERROR = 3, "the stage did not follow its reference: check the amplifier, the load and the gains";
        /// Tick missed or too long.
        OVERRUN = 4, "a control tick was missed or took too long: report this with the tick-time histogram";
        /// Nobody talked to the controller.
        COMMAND_TIMEOUT = 5, "no command within the command timeout: the host stopped or was unplugged";
        /// Configuration cannot be used.
        BAD_CONFIG = 6, "the configuration is damaged: load and save one again";
        /// Amplifier output is not what was commanded.
        MONITOR = 7, "the amplifier output differs from the commanded voltage: check that it is on, its gain and its current limit";
        /// Position outside its limits.
        TRAVEL = 8, "the measured position is outside the travel limits";
        /// A converter delivered no new samples.
        CONVERTER = 9, "a converter of the board delivers no samples: restart the board and read its self-test";
        /// The tasks beside the control loop do not run, or crashed.
        STARVED = 10, "the board's background tasks stopped: it restarts by itself; read the crash report afterwards";
    }
}

/// Status word of a record, and the `flags` column of a recording.
///
/// | bits | meaning |
/// | --- | --- |
/// | 0..=2 | [`State`] |
/// | 3 | parked: every drive is at its safe voltage |
/// | 4 | a new configuration took effect at this tick |
/// | 8..=15 | [`Limits`] of any axis |
/// | 16..=28 | [`Faults`], latched |
/// | 29..=31 | axes 1 to 3 with a fault of their own |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Flags(pub u32);

impl Flags {
    pub(crate) const PARKED: u32 = 1 << 3;
    pub(crate) const SWAPPED: u32 = 1 << 4;

    /// State of the guard; bit patterns that no controller writes read as a fault.
    pub const fn state(self) -> State {
        match self.0 & 7 {
            0 => State::Off,
            1 => State::Arming,
            2 => State::Run,
            3 => State::Hold,
            _ => State::Fault,
        }
    }
    /// Whether every drive is at its safe voltage.
    pub const fn is_parked(self) -> bool {
        self.0 & Self::PARKED != 0
    }
    /// Whether a new configuration took effect at this tick.
    pub const fn is_swapped(self) -> bool {
        self.0 & Self::SWAPPED != 0
    }
    /// Limits of any axis.
    pub const fn limits(self) -> Limits {
        Limits::from_bits((self.0 >> 8) as u8)
    }
    /// Latched faults.
    pub const fn faults(self) -> Faults {
        Faults::from_bits(((self.0 >> 16) & 0x1fff) as u16)
    }
    /// Whether axis `axis` (from 0) has a fault of its own.
    pub const fn axis_faulted(self, axis: usize) -> bool {
        axis < AXES && (self.0 >> 29) & (1 << axis) != 0
    }
}
