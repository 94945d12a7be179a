//! The host's end of the link, for tests and for the emulator's own console: frames out of bulk transfers, replies by
//! sequence number, and a stream that proves whether anything was lost.

use std::collections::HashMap;

use flexstage::link::message::{self, Command, Reply};
use flexstage::link::{Deframer, Frame, Identity, Kind, MAX_FRAME, Sample, StreamFrame, encode};

/// What came through the stream since it was last cleared.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Frames.
    pub frames: u64,
    /// Samples.
    pub samples: u64,
    /// First tick.
    pub first_tick: Option<u64>,
    /// The tick after the last sample.
    pub next_tick: u64,
    /// Ticks between frames that never came.
    pub missing: u64,
    /// Of those, ticks that the board has not counted as dropped by the frame after the gap: lost on the way.
    pub lost_in_transit: u64,
    /// The board's own count of dropped samples, newest.
    pub dropped: u32,
    /// Its count in the first frame.
    pub dropped_at_start: u32,
    /// Frames whose samples do not parse, or that overlap the one before.
    pub bad: u64,
    /// Bytes of stream frames.
    pub bytes: u64,
}

/// Decodes what a device sends.
#[derive(Default)]
pub struct Link {
    deframer: Deframer,
    sequence: u16,
    replies: HashMap<u16, Reply>,
    /// Newest identity.
    pub identity: Option<Identity>,
    /// Stream so far.
    pub tally: Tally,
    /// Samples so far, while somebody wants them.
    pub samples: Option<Vec<Sample>>,
    /// Samples of the newest frame.
    pub newest: Option<Sample>,
    /// Replies that could not be decoded.
    pub undecodable: u64,
    /// Every status word's faults seen, or'ed, and the tick of the first.
    pub first_fault: Option<(u64, u32)>,
}

impl Link {
    /// A frame for a command, and the sequence number of its reply.
    pub fn command(&mut self, command: &Command) -> (u16, Vec<u8>) {
        self.sequence = self.sequence.wrapping_add(1);
        // An answer to something else that had this number is not the one to come.
        self.replies.remove(&self.sequence);
        let mut buffer = [0; MAX_FRAME];
        // MAX_FRAME holds the longest command.
        let bytes =
            message::encode_command(&mut buffer, self.sequence, command).unwrap_or_default();
        (self.sequence, bytes.to_vec())
    }

    /// A frame that asks who the device is.
    pub fn identify(&mut self) -> Vec<u8> {
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        encode(&mut buffer, Kind::Identify, self.sequence, &[]).unwrap_or_default().to_vec()
    }

    /// Takes one finished bulk IN transfer.
    pub fn transfer(&mut self, bytes: &[u8]) {
        let Link {
            deframer,
            replies,
            identity,
            tally,
            samples,
            newest,
            undecodable,
            first_fault,
            ..
        } = self;
        deframer.push(bytes, |frame: Frame<'_>| match frame.kind {
            Kind::Stream => {
                tally.bytes += frame.payload.len() as u64 + 16;
                match StreamFrame::parse(&frame) {
                    Ok(stream) => take(&stream, tally, samples, newest, first_fault),
                    Err(_) => tally.bad += 1,
                }
            }
            Kind::Reply => match message::decode_reply(&frame) {
                Ok(reply) => {
                    replies.insert(frame.sequence, reply);
                }
                Err(_) => *undecodable += 1,
            },
            Kind::Identity => *identity = Identity::from_bytes(frame.payload),
            Kind::Command | Kind::Identify => *undecodable += 1,
        });
        if !bytes.len().is_multiple_of(64) {
            deframer.end_of_transfer();
        }
    }

    /// The reply to a command, once.
    pub fn reply(&mut self, sequence: u16) -> Option<Reply> {
        self.replies.remove(&sequence)
    }

    /// Malformed pieces of what the device sent.
    pub fn malformed(&self) -> u32 {
        self.deframer.malformed
    }

    /// Starts the tally over.
    pub fn clear(&mut self) {
        self.tally = Tally::default();
        self.first_fault = None;
    }
}

fn take(
    stream: &StreamFrame<'_>,
    tally: &mut Tally,
    samples: &mut Option<Vec<Sample>>,
    newest: &mut Option<Sample>,
    first_fault: &mut Option<(u64, u32)>,
) {
    tally.frames += 1;
    tally.samples += stream.count as u64;
    if tally.first_tick.is_none() {
        tally.first_tick = Some(stream.first_tick);
        tally.next_tick = stream.first_tick;
        tally.dropped_at_start = stream.dropped;
    }
    match stream.first_tick.checked_sub(tally.next_tick) {
        Some(gap) => {
            tally.missing += gap;
            let by_board = u64::from(stream.dropped.wrapping_sub(tally.dropped));
            if tally.frames > 1 {
                tally.lost_in_transit += gap.saturating_sub(by_board);
            }
        }
        None => tally.bad += 1,
    }
    tally.next_tick = stream.first_tick + stream.count as u64;
    tally.dropped = stream.dropped;
    for sample in stream.samples() {
        let faults = flexstage::Flags(sample.flags).faults().to_bits() as u32;
        if faults != 0 && first_fault.is_none() {
            *first_fault = Some((sample.tick, faults));
        }
        *newest = Some(sample);
        if let Some(all) = samples {
            all.push(sample);
        }
    }
}
