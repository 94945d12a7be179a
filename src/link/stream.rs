//! Samples on the wire: which quantities of each tick travel, and in how many bits.
//!
//! A stream frame holds consecutive ticks only. Its payload is
//!
//! | offset | bytes | field |
//! | --- | --- | --- |
//! | 0 | 8 | tick of the first sample |
//! | 8 | 4 | samples dropped before that one, since the stream was started |
//! | 12 | 1 | number of samples |
//! | 13 | 1 | [`Profile`] |
//! | 14 | 2 | [`Fields`] mask |
//! | 16 | … | samples, each [`sample_bytes`] long, the fields in the order of their bits, axis 1 to 3 in each |
//!
//! The host proves that nothing was lost: each frame starts at the tick after the last one of the frame before, and the drop
//! counter says how many ticks a gap must have. Both are independent of the frame's sequence number, which counts frames.

use super::frame::{self, FrameError, HEADER, Kind, TRAILER};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Axes in a sample.
pub const AXES: usize = 3;
/// Bytes of the stream payload before the first sample.
pub const STREAM_HEADER: usize = 16;

/// Everything that can be streamed of one tick. Fixed point as in the core: displacement Q7.24 um, voltage Q9.22 V.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sample {
    /// Tick number. On the wire only the first of a frame.
    pub tick: u64,
    /// Setpoint, Q7.24 um.
    pub reference: [i32; AXES],
    /// Measured position, Q7.24 um.
    pub position: [i32; AXES],
    /// Voltage commanded at the amplifier output from this tick to the next, Q9.22 V.
    pub drive: [i32; AXES],
    /// Amplifier output measured at the tick, Q9.22 V.
    pub monitor: [i32; AXES],
    /// Controller state and faults, as the core packs them (contract: `flags`).
    pub flags: u32,
    /// Cycles of the core clock that the tick took.
    pub cycles: u16,
    /// Gauge converter codes, 16 bit (sum of 64 conversions / 4).
    pub gauge_code: [u16; AXES],
    /// Output converter codes, 12 bit, written for the next tick.
    pub dac_code: [u16; AXES],
}

/// Which quantities of a sample are streamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Fields(pub u16);

impl Fields {
    /// [`Sample::reference`].
    pub const REFERENCE: Self = Self(1 << 0);
    /// [`Sample::position`].
    pub const POSITION: Self = Self(1 << 1);
    /// [`Sample::drive`].
    pub const DRIVE: Self = Self(1 << 2);
    /// [`Sample::monitor`].
    pub const MONITOR: Self = Self(1 << 3);
    /// [`Sample::flags`].
    pub const FLAGS: Self = Self(1 << 4);
    /// [`Sample::cycles`].
    pub const CYCLES: Self = Self(1 << 5);
    /// [`Sample::gauge_code`].
    pub const GAUGE_CODE: Self = Self(1 << 6);
    /// [`Sample::dac_code`].
    pub const DAC_CODE: Self = Self(1 << 7);
    /// All of them.
    pub const ALL: Self = Self(0xff);
    /// What a recording needs: reference, position, drive, monitor, flags.
    pub const RECORDING: Self = Self(0x1f);

    /// Whether all of `other` is in this mask.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The union of two masks.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether the mask names at least one field and none that does not exist.
    pub const fn is_valid(self) -> bool {
        self.0 != 0 && self.0 & !Self::ALL.0 == 0
    }
}

/// In how many bits displacements and voltages travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub enum Profile {
    /// As the core computes them, 32 bits: bit-exact, 54 bytes a tick with [`Fields::RECORDING`] and the cycles.
    Exact = 0,
    /// 16 bits, 28 bytes a tick with [`Fields::RECORDING`]: displacement to 2^-10 um (0.98 nm, range ±32 um), voltage to 2^-8 V
    /// (3.9 mV, range -32..224 V). Rounded to nearest, saturated.
    Packed = 1,
}

impl Profile {
    /// The profile of a wire byte.
    pub const fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            0 => Some(Self::Exact),
            1 => Some(Self::Packed),
            _ => None,
        }
    }
}

/// Bits dropped from Q7.24 um in the packed profile.
const PACKED_DISPLACEMENT_SHIFT: u32 = 14;
/// Bits dropped from Q9.22 V in the packed profile.
const PACKED_VOLTAGE_SHIFT: u32 = 14;
/// Voltage of packed code 0, Q9.22 V: -32 V.
const PACKED_VOLTAGE_ORIGIN: i32 = -(32 << 22);

/// Rounds to nearest, ties up, without overflow.
const fn shift_rounded(value: i32, shift: u32) -> i32 {
    (value >> shift) + ((value >> (shift - 1)) & 1)
}

fn pack_displacement(value: i32) -> u16 {
    let code = shift_rounded(value, PACKED_DISPLACEMENT_SHIFT);
    code.clamp(i16::MIN.into(), i16::MAX.into()) as i16 as u16
}

fn unpack_displacement(code: u16) -> i32 {
    i32::from(code as i16) << PACKED_DISPLACEMENT_SHIFT
}

fn pack_voltage(value: i32) -> u16 {
    let code = shift_rounded(value.saturating_sub(PACKED_VOLTAGE_ORIGIN), PACKED_VOLTAGE_SHIFT);
    code.clamp(0, u16::MAX.into()) as u16
}

fn unpack_voltage(code: u16) -> i32 {
    (i32::from(code) << PACKED_VOLTAGE_SHIFT) + PACKED_VOLTAGE_ORIGIN
}

/// Bytes of one sample on the wire.
pub const fn sample_bytes(fields: Fields, profile: Profile) -> usize {
    let wide = match profile {
        Profile::Exact => 4,
        Profile::Packed => 2,
    };
    let analogue = (fields.0 & 0x0f).count_ones() as usize * wide * AXES;
    let flags = if fields.contains(Fields::FLAGS) { 4 } else { 0 };
    let cycles = if fields.contains(Fields::CYCLES) { 2 } else { 0 };
    let codes = ((fields.0 >> 6) & 3).count_ones() as usize * 2 * AXES;
    analogue + flags + cycles + codes
}

/// Writes samples into frames.
///
/// ```
/// use flexstage::link::{Fields, Profile, Sample, StreamFrame, StreamWriter, frame};
/// let mut buffer = [0; 512];
/// let mut writer = StreamWriter::new(&mut buffer, Fields::RECORDING, Profile::Exact);
/// writer.push(&Sample { tick: 41, ..Sample::default() });
/// writer.push(&Sample { tick: 42, ..Sample::default() });
/// let length = writer.finish(0, 0).unwrap();
/// let stream = StreamFrame::parse(&frame::decode(&buffer[..length]).unwrap()).unwrap();
/// assert_eq!(stream.samples().map(|s| s.tick).collect::<Vec<_>>(), [41, 42]);
/// ```
pub struct StreamWriter<'a> {
    buffer: &'a mut [u8],
    at: usize,
    fields: Fields,
    profile: Profile,
    first_tick: u64,
    count: u8,
}

impl<'a> StreamWriter<'a> {
    /// A writer of one frame into `buffer`.
    pub fn new(buffer: &'a mut [u8], fields: Fields, profile: Profile) -> Self {
        Self { buffer, at: HEADER + STREAM_HEADER, fields, profile, first_tick: 0, count: 0 }
    }

    /// Number of samples in the frame.
    pub fn count(&self) -> u8 {
        self.count
    }

    /// Adds a sample. `false`, and nothing changed, if the frame is full or the sample is not the next tick.
    pub fn push(&mut self, sample: &Sample) -> bool {
        let size = sample_bytes(self.fields, self.profile);
        let is_next =
            self.count == 0 || sample.tick == self.first_tick.wrapping_add(self.count.into());
        let has_room = self.at + size + TRAILER <= self.buffer.len()
            && self.at + size - HEADER <= frame::MAX_PAYLOAD
            && self.count < u8::MAX;
        if !(is_next && has_room && size > 0) {
            return false;
        }
        if self.count == 0 {
            self.first_tick = sample.tick;
        }
        self.count += 1;
        self.write(sample, size);
        true
    }

    /// Into a place of [`sample_bytes`], which [`StreamWriter::push`] has found room for.
    fn write(&mut self, sample: &Sample, size: usize) {
        let Some(place) = self.buffer.get_mut(self.at..self.at + size) else { return };
        self.at += size;
        let mut rest = place;
        let has = |field| self.fields.contains(field);
        for (field, values, is_voltage) in [
            (Fields::REFERENCE, &sample.reference, false),
            (Fields::POSITION, &sample.position, false),
            (Fields::DRIVE, &sample.drive, true),
            (Fields::MONITOR, &sample.monitor, true),
        ] {
            if has(field) {
                rest = match (self.profile, is_voltage) {
                    (Profile::Exact, _) => put(rest, values.map(i32::to_le_bytes)),
                    (Profile::Packed, false) => {
                        put(rest, values.map(|v| pack_displacement(v).to_le_bytes()))
                    }
                    (Profile::Packed, true) => {
                        put(rest, values.map(|v| pack_voltage(v).to_le_bytes()))
                    }
                };
            }
        }
        if has(Fields::FLAGS) {
            rest = put(rest, [sample.flags.to_le_bytes()]);
        }
        if has(Fields::CYCLES) {
            rest = put(rest, [sample.cycles.to_le_bytes()]);
        }
        if has(Fields::GAUGE_CODE) {
            rest = put(rest, sample.gauge_code.map(u16::to_le_bytes));
        }
        if has(Fields::DAC_CODE) {
            put(rest, sample.dac_code.map(u16::to_le_bytes));
        }
    }

    /// Writes the headers and the CRC; returns the length of the frame.
    pub fn finish(self, sequence: u16, dropped: u32) -> Result<usize, FrameError> {
        let header = self
            .buffer
            .get_mut(HEADER..HEADER + STREAM_HEADER)
            .and_then(|h| h.first_chunk_mut::<STREAM_HEADER>())
            .ok_or(FrameError::TooLong)?;
        header[..8].copy_from_slice(&self.first_tick.to_le_bytes());
        header[8..12].copy_from_slice(&dropped.to_le_bytes());
        header[12] = self.count;
        header[13] = self.profile as u8;
        header[14..].copy_from_slice(&self.fields.0.to_le_bytes());
        frame::seal(self.buffer, Kind::Stream, sequence, self.at - HEADER)
    }
}

/// Writes values to the front of a place; what is left of it.
fn put<const N: usize, const M: usize>(place: &mut [u8], values: [[u8; N]; M]) -> &mut [u8] {
    match place.split_at_mut_checked(N * M) {
        Some((front, rest)) => {
            front.copy_from_slice(values.as_flattened());
            rest
        }
        None => &mut [],
    }
}

/// Why the payload of a good frame is no stream of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamError {
    /// The frame is of another kind, version or schema.
    NotAStream,
    /// A profile or field that this version does not know.
    Unknown,
    /// The payload is not as long as its header says.
    Length,
}

impl core::fmt::Display for StreamError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotAStream => "not a stream frame of this version and schema",
            Self::Unknown => "a stream profile or field that this version does not know",
            Self::Length => "the stream frame is not as long as its header says",
        })
    }
}
impl core::error::Error for StreamError {}

/// The samples of one frame.
#[derive(Clone, Copy, Debug)]
pub struct StreamFrame<'a> {
    /// Tick of the first sample.
    pub first_tick: u64,
    /// Samples dropped by the device before the first sample, since the stream was started.
    pub dropped: u32,
    /// Number of samples.
    pub count: u8,
    /// How they are packed.
    pub profile: Profile,
    /// Which quantities they have; the others read as zero.
    pub fields: Fields,
    data: &'a [u8],
}

impl<'a> StreamFrame<'a> {
    /// Reads the payload of a stream frame.
    pub fn parse(frame: &Frame<'a>) -> Result<Self, StreamError> {
        if frame.kind != Kind::Stream || !frame.is_same_schema() {
            return Err(StreamError::NotAStream);
        }
        let (header, data) =
            frame.payload.split_first_chunk::<STREAM_HEADER>().ok_or(StreamError::Length)?;
        let [t0, t1, t2, t3, t4, t5, t6, t7, d0, d1, d2, d3, count, profile, f0, f1] = *header;
        let fields = Fields(u16::from_le_bytes([f0, f1]));
        let profile = Profile::from_byte(profile).ok_or(StreamError::Unknown)?;
        if !fields.is_valid() {
            return Err(StreamError::Unknown);
        }
        if data.len() != usize::from(count) * sample_bytes(fields, profile) {
            return Err(StreamError::Length);
        }
        Ok(Self {
            first_tick: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            dropped: u32::from_le_bytes([d0, d1, d2, d3]),
            count,
            profile,
            fields,
            data,
        })
    }

    /// The samples, in order of their ticks.
    pub fn samples(&self) -> impl Iterator<Item = Sample> + 'a {
        let Self { first_tick, profile, fields, data, .. } = *self;
        let size = sample_bytes(fields, profile).max(1);
        data.chunks_exact(size).zip(0u64..).map(move |(bytes, i)| {
            let mut sample = read_sample(bytes, fields, profile);
            sample.tick = first_tick.wrapping_add(i);
            sample
        })
    }
}

use super::frame::Frame;

fn read_sample(bytes: &[u8], fields: Fields, profile: Profile) -> Sample {
    let mut sample = Sample::default();
    let mut rest = bytes;
    let has = |field| fields.contains(field);
    for (field, values, is_voltage) in [
        (Fields::REFERENCE, &mut sample.reference, false),
        (Fields::POSITION, &mut sample.position, false),
        (Fields::DRIVE, &mut sample.drive, true),
        (Fields::MONITOR, &mut sample.monitor, true),
    ] {
        if has(field) {
            for value in values {
                *value = match (profile, is_voltage) {
                    (Profile::Exact, _) => i32::from_le_bytes(take(&mut rest)),
                    (Profile::Packed, false) => unpack_displacement(take_u16(&mut rest)),
                    (Profile::Packed, true) => unpack_voltage(take_u16(&mut rest)),
                };
            }
        }
    }
    if has(Fields::FLAGS) {
        sample.flags = u32::from_le_bytes(take(&mut rest));
    }
    if has(Fields::CYCLES) {
        sample.cycles = take_u16(&mut rest);
    }
    if has(Fields::GAUGE_CODE) {
        sample.gauge_code = core::array::from_fn(|_| take_u16(&mut rest));
    }
    if has(Fields::DAC_CODE) {
        sample.dac_code = core::array::from_fn(|_| take_u16(&mut rest));
    }
    sample
}

fn take_u16(rest: &mut &[u8]) -> u16 {
    u16::from_le_bytes(take(rest))
}

/// The next `N` bytes; zeros where there are none, which [`StreamFrame::parse`] has excluded.
fn take<const N: usize>(rest: &mut &[u8]) -> [u8; N] {
    match rest.split_first_chunk::<N>() {
        Some((head, tail)) => {
            *rest = tail;
            *head
        }
        None => [0; N],
    }
}

#[cfg(test)]
mod tests;
