//! One tick of the controller as the host sees it: SI-like units, 64-bit tick.

/// Number of axes of the board.
pub const AXES: usize = 3;

/// Everything the board says about one tick.
///
/// The tick is the sample's own time: arrival time over USB never enters a plot or a file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Sample number since the board started.
    pub tick: u64,
    /// Setpoint per axis, micrometres.
    pub reference_um: [f32; AXES],
    /// Strain-gauge position per axis, micrometres, sampled at the tick.
    pub position_um: [f32; AXES],
    /// Voltage commanded at the amplifier output per axis, held from this tick to the next.
    pub drive_v: [f32; AXES],
    /// Measured amplifier output per axis, volts, sampled at the tick.
    pub monitor_v: [f32; AXES],
    /// Status and fault bits of the controller.
    pub flags: u32,
    /// Time the control interrupt took, microseconds.
    pub tick_time_us: f32,
}

/// A traced quantity of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Setpoint, micrometres.
    Reference,
    /// Measured position, micrometres.
    Position,
    /// Reference minus position, micrometres.
    Error,
    /// Commanded voltage.
    Drive,
    /// Measured amplifier output, volts.
    Monitor,
}

impl Channel {
    /// Every channel, in the order in which panels list them.
    pub const ALL: [Channel; 5] =
        [Channel::Reference, Channel::Position, Channel::Error, Channel::Drive, Channel::Monitor];

    /// Name for legends.
    pub fn name(self) -> &'static str {
        match self {
            Channel::Reference => "reference",
            Channel::Position => "position",
            Channel::Error => "error",
            Channel::Drive => "drive",
            Channel::Monitor => "monitor",
        }
    }

    /// Unit of [`Channel::of`].
    pub fn unit(self) -> &'static str {
        match self {
            Channel::Drive | Channel::Monitor => "V",
            _ => "um",
        }
    }

    /// The value of this channel in a sample.
    pub fn of(self, sample: &Sample, axis: usize) -> f32 {
        match self {
            Channel::Reference => sample.reference_um[axis],
            Channel::Position => sample.position_um[axis],
            Channel::Error => sample.reference_um[axis] - sample.position_um[axis],
            Channel::Drive => sample.drive_v[axis],
            Channel::Monitor => sample.monitor_v[axis],
        }
    }
}
