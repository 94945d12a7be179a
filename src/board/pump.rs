//! The pump: records of the tick to frames for the host.
//!
//! # Design
//! Every record passes here, whether somebody listens or not: what acts on the stage from one tick to the next is what the tick before
//! commanded, so a sample takes two records. A stream begins with the tick that the answer to its start names. It ends by getting another
//! number ([`device::stream_word`]): the frame that is being filled is left, and the writer passes over those that wait in the ring. The ring
//! itself is never cleared from here, as the writer may hold a frame of it.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::Sender;
use embassy_time::{Duration, Ticker};

use super::device::{self, selection, stream_number, stream_word};
use super::records::{Consumer, Entry, RECORDS};
use super::tick;
use super::usb::StreamFrame;
use crate::AXES;
use crate::link::{Sample, StreamWriter};

/// Incremented while the pump runs.
pub static HEARTBEAT: AtomicU32 = AtomicU32::new(0);

/// Samples dropped of the stream that is on, less the records that the tick has lost in all; of the last one if none is on. Only tasks of
/// the USB executor touch it.
static DROPPED: AtomicU32 = AtomicU32::new(0);

fn lost_by_the_tick() -> u32 {
    tick::SHOWN.lost_records.load(Ordering::Relaxed)
}

/// Samples dropped since the stream was started: by the pump for want of a frame, and by the tick for want of a pump. Of the last stream,
/// if none is on.
pub fn dropped() -> u32 {
    let dropped = DROPPED.load(Ordering::Relaxed);
    match selection(stream_word()) {
        Some(_) => dropped.wrapping_add(lost_by_the_tick()),
        None => dropped,
    }
}

/// Counts from here: a stream is about to start.
pub fn start_count() {
    DROPPED.store(lost_by_the_tick().wrapping_neg(), Ordering::Relaxed);
}

/// What has been counted stays: the stream, if one is on, is about to end.
pub fn end_count() {
    DROPPED.store(dropped(), Ordering::Relaxed);
}

fn count_dropped() {
    DROPPED.store(DROPPED.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// Records to frames.
#[embassy_executor::task]
pub async fn pump(mut records: Consumer, mut ring: Sender<'static, NoopRawMutex, StreamFrame>) {
    let mut sequence = 0u16;
    let mut last = Last { tick: 0, drive: [0; AXES], lost: 0 };
    let mut ticker = Ticker::every(Duration::from_millis(1));
    loop {
        let stream = stream_word();
        let Some((fields, profile)) = selection(stream) else {
            // Nobody listens, nobody misses them.
            while last.pass(&mut records) {}
            breathe(&mut ticker).await;
            continue;
        };
        let start = device::STREAM_START.load(Ordering::Relaxed);
        while records.peek().is_some_and(|entry| is_before(entry.record.tick, start)) {
            last.pass(&mut records);
        }
        while stream_word() == stream {
            // The frame is filled in place, over as many milliseconds as it takes.
            let Some(frame) = ring.try_send() else {
                // Full is full: the records wait in their queue, but for the ones that the next millisecond needs.
                while records.len() > RECORDS - 16 {
                    last.pass(&mut records);
                    count_dropped();
                }
                breathe(&mut ticker).await;
                continue;
            };
            let mut writer = StreamWriter::new(&mut frame.buffer, fields, profile);
            // What was dropped before the frame's first sample: it may be finished because of a loss behind its last one.
            let mut dropped = 0;
            let is_full = loop {
                if stream_word() != stream {
                    break false;
                }
                let Some(entry) = records.peek() else {
                    breathe(&mut ticker).await;
                    continue;
                };
                match last.sample(entry) {
                    Some(sample) => {
                        if writer.count() == 0 {
                            dropped = DROPPED.load(Ordering::Relaxed).wrapping_add(last.lost);
                        }
                        if !writer.push(&sample) {
                            break true;
                        }
                    }
                    // A loss before it cost it its sample too.
                    None => count_dropped(),
                }
                last.pass(&mut records);
            };
            if is_full && let Ok(length) = writer.finish(sequence, dropped) {
                sequence = sequence.wrapping_add(1);
                frame.length = length as u16;
                frame.stream = stream_number(stream);
                ring.send_done();
            }
        }
    }
}

/// Whether a tick comes before another one, from which it is less than two days away.
const fn is_before(tick: u32, other: u32) -> bool {
    (tick.wrapping_sub(other) as i32) < 0
}

/// Waits for the next millisecond and shows that the pump runs.
async fn breathe(ticker: &mut Ticker) {
    ticker.next().await;
    HEARTBEAT.store(HEARTBEAT.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// The last record that passed.
struct Last {
    /// Its tick, extended to 64 bits.
    tick: u64,
    /// The drives that it commanded.
    drive: [i32; AXES],
    /// Ticks without a record before it, in all: [`lost_by_the_tick`], as it was then.
    lost: u32,
}

impl Last {
    /// Takes the oldest record off its queue; whether there was one.
    fn pass(&mut self, records: &mut Consumer) -> bool {
        if let Some(Entry { record, .. }) = records.peek() {
            let missing = record.tick.wrapping_sub(self.tick as u32).saturating_sub(1);
            self.lost = self.lost.wrapping_add(missing);
            self.tick += u64::from(record.tick.wrapping_sub(self.tick as u32));
            self.drive = record.axes.each_ref().map(|axis| axis.drive.to_bits());
        }
        records.drop_oldest()
    }

    /// A record as it travels; nothing if it is not the next one.
    fn sample(&self, entry: &Entry) -> Option<Sample> {
        let record = &entry.record;
        if record.tick.wrapping_sub(self.tick as u32) != 1 {
            return None;
        }
        let axes = &record.axes;
        Some(Sample {
            tick: self.tick + 1,
            reference: axes.each_ref().map(|axis| axis.reference.to_bits()),
            position: axes.each_ref().map(|axis| axis.position.to_bits()),
            drive: self.drive,
            monitor: axes.each_ref().map(|axis| axis.monitor.to_bits()),
            flags: record.flags.0,
            cycles: entry.cycles,
            gauge_code: entry.gauge,
            dac_code: axes.each_ref().map(|axis| axis.dac),
        })
    }
}
