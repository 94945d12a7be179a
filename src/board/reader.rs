//! The reader: packets from the host to commands, and to answers.
//!
//! # Design
//! A command may take its time, and must wait for the answer to the one before it to leave, which takes for ever where the host
//! does not read. Meanwhile the reader goes on taking packets and keeps them ([`AHEAD_BYTES`]), for one reason: a packet that ends with an order to
//! open the loop ([`ends_with_disarm`]) acts at the next tick, whatever comes before it. It is answered when its turn comes, and until then what
//! comes before it closes no loop ([`STOPS`]). With nothing before it, it is a command like others, whose answer names the very tick.

use core::future::{Future, poll_fn};
use core::pin::pin;
use core::sync::atomic::Ordering;
use core::task::{Context, Poll};

use embassy_stm32::peripherals::USB;
use embassy_stm32::usb;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::Sender;
use embassy_usb::driver::{Endpoint, EndpointOut};
use static_cell::StaticCell;

use super::device::{Board, STOPS};
use super::tick;
use super::usb::ReplyFrame;
use crate::link::message::{DISARM_BYTES, ends_with_disarm};
use crate::link::session::Session;
use crate::link::{Deframer, USB_PACKET_BYTES};

type OutEndpoint = usb::Endpoint<'static, USB, usb::Out>;

/// Room for packets that have been read ahead, each with a byte for its length: 54 short commands, or 15 whole packets.
const AHEAD_BYTES: usize = 1_024;
/// In the byte with a packet's length: it has opened the loop.
const HAS_STOPPED: u8 = 0x80;

/// Packets from the host that wait, in order.
struct Ahead {
    bytes: [u8; AHEAD_BYTES],
    start: usize,
    end: usize,
    /// The host is gone: what waits is for nobody.
    is_gone: bool,
}

impl Ahead {
    /// Reads what is there and fits, while a command that came before goes on or waits, or none does. What does not fit waits in the
    /// endpoint's buffer and with the host.
    #[inline(never)]
    fn read(&mut self, endpoint: &mut OutEndpoint, context: &mut Context<'_>, is_busy: bool) {
        if self.start == self.end {
            (self.start, self.end) = (0, 0);
        }
        while !self.is_gone
            && let Some([length, place @ ..]) =
                self.bytes.get_mut(self.end..self.end + 1 + USB_PACKET_BYTES)
        {
            // The driver's future remembers nothing from poll to poll, so that each may be a new one.
            let read = pin!(endpoint.read(place)).poll(context);
            match read {
                Poll::Pending => return,
                Poll::Ready(Ok(read)) => {
                    let has_others = is_busy || self.start < self.end || read > DISARM_BYTES;
                    *length = read as u8;
                    if has_others && place.get(..read).is_some_and(ends_with_disarm) {
                        *length |= HAS_STOPPED;
                        count_stops(1);
                        tick::stop();
                    }
                    self.end += 1 + read;
                }
                Poll::Ready(Err(_)) => self.is_gone = true,
            }
        }
    }

    /// Moves the oldest packet to a place of its own; its length, and whether it has opened the loop.
    fn take(&mut self, packet: &mut [u8; USB_PACKET_BYTES]) -> Option<(usize, bool)> {
        let waiting = self.bytes.get(self.start..self.end)?;
        let (first, rest) = waiting.split_first()?;
        let length = usize::from(first & !HAS_STOPPED);
        packet.get_mut(..length)?.copy_from_slice(rest.get(..length)?);
        self.start += 1 + length;
        Some((length, first & HAS_STOPPED != 0))
    }
}

fn count_stops(change: i32) {
    STOPS.store(STOPS.load(Ordering::Relaxed).wrapping_add_signed(change), Ordering::Relaxed);
}

/// Commands from the host.
#[embassy_executor::task]
pub async fn read(
    mut endpoint: OutEndpoint,
    mut board: Board,
    mut replies: Sender<'static, NoopRawMutex, ReplyFrame>,
) {
    static DEFRAMER: StaticCell<Deframer> = StaticCell::new();
    static AHEAD: StaticCell<Ahead> = StaticCell::new();
    let deframer = DEFRAMER.init_with(Deframer::new);
    let ahead =
        AHEAD.init_with(|| Ahead { bytes: [0; AHEAD_BYTES], start: 0, end: 0, is_gone: false });
    let mut session = Session::new();
    let mut packet = [0; USB_PACKET_BYTES];
    loop {
        endpoint.wait_enabled().await;
        deframer.end_of_transfer();
        (ahead.start, ahead.end, ahead.is_gone) = (0, 0, false);
        STOPS.store(0, Ordering::Relaxed);
        'host: loop {
            let packet_taken = poll_fn(|context| {
                // The next command has to wait where an answer has not left.
                ahead.read(&mut endpoint, context, replies.is_full());
                match ahead.take(&mut packet) {
                    _ if ahead.is_gone => Poll::Ready(None),
                    None => Poll::Pending,
                    taken => Poll::Ready(taken),
                }
            })
            .await;
            let Some((length, has_stopped)) = packet_taken else { break };
            let mut taken = 0;
            while taken < length {
                taken += deframer.feed(packet.get(taken..length).unwrap_or_default());
                loop {
                    let errors = deframer.malformed;
                    let Some(frame) = deframer.next_frame() else { break };
                    poll_fn(|context| {
                        ahead.read(&mut endpoint, context, true);
                        if ahead.is_gone || replies.poll_send(context).is_ready() {
                            Poll::Ready(())
                        } else {
                            Poll::Pending
                        }
                    })
                    .await;
                    // Nothing to send an answer with: the host is gone, and the command with it.
                    let Some(reply) = replies.try_send().filter(|_| !ahead.is_gone) else {
                        break 'host;
                    };
                    reply.length = {
                        let mut handled =
                            pin!(session.handle(&mut board, &frame, errors, &mut reply.buffer));
                        poll_fn(|context| {
                            let handling = handled.as_mut().poll(context);
                            if handling.is_pending() {
                                ahead.read(&mut endpoint, context, true);
                            }
                            handling
                        })
                        .await as u16
                    };
                    if reply.length > 0 {
                        replies.send_done();
                    }
                }
            }
            if length < USB_PACKET_BYTES {
                deframer.end_of_transfer();
            }
            if has_stopped {
                count_stops(-1);
            }
        }
    }
}
