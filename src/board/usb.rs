//! USB: one vendor interface with a bulk endpoint each way, and the pump that feeds it.
//!
//! # Design
//! RM0440 section 45, through embassy-usb. No driver is needed: Microsoft OS 2.0 descriptors bind WinUSB, Linux and macOS give the
//! interface to any program. Four tasks share an interrupt executor below the tick and above everything else; each is polled only when
//! it has something to do:
//!
//! - the device itself (enumeration, resets),
//! - the [`pump`]: every millisecond it packs the records of the tick into frames, in a ring of [`FRAMES_IN_RING`] ([`RING_MS`] of packed
//!   recording) that carries the board over a host that does not read for a while; what does not fit then is dropped and counted,
//! - the writer: replies first, then frames, each as one transfer,
//! - the [`reader`]: bytes to frames to [`Session`](crate::link::session::Session) to replies. While a command takes its time, or waits for
//!   the reply before it to leave, the reader already takes the next packets: an order to open the loop acts at the next tick.
//!
//! # Limits
//! embassy's driver buffers one packet per endpoint. The clock is HSI48, trimmed by the host's start-of-frame.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_executor::Spawner;
use embassy_futures::select::{Either, select};
use embassy_stm32::peripherals::{PA11, PA12, USB};
use embassy_stm32::{Peri, bind_interrupts, usb};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::{Channel, Receiver};
use embassy_usb::driver::{Direction, Endpoint, EndpointAddress, EndpointIn};
use embassy_usb::msos::{
    CompatibleIdFeatureDescriptor, PropertyData, RegistryPropertyFeatureDescriptor, windows_version,
};
use embassy_usb::{Builder, Config, Handler};
use static_cell::StaticCell;

use super::device::{self, Board, stream_number};
use super::records::Consumer;
use super::{halts, pump, reader};
use crate::link::{
    MAX_FRAME, USB_ENDPOINT_IN, USB_ENDPOINT_OUT, USB_MANUFACTURER, USB_PACKET_BYTES, USB_PRODUCT,
    USB_PRODUCT_ID, USB_VENDOR_ID,
};

bind_interrupts!(struct Irqs {
    USB_LP => usb::InterruptHandler<USB>;
});

/// Bytes of a stream frame.
const FRAME_BYTES: usize = 1_024;
/// Frames between pump and writer.
pub const FRAMES_IN_RING: usize = 35;
/// What the ring holds of a packed recording (35 samples a frame), ms.
pub const RING_MS: usize = FRAMES_IN_RING * 35 / 10;
/// Vendor request by which Windows asks for the Microsoft OS descriptors.
const MSOS_VENDOR_CODE: u8 = 0x20;
/// Device interface class by which Windows programs find the board.
const INTERFACE_GUIDS: &[&str] = &["{6F1B9F3A-4C0E-4E0B-9B0C-0B8A5D3E7F21}"];

/// Stream frames sent.
pub static FRAMES: AtomicU32 = AtomicU32::new(0);
/// Bus resets.
pub static RESETS: AtomicU32 = AtomicU32::new(0);

/// A frame on its way to the host. 16 bits each, as there are many.
pub struct Outgoing<const N: usize> {
    /// Its bytes, of those that are there.
    pub length: u16,
    /// The number of the stream that it is of.
    pub stream: u16,
    /// Bytes.
    pub buffer: [u8; N],
}

impl<const N: usize> Outgoing<N> {
    const EMPTY: Self = Self { length: 0, stream: 0, buffer: [0; N] };

    fn bytes(&self) -> &[u8] {
        self.buffer.get(..usize::from(self.length)).unwrap_or_default()
    }
}

/// Some samples.
pub type StreamFrame = Outgoing<FRAME_BYTES>;
/// An answer.
pub type ReplyFrame = Outgoing<MAX_FRAME>;

/// Counts resets, and stops the stream of a host that is gone.
struct Watcher;

impl Handler for Watcher {
    fn reset(&mut self) {
        RESETS.store(RESETS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        device::set_stream(None);
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

    let driver = halts::Driver(usb::Driver::new(peripheral, Irqs, dp, dm));
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
        pump::pump(records, frames_in),
        write(input, frames_out, replies_out),
        reader::read(output, board, replies_in),
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

/// Frames and replies to the host, replies first.
///
/// A frame stays in the ring until its transfer is over, so only this task takes frames off it: one of a stream that has ended meanwhile is
/// for nobody, and not sent.
#[embassy_executor::task]
async fn write(
    mut endpoint: usb::Endpoint<'static, USB, usb::In>,
    mut frames: Receiver<'static, NoopRawMutex, StreamFrame>,
    mut replies: Receiver<'static, NoopRawMutex, ReplyFrame>,
) {
    loop {
        endpoint.wait_enabled().await;
        // An answer to a host that is gone is not for the one that came.
        if replies.try_receive().is_some() {
            replies.receive_done();
        }
        loop {
            let sent = match select(replies.receive(), frames.receive()).await {
                Either::First(reply) => {
                    let sent = endpoint.write_transfer(reply.bytes(), true).await;
                    replies.receive_done();
                    sent
                }
                Either::Second(frame) => {
                    let is_wanted = frame.stream == stream_number(device::stream_word());
                    let sent = if is_wanted {
                        endpoint.write_transfer(frame.bytes(), true).await
                    } else {
                        Ok(())
                    };
                    frames.receive_done();
                    let frames = FRAMES.load(Ordering::Relaxed).wrapping_add(u32::from(is_wanted));
                    FRAMES.store(frames, Ordering::Relaxed);
                    sent
                }
            };
            if sent.is_err() {
                break;
            }
        }
    }
}
