//! A board without hardware: the real control core in closed loop with the plant of `host-sim`, behind the real wire format.
//!
//! It answers through [`flexstage::link::session`], the same code as the firmware, and streams the same frames. What it does not have
//! is the microcontroller: no interrupt, no USB, no flash. Tick times are those of this computer's processor.
//!
//! In real time a host that does not read loses samples, and the drop counter says so, as on the board. At full speed
//! simulated time waits for the host, so nothing is ever lost.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender, TrySendError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use flexstage::link::message::{Counters, Crash, Refusal, Status};
use flexstage::link::session::{Device, Session, ready};
use flexstage::link::stream::Sample as WireSample;
use flexstage::link::{Deframer, Fields, Identity, MAX_FRAME, Profile, StreamWriter};
use flexstage::{AXES, Command, Config, Controller, Record, Settings, TICK_HZ, Table};
use host_sim::{Plant, Rig};

use crate::transport::Transport;
use crate::{Error, Result};

/// Frames that may wait for the host: at 30 samples a frame a tenth of a second.
const QUEUE_FRAMES: usize = 32;
/// Most ticks between two looks at the inbox.
const BATCH_TICKS: u64 = 32;
/// Longest stretch that real time may be behind before it is given up as lost time (a suspended computer).
const CATCH_UP: Duration = Duration::from_secs(1);
/// Ticks a frame waits to be filled before it is sent as it is.
const FRAME_TICKS: u64 = 32;
/// Core clock that tick times are given in.
const CORE_HZ: u32 = 170_000_000;

/// How fast simulated time goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Speed {
    /// As the wall clock.
    #[default]
    RealTime,
    /// As fast as the computer can and the host reads.
    Max,
}

/// What the virtual board is connected to.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The rig that is simulated, with whatever effects it has.
    pub rig: Rig,
    /// Seed of the sensor noise.
    pub seed: u64,
    /// Speed.
    pub speed: Speed,
    /// Settings in the board's memory; the default is the first paper's rig.
    pub settings: Settings,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            rig: Rig::named("handley").unwrap_or_else(|| unreachable!("the built-in rig is there")),
            seed: 1,
            speed: Speed::RealTime,
            settings: Settings::default(),
        }
    }
}

/// The board's thread and the two ends of its cable.
pub struct VirtualBoard {
    to_board: Option<Sender<Vec<u8>>>,
    from_board: Option<Receiver<Vec<u8>>>,
    thread: Option<JoinHandle<()>>,
    rig: String,
}

impl VirtualBoard {
    /// Power it up.
    pub fn start(options: &Options) -> Result<Self> {
        let plant_options = host_sim::Options {
            sample_rate_hz: Some(f64::from(TICK_HZ)),
            seed: options.seed,
            ..host_sim::Options::default()
        };
        let plant =
            Plant::new(&options.rig, plant_options).map_err(|e| Error::Rig(e.to_string()))?;
        let mut board = Board::new(plant, options)?;
        // By the time a host finds a board its guard has seen that the drives are parked.
        (0..BATCH_TICKS).for_each(|_| board.step());
        let (to_board, inbox) = mpsc::channel();
        let (outbox, from_board) = mpsc::sync_channel(QUEUE_FRAMES);
        let speed = options.speed;
        let thread = std::thread::Builder::new()
            .name("virtual board".into())
            .spawn(move || run(board, &inbox, &outbox, speed))
            .map_err(|source| Error::File { path: "virtual board thread".into(), source })?;
        Ok(Self {
            to_board: Some(to_board),
            from_board: Some(from_board),
            thread: Some(thread),
            rig: options.rig.name.clone(),
        })
    }

    fn gone(&self) -> Error {
        Error::Lost { board: self.name(), reason: "it was switched off".into() }
    }
}

impl Transport for VirtualBoard {
    fn name(&self) -> String {
        format!("the virtual board ({})", self.rig)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<()> {
        let sender = self.to_board.as_ref().ok_or_else(|| self.gone())?;
        sender.send(bytes.to_vec()).map_err(|_| self.gone())
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>> {
        let receiver = self.from_board.as_ref().ok_or_else(|| self.gone())?;
        match receiver.recv_timeout(timeout) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(self.gone()),
        }
    }
}

impl Drop for VirtualBoard {
    fn drop(&mut self) {
        // Both ends go first, so that the thread finds out wherever it waits.
        self.to_board = None;
        self.from_board = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn run(mut board: Board, inbox: &Receiver<Vec<u8>>, outbox: &SyncSender<Vec<u8>>, speed: Speed) {
    let mut session = Session::new();
    let mut deframer = Deframer::new();
    let mut epoch = Instant::now();
    let mut epoch_tick = 0u64;
    let period = Duration::from_secs(1) / TICK_HZ;
    loop {
        loop {
            let bytes = match inbox.try_recv() {
                Ok(bytes) => bytes,
                Err(mpsc::TryRecvError::Empty) => break,
                Err(mpsc::TryRecvError::Disconnected) => return,
            };
            let mut answers = Vec::new();
            let malformed = deframer.malformed;
            deframer.push(&bytes, |frame| {
                let mut out = [0; MAX_FRAME];
                // Nothing of this board waits, so the answer is there at once.
                let length =
                    ready(session.handle(&mut board, &frame, malformed, &mut out)).unwrap_or(0);
                answers.push(out[..length].to_vec());
            });
            deframer.end_of_transfer();
            for answer in answers {
                if outbox.send(answer).is_err() {
                    return;
                }
            }
        }
        let due = match speed {
            Speed::Max => board.tick + BATCH_TICKS,
            Speed::RealTime => {
                let elapsed = epoch.elapsed();
                let due = epoch_tick + (elapsed.as_nanos() / period.as_nanos()) as u64;
                if due > board.tick + (CATCH_UP.as_nanos() / period.as_nanos()) as u64 {
                    epoch = Instant::now();
                    epoch_tick = board.tick;
                }
                if due <= board.tick {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
                due.min(board.tick + BATCH_TICKS)
            }
        };
        while board.tick < due {
            board.step();
            let Some(frame) = board.frame(false) else { continue };
            let sent = match speed {
                Speed::Max => outbox.send(frame.bytes).map_err(|_| ()),
                Speed::RealTime => match outbox.try_send(frame.bytes) {
                    Ok(()) => Ok(()),
                    Err(TrySendError::Full(_)) => {
                        board.dropped = board.dropped.wrapping_add(frame.samples);
                        Ok(())
                    }
                    Err(TrySendError::Disconnected(_)) => Err(()),
                },
            };
            if sent.is_err() {
                return;
            }
        }
    }
}

struct FrameOut {
    bytes: Vec<u8>,
    samples: u32,
}

/// Everything on the far side of the cable.
struct Board {
    plant: Plant,
    controller: Controller,
    config: Config,
    /// Scaling of the converters as they are, whatever the settings say about them.
    hardware: Config,
    settings: Settings,
    stored: Settings,
    saves: u32,
    table: Table,
    points: Vec<f32>,
    tick: u64,
    last: Record,
    stream: Option<(Fields, Profile)>,
    queue: Vec<WireSample>,
    sequence: u16,
    dropped: u32,
    frames: u32,
    cycles: [u32; 2],
    histogram: [u32; flexstage::link::message::HISTOGRAM_BINS],
}

impl Board {
    fn new(plant: Plant, options: &Options) -> Result<Self> {
        let build = |settings: &Settings| {
            Config::build(settings).map_err(|e| Error::Invalid(e.to_string()))
        };
        let config = build(&options.settings)?;
        let hardware = build(&Settings::default())?;
        let mut last = Record::default();
        for (axis, record) in last.axes.iter_mut().enumerate() {
            // The conditioner puts the drives at 0 V before the first tick.
            let full = 4096u16;
            record.dac = (0..full)
                .min_by(|a, b| {
                    let off = |code: u16| hardware.dac_volts(axis, code).abs();
                    off(*a).total_cmp(&off(*b))
                })
                .unwrap_or(0);
        }
        Ok(Self {
            plant,
            controller: Controller::new(),
            config,
            hardware,
            settings: options.settings.clone(),
            stored: options.settings.clone(),
            saves: 0,
            table: Table::EMPTY,
            points: vec![0.0; flexstage::TABLE_POINTS],
            tick: 0,
            last,
            stream: None,
            queue: Vec::new(),
            sequence: 0,
            dropped: 0,
            frames: 0,
            cycles: [0; 2],
            histogram: [0; flexstage::link::message::HISTOGRAM_BINS],
        })
    }

    /// One tick of plant and controller, as the trigger and the interrupt do it: sample, latch the codes of the tick
    /// before, compute the next ones.
    fn step(&mut self) {
        let mut codes = flexstage::Sample { gauge: [0; AXES], monitor: [0; AXES], overrun: false };
        let clip = |code: i32| code.clamp(0, 0xffff);
        let readings = self.plant.sample();
        for axis in 0..AXES {
            let (um, volt) = readings
                .get(axis)
                .map_or((0.0, 0.0), |reading| (reading.sensed_m * 1e6, reading.monitor_v));
            codes.gauge[axis] = clip(self.hardware.gauge_code(axis, um));
            codes.monitor[axis] = clip(self.hardware.monitor_code(axis, volt));
        }
        let held: Vec<f64> = (0..self.plant.axes())
            .map(|axis| {
                let code = self.last.axes.get(axis).map_or(0, |record| record.dac);
                self.hardware.dac_volts(axis.min(AXES - 1), code)
            })
            .collect();
        self.plant.advance(&held);
        let started = Instant::now();
        let record = self.controller.tick(&self.config, &self.table, &codes);
        let nanoseconds = started.elapsed().as_nanos() as u64;
        let cycles = (nanoseconds * u64::from(CORE_HZ) / 1_000_000_000) as u32;
        self.cycles = [cycles, self.cycles[1].max(cycles)];
        let bin = (cycles / flexstage::link::message::HISTOGRAM_BIN_CYCLES) as usize;
        let last_bin = self.histogram.len() - 1;
        self.histogram[bin.min(last_bin)] += 1;
        if self.stream.is_some() {
            self.queue.push(WireSample {
                tick: self.tick,
                reference: record.axes.map(|a| a.reference.to_bits()),
                position: record.axes.map(|a| a.position.to_bits()),
                // Latched at this tick: what the tick before computed.
                drive: self.last.axes.map(|a| a.drive.to_bits()),
                monitor: record.axes.map(|a| a.monitor.to_bits()),
                flags: record.flags.0,
                cycles: cycles.min(u32::from(u16::MAX)) as u16,
                gauge_code: codes.gauge.map(|c| c as u16),
                dac_code: record.axes.map(|a| a.dac),
            });
        }
        self.last = record;
        self.tick += 1;
    }

    /// The next frame, when there are enough samples for one.
    fn frame(&mut self, flush: bool) -> Option<FrameOut> {
        let (fields, profile) = self.stream?;
        if self.queue.is_empty() || !(flush || self.queue.len() as u64 >= FRAME_TICKS) {
            return None;
        }
        let mut buffer = [0; MAX_FRAME];
        let mut writer = StreamWriter::new(&mut buffer, fields, profile);
        let samples = self.queue.iter().take_while(|sample| writer.push(sample)).count();
        let length = writer.finish(self.sequence, self.dropped).ok()?;
        self.queue.drain(..samples);
        self.sequence = self.sequence.wrapping_add(1);
        self.frames = self.frames.wrapping_add(1);
        Some(FrameOut { bytes: buffer[..length].to_vec(), samples: samples as u32 })
    }
}

impl Device for Board {
    fn identity(&self) -> Identity {
        let mut serial = [0; 12];
        serial[..7].copy_from_slice(b"virtual");
        let part = |text: &str| text.parse().unwrap_or(0);
        Identity {
            schema: flexstage::link::message::SCHEMA_HASH,
            firmware: [
                part(env!("CARGO_PKG_VERSION_MAJOR")),
                part(env!("CARGO_PKG_VERSION_MINOR")),
                part(env!("CARGO_PKG_VERSION_PATCH")),
            ],
            axes: AXES as u8,
            serial,
            sample_rate_hz: TICK_HZ,
            core_hz: CORE_HZ,
            reset_flags: 1 << 3,
            has_crash_report: 0,
            has_stored_config: 0,
            self_test: 0,
            restarts: 0,
        }
    }

    fn status(&self) -> Status {
        Status {
            tick: self.tick as u32,
            flags: self.last.flags.0,
            digest: self.config.digest(),
            is_stored: self.settings == self.stored,
            stream: self.stream,
            uptime_ms: (self.tick / u64::from(TICK_HZ / 1000)) as u32,
            has_crash: false,
        }
    }

    fn counters(&self) -> Counters {
        Counters {
            ticks: self.tick as u32,
            cycles_last: self.cycles[0],
            cycles_max: self.cycles[1],
            cycles_histogram: self.histogram,
            dropped: self.dropped,
            frames: self.frames,
            ..Counters::default()
        }
    }

    fn crash(&self) -> Crash {
        Crash::default()
    }

    fn settings(&self) -> &Settings {
        &self.settings
    }

    async fn control(&mut self, command: Command) -> std::result::Result<u32, Refusal> {
        self.controller.command(&self.config, command).map_err(Refusal::Control)?;
        Ok(self.tick as u32)
    }

    /// The simulated converters are what the settings say.
    fn fits(&self, _: &Settings) -> std::result::Result<(), flexstage::SettingsError> {
        Ok(())
    }

    fn configure(
        &mut self,
        settings: &Settings,
        config: Config,
    ) -> std::result::Result<u32, Refusal> {
        self.settings = settings.clone();
        self.config = config;
        Ok(self.tick as u32)
    }

    fn write_table(&mut self, offset: usize, points: &[f32]) -> std::result::Result<(), Refusal> {
        let place = self.points.get_mut(offset..offset + points.len()).ok_or(Refusal::Range)?;
        place.copy_from_slice(points);
        Ok(())
    }

    fn use_table(&mut self, len: usize) -> std::result::Result<u32, Refusal> {
        let points = self.points.get(..len).ok_or(Refusal::Range)?;
        self.table.set(points).map_err(|e| Refusal::Settings(e.into()))?;
        Ok(self.tick as u32)
    }

    fn stream(&mut self, stream: Option<(Fields, Profile)>) -> u32 {
        self.stream = stream;
        self.queue.clear();
        // The count of a stream that has ended stays until the next one starts.
        if stream.is_some() {
            self.dropped = 0;
        }
        self.tick as u32
    }

    async fn save(&mut self) -> std::result::Result<(u32, u8), Refusal> {
        self.stored = self.settings.clone();
        self.saves += 1;
        Ok((self.saves, (self.saves % 2) as u8))
    }

    fn reboot(&mut self, _dfu: bool) {
        self.settings = self.stored.clone();
        if let Ok(config) = Config::build(&self.settings) {
            self.config = config;
        }
        self.controller = Controller::new();
        self.stream = None;
        self.queue.clear();
    }
}
