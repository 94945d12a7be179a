//! Framing: header, payload, CRC-32, and the way back from a byte stream.
//!
//! | offset | bytes | field |
//! | --- | --- | --- |
//! | 0 | 2 | magic, `46 53` ("FS") |
//! | 2 | 1 | [`VERSION`] |
//! | 3 | 1 | [`Kind`] |
//! | 4 | 4 | [schema hash](super::message::SCHEMA_HASH) |
//! | 8 | 2 | payload length |
//! | 10 | 2 | sequence number: of the request in commands and replies, running in stream frames |
//! | 12 | n | payload |
//! | 12+n | 4 | CRC-32 (ISO-HDLC) of all before |
//!
//! Integers are little-endian. USB already repeats damaged packets; the CRC catches what it does not: a buffer
//! overwritten in memory, a file cut short, a socket joined in the middle.

use super::VERSION;
use super::message::SCHEMA_HASH;
use crc::{CRC_32_ISO_HDLC, Crc};

/// Largest frame in bytes, header and CRC included. Both sides hold one such buffer.
pub const MAX_FRAME: usize = 2048;
/// Bytes before the payload.
pub const HEADER: usize = 12;
/// Bytes after the payload.
pub const TRAILER: usize = 4;
/// Largest payload in bytes.
pub const MAX_PAYLOAD: usize = MAX_FRAME - HEADER - TRAILER;
const MAGIC: [u8; 2] = *b"FS";

static CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// CRC-32 (ISO-HDLC), the one that frames and the stored configuration carry.
pub fn crc32(bytes: &[u8]) -> u32 {
    CRC32.checksum(bytes)
}

/// The same over bytes that come in pieces.
pub struct Checksum(crc::Digest<'static, u32>);

impl Checksum {
    /// Of nothing yet.
    pub fn new() -> Self {
        Self(CRC32.digest())
    }

    /// Takes in more bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The sum.
    pub fn finish(self) -> u32 {
        self.0.finalize()
    }
}

impl Default for Checksum {
    fn default() -> Self {
        Self::new()
    }
}

/// What a frame carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Samples of consecutive ticks ([`super::stream`]), device to host.
    Stream = 1,
    /// Answer to the command of the same sequence number ([`super::message::Reply`]), device to host.
    Reply = 2,
    /// Who the device is ([`super::identity`]), device to host; also the answer to any frame of another version or schema.
    Identity = 3,
    /// A command ([`super::message::Command`]), host to device.
    Command = 16,
    /// Asks for [`Kind::Identity`]; empty payload, understood whatever the version and schema of the sender.
    Identify = 17,
}

impl Kind {
    fn from_byte(byte: u8) -> Option<Self> {
        [Self::Stream, Self::Reply, Self::Identity, Self::Command, Self::Identify]
            .into_iter()
            .find(|kind| *kind as u8 == byte)
    }
}

/// Why bytes are not a frame, or a frame not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The payload does not fit [`MAX_PAYLOAD`] or the output buffer.
    TooLong,
    /// The checksum does not match.
    Checksum,
    /// A kind this version does not know.
    Kind,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooLong => "the payload is longer than a frame may be",
            Self::Checksum => "the CRC-32 of the frame does not match its bytes",
            Self::Kind => "the frame is of a kind this version does not know",
        })
    }
}
impl core::error::Error for FrameError {}

/// A frame whose checksum matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Header version of the sender; anything but [`VERSION`] means that only `kind` and `sequence` may be trusted.
    pub version: u8,
    /// What the payload is.
    pub kind: Kind,
    /// Schema hash of the sender: messages may be decoded only if it equals [`SCHEMA_HASH`].
    pub schema: u32,
    /// Sequence number.
    pub sequence: u16,
    /// Payload bytes.
    pub payload: &'a [u8],
}

impl Frame<'_> {
    /// Whether the sender was built from the same definitions, so that the payload may be decoded.
    pub fn is_same_schema(&self) -> bool {
        self.version == VERSION && self.schema == SCHEMA_HASH
    }
}

/// Writes header and CRC around a payload of `payload_len` bytes that already stands at `buffer[HEADER..]`; returns the
/// length of the frame. Used by encoders that write their payload in place.
pub fn seal(
    buffer: &mut [u8],
    kind: Kind,
    sequence: u16,
    payload_len: usize,
) -> Result<usize, FrameError> {
    let end = HEADER + payload_len;
    if payload_len > MAX_PAYLOAD {
        return Err(FrameError::TooLong);
    }
    let frame = buffer.get_mut(..end + TRAILER).ok_or(FrameError::TooLong)?;
    let (body, trailer) = frame.split_at_mut(end);
    let header = body.first_chunk_mut::<HEADER>().ok_or(FrameError::TooLong)?;
    let schema = SCHEMA_HASH.to_le_bytes();
    let length = (payload_len as u16).to_le_bytes();
    let sequence = sequence.to_le_bytes();
    *header = [
        MAGIC[0],
        MAGIC[1],
        VERSION,
        kind as u8,
        schema[0],
        schema[1],
        schema[2],
        schema[3],
        length[0],
        length[1],
        sequence[0],
        sequence[1],
    ];
    trailer.copy_from_slice(&crc32(body).to_le_bytes());
    Ok(end + TRAILER)
}

/// Encodes one frame into `buffer` and returns it.
///
/// ```
/// use flexstage::link::{Kind, MAX_FRAME, encode};
/// let mut buffer = [0; MAX_FRAME];
/// let frame = encode(&mut buffer, Kind::Identify, 7, &[]).unwrap();
/// assert_eq!(frame.len(), 16);
/// ```
pub fn encode<'a>(
    buffer: &'a mut [u8],
    kind: Kind,
    sequence: u16,
    payload: &[u8],
) -> Result<&'a [u8], FrameError> {
    let place = buffer.get_mut(HEADER..HEADER + payload.len()).ok_or(FrameError::TooLong)?;
    place.copy_from_slice(payload);
    let length = seal(buffer, kind, sequence, payload.len())?;
    buffer.get(..length).ok_or(FrameError::TooLong)
}

/// What [`parse`] found at the start of some bytes.
enum Parsed<'a> {
    /// A whole frame and its length.
    Frame(Frame<'a>, usize),
    /// The start of what may be a frame.
    More,
    /// No frame starts here.
    Not(FrameError),
}

/// Reads the header of a frame that is all there, without checking it; and the bytes that its CRC covers.
fn header(bytes: &[u8]) -> Option<(Frame<'_>, &[u8])> {
    let [_, _, version, kind, s0, s1, s2, s3, l0, l1, q0, q1] = *bytes.first_chunk::<HEADER>()?;
    let length = usize::from(u16::from_le_bytes([l0, l1]));
    let body = bytes.get(..HEADER + length)?;
    let frame = Frame {
        version,
        kind: Kind::from_byte(kind)?,
        schema: u32::from_le_bytes([s0, s1, s2, s3]),
        sequence: u16::from_le_bytes([q0, q1]),
        payload: body.get(HEADER..)?,
    };
    Some((frame, body))
}

/// Not inlined: it is in the board's flash once.
#[inline(never)]
fn parse(bytes: &[u8]) -> Parsed<'_> {
    if MAGIC.iter().zip(bytes).any(|(expected, found)| expected != found) {
        return Parsed::Not(FrameError::Kind);
    }
    let Some(&[_, _, _, kind, _, _, _, _, l0, l1, _, _]) = bytes.first_chunk::<HEADER>() else {
        return Parsed::More;
    };
    if Kind::from_byte(kind).is_none() {
        return Parsed::Not(FrameError::Kind);
    }
    let length = HEADER + usize::from(u16::from_le_bytes([l0, l1])) + TRAILER;
    if length > MAX_FRAME {
        return Parsed::Not(FrameError::TooLong);
    }
    let Some((frame, body)) = header(bytes) else { return Parsed::More };
    let Some(trailer) = bytes.get(body.len()..).and_then(|rest| rest.first_chunk::<TRAILER>())
    else {
        return Parsed::More;
    };
    if crc32(body) == u32::from_le_bytes(*trailer) {
        Parsed::Frame(frame, length)
    } else {
        Parsed::Not(FrameError::Checksum)
    }
}

/// Decodes exactly one frame that fills `bytes`.
pub fn decode(bytes: &[u8]) -> Result<Frame<'_>, FrameError> {
    match parse(bytes) {
        Parsed::Frame(frame, length) if length == bytes.len() => Ok(frame),
        Parsed::Frame(..) | Parsed::More => Err(FrameError::TooLong),
        Parsed::Not(error) => Err(error),
    }
}

/// Finds frames in a byte stream that arrives in pieces of any size, and counts what was not one.
///
/// After damage it goes on at the next byte that can start a frame, so one bad frame never hides the good one behind it.
#[derive(Clone, Debug)]
pub struct Deframer {
    buffer: [u8; MAX_FRAME],
    /// Bytes before this are done with.
    start: usize,
    /// Bytes from here on are free.
    end: usize,
    /// Whether the current run of garbage was already counted as one malformed piece.
    in_garbage: bool,
    /// Good frames so far.
    pub frames: u32,
    /// Malformed pieces so far: runs of bytes that are no frame, and frames whose checksum failed.
    pub malformed: u32,
    /// Bytes that belonged to no good frame.
    pub skipped_bytes: u32,
}

impl Default for Deframer {
    fn default() -> Self {
        Self::new()
    }
}

impl Deframer {
    /// An empty deframer.
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            start: 0,
            end: 0,
            in_garbage: false,
            frames: 0,
            malformed: 0,
            skipped_bytes: 0,
        }
    }

    /// Takes in `bytes` and calls `on_frame` for every frame that they complete.
    pub fn push(&mut self, mut bytes: &[u8], mut on_frame: impl FnMut(Frame<'_>)) {
        while !bytes.is_empty() {
            let taken = self.feed(bytes);
            bytes = bytes.get(taken..).unwrap_or_default();
            while let Some(frame) = self.next_frame() {
                on_frame(frame);
            }
        }
    }

    /// Takes in as many of `bytes` as there is room for, and returns how many. There is room for at least one once
    /// [`Deframer::next_frame`] has returned `None`.
    pub fn feed(&mut self, bytes: &[u8]) -> usize {
        self.buffer.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        let free = self.buffer.get_mut(self.end..).unwrap_or_default();
        let taken = free.len().min(bytes.len());
        for (to, from) in free.iter_mut().zip(bytes) {
            *to = *from;
        }
        self.end += taken;
        taken
    }

    /// The next whole frame, if the bytes taken in so far hold one.
    pub fn next_frame(&mut self) -> Option<Frame<'_>> {
        let found = loop {
            let held = self.buffer.get(self.start..self.end).unwrap_or_default();
            match parse(held) {
                Parsed::Frame(_, length) => break self.start..self.start + length,
                Parsed::More => return None,
                Parsed::Not(error) => {
                    if error == FrameError::Checksum || !self.in_garbage {
                        self.malformed = self.malformed.saturating_add(1);
                    }
                    self.in_garbage = true;
                    self.skipped_bytes = self.skipped_bytes.saturating_add(1);
                    self.start += 1;
                }
            }
        };
        self.frames = self.frames.saturating_add(1);
        self.in_garbage = false;
        self.start = found.end;
        header(self.buffer.get(found)?).map(|(frame, _)| frame)
    }

    /// Forgets an incomplete frame: the transfer that should have held it is over. Counts it as malformed if there was one.
    pub fn end_of_transfer(&mut self) {
        let left = self.end - self.start;
        if left > 0 {
            self.malformed = self.malformed.saturating_add(1);
            self.skipped_bytes = self.skipped_bytes.saturating_add(left as u32);
        }
        (self.start, self.end) = (0, 0);
        self.in_garbage = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn frame(kind: Kind, sequence: u16, payload: &[u8]) -> Vec<u8> {
        let mut buffer = [0; MAX_FRAME];
        encode(&mut buffer, kind, sequence, payload).unwrap().to_vec()
    }

    fn collect(deframer: &mut Deframer, bytes: &[u8]) -> Vec<(u16, Vec<u8>)> {
        let mut found = Vec::new();
        deframer.push(bytes, |f| found.push((f.sequence, f.payload.to_vec())));
        found
    }

    #[test]
    fn the_longest_payload_fits_and_one_more_is_refused() {
        let payload = [0x46; MAX_PAYLOAD];
        let bytes = frame(Kind::Command, 1, &payload);
        assert_eq!(bytes.len(), MAX_FRAME);
        assert_eq!(decode(&bytes).unwrap().payload, payload);
        let mut buffer = [0; MAX_FRAME + 64];
        let too_long = [0; MAX_PAYLOAD + 1];
        assert_eq!(encode(&mut buffer, Kind::Command, 1, &too_long), Err(FrameError::TooLong));
    }

    #[test]
    fn a_truncated_frame_ends_with_its_transfer() {
        let mut deframer = Deframer::new();
        let cut = frame(Kind::Command, 1, &[1; 100]);
        assert!(collect(&mut deframer, &cut[..70]).is_empty());
        deframer.end_of_transfer();
        assert_eq!(collect(&mut deframer, &frame(Kind::Command, 2, &[5])), [(2, vec![5])]);
        assert_eq!((deframer.malformed, deframer.frames), (1, 1));
    }

    proptest! {
        #[test]
        fn frames_survive_any_cut_into_pieces(
            payloads in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 1..12),
            piece in 1usize..200,
        ) {
            let mut stream = Vec::new();
            for (i, payload) in payloads.iter().enumerate() {
                stream.extend(frame(Kind::Reply, i as u16, payload));
            }
            let mut deframer = Deframer::new();
            let mut found = Vec::new();
            for part in stream.chunks(piece) {
                found.extend(collect(&mut deframer, part));
            }
            let expected: Vec<_> =
                payloads.into_iter().enumerate().map(|(i, p)| (i as u16, p)).collect();
            prop_assert_eq!(found, expected);
            prop_assert_eq!(deframer.malformed, 0);
        }

        #[test]
        fn garbage_never_panics_and_never_hides_the_next_frames(
            garbage in prop::collection::vec(any::<u8>(), 0..3000),
            piece in 1usize..200,
        ) {
            let mut deframer = Deframer::new();
            for part in garbage.chunks(piece) {
                prop_assert!(collect(&mut deframer, part).is_empty());
            }
            deframer.end_of_transfer();
            prop_assert_eq!(deframer.skipped_bytes as usize, garbage.len());
            let good = frame(Kind::Command, 9, b"go");
            prop_assert_eq!(collect(&mut deframer, &good), vec![(9, b"go".to_vec())]);
        }

        #[test]
        fn a_flipped_bit_is_always_found(
            payload in prop::collection::vec(any::<u8>(), 0..200),
            position in any::<prop::sample::Index>(),
            bit in 0u8..8,
        ) {
            let mut bytes = frame(Kind::Command, 3, &payload);
            let at = position.index(bytes.len());
            bytes[at] ^= 1 << bit;
            let mut deframer = Deframer::new();
            prop_assert!(collect(&mut deframer, &bytes).is_empty());
        }

        #[test]
        fn a_good_frame_after_a_broken_one_is_found_without_an_end_of_transfer(
            payload in prop::collection::vec(any::<u8>(), 1..200),
            cut in any::<prop::sample::Index>(),
        ) {
            let broken = frame(Kind::Command, 1, &payload);
            let keep = 1 + cut.index(broken.len() - 1);
            let mut stream = broken[..keep].to_vec();
            for i in 0..80 {
                stream.extend(frame(Kind::Command, 100 + i, b"later"));
            }
            let mut deframer = Deframer::new();
            let found = collect(&mut deframer, &stream);
            let later = |sequence: u16| found.iter().any(|(s, p)| *s == sequence && p == b"later");
            // Where the next frame happens to begin with the bytes that were cut off, the broken one is whole and takes them.
            let completed = found.iter().any(|(s, p)| *s == 1 && *p == payload);
            prop_assert!(later(100) || (completed && later(101)));
        }
    }
}
