//! What an operating system does with a device that appears: descriptors, address, strings, BOS, configuration.
//!
//! The order is that of Windows, the most particular of the three: short device descriptor at address 0, address,
//! full descriptors, BOS and Microsoft OS 2.0 set, strings, configuration, status. [`Stack`] goes on to keep bulk IN
//! transfers queued for whoever reads, as a driver does.

use std::collections::{HashMap, VecDeque};

use super::bus::Host;
use super::descriptors::Device;
use super::transfer::{Completion, Pipe, Status};
use crate::periph::usb::Usb;
use crate::time::{MILLISECOND, NEVER, Time};

const GET_DESCRIPTOR: u8 = 6;
/// Time a device has to answer a standard request (USB 2.0 9.2.6.4).
const PATIENCE: Time = 500 * MILLISECOND;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    ShortDevice,
    Address,
    Settle(Time),
    Device,
    ConfigurationHeader,
    Configuration(u16),
    Qualifier,
    BosHeader,
    Bos(u16),
    MsOs,
    Languages,
    String(usize),
    Configure,
    Status,
    Ready,
    Failed,
}

/// Host software: enumerates, then moves bytes.
#[derive(Default)]
pub struct Stack {
    /// The controller below.
    pub host: Host,
    seen: u64,
    step: Option<Step>,
    waiting: Option<u64>,
    found: Device,
    next_address: u8,
    language: u16,
    /// Log of what happened on the bus, for people.
    pub log: Vec<(Time, String)>,
    /// Bytes of one bulk IN transfer; IN tokens are sent only while `reading`.
    pub in_length: usize,
    /// Bulk IN transfers kept queued, so that no gap between two transfers is longer than the bus needs.
    pub in_depth: usize,
    /// Whether a program reads the device.
    pub reading: bool,
    /// Finished bulk IN transfers.
    pub received: VecDeque<(Time, Vec<u8>)>,
    /// Finished bulk OUT transfers: id and how.
    pub sent: VecDeque<(u64, Status)>,
    controls: HashMap<u64, Option<Completion>>,
}

impl Stack {
    /// A host with nothing plugged in yet.
    pub fn new() -> Stack {
        Stack { in_length: 4096, in_depth: 8, ..Default::default() }
    }

    /// The device, once it is configured.
    pub fn device(&self) -> Option<&Device> {
        (self.step == Some(Step::Ready)).then_some(&self.found)
    }

    /// What is known of a device whose enumeration failed or still runs.
    pub fn partial_device(&self) -> &Device {
        &self.found
    }

    /// Whether enumeration was given up.
    pub fn failed(&self) -> bool {
        self.step == Some(Step::Failed)
    }

    /// Queues a bulk OUT transfer; `None` while no device is configured.
    pub fn send(&mut self, data: Vec<u8>) -> Option<u64> {
        let endpoint = self.device()?.bulk(false)?;
        Some(self.host.bulk_out(endpoint, data, true))
    }

    /// Queues a control transfer; take its result with [`Stack::control_result`].
    pub fn control(&mut self, setup: [u8; 8], data: Vec<u8>, now: Time) -> u64 {
        let id = self.host.control(setup, data, now + PATIENCE);
        self.controls.insert(id, None);
        id
    }

    /// The result of a control transfer, once.
    pub fn control_result(&mut self, id: u64) -> Option<Completion> {
        if self.controls.get(&id)?.is_some() { self.controls.remove(&id)? } else { None }
    }

    /// Starts or stops reading; stopping takes the queued IN transfers back, as closing a device does.
    pub fn set_reading(&mut self, reading: bool, now: Time) {
        self.reading = reading;
        self.host.touch();
        if let (false, Some(e)) = (reading, self.device().and_then(|d| d.bulk(true))) {
            self.host.cancel(Pipe::In(e), now);
        }
    }

    /// When this has to be updated next.
    pub fn next_event(&self, now: Time) -> Time {
        let settle = match self.step {
            Some(Step::Settle(t)) => t,
            _ => NEVER,
        };
        if self.host.has_completions() { now } else { self.host.next_event(now).min(settle) }
    }

    /// Brings bus and software up to `now`.
    pub fn update(&mut self, now: Time, device: &mut Usb) {
        self.host.update(now, device);
        if self.host.enabled_count != self.seen {
            self.seen = self.host.enabled_count;
            self.log.push((now, "device attached, bus reset done".into()));
            self.found = Device::default();
            self.step = Some(Step::ShortDevice);
            self.waiting = None;
        } else if !self.host.enabled() && self.step.is_some() {
            self.log.push((now, "device gone".into()));
            self.step = None;
            self.waiting = None;
        }
        while let Some(done) = self.host.completion() {
            self.finish(done, now);
        }
        if self.step.is_some_and(|s| !matches!(s, Step::Ready | Step::Failed))
            && self.waiting.is_none()
        {
            self.request(now);
        }
        if self.reading
            && let Some(endpoint) = self.device().and_then(|d| d.bulk(true))
        {
            while self.host.queued(Pipe::In(endpoint)) < self.in_depth {
                self.host.bulk_in(endpoint, self.in_length);
            }
        }
        self.host.update(now, device);
    }

    fn finish(&mut self, done: Completion, now: Time) {
        match done.pipe {
            Pipe::In(_) => {
                if !done.data.is_empty() {
                    self.received.push_back((done.at, done.data));
                }
            }
            Pipe::Out(_) => self.sent.push_back((done.id, done.status)),
            Pipe::Control if self.waiting == Some(done.id) => {
                self.waiting = None;
                self.answer(done, now);
            }
            Pipe::Control => {
                if let Some(slot) = self.controls.get_mut(&done.id) {
                    *slot = Some(done);
                }
            }
        }
    }

    fn request(&mut self, now: Time) {
        let get = |kind: u8, index: u8, language: u16, length: u16| {
            let [l0, l1] = language.to_le_bytes();
            let [n0, n1] = length.to_le_bytes();
            [0x80, GET_DESCRIPTOR, index, kind, l0, l1, n0, n1]
        };
        let setup = match self.step {
            Some(Step::ShortDevice) => get(1, 0, 0, 64),
            Some(Step::Address) => {
                self.next_address = self.next_address % 127 + 1;
                [0x00, 5, self.next_address, 0, 0, 0, 0, 0]
            }
            Some(Step::Settle(t)) => {
                if now >= t {
                    self.step = Some(Step::Device);
                    self.request(now);
                }
                return;
            }
            Some(Step::Device) => get(1, 0, 0, 18),
            Some(Step::ConfigurationHeader) => get(2, 0, 0, 9),
            Some(Step::Configuration(n)) => get(2, 0, 0, n),
            Some(Step::Qualifier) => get(6, 0, 0, 10),
            Some(Step::BosHeader) => get(15, 0, 0, 5),
            Some(Step::Bos(n)) => get(15, 0, 0, n),
            Some(Step::MsOs) => {
                let (code, length) = self.found.msos.unwrap_or_default();
                let [n0, n1] = length.to_le_bytes();
                [0xc0, code, 0, 0, 7, 0, n0, n1]
            }
            Some(Step::Languages) => get(3, 0, 0, 255),
            Some(Step::String(i)) => get(3, self.found.string_index[i], self.language, 255),
            Some(Step::Configure) => [0x00, 9, self.found.configuration, 0, 0, 0, 0, 0],
            Some(Step::Status) => [0x80, 0, 0, 0, 0, 0, 2, 0],
            Some(Step::Ready | Step::Failed) | None => return,
        };
        self.waiting = Some(self.host.control(setup, Vec::new(), now + PATIENCE));
    }

    fn answer(&mut self, done: Completion, now: Time) {
        let Some(step) = self.step else { return };
        let ok = done.status == Status::Done;
        let b = &done.data[..];
        if !ok && !matches!(step, Step::Qualifier | Step::BosHeader | Step::Bos(_) | Step::MsOs) {
            self.log.push((now, format!("enumeration failed at {step:?}: {:?}", done.status)));
            self.found.problems.push(format!("{step:?} ended with {:?}", done.status));
            self.step = Some(Step::Failed);
            return;
        }
        self.step = Some(match step {
            Step::ShortDevice => {
                if b.len() < 8 || b[1] != 1 {
                    self.found.problems.push(format!("first device descriptor read gave {b:02x?}"));
                }
                Step::Address
            }
            Step::Address => {
                self.host.address = self.next_address;
                // SetAddress recovery (9.2.6.3: 2 ms; hosts wait longer).
                Step::Settle(now + 10 * MILLISECOND)
            }
            Step::Settle(_) => Step::Device,
            Step::Device => {
                self.found.read_device(b);
                Step::ConfigurationHeader
            }
            Step::ConfigurationHeader if b.len() >= 4 => {
                Step::Configuration(u16::from_le_bytes([b[2], b[3]]))
            }
            Step::ConfigurationHeader => Step::Failed,
            Step::Configuration(_) => {
                self.found.read_configuration(b);
                Step::Qualifier
            }
            Step::Qualifier => {
                if ok {
                    self.found.problems.push(
                        "a full-speed-only device answered DEVICE_QUALIFIER (9.6.2: request error)"
                            .into(),
                    );
                }
                if self.found.usb > 0x0200 { Step::BosHeader } else { Step::Languages }
            }
            Step::BosHeader if ok && b.len() == 5 => Step::Bos(u16::from_le_bytes([b[2], b[3]])),
            Step::BosHeader => {
                self.found.problems.push("no BOS descriptor, though bcdUSB is above 2.00".into());
                Step::Languages
            }
            Step::Bos(_) => {
                self.found.read_bos(b);
                if self.found.msos.is_some() { Step::MsOs } else { Step::Languages }
            }
            Step::MsOs => {
                self.found.read_msos(b);
                Step::Languages
            }
            Step::Languages => {
                if b.len() >= 4 && b[1] == 3 {
                    self.language = u16::from_le_bytes([b[2], b[3]]);
                } else {
                    self.found.problems.push(format!("language table is malformed: {b:02x?}"));
                }
                Step::String(0)
            }
            Step::String(i) => {
                self.found.read_string(i, b);
                if i < 2 { Step::String(i + 1) } else { Step::Configure }
            }
            Step::Configure => {
                self.host.reset_toggles();
                Step::Status
            }
            Step::Status => {
                if b.len() != 2 {
                    self.found
                        .problems
                        .push(format!("GET_STATUS gave {b:02x?}, expected two bytes"));
                }
                self.log.push((
                    now,
                    format!(
                        "configured: {:04x}:{:04x} {:?}",
                        self.found.vid, self.found.pid, self.found.strings
                    ),
                ));
                Step::Ready
            }
            s => s,
        });
    }
}
