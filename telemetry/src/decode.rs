//! From bulk transfers to samples, with proof of what was lost.
//!
//! Two independent counts must agree: the ticks missing between frames, and the growth of the board's own drop counter.
//! Where they do not, the loss happened on the way (`lost_in_transit`), which USB should make impossible.

use flexstage::link::stream::Sample as WireSample;
use flexstage::link::{Deframer, Frame, Kind, StreamFrame};
use serde::Serialize;

use crate::sample::Sample;

/// Displacement on the wire: I8F24 micrometres.
const UM_PER_BIT: f64 = 1.0 / (1u32 << 24) as f64;
/// Voltage on the wire: I10F22 volts.
const VOLT_PER_BIT: f64 = 1.0 / (1u32 << 22) as f64;

/// What arrived and what did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamStatistics {
    /// Samples received.
    pub samples: u64,
    /// Stream frames received.
    pub frames: u64,
    /// Ticks that are missing between the first and the last one received.
    pub lost_ticks: u64,
    /// Of those, ticks that the board says it dropped because the host did not fetch them in time.
    pub dropped_by_board: u64,
    /// Of those, ticks that vanished between board and host.
    pub lost_in_transit: u64,
    /// Pieces of data that were no good frame.
    pub malformed: u32,
    /// Bytes received.
    pub bytes: u64,
    /// Times the tick counter went back: the board restarted.
    pub restarts: u64,
}

/// What a transfer brought.
#[derive(Default)]
pub struct Received {
    /// Samples in order of their ticks.
    pub samples: Vec<Sample>,
    /// Other frames: kind, sequence number and whole frame to be decoded by the session.
    pub others: Vec<OwnedFrame>,
    /// The tick counter went back before these samples.
    pub restarted: bool,
}

/// A frame that outlives its transfer.
#[derive(Clone, Debug)]
pub struct OwnedFrame {
    /// Header version of the sender.
    pub version: u8,
    /// What the payload is.
    pub kind: Kind,
    /// Schema hash of the sender.
    pub schema: u32,
    /// Sequence number.
    pub sequence: u16,
    /// Payload bytes.
    pub payload: Vec<u8>,
}

impl OwnedFrame {
    fn of(frame: &Frame<'_>) -> Self {
        Self {
            version: frame.version,
            kind: frame.kind,
            schema: frame.schema,
            sequence: frame.sequence,
            payload: frame.payload.to_vec(),
        }
    }

    /// The frame as the link code reads it.
    pub fn borrow(&self) -> Frame<'_> {
        Frame {
            version: self.version,
            kind: self.kind,
            schema: self.schema,
            sequence: self.sequence,
            payload: &self.payload,
        }
    }
}

/// Turns transfers into samples and replies.
pub struct StreamDecoder {
    deframer: Deframer,
    core_hz: f64,
    expected: Option<u64>,
    dropped: u32,
    statistics: StreamStatistics,
}

impl StreamDecoder {
    /// A decoder for a board with this core clock (for tick times).
    pub fn new(core_hz: u32) -> Self {
        Self {
            deframer: Deframer::new(),
            core_hz: f64::from(core_hz.max(1)),
            expected: None,
            dropped: 0,
            statistics: StreamStatistics::default(),
        }
    }

    /// Use this core clock from now on.
    pub fn set_core_hz(&mut self, core_hz: u32) {
        self.core_hz = f64::from(core_hz.max(1));
    }

    /// The next stream frame is the first of a new stream: a gap before it is not a loss.
    pub fn expect_new_stream(&mut self) {
        self.expected = None;
        self.dropped = 0;
    }

    /// Counts so far.
    pub fn statistics(&self) -> StreamStatistics {
        StreamStatistics { malformed: self.deframer.malformed, ..self.statistics }
    }

    /// One bulk IN transfer, or a piece of it.
    pub fn push(&mut self, bytes: &[u8]) -> Received {
        let Self { deframer, core_hz, expected, dropped, statistics } = self;
        statistics.bytes += bytes.len() as u64;
        let mut out = Received::default();
        deframer.push(bytes, |frame| {
            if frame.kind != Kind::Stream {
                out.others.push(OwnedFrame::of(&frame));
                return;
            }
            // A stream of another schema cannot be read; the identity check tells the person about it.
            let Ok(stream) = StreamFrame::parse(&frame) else { return };
            statistics.frames += 1;
            if let Some(expected) = *expected {
                if stream.first_tick < expected {
                    statistics.restarts += 1;
                    out.restarted = true;
                    out.samples.clear();
                } else {
                    let gap = stream.first_tick - expected;
                    let by_board = u64::from(stream.dropped.wrapping_sub(*dropped)).min(gap);
                    statistics.lost_ticks += gap;
                    statistics.dropped_by_board += by_board;
                    statistics.lost_in_transit += gap - by_board;
                }
            }
            *dropped = stream.dropped;
            *expected = Some(stream.first_tick + u64::from(stream.count));
            out.samples.extend(stream.samples().map(|s| physical(&s, *core_hz)));
            statistics.samples += u64::from(stream.count);
        });
        out
    }
}

/// Fixed point to micrometres, volts and microseconds.
fn physical(wire: &WireSample, core_hz: f64) -> Sample {
    let um = |bits: [i32; 3]| bits.map(|b| (f64::from(b) * UM_PER_BIT) as f32);
    let volt = |bits: [i32; 3]| bits.map(|b| (f64::from(b) * VOLT_PER_BIT) as f32);
    Sample {
        tick: wire.tick,
        reference_um: um(wire.reference),
        position_um: um(wire.position),
        drive_v: volt(wire.drive),
        monitor_v: volt(wire.monitor),
        flags: wire.flags,
        tick_time_us: (f64::from(wire.cycles) / core_hz * 1e6) as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flexstage::link::stream::Sample as WireSample;
    use flexstage::link::{Fields, Profile, StreamWriter};

    fn frame(first: u64, count: u64, dropped: u32) -> Vec<u8> {
        let mut buffer = [0; 2048];
        let mut writer = StreamWriter::new(&mut buffer, Fields::RECORDING, Profile::Exact);
        for tick in first..first + count {
            let sample = WireSample {
                tick,
                position: [1 << 24, -(1 << 23), tick as i32],
                drive: [90 << 22; 3],
                ..WireSample::default()
            };
            assert!(writer.push(&sample));
        }
        let length = writer.finish(0, dropped).unwrap();
        buffer[..length].to_vec()
    }

    #[test]
    fn units_come_out_physical() {
        let mut decoder = StreamDecoder::new(170_000_000);
        let got = decoder.push(&frame(7, 3, 0));
        assert_eq!(got.samples.len(), 3);
        assert_eq!(got.samples[0].position_um[..2], [1.0, -0.5]);
        assert_eq!(got.samples[2].tick, 9);
        assert_eq!(got.samples[1].drive_v, [90.0; 3]);
    }

    #[test]
    fn a_loss_is_attributed() {
        let mut decoder = StreamDecoder::new(1);
        decoder.push(&frame(100, 10, 0));
        decoder.push(&frame(120, 10, 10)); // the board dropped 110..120
        decoder.push(&frame(135, 5, 10)); // 130..135 vanished
        let s = decoder.statistics();
        assert_eq!((s.lost_ticks, s.dropped_by_board, s.lost_in_transit), (15, 10, 5));
        assert_eq!(s.samples, 25);
    }

    #[test]
    fn a_restart_is_no_loss() {
        let mut decoder = StreamDecoder::new(1);
        decoder.push(&frame(1_000_000, 10, 3));
        let got = decoder.push(&frame(0, 10, 0));
        assert!(got.restarted);
        assert_eq!(decoder.statistics().lost_ticks, 0);
        assert_eq!(decoder.statistics().restarts, 1);
    }

    #[test]
    fn damage_costs_one_frame() {
        let mut decoder = StreamDecoder::new(1);
        let mut bytes = frame(0, 10, 0);
        let mut bad = frame(10, 10, 0);
        bad[40] ^= 0x55;
        bytes.extend(bad);
        bytes.extend(frame(20, 10, 0));
        let got = decoder.push(&bytes);
        assert_eq!(got.samples.len(), 20);
        let s = decoder.statistics();
        assert_eq!((s.lost_in_transit, s.malformed >= 1), (10, true));
    }
}
