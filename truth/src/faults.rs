//! What no catalogue of effects has: faults that come and go, that jump, or that are there all the time, and physics that nobody thought
//! of. A diagnosis must not rename them.

use rand::{Rng, RngExt};

mod acts;
mod physics;

pub use acts::Fault;

/// Kinds of faults; `size` in [`Fault`] is in the unit given here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The gauge bridge jumps between two states at random (m).
    Telegraph,
    /// The reading freezes for a while, again and again (fraction of the time).
    Freeze,
    /// The reading falls towards zero for some milliseconds (fraction of the reading).
    Dropout,
    /// The gauge's gain flips between two values at random times (relative).
    GainFlip,
    /// A tone whose frequency wanders over the band and beyond (m).
    Interference,
    /// The dead time of the command wanders (s).
    DeadTime,
    /// Knocks: random impulses that ring (N).
    Knocks,
    /// The noise swells now and then (m rms).
    NoiseBursts,
    /// The floor shakes: random force below 30 Hz (N).
    Vibration,
    /// One bit of the converter is stuck (m of the bit).
    StuckBit,
    /// The amplifier collapses for some milliseconds now and then (fraction of the voltage).
    Brownout,
    /// The guide catches at random and lets go again (N).
    Catching,
    /// A pump on the same table shakes the stage at one frequency (N).
    Pump,
    /// The gauge follows the stage with play (m).
    Play,
    /// The conditioner warms up, its gain creeps to another value (relative).
    Warming,
    /// The command arrives in coarse steps: lower bits of the converter are lost (V).
    CoarseDrive,
    /// An eddy-current brake: drag that grows with the speed and falls beyond a critical one (N at most).
    Brake,
    /// Drag of a fluid: it grows with the square of the speed (N at 1 mm/s).
    FluidDrag,
    /// A hard stop above some deflection (N/m).
    EndStop,
    /// The amplifier's supply gives way under load, and recovers (relative, at 0.1 A).
    SupplySag,
    /// The amplifier does not answer to less than a certain step (V).
    DeadBand,
    /// The stack warms up with what it is moved, and grows (m, for 100 V at 100 Hz).
    SelfHeating,
    /// The gauge's amplifier has a coupling capacitor: what lasts fades from the reading (share of it that fades).
    HighPass,
    /// The conditioner does not follow faster than a certain rate, 100 um/ms / (1 + size).
    SlewLimit,
    /// The moving stage tilts: a gauge sees the product of two axes' displacements (m at 10 um by 10 um).
    Tilt,
    /// The sampling instant jitters (s rms).
    Jitter,
    /// The voltage is no straight line of the command (V at most off the line, or by what a kink turns it at the far end).
    DriveBend,
    /// The amplifier settles in two ways, most of it at once and the rest slowly (share of it that comes slowly).
    DriveTail,
}

impl Kind {
    /// Kinds that something is broken in.
    pub const BROKEN: [Self; 16] = [
        Self::Telegraph,
        Self::Freeze,
        Self::Dropout,
        Self::GainFlip,
        Self::Interference,
        Self::DeadTime,
        Self::Knocks,
        Self::NoiseBursts,
        Self::Vibration,
        Self::StuckBit,
        Self::Brownout,
        Self::Catching,
        Self::Pump,
        Self::Play,
        Self::Warming,
        Self::CoarseDrive,
    ];

    /// Kinds that are physics of a healthy rig.
    pub const PHYSICS: [Self; 10] = [
        Self::Brake,
        Self::FluidDrag,
        Self::EndStop,
        Self::SupplySag,
        Self::DeadBand,
        Self::SelfHeating,
        Self::HighPass,
        Self::SlewLimit,
        Self::Tilt,
        Self::Jitter,
    ];

    /// Kinds that are electronics which nobody measured: apart from the others, whose draws stay what they are.
    pub const ELECTRONICS: [Self; 2] = [Self::DriveBend, Self::DriveTail];

    /// Whether a kind stays what it is from one session to another, as physics does.
    pub fn is_steady(self) -> bool {
        Self::PHYSICS.contains(&self) || Self::ELECTRONICS.contains(&self)
    }

    /// Name, for the key.
    pub fn name(self) -> &'static str {
        match self {
            Self::Telegraph => "telegraph-gauge",
            Self::Freeze => "frozen-reading",
            Self::Dropout => "dropouts",
            Self::GainFlip => "gain-flips",
            Self::Interference => "wandering-interference",
            Self::DeadTime => "wandering-dead-time",
            Self::Knocks => "knocks",
            Self::NoiseBursts => "noise-bursts",
            Self::Vibration => "floor-vibration",
            Self::StuckBit => "stuck-bit",
            Self::Brownout => "brownouts",
            Self::Catching => "catching-guide",
            Self::Pump => "pump",
            Self::Play => "play",
            Self::Warming => "warming",
            Self::CoarseDrive => "coarse-drive",
            Self::Brake => "eddy-brake",
            Self::FluidDrag => "fluid-drag",
            Self::EndStop => "end-stop",
            Self::SupplySag => "supply-sag",
            Self::DeadBand => "dead-band",
            Self::SelfHeating => "self-heating",
            Self::HighPass => "high-pass",
            Self::SlewLimit => "slew-limit",
            Self::Tilt => "tilt",
            Self::Jitter => "jitter",
            Self::DriveBend => "drive-bend",
            Self::DriveTail => "drive-tail",
        }
    }

    /// Where it sits, in the contract's words.
    pub fn stage(self) -> &'static str {
        match self {
            Self::DeadTime | Self::CoarseDrive | Self::DriveBend => "drive",
            Self::Brownout | Self::SupplySag | Self::DeadBand | Self::DriveTail => "amplifier",
            Self::SelfHeating => "piezo",
            Self::Catching | Self::Brake | Self::FluidDrag | Self::EndStop => "mechanism",
            Self::Knocks | Self::Vibration | Self::Pump => "environment",
            _ => "sensor",
        }
    }

    /// A size in the kind's unit.
    pub fn draw(self, rng: &mut impl Rng) -> f64 {
        let (low, high): (f64, f64) = match self {
            Self::Telegraph => (1e-8, 2e-7),
            Self::Freeze => (0.02, 0.3),
            Self::Dropout => (0.05, 1.0),
            Self::GainFlip => (2e-3, 5e-2),
            Self::Interference => (1e-8, 1e-7),
            Self::DeadTime => (1e-4, 1e-3),
            Self::Knocks => (1.0, 30.0),
            Self::NoiseBursts => (1e-8, 1e-7),
            Self::Vibration => (0.3, 8.0),
            Self::StuckBit => (3e-8, 3e-7),
            Self::Brownout => (0.05, 0.5),
            Self::Catching => (5.0, 60.0),
            Self::Pump => (0.3, 15.0),
            Self::Play => (2e-8, 3e-7),
            Self::Warming => (2e-3, 3e-2),
            Self::CoarseDrive => (0.1, 2.0),
            Self::Brake => (2.0, 60.0),
            Self::FluidDrag => (3e-3, 1.0),
            Self::EndStop => (5e6, 5e7),
            Self::SupplySag => (2e-3, 5e-2),
            Self::DeadBand => (0.02, 1.0),
            Self::SelfHeating => (1e-7, 2e-6),
            Self::HighPass => (0.02, 0.5),
            Self::SlewLimit => (5.0, 500.0),
            Self::Tilt => (1e-8, 3e-7),
            Self::Jitter => (1e-6, 3e-5),
            Self::DriveBend => (0.1, 3.0),
            Self::DriveTail => (1e-3, 3e-2),
        };
        (rng.random_range(low.ln()..high.ln())).exp()
    }
}
