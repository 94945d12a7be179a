//! A session with one board: who it is, commands with acknowledgement, and the stream to whoever wants it.
//!
//! One thread owns the transport. It sends what is asked, matches replies by sequence number, and hands every batch
//! of samples to all subscribers; a subscriber that is slow delays nobody (its queue grows, nothing is dropped). When the board goes
//! away the thread ends and the reason stays readable; nothing reconnects behind the caller's back.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flexstage::link::message::{self, Command, Reply, SCHEMA_HASH};
use flexstage::link::{Fields, Identity, Kind, MAX_FRAME, Profile, encode};
use serde::Serialize;

use crate::decode::{Received, StreamDecoder, StreamStatistics};
use crate::sample::Sample;
use crate::transport::{SocketTransport, Target, Transport, UsbTransport};
use crate::virtual_board::VirtualBoard;
use crate::words::{command_name, refusal};
use crate::{Error, Result};

/// How long a board may take to identify itself.
const IDENTIFY_TIMEOUT: Duration = Duration::from_secs(2);
/// How long a command may take. Saving erases flash pages (22 ms each) and waits for parked outputs.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(2);
/// Wait for data before looking for commands to send: bounds their latency.
const POLL: Duration = Duration::from_millis(2);
/// Silence after which a keep-alive feeds the board's command timeout.
const KEEP_ALIVE: Duration = Duration::from_millis(100);
/// The same on the sample clock: a virtual board may run faster than the wall clock.
const KEEP_ALIVE_SAMPLES: u64 = 1000;

/// Who the board is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DeviceInfo {
    /// How messages call it.
    pub name: String,
    /// 96-bit id of the microcontroller in hexadecimal.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
    /// Control rate.
    pub sample_rate_hz: f64,
    /// Core clock.
    pub core_hz: u32,
    /// Why it last restarted.
    pub reset_reason: String,
    /// Restarts since power-on.
    pub restarts: u16,
    /// Whether its configuration came from flash.
    pub has_stored_config: bool,
    /// Whether a crash report waits to be read.
    pub has_crash_report: bool,
    /// Converters that failed the self-test, a bit each; 0 is good.
    pub self_test: u16,
}

impl DeviceInfo {
    fn of(name: String, identity: &Identity) -> Self {
        let [major, minor, patch] = identity.firmware;
        Self {
            name,
            serial: identity.serial.iter().map(|b| format!("{b:02x}")).collect(),
            firmware: format!("{major}.{minor}.{patch}"),
            sample_rate_hz: f64::from(identity.sample_rate_hz),
            core_hz: identity.core_hz,
            reset_reason: identity.reset_reason().to_owned(),
            restarts: identity.restarts,
            has_stored_config: identity.has_stored_config != 0,
            has_crash_report: identity.has_crash_report != 0,
            self_test: identity.self_test,
        }
    }
}

/// Samples of consecutive arrivals.
#[derive(Clone, Debug)]
pub struct Batch {
    /// In order of ticks.
    pub samples: Arc<[Sample]>,
    /// The board restarted before the first of them: ticks count anew.
    pub restarted: bool,
}

enum Order {
    Command { command: Box<Command>, answer: SyncSender<Result<Reply>> },
    Close,
}

struct Shared {
    subscribers: Mutex<Vec<Sender<Batch>>>,
    statistics: Mutex<StreamStatistics>,
    ended: Mutex<Option<String>>,
    is_connected: AtomicBool,
    /// Whether this session has started the stream.
    has_streamed: AtomicBool,
}

/// A lock that a panicked thread held is still good here: all guarded values are valid after every single write.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Open the way to a board.
pub fn connect(target: &Target) -> Result<Box<dyn Transport>> {
    Ok(match target {
        Target::Usb { serial } => Box::new(UsbTransport::open(serial.as_deref())?),
        Target::Socket(address) => Box::new(SocketTransport::connect(address)?),
        Target::Virtual(options) => Box::new(VirtualBoard::start(options)?),
    })
}

/// A connected board. Dropping it closes the connection.
pub struct Device {
    info: DeviceInfo,
    orders: Sender<Order>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Device {
    /// Connect, identify, check the version.
    pub fn open(target: &Target) -> Result<Self> {
        Self::start(connect(target)?)
    }

    /// A session over an open transport.
    pub fn start(mut transport: Box<dyn Transport>) -> Result<Self> {
        let mut decoder = StreamDecoder::new(1);
        let identity = identify(transport.as_mut(), &mut decoder)?;
        let info = DeviceInfo::of(transport.name(), &identity);
        if identity.schema != SCHEMA_HASH {
            return Err(Error::Version {
                board: info.name,
                firmware: info.firmware,
                found: identity.schema,
                expected: SCHEMA_HASH,
            });
        }
        decoder.set_core_hz(identity.core_hz);
        let shared = Arc::new(Shared {
            subscribers: Mutex::default(),
            statistics: Mutex::default(),
            ended: Mutex::default(),
            is_connected: AtomicBool::new(true),
            has_streamed: AtomicBool::new(false),
        });
        let (orders, inbox) = mpsc::channel();
        let pump = Pump {
            transport,
            decoder,
            inbox,
            shared: shared.clone(),
            pending: Vec::new(),
            sequence: 1,
            last_sent: Instant::now(),
            samples_at_last_sent: 0,
        };
        let thread = std::thread::Builder::new()
            .name("board link".into())
            .spawn(move || pump.run())
            .map_err(|source| Error::File { path: "board link thread".into(), source })?;
        Ok(Self { info, orders, shared, thread: Some(thread) })
    }

    /// Who it is.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Whether the connection still stands.
    pub fn is_connected(&self) -> bool {
        self.shared.is_connected.load(Ordering::Acquire)
    }

    /// Why the connection ended.
    pub fn ended(&self) -> Option<String> {
        lock(&self.shared.ended).clone()
    }

    /// What arrived so far.
    pub fn statistics(&self) -> StreamStatistics {
        *lock(&self.shared.statistics)
    }

    /// Every sample from now on, in order.
    pub fn subscribe(&self) -> Receiver<Batch> {
        let (sender, receiver) = mpsc::channel();
        lock(&self.shared.subscribers).push(sender);
        receiver
    }

    /// Make the board stream everything that is drawn and recorded, unless this session had it do so already: a new start would cost a
    /// few ticks. What an earlier session left on its way is not taken for a loss; subscribe afterwards.
    pub fn stream(&self) -> Result<()> {
        let fields = Fields::RECORDING.with(Fields::CYCLES);
        let on = Command::StreamOn { fields, profile: Profile::Exact };
        if !self.shared.has_streamed.swap(true, Ordering::AcqRel) {
            return self.command(on).map(|_| ());
        }
        let Reply::Status(status) = self.command(Command::Status)? else {
            return Err(Error::Invalid("the board did not answer with its status".into()));
        };
        if status.stream != Some((fields, Profile::Exact)) {
            self.command(on)?;
        }
        Ok(())
    }

    /// Send a command and wait for what took effect. A refusal is an error that says why.
    pub fn command(&self, command: Command) -> Result<Reply> {
        let name = command_name(&command);
        match self.ask(command)? {
            Reply::Refused(why) => {
                Err(Error::Refused { command: name.to_owned(), reason: refusal(&why) })
            }
            reply => Ok(reply),
        }
    }

    fn ask(&self, command: Command) -> Result<Reply> {
        let name = command_name(&command).to_owned();
        let (answer, wait) = mpsc::sync_channel(1);
        let gone = || Error::Lost {
            board: self.info.name.clone(),
            reason: self.ended().unwrap_or_else(|| "the session is closed".into()),
        };
        self.orders
            .send(Order::Command { command: Box::new(command), answer })
            .map_err(|_| gone())?;
        // The pump times out by itself; the margin covers a pump that is blocked in a send.
        match wait.recv_timeout(COMMAND_TIMEOUT * 2) {
            Ok(reply) => reply,
            Err(RecvTimeoutError::Timeout) => {
                Err(Error::Timeout { command: name, after: COMMAND_TIMEOUT * 2 })
            }
            Err(RecvTimeoutError::Disconnected) => Err(gone()),
        }
    }

    /// Close the connection and wait for the thread.
    pub fn close(mut self) {
        self.shut();
    }

    fn shut(&mut self) {
        // An error means that the pump has ended already.
        let _ = self.orders.send(Order::Close);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.shut();
    }
}

/// Ask who is there until somebody answers.
fn identify(transport: &mut dyn Transport, decoder: &mut StreamDecoder) -> Result<Identity> {
    let mut buffer = [0; 64];
    let ask =
        encode(&mut buffer, Kind::Identify, 0, &[]).map_err(|e| Error::Invalid(e.to_string()))?;
    let deadline = Instant::now() + IDENTIFY_TIMEOUT;
    let mut next_ask = Instant::now();
    let mut bytes = 0;
    while Instant::now() < deadline {
        if Instant::now() >= next_ask {
            transport.send(ask)?;
            next_ask += Duration::from_millis(500);
        }
        let Some(transfer) = transport.receive(Duration::from_millis(20))? else { continue };
        bytes += transfer.len();
        for frame in decoder.push(&transfer).others {
            if frame.kind == Kind::Identity
                && let Some(identity) = Identity::from_bytes(&frame.payload)
            {
                return Ok(identity);
            }
        }
    }
    Err(Error::NotFlexstage {
        board: transport.name(),
        reason: format!(
            "{bytes} bytes and no identity within {} s; expected a flexstage controller",
            IDENTIFY_TIMEOUT.as_secs()
        ),
    })
}

struct Pending {
    sequence: u16,
    name: &'static str,
    deadline: Instant,
    starts_stream: bool,
    answer: Option<SyncSender<Result<Reply>>>,
}

struct Pump {
    transport: Box<dyn Transport>,
    decoder: StreamDecoder,
    inbox: Receiver<Order>,
    shared: Arc<Shared>,
    pending: Vec<Pending>,
    sequence: u16,
    last_sent: Instant,
    samples_at_last_sent: u64,
}

impl Pump {
    fn run(mut self) {
        let reason = match self.work() {
            Ok(()) => "the session was closed".to_owned(),
            Err(error) => error.to_string(),
        };
        *lock(&self.shared.ended) = Some(reason.clone());
        self.shared.is_connected.store(false, Ordering::Release);
        for pending in self.pending.drain(..) {
            if let Some(answer) = pending.answer {
                let board = self.transport.name();
                let _ = answer.send(Err(Error::Lost { board, reason: reason.clone() }));
            }
        }
        // Ends every subscriber's loop.
        lock(&self.shared.subscribers).clear();
    }

    fn work(&mut self) -> Result<()> {
        loop {
            loop {
                match self.inbox.try_recv() {
                    Ok(Order::Command { command, answer }) => self.send(&command, Some(answer))?,
                    Ok(Order::Close) | Err(mpsc::TryRecvError::Disconnected) => return Ok(()),
                    Err(mpsc::TryRecvError::Empty) => break,
                }
            }
            let silent = self.decoder.statistics().samples - self.samples_at_last_sent;
            if self.last_sent.elapsed() > KEEP_ALIVE || silent > KEEP_ALIVE_SAMPLES {
                self.send(&Command::KeepAlive, None)?;
            }
            if let Some(transfer) = self.transport.receive(POLL)? {
                let received = self.decoder.push(&transfer);
                *lock(&self.shared.statistics) = self.decoder.statistics();
                self.hand_out(received);
            }
            self.expire();
        }
    }

    fn send(&mut self, command: &Command, answer: Option<SyncSender<Result<Reply>>>) -> Result<()> {
        self.sequence = self.sequence.wrapping_add(1).max(1);
        let mut buffer = [0; MAX_FRAME];
        match message::encode_command(&mut buffer, self.sequence, command) {
            Ok(bytes) => self.transport.send(bytes)?,
            Err(error) => {
                if let Some(answer) = answer {
                    let text = format!("`{}` cannot be sent: {error}", command_name(command));
                    let _ = answer.send(Err(Error::Invalid(text)));
                }
                return Ok(());
            }
        }
        self.last_sent = Instant::now();
        self.samples_at_last_sent = self.decoder.statistics().samples;
        if matches!(command, Command::StreamOn { .. }) {
            self.decoder.expect_new_stream();
        }
        self.pending.push(Pending {
            sequence: self.sequence,
            name: command_name(command),
            deadline: self.last_sent + COMMAND_TIMEOUT,
            starts_stream: matches!(command, Command::StreamOn { .. }),
            answer,
        });
        Ok(())
    }

    fn hand_out(&mut self, received: Received) {
        for frame in received.others {
            if frame.kind != Kind::Reply {
                continue;
            }
            let Some(at) = self.pending.iter().position(|p| p.sequence == frame.sequence) else {
                continue;
            };
            let pending = self.pending.swap_remove(at);
            if pending.starts_stream {
                self.decoder.expect_new_stream();
            }
            let Some(answer) = pending.answer else { continue };
            let reply = message::decode_reply(&frame.borrow()).map_err(|error| {
                Error::Invalid(format!("the answer to `{}` cannot be read: {error}", pending.name))
            });
            let _ = answer.send(reply);
        }
        if received.samples.is_empty() {
            return;
        }
        let batch = Batch { samples: received.samples.into(), restarted: received.restarted };
        lock(&self.shared.subscribers).retain(|s| s.send(batch.clone()).is_ok());
    }

    fn expire(&mut self) {
        let now = Instant::now();
        self.pending.retain_mut(|pending| {
            if now < pending.deadline {
                return true;
            }
            if let Some(answer) = pending.answer.take() {
                let command = pending.name.to_owned();
                let _ = answer.send(Err(Error::Timeout { command, after: COMMAND_TIMEOUT }));
            }
            false
        });
    }
}
