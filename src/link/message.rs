//! Commands and replies: what the host asks of the board, and what took effect.
//!
//! Encoded with [postcard], and hashed: [`SCHEMA_HASH`] changes with any change to any type below, or to the layout of samples.
//! Every command that arrives whole gets exactly one reply of the same sequence number: what took effect and at which tick, or
//! the reason why nothing did. A command is decoded and checked whole before anything of it acts.

use heapless::{String, Vec};
use postcard_schema::{Schema, key::Key};
use serde::{Deserialize, Serialize};

use super::frame::{self, Frame, FrameError, HEADER, Kind, TRAILER};
use super::stream::{Fields, Profile};
use crate::{GeneratorSettings, Settings};

mod refusal;
pub use refusal::{BadSetting, MessageError, Refusal};

/// What the messages and the layout of the samples are made of, in 32 bits. Any change of either changes it.
pub const SCHEMA_HASH: u32 = {
    let [a, b, c, d, e, f, g, h] =
        Key::for_path::<(Command, Reply)>("flexstage/samples/1").to_bytes();
    u32::from_le_bytes([a, b, c, d]) ^ u32::from_le_bytes([e, f, g, h])
};

/// Position of [`Reply::Settings`] among the replies, which is how postcard starts it.
const SETTINGS_VARIANT: u8 = 1;
/// Points of the arbitrary waveform in one [`Command::WriteTable`].
pub const TABLE_CHUNK: usize = 256;
/// Longest text of a [`Crash`].
pub const CRASH_TEXT: usize = 192;
/// Bytes of a [`Command::Disarm`] as it travels.
pub const DISARM_BYTES: usize = HEADER + 1 + TRAILER;
/// Bins of [`Counters::cycles_histogram`].
pub const HISTOGRAM_BINS: usize = 16;
/// Width of a histogram bin in core clock cycles; the last bin also counts everything longer.
pub const HISTOGRAM_BIN_CYCLES: u32 = 512;

/// What the host may ask for. Those that reach the controller (arming, motion, [`Command::KeepAlive`]) restart the command timeout;
/// reading state does not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[expect(
    clippy::large_enum_variant,
    reason = "no allocation on the board; one command exists at a time"
)]
pub enum Command {
    /// State of the controller: [`Reply::Status`].
    Status,
    /// Health of the loop and the link: [`Reply::Counters`].
    Counters,
    /// Why the last run ended, if it ended badly: [`Reply::Crash`]. Reading does not clear it.
    Crash,
    /// The settings in effect: [`Reply::Settings`].
    ReadSettings,
    /// Close the loop where the stage is.
    Arm,
    /// Open the loop and return softly to the parked voltage.
    Disarm,
    /// Bring the references to rest and hold them.
    Hold,
    /// Forget latched faults.
    ClearFaults,
    /// Nothing else.
    KeepAlive,
    /// Keep a waveform for an axis (from 0) until [`Command::Start`] or until the loop opens, which forgets it. Refused while the loop is open;
    /// not while it is being closed.
    Stage {
        /// Axis, from 0.
        axis: u8,
        /// The waveform.
        generator: GeneratorSettings,
    },
    /// Start the staged waveforms of these axes (bit 0 = axis 0) at the same tick.
    Start {
        /// One bit an axis.
        axes: u8,
    },
    /// Replace all settings: checked whole, then in effect from one tick to the next.
    SetSettings(Settings),
    /// Write part of the arbitrary waveform; it is flat until [`Command::UseTable`]. Refused while the loop is closed.
    WriteTable {
        /// Index of the first point.
        offset: u16,
        /// Points, -1 to 1.
        points: Vec<f32, TABLE_CHUNK>,
    },
    /// Use the points written. Refused while the loop is closed.
    UseTable {
        /// Number of points.
        len: u16,
    },
    /// Stream these fields of every tick.
    StreamOn {
        /// Which.
        fields: Fields,
        /// In how many bits.
        profile: Profile,
    },
    /// Stop streaming.
    StreamOff,
    /// Start the stream, then at a later tick the waveform on this axis, so that the record holds all of it. A stream of the same fields and
    /// profile goes on. Refused while nothing can be started.
    Probe {
        /// Axis, from 0.
        axis: u8,
        /// Excitation; one with a duration ends by itself.
        generator: GeneratorSettings,
        /// Fields to stream.
        fields: Fields,
        /// In how many bits.
        profile: Profile,
    },
    /// Write the settings in effect to flash. Only while parked.
    Save,
    /// Restart. Only while parked.
    Reboot,
    /// Restart into the ROM's DFU loader. Only while parked.
    RebootToDfu,
}

/// What became of a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[expect(
    clippy::large_enum_variant,
    reason = "no allocation on the board; one reply exists at a time"
)]
pub enum Reply {
    /// It acts from this tick on.
    Done {
        /// Tick.
        tick: u32,
    },
    /// The settings in effect.
    Settings(Settings),
    /// New settings act from this tick on.
    Configured {
        /// Tick.
        tick: u32,
        /// [`Config::digest`](crate::Config::digest) of what was built from them.
        digest: u32,
    },
    /// Samples are streamed from this tick on; the first frame begins later only by what the board had to drop.
    Streaming {
        /// Tick.
        tick: u32,
        /// Fields in effect.
        fields: Fields,
        /// Profile in effect.
        profile: Profile,
        /// Bytes of a sample.
        sample_bytes: u8,
    },
    /// State.
    Status(Status),
    /// Counters.
    Counters(Counters),
    /// How the last run ended.
    Crash(Crash),
    /// The settings are in flash.
    Saved {
        /// Number of this save.
        version: u32,
        /// Slot, 0 or 1.
        slot: u8,
    },
    /// Nothing changed, for this reason.
    Refused(Refusal),
}

/// State of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Status {
    /// Tick of the flags.
    pub tick: u32,
    /// Status word ([`Flags`](crate::Flags)).
    pub flags: u32,
    /// [`Config::digest`](crate::Config::digest) of the configuration in effect.
    pub digest: u32,
    /// Whether the settings in effect are the ones in flash.
    pub is_stored: bool,
    /// The stream, if one is on.
    pub stream: Option<(Fields, Profile)>,
    /// Time since the restart, ms.
    pub uptime_ms: u32,
    /// Whether a crash report waits.
    pub has_crash: bool,
}

/// Health of the loop and the link since the restart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Counters {
    /// Ticks run.
    pub ticks: u32,
    /// Ticks missed, or not finished before the next.
    pub overruns: u32,
    /// Core clock cycles of the last tick, interrupt entry to exit.
    pub cycles_last: u32,
    /// Most cycles of any tick.
    pub cycles_max: u32,
    /// Ticks by cycles, [`HISTOGRAM_BIN_CYCLES`] a bin.
    pub cycles_histogram: [u32; HISTOGRAM_BINS],
    /// Samples dropped of the stream that is on, or of the last one if none is.
    pub dropped: u32,
    /// Stream frames sent.
    pub frames: u32,
    /// Commands taken.
    pub commands: u32,
    /// Commands refused.
    pub refused: u32,
    /// Malformed pieces of input.
    pub malformed: u32,
    /// USB resets and reconnections.
    pub usb_resets: u32,
    /// Double words of flash found damaged.
    pub flash_errors: u32,
    /// Bytes of the stack never used.
    pub stack_free: u32,
}

/// How the last run ended.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Crash {
    /// As in [`Identity::reset_flags`](super::Identity::reset_flags).
    pub reset_flags: u8,
    /// Panic message or fault registers; empty if the run ended without.
    pub message: String<CRASH_TEXT>,
}

fn encode_message<'a, T: Serialize>(
    buffer: &'a mut [u8],
    kind: Kind,
    sequence: u16,
    message: &T,
) -> Result<&'a [u8], FrameError> {
    let place = buffer.get_mut(HEADER..).ok_or(FrameError::TooLong)?;
    let length = postcard::to_slice(message, place).map_err(|_| FrameError::TooLong)?.len();
    let length = frame::seal(buffer, kind, sequence, length)?;
    buffer.get(..length).ok_or(FrameError::TooLong)
}

fn decode_message<'a, T: Deserialize<'a>>(
    frame: &Frame<'a>,
    kind: Kind,
) -> Result<T, MessageError> {
    if frame.kind != kind {
        return Err(MessageError::Kind);
    }
    if !frame.is_same_schema() {
        return Err(MessageError::Schema { found: frame.schema });
    }
    match postcard::take_from_bytes(frame.payload) {
        Ok((message, [])) => Ok(message),
        Ok(_) | Err(_) => Err(MessageError::Payload),
    }
}

/// Encodes a command into a frame.
///
/// # Errors
/// The buffer is too small; [`MAX_FRAME`](super::MAX_FRAME) bytes always suffice.
pub fn encode_command<'a>(
    buffer: &'a mut [u8],
    sequence: u16,
    command: &Command,
) -> Result<&'a [u8], FrameError> {
    encode_message(buffer, Kind::Command, sequence, command)
}

/// Encodes a reply into a frame.
///
/// # Errors
/// The buffer is too small; [`MAX_FRAME`](super::MAX_FRAME) bytes always suffice.
pub fn encode_reply<'a>(
    buffer: &'a mut [u8],
    sequence: u16,
    reply: &Reply,
) -> Result<&'a [u8], FrameError> {
    encode_message(buffer, Kind::Reply, sequence, reply)
}

/// Encodes [`Reply::Settings`] without a copy of the settings; the length of the frame, 0 if the buffer is too small.
pub fn encode_settings(buffer: &mut [u8], sequence: u16, settings: &Settings) -> usize {
    let mut encode = || {
        let (variant, rest) = buffer.get_mut(HEADER..)?.split_first_mut()?;
        *variant = SETTINGS_VARIANT;
        let length = 1 + postcard::to_slice(settings, rest).ok()?.len();
        frame::seal(buffer, Kind::Reply, sequence, length).ok()
    };
    encode().unwrap_or(0)
}

/// Decodes a command; nothing of it is used unless all of it decodes.
///
/// # Errors
/// Another kind, another schema, or damaged content.
pub fn decode_command(frame: &Frame<'_>) -> Result<Command, MessageError> {
    decode_message(frame, Kind::Command)
}

/// Whether a packet ends with a whole [`Command::Disarm`]: a device may act on it while it has other commands to finish, of this packet or
/// of earlier ones, and answer it when its turn comes. What comes last holds in the end, so it does no harm to obey it too early.
pub fn ends_with_disarm(packet: &[u8]) -> bool {
    /// Its number in the enumeration, which is all of its payload.
    const DISARM: u8 = 5;
    let frame = packet.last_chunk::<DISARM_BYTES>();
    frame.and_then(|frame| frame::decode(frame).ok()).is_some_and(|frame| {
        frame.kind == Kind::Command && frame.is_same_schema() && frame.payload == [DISARM]
    })
}

/// Decodes a reply.
///
/// # Errors
/// Another kind, another schema, or damaged content.
pub fn decode_reply(frame: &Frame<'_>) -> Result<Reply, MessageError> {
    decode_message(frame, Kind::Reply)
}

#[cfg(test)]
mod tests;
