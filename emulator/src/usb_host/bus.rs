//! The host controller and its port: transactions in time, transfers out of packets.
//!
//! A full-speed bus carries 12 Mbit/s in frames of 1 ms. Pending transfers are served in turn; an endpoint that
//! answers NAK is asked again at once, as OHCI and xHCI controllers do, so that a packet starts within one retry
//! (8 us) of the device being ready. NAKs themselves are not simulated one by one. Nothing is sent in the last
//! 100 us of a frame that would not fit. Left out: bit errors, hubs, isochronous and interrupt pipes, other traffic.

use std::collections::VecDeque;

use super::transfer::{Completion, Pipe, Stage, Status, Transfer};
use crate::periph::usb::Usb;
use crate::time::{MICROSECOND, MILLISECOND, NEVER, Time};

mod transaction;

/// Retry grid of an endpoint that answered NAK.
const RETRY: Time = 8 * MICROSECOND;
/// SE0 of a bus reset and the recovery time after it (USB 2.0 7.1.7.5).
const RESET: Time = 10 * MILLISECOND;
const RECOVERY: Time = 10 * MILLISECOND;
/// Debounce of a new attachment (7.1.7.3, 100 ms; shortened, nothing here bounces).
const DEBOUNCE: Time = 5 * MILLISECOND;
/// No frames for so long suspends the device (7.1.7.6).
const IDLE: Time = 3 * MILLISECOND;
/// Bulk packets and control packets of a full-speed device with 64-byte endpoints.
pub const MAX_PACKET: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Port {
    /// Cable out.
    Unplugged,
    /// Cable in, nothing pulls D+ up.
    Empty,
    Debouncing(Time),
    Resetting(Time),
    Recovering(Time),
    Enabled,
}

/// Host controller, port and transfer queues.
pub struct Host {
    port: Port,
    queues: Vec<(Pipe, VecDeque<Transfer>)>,
    turn: usize,
    running: Option<(Time, usize)>,
    bus_free: Time,
    toggles: Vec<(Pipe, bool)>,
    completions: VecDeque<Completion>,
    next_id: u64,
    suspend_at: Time,
    suspended: bool,
    /// Address the device was given.
    pub address: u8,
    /// Bumped whenever the port becomes enabled: whoever drives the device starts over.
    pub enabled_count: u64,
    /// Packets that carried data, both ways.
    pub packets: u64,
    /// Packets the device repeated with an old toggle (dropped, as hosts do).
    pub repeats: u64,
    /// Frames stopped for the device to sleep (laptop lid closed).
    asleep: bool,
    /// A transfer was queued, the cable or the port was touched: look at once.
    touched: bool,
    /// No IN tokens go to bulk endpoints: a host too busy to serve its queues.
    stalled: bool,
}

impl Default for Host {
    fn default() -> Self {
        Host {
            port: Port::Empty,
            queues: Vec::new(),
            turn: 0,
            running: None,
            bus_free: 0,
            toggles: Vec::new(),
            completions: VecDeque::new(),
            next_id: 1,
            suspend_at: NEVER,
            suspended: false,
            address: 0,
            enabled_count: 0,
            packets: 0,
            repeats: 0,
            asleep: false,
            touched: false,
            stalled: false,
        }
    }
}

/// Time on the wire of a transaction with `bytes` of data: token, data and handshake packets with sync, PID, CRC,
/// end of packet and turn-around, bits stuffed at the average rate.
fn wire_time(bytes: usize) -> Time {
    (bytes as Time + 13) * 8 * MICROSECOND * 21 / (12 * 20)
}

impl Host {
    /// Pulls the cable out.
    pub fn unplug(&mut self, now: Time) {
        self.port = Port::Unplugged;
        self.suspend_at = now + IDLE;
        self.drop_all(now, Status::Gone);
    }

    /// Puts the cable in.
    pub fn plug(&mut self) {
        self.touched = true;
        if self.port == Port::Unplugged {
            self.port = Port::Empty;
        }
    }

    /// Resets the bus: the device is enumerated anew.
    pub fn reset(&mut self, now: Time) {
        if self.port == Port::Enabled {
            self.drop_all(now, Status::Gone);
            self.port = Port::Resetting(now + RESET);
        }
    }

    /// Stops frames (the host goes to sleep) or starts them again.
    pub fn sleep(&mut self, asleep: bool, now: Time) {
        self.touched = true;
        self.asleep = asleep;
        self.suspend_at = if asleep { now + IDLE } else { NEVER };
    }

    /// Sends no IN tokens to bulk endpoints while `stalled`; queued transfers stay queued.
    pub fn stall(&mut self, stalled: bool) {
        self.stalled = stalled;
        self.touched = true;
    }

    /// Something outside changed: look at the queues at once.
    pub fn touch(&mut self) {
        self.touched = true;
    }

    /// Whether a device is there, reset and listening.
    pub fn enabled(&self) -> bool {
        self.port == Port::Enabled
    }

    fn drop_all(&mut self, now: Time, status: Status) {
        self.running = None;
        self.toggles.clear();
        self.address = 0;
        for (pipe, queue) in &mut self.queues {
            for t in queue.drain(..) {
                self.completions.push_back(Completion {
                    id: t.id,
                    pipe: *pipe,
                    status,
                    data: t.data,
                    at: now,
                });
            }
        }
    }

    fn push(&mut self, mut t: Transfer) -> u64 {
        self.touched = true;
        t.id = self.next_id;
        self.next_id += 1;
        let id = t.id;
        match self.queues.iter_mut().find(|q| q.0 == t.pipe) {
            Some(q) => q.1.push_back(t),
            None => self.queues.push((t.pipe, VecDeque::from([t]))),
        }
        id
    }

    /// Queues a control transfer; `data` is the OUT data stage. It fails when not done by `deadline`.
    pub fn control(&mut self, setup: [u8; 8], data: Vec<u8>, deadline: Time) -> u64 {
        let length = u16::from_le_bytes([setup[6], setup[7]]) as usize;
        self.push(Transfer {
            id: 0,
            pipe: Pipe::Control,
            setup,
            stage: Stage::Setup,
            data,
            sent: 0,
            want: length,
            zlp: false,
            toggle: false,
            silent: 0,
            deadline,
        })
    }

    /// Queues a bulk IN transfer of up to `length` bytes: a short packet ends it sooner.
    pub fn bulk_in(&mut self, endpoint: u8, length: usize) -> u64 {
        self.bulk(Pipe::In(endpoint), Stage::DataIn, Vec::new(), length, false)
    }

    /// Queues a bulk OUT transfer, split into packets of 64; `zlp` ends one of whole packets with an empty packet.
    pub fn bulk_out(&mut self, endpoint: u8, data: Vec<u8>, zlp: bool) -> u64 {
        let zlp = data.is_empty() || zlp && data.len().is_multiple_of(MAX_PACKET);
        let want = data.len();
        self.bulk(Pipe::Out(endpoint), Stage::DataOut, data, want, zlp)
    }

    fn bulk(&mut self, pipe: Pipe, stage: Stage, data: Vec<u8>, want: usize, zlp: bool) -> u64 {
        let t = Transfer {
            id: 0,
            pipe,
            setup: [0; 8],
            stage,
            data,
            sent: 0,
            want,
            zlp,
            toggle: false,
            silent: 0,
            deadline: NEVER,
        };
        self.push(t)
    }

    /// Takes back every queued transfer of a pipe.
    pub fn cancel(&mut self, pipe: Pipe, now: Time) {
        for i in 0..self.queues.len() {
            if self.queues[i].0 == pipe {
                if self.running.is_some_and(|r| r.1 == i) {
                    self.running = None;
                }
                while self.complete(i, Status::Cancelled, now) {}
            }
        }
    }

    /// Transfers of a pipe that wait.
    pub fn queued(&self, pipe: Pipe) -> usize {
        self.queues.iter().find(|q| q.0 == pipe).map_or(0, |q| q.1.len())
    }

    /// The next finished transfer.
    pub fn completion(&mut self) -> Option<Completion> {
        self.completions.pop_front()
    }

    /// Whether transfers have finished that nobody has taken.
    #[inline]
    pub fn has_completions(&self) -> bool {
        !self.completions.is_empty()
    }

    /// When the host does something next, as things stand.
    pub fn next_event(&self, now: Time) -> Time {
        if self.touched {
            return now;
        }
        let port = match self.port {
            Port::Debouncing(t) | Port::Resetting(t) | Port::Recovering(t) => t,
            // What was under way when the frames stopped goes on when they come back.
            Port::Enabled if self.asleep => return self.suspend_at,
            Port::Enabled
                if self.running.is_none() && self.queues.iter().any(|q| !q.1.is_empty()) =>
            {
                // Time-outs of control transfers that the device never answers.
                self.queues
                    .iter()
                    .filter_map(|q| q.1.front())
                    .map(|t| t.deadline)
                    .min()
                    .unwrap_or(NEVER)
                    .max(now + 1)
            }
            _ => NEVER,
        };
        port.min(self.running.map_or(NEVER, |r| r.0)).min(self.suspend_at)
    }

    /// Brings the bus up to `now` and starts what can start. Call at every event and when the device's registers
    /// change.
    pub fn update(&mut self, now: Time, device: &mut Usb) {
        self.touched = false;
        if now >= self.suspend_at {
            self.suspend_at = NEVER;
            self.suspended = true;
            device.bus_suspend();
        }
        match self.port {
            Port::Empty if device.attached() => self.port = Port::Debouncing(now + DEBOUNCE),
            Port::Unplugged | Port::Empty => {}
            _ if !device.attached() => {
                self.drop_all(now, Status::Gone);
                self.port = Port::Empty;
            }
            Port::Debouncing(t) if now >= t => {
                self.port = Port::Resetting(now + RESET);
            }
            Port::Resetting(t) if now >= t => {
                if std::mem::take(&mut self.suspended) {
                    device.bus_resume();
                }
                device.bus_reset();
                self.port = Port::Recovering(now + RECOVERY);
            }
            Port::Recovering(t) if now >= t => {
                self.port = Port::Enabled;
                self.enabled_count += 1;
                self.bus_free = now;
            }
            Port::Enabled if !self.asleep => {
                if std::mem::take(&mut self.suspended) {
                    device.bus_resume();
                }
                if let Some((_, index)) = self.running.take_if(|r| r.0 <= now) {
                    self.transact(index, now, device);
                }
                self.start(now, device);
            }
            _ => {}
        }
    }

    fn start(&mut self, now: Time, device: &Usb) {
        if self.running.is_some() {
            return;
        }
        let n = self.queues.len();
        for k in 0..n {
            let i = (self.turn + k) % n;
            let (pipe, queue) = &mut self.queues[i];
            let Some(t) = queue.front() else { continue };
            if now >= t.deadline {
                let t = queue.pop_front().expect("front");
                let (id, pipe, status) = (t.id, *pipe, Status::Timeout);
                self.completions.push_back(Completion { id, pipe, status, data: t.data, at: now });
                continue;
            }
            let endpoint = match pipe {
                Pipe::Control => 0,
                Pipe::In(e) | Pipe::Out(e) => *e as usize,
            };
            let (ready, bytes) = match t.stage {
                Stage::Setup => (true, 8),
                Stage::DataIn | Stage::StatusIn => (device.in_ready(endpoint), MAX_PACKET),
                Stage::DataOut => (device.out_ready(endpoint), (t.want - t.sent).min(MAX_PACKET)),
                Stage::StatusOut => (device.out_ready(endpoint), 0),
            };
            if !ready || self.stalled && matches!(pipe, Pipe::In(_)) {
                continue;
            }
            let begin = now.max(self.bus_free).next_multiple_of(RETRY);
            let mut end = begin + wire_time(bytes);
            // SOF takes the first 4 us of a frame; a transaction that would cross into the next frame waits for it.
            let frame = begin / MILLISECOND;
            if end > (frame + 1) * MILLISECOND - 2 * MICROSECOND {
                end = (frame + 1) * MILLISECOND + 4 * MICROSECOND + wire_time(bytes);
            }
            self.turn = (i + 1) % n;
            self.running = Some((end, i));
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bulk_packet_takes_54_microseconds_on_the_wire() {
        let us = wire_time(64) as f64 / MICROSECOND as f64;
        assert!((50.0..58.0).contains(&us), "{us} us");
        // 19 bulk packets of 64 bytes fit in a frame (USB 2.0 table 5-9).
        let per_frame = MILLISECOND / wire_time(64);
        assert!((17..=19).contains(&per_frame), "{per_frame}");
    }
}
