//! USB: one vendor interface with a bulk endpoint each way, and the pump that feeds it.
//!
//! # Design
//! RM0440 section 45, through embassy-usb. No driver is needed: Microsoft OS 2.0 descriptors bind WinUSB, Linux and macOS give the
//! interface to any program. Four tasks share an interrupt executor below the tick and above everything else; each is polled only when
//! it has something to do:
//!
//! - the device itself (enumeration, resets),
//! - the pump: every millisecond it packs the records of the tick into frames, in a ring of [`FRAMES_IN_RING`] ([`RING_MS`] of packed
//!   recording) that carries the board over a host that does not read for a while; what does not fit then is dropped and counted,
//! - the writer: replies first, then frames, each as one transfer,
//! - the reader: bytes to frames to [`Session`] to replies. While a command takes its time the reader already looks at the next packet: an
//!   order to open the loop acts at the next tick.
//!
//! # Limits
//! embassy's driver buffers one packet per endpoint. The clock is HSI48, trimmed by the host's start-of-frame.

use core::future::{Future, poll_fn};
use core::pin::pin;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::{Context, Poll};

use embassy_executor::Spawner;
use embassy_futures::select::{Either, select};
use embassy_stm32::peripherals::{PA11, PA12, USB};
use embassy_stm32::{Peri, bind_interrupts, usb};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver, Sender};
use embassy_time::{Duration, Ticker};
use embassy_usb::driver::{
    Direction, Endpoint, EndpointAddress, EndpointError, EndpointIn, EndpointOut,
};
use embassy_usb::msos::{
    CompatibleIdFeatureDescriptor, PropertyData, RegistryPropertyFeatureDescriptor, windows_version,
};
use embassy_usb::{Builder, Config, Handler};
use static_cell::StaticCell;

use super::device::{self, Board};
use super::records::{Consumer, Entry, RECORDS};
use super::tick;
use crate::AXES;
use crate::link::message::is_disarm;
use crate::link::session::Session;
use crate::link::{
    Deframer, MAX_FRAME, Sample, StreamWriter, USB_ENDPOINT_IN, USB_ENDPOINT_OUT, USB_MANUFACTURER,
    USB_PACKET_BYTES, USB_PRODUCT, USB_PRODUCT_ID, USB_VENDOR_ID,
};

bind_interrupts!(struct Irqs {
    USB_LP => usb::InterruptHandler<USB>;
});

/// Bytes of a stream frame.
const FRAME_BYTES: usize = 1_024;
/// Frames between pump and writer.
pub const FRAMES_IN_RING: usize = 36;
/// What the ring holds of a packed recording (35 samples a frame), ms.
pub const RING_MS: usize = FRAMES_IN_RING * 35 / 10;
/// Vendor request by which Windows asks for the Microsoft OS descriptors.
const MSOS_VENDOR_CODE: u8 = 0x20;
/// Device interface class by which Windows programs find the board.
const INTERFACE_GUIDS: &[&str] = &["{6F1B9F3A-4C0E-4E0B-9B0C-0B8A5D3E7F21}"];

/// Samples that were dropped since the stream was started.
pub static DROPPED: AtomicU32 = AtomicU32::new(0);
/// Stream frames sent.
pub static FRAMES: AtomicU32 = AtomicU32::new(0);
/// Bus resets.
pub static RESETS: AtomicU32 = AtomicU32::new(0);
/// Incremented by the pump while it runs.
pub static HEARTBEAT: AtomicU32 = AtomicU32::new(0);

/// A frame on its way to the host.
struct Outgoing<const N: usize> {
    length: usize,
    bytes: [u8; N],
}

impl<const N: usize> Outgoing<N> {
    const EMPTY: Self = Self { length: 0, bytes: [0; N] };

    fn frame(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }
}

type StreamFrame = Outgoing<FRAME_BYTES>;
type ReplyFrame = Outgoing<MAX_FRAME>;

/// Counts resets, and stops the stream of a host that is gone.
struct Watcher;

impl Handler for Watcher {
    fn reset(&mut self) {
        RESETS.store(RESETS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        device::stop_stream();
    }

    fn configured(&mut self, configured: bool) {
        defmt::info!("usb configured: {=bool}", configured);
    }

    fn suspended(&mut self, suspended: bool) {
        defmt::info!("usb suspended: {=bool}", suspended);
    }
}

/// The USB side of the board.
#[embassy_executor::task]
pub async fn run(
    peripheral: Peri<'static, USB>,
    dp: Peri<'static, PA12>,
    dm: Peri<'static, PA11>,
    records: Consumer,
    board: Board,
) {
    static CONFIG_DESCRIPTOR: StaticCell<[u8; 40]> = StaticCell::new();
    static BOS_DESCRIPTOR: StaticCell<[u8; 40]> = StaticCell::new();
    static MSOS_DESCRIPTOR: StaticCell<[u8; 192]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; 64]> = StaticCell::new();
    static WATCHER: StaticCell<Watcher> = StaticCell::new();
    static RING: StaticCell<[StreamFrame; FRAMES_IN_RING]> = StaticCell::new();
    static RING_CHANNEL: StaticCell<Channel<'static, NoopRawMutex, StreamFrame>> =
        StaticCell::new();
    static REPLY: StaticCell<[ReplyFrame; 1]> = StaticCell::new();
    static REPLY_CHANNEL: StaticCell<Channel<'static, NoopRawMutex, ReplyFrame>> =
        StaticCell::new();

    let driver = usb::Driver::new(peripheral, Irqs, dp, dm);
    let mut builder = Builder::new(
        driver,
        config(),
        CONFIG_DESCRIPTOR.init_with(|| [0; 40]),
        BOS_DESCRIPTOR.init_with(|| [0; 40]),
        MSOS_DESCRIPTOR.init_with(|| [0; 192]),
        CONTROL.init_with(|| [0; 64]),
    );
    builder.handler(WATCHER.init(Watcher));
    builder.msos_descriptor(windows_version::WIN8_1, MSOS_VENDOR_CODE);
    builder.msos_feature(CompatibleIdFeatureDescriptor::new("WINUSB", ""));
    builder.msos_feature(RegistryPropertyFeatureDescriptor::new(
        "DeviceInterfaceGUIDs",
        PropertyData::RegMultiSz(INTERFACE_GUIDS),
    ));
    let (input, output) = {
        let mut function = builder.function(0xff, 0, 0);
        let mut interface = function.interface();
        let mut setting = interface.alt_setting(0xff, 0, 0, None);
        let at = |address: u8, direction| {
            Some(EndpointAddress::from_parts(usize::from(address & 0x0f), direction))
        };
        let size = USB_PACKET_BYTES as u16;
        (
            setting.endpoint_bulk_in(at(USB_ENDPOINT_IN, Direction::In), size),
            setting.endpoint_bulk_out(at(USB_ENDPOINT_OUT, Direction::Out), size),
        )
    };
    let mut device = builder.build();

    let ring = RING.init_with(|| [const { StreamFrame::EMPTY }; FRAMES_IN_RING]);
    let (frames_in, frames_out) = RING_CHANNEL.init_with(|| Channel::new(ring)).split();
    let reply = REPLY.init_with(|| [const { ReplyFrame::EMPTY }; 1]);
    let (replies_in, replies_out) = REPLY_CHANNEL.init_with(|| Channel::new(reply)).split();
    // SAFETY: only embassy's executor polls this task. The ends of the rings, which it hands to the others, must not leave the
    // interrupt that runs them all.
    let tasks = unsafe { Spawner::for_current_executor().await };
    match (
        pump(records, frames_in),
        write(input, frames_out, replies_out),
        read(output, board, replies_in),
    ) {
        (Ok(pump), Ok(write), Ok(read)) => {
            tasks.spawn(pump);
            tasks.spawn(write);
            tasks.spawn(read);
        }
        _ => defmt::error!("the USB tasks could not start"),
    }
    device.run().await;
}

fn config() -> Config<'static> {
    let mut config = Config::new(USB_VENDOR_ID, USB_PRODUCT_ID);
    config.manufacturer = Some(USB_MANUFACTURER);
    config.product = Some(USB_PRODUCT);
    config.serial_number = Some(embassy_stm32::uid::uid_hex());
    config.device_release =
        u16::from_be_bytes([super::VERSION[0], super::VERSION[1] << 4 | super::VERSION[2]]);
    config.device_class = 0xff;
    config.device_sub_class = 0;
    config.device_protocol = 0;
    config.composite_with_iads = false;
    config.max_power = 250;
    config
}

/// Records to frames.
#[embassy_executor::task]
async fn pump(mut records: Consumer, mut ring: Sender<'static, NoopRawMutex, StreamFrame>) {
    let mut packer =
        Packer { sequence: 0, tick_high: 0, tick_low: 0, lost_before: 0, before: None };
    let mut ticker = Ticker::every(Duration::from_millis(1));
    loop {
        packer.start_stream();
        while let Some((fields, profile)) = device::stream() {
            // The frame is filled in place, over as many milliseconds as it takes.
            let Some(frame) = ring.try_send() else {
                // Full is full: the records wait in their queue, but for the ones that the next millisecond needs.
                packer.drop_all_but(&mut records, RECORDS - 16);
                breathe(&mut ticker).await;
                continue;
            };
            let mut writer = StreamWriter::new(&mut frame.bytes, fields, profile);
            while device::stream() == Some((fields, profile)) {
                let Some(entry) = records.peek() else {
                    breathe(&mut ticker).await;
                    continue;
                };
                if let Some(sample) = packer.sample(entry)
                    && !writer.push(&sample)
                {
                    break;
                }
                packer.done(entry);
                records.drop_oldest();
            }
            if writer.count() > 0
                && let Ok(length) = writer.finish(packer.sequence, packer.dropped())
            {
                packer.sequence = packer.sequence.wrapping_add(1);
                frame.length = length;
                ring.send_done();
            }
        }
        // Nobody listens: frames of the last stream are for nobody, and so are the records.
        ring.clear();
        packer.drop_all_but(&mut records, 0);
        breathe(&mut ticker).await;
    }
}

/// Waits for the next millisecond and shows that the pump runs.
async fn breathe(ticker: &mut Ticker) {
    ticker.next().await;
    HEARTBEAT.store(HEARTBEAT.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// What the pump remembers from frame to frame.
struct Packer {
    sequence: u16,
    tick_high: u32,
    tick_low: u32,
    lost_before: u32,
    /// Tick of the record before, and the drives that it commanded.
    before: Option<(u32, [i32; AXES])>,
}

impl Packer {
    /// Counts losses from here.
    fn start_stream(&mut self) {
        self.lost_before = tick::SHOWN.lost_records.load(Ordering::Relaxed);
        self.before = None;
        DROPPED.store(0, Ordering::Relaxed);
    }

    /// Samples dropped since the stream was started: by the pump for want of a frame, and by the tick for want of a pump.
    fn dropped(&mut self) -> u32 {
        let lost = tick::SHOWN.lost_records.load(Ordering::Relaxed);
        let dropped =
            DROPPED.load(Ordering::Relaxed).wrapping_add(lost.wrapping_sub(self.lost_before));
        self.lost_before = lost;
        DROPPED.store(dropped, Ordering::Relaxed);
        dropped
    }

    fn drop_all_but(&mut self, records: &mut Consumer, keep: usize) {
        while records.len() > keep && records.drop_oldest() {
            DROPPED.store(DROPPED.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
    }

    /// A record as it travels, its tick extended to 64 bits. What acts on the stage from this tick to the next is what the tick before
    /// commanded, so there is no sample of the first record, nor of the first one after a loss.
    fn sample(&mut self, entry: &Entry) -> Option<Sample> {
        let record = &entry.record;
        let (tick, drive) = self.before?;
        if tick.wrapping_add(1) != record.tick {
            return None;
        }
        if record.tick < self.tick_low {
            self.tick_high = self.tick_high.wrapping_add(1);
        }
        self.tick_low = record.tick;
        let axes = &record.axes;
        Some(Sample {
            tick: u64::from(self.tick_high) << 32 | u64::from(record.tick),
            reference: axes.each_ref().map(|axis| axis.reference.to_bits()),
            position: axes.each_ref().map(|axis| axis.position.to_bits()),
            drive,
            monitor: axes.each_ref().map(|axis| axis.monitor.to_bits()),
            flags: record.flags.0,
            cycles: entry.cycles,
            gauge_code: entry.gauge,
            dac_code: axes.each_ref().map(|axis| axis.dac),
        })
    }

    /// A record has been dealt with: its drives act in the next one. A loss before it cost it its sample too.
    fn done(&mut self, entry: &Entry) {
        let record = &entry.record;
        if self.before.is_some_and(|(tick, _)| tick.wrapping_add(1) != record.tick) {
            DROPPED.store(DROPPED.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
        self.before = Some((record.tick, record.axes.each_ref().map(|axis| axis.drive.to_bits())));
    }
}

/// Frames and replies to the host, replies first.
#[embassy_executor::task]
async fn write(
    mut endpoint: usb::Endpoint<'static, USB, usb::In>,
    mut frames: Receiver<'static, NoopRawMutex, StreamFrame>,
    mut replies: Receiver<'static, NoopRawMutex, ReplyFrame>,
) {
    loop {
        endpoint.wait_enabled().await;
        loop {
            let sent = match select(replies.receive(), frames.receive()).await {
                Either::First(reply) => {
                    let sent = endpoint.write_transfer(reply.frame(), true).await;
                    replies.receive_done();
                    sent
                }
                Either::Second(frame) => {
                    let sent = endpoint.write_transfer(frame.frame(), true).await;
                    frames.receive_done();
                    FRAMES.store(FRAMES.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
                    sent
                }
            };
            if sent.is_err() {
                break;
            }
        }
    }
}

/// Commands from the host.
#[embassy_executor::task]
async fn read(
    mut endpoint: usb::Endpoint<'static, USB, usb::Out>,
    mut board: Board,
    mut replies: Sender<'static, NoopRawMutex, ReplyFrame>,
) {
    static DEFRAMER: StaticCell<Deframer> = StaticCell::new();
    let deframer = DEFRAMER.init_with(Deframer::new);
    let mut session = Session::new();
    let mut packet = [0; USB_PACKET_BYTES];
    loop {
        endpoint.wait_enabled().await;
        deframer.end_of_transfer();
        let mut next = None;
        loop {
            let read = match next.take() {
                Some(read) => read,
                None => poll_fn(|context| poll_read(&mut endpoint, &mut packet, context)).await,
            };
            let Ok(length) = read else { break };
            let mut taken = 0;
            while taken < length {
                taken += deframer.feed(packet.get(taken..length).unwrap_or_default());
                loop {
                    let errors = deframer.malformed;
                    let Some(frame) = deframer.next_frame() else { break };
                    let reply = replies.send().await;
                    reply.length = {
                        let mut handled =
                            pin!(session.handle(&mut board, &frame, errors, &mut reply.bytes));
                        // Staging takes milliseconds, for which an order to open the loop must not wait. The next packet takes the place of
                        // this one, of which the deframer has everything.
                        poll_fn(|context| {
                            let handling = handled.as_mut().poll(context);
                            if handling.is_pending()
                                && taken == length
                                && next.is_none()
                                && let Poll::Ready(read) =
                                    poll_read(&mut endpoint, &mut packet, context)
                            {
                                if let Ok(length) = read
                                    && packet.get(..length).is_some_and(is_disarm)
                                {
                                    tick::stop();
                                }
                                next = Some(read);
                            }
                            handling
                        })
                        .await
                    };
                    if reply.length > 0 {
                        replies.send_done();
                    }
                }
            }
            if length < USB_PACKET_BYTES {
                deframer.end_of_transfer();
            }
        }
    }
}

/// Reads a packet if one is there. The driver's future remembers nothing from poll to poll, so that each may be a new one.
#[inline(never)]
fn poll_read(
    endpoint: &mut usb::Endpoint<'static, USB, usb::Out>,
    packet: &mut [u8],
    context: &mut Context<'_>,
) -> Poll<Result<usize, EndpointError>> {
    pin!(endpoint.read(packet)).poll(context)
}
