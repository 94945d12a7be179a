//! The board's side of the conversation, without the board: frames in, actions of a [`Device`], frames out.
//!
//! The firmware and the virtual board of the host share it, so that both answer alike. It decides nothing about control: it
//! checks what can be checked without the controller, asks the device, and says what took effect.

use heapless::Vec;

use super::frame::{Frame, Kind};
use super::identity::Identity;
use super::message::{
    self, Command, Counters, Crash, MessageError, Refusal, Reply, SCHEMA_HASH, Status, TABLE_CHUNK,
};
use super::stream::{Fields, Profile, sample_bytes};
use crate::{AXES, Config, Generator, GeneratorSettings, Settings, TABLE_POINTS};

/// What a board does. Methods that wait for the tick are asynchronous; a device without hardware returns at once.
#[expect(async_fn_in_trait, reason = "used on one executor only; the futures need not be Send")]
pub trait Device {
    /// Who it is.
    fn identity(&self) -> Identity;
    /// Its state.
    fn status(&self) -> Status;
    /// Its counters; `malformed`, `commands` and `refused` are the session's and overwritten by it.
    fn counters(&self) -> Counters;
    /// How its last run ended.
    fn crash(&self) -> Crash;
    /// The settings in effect.
    fn settings(&self) -> &Settings;
    /// Passes a command to the controller; the tick at which it acts.
    async fn control(&mut self, command: crate::Command) -> Result<u32, Refusal>;
    /// Puts a checked configuration into effect, and keeps the settings it came from; the tick at which it acts.
    async fn configure(&mut self, settings: Settings, config: Config) -> Result<u32, Refusal>;
    /// Writes points of the table that is not in use.
    fn write_table(&mut self, offset: usize, points: &[f32]) -> Result<(), Refusal>;
    /// Puts that table into use.
    async fn use_table(&mut self, len: usize) -> Result<u32, Refusal>;
    /// Starts (or changes) or ends the stream; the tick from which.
    fn stream(&mut self, stream: Option<(Fields, Profile)>) -> u32;
    /// Writes the settings in effect to permanent memory; number and slot of the copy. Only called while parked.
    async fn save(&mut self) -> Result<(u32, u8), Refusal>;
    /// Restarts once the reply is out, into the DFU loader if `dfu`. Only called while parked.
    fn reboot(&mut self, dfu: bool);
}

/// Counts of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Session {
    /// Commands taken.
    pub commands: u32,
    /// Commands refused.
    pub refused: u32,
    /// Whole frames that were no command.
    pub malformed: u32,
}

impl Session {
    /// No commands yet.
    pub const fn new() -> Self {
        Self { commands: 0, refused: 0, malformed: 0 }
    }

    /// Answers one frame; returns the length of the answer in `out`, 0 if there is none. `framing_errors` is
    /// [`Deframer::malformed`](super::Deframer::malformed) of the stream that the frame came from.
    pub async fn handle<D: Device>(
        &mut self,
        device: &mut D,
        frame: &Frame<'_>,
        framing_errors: u32,
        out: &mut [u8],
    ) -> usize {
        let reply = match (frame.kind, message::decode_command(frame)) {
            (Kind::Identify, _) => return identify(device, frame.sequence, out),
            (_, Ok(command)) => {
                self.commands = self.commands.saturating_add(1);
                self.execute(device, command, framing_errors).await
            }
            (Kind::Command, Err(MessageError::Schema { .. })) => {
                self.malformed = self.malformed.saturating_add(1);
                return identify(device, frame.sequence, out);
            }
            (Kind::Command, Err(_)) => {
                self.malformed = self.malformed.saturating_add(1);
                Reply::Refused(Refusal::Malformed)
            }
            // A device never answers what only devices send.
            (Kind::Stream | Kind::Reply | Kind::Identity, Err(_)) => {
                self.malformed = self.malformed.saturating_add(1);
                return 0;
            }
        };
        if matches!(reply, Reply::Refused(_)) {
            self.refused = self.refused.saturating_add(1);
        }
        message::encode_reply(out, frame.sequence, &reply).map_or(0, <[u8]>::len)
    }

    async fn execute<D: Device>(
        &mut self,
        device: &mut D,
        command: Command,
        framing_errors: u32,
    ) -> Reply {
        use crate::Command as Control;
        let result = match command {
            Command::Status => Ok(Reply::Status(device.status())),
            Command::Counters => Ok(Reply::Counters(Counters {
                commands: self.commands,
                refused: self.refused,
                malformed: self.malformed.saturating_add(framing_errors),
                ..device.counters()
            })),
            Command::Crash => Ok(Reply::Crash(device.crash())),
            Command::ReadSettings => Ok(Reply::Settings(device.settings().clone())),
            Command::Arm => done(device, Control::Arm).await,
            Command::Disarm => done(device, Control::Disarm).await,
            Command::Hold => done(device, Control::Hold).await,
            Command::ClearFaults => done(device, Control::ClearFaults).await,
            Command::KeepAlive => done(device, Control::KeepAlive).await,
            Command::Stage { axis, generator } => stage(device, axis, &generator).await,
            Command::Start { axes } => done(device, Control::Start { axes }).await,
            Command::SetSettings(settings) => configure(device, settings).await,
            Command::WriteTable { offset, points } => write_table(device, offset.into(), &points),
            Command::UseTable { len } => use_table(device, len.into()).await,
            Command::StreamOn { fields, profile } => stream_on(device, fields, profile),
            Command::StreamOff => Ok(Reply::Done { tick: device.stream(None) }),
            Command::Probe { axis, generator, fields, profile } => {
                probe(device, axis, &generator, fields, profile).await
            }
            Command::Save => match parked(device) {
                Ok(()) => device.save().await.map(|(version, slot)| Reply::Saved { version, slot }),
                Err(refusal) => Err(refusal),
            },
            Command::Reboot => reboot(device, false),
            Command::RebootToDfu => reboot(device, true),
        };
        result.unwrap_or_else(Reply::Refused)
    }
}

fn identify<D: Device>(device: &D, sequence: u16, out: &mut [u8]) -> usize {
    let payload = Identity { schema: SCHEMA_HASH, ..device.identity() }.to_bytes();
    super::encode(out, Kind::Identity, sequence, &payload).map_or(0, <[u8]>::len)
}

async fn done<D: Device>(device: &mut D, command: crate::Command) -> Result<Reply, Refusal> {
    device.control(command).await.map(|tick| Reply::Done { tick })
}

async fn stage<D: Device>(
    device: &mut D,
    axis: u8,
    generator: &GeneratorSettings,
) -> Result<Reply, Refusal> {
    let generator = Generator::build(generator).map_err(|e| Refusal::Settings(e.into()))?;
    done(device, crate::Command::Stage { axis, generator }).await
}

async fn configure<D: Device>(device: &mut D, settings: Settings) -> Result<Reply, Refusal> {
    let config = Config::build(&settings).map_err(|e| Refusal::Settings(e.into()))?;
    let digest = config.digest();
    device.configure(settings, config).await.map(|tick| Reply::Configured { tick, digest })
}

fn write_table<D: Device>(
    device: &mut D,
    offset: usize,
    points: &Vec<f32, TABLE_CHUNK>,
) -> Result<Reply, Refusal> {
    if offset + points.len() > TABLE_POINTS || !points.iter().all(|p| p.abs() <= 1.0) {
        return Err(Refusal::Range);
    }
    device.write_table(offset, points)?;
    Ok(Reply::Done { tick: device.status().tick })
}

async fn use_table<D: Device>(device: &mut D, len: usize) -> Result<Reply, Refusal> {
    if !(1..=TABLE_POINTS).contains(&len) {
        return Err(Refusal::Range);
    }
    if crate::Flags(device.status().flags).state().is_active() {
        return Err(Refusal::Armed);
    }
    device.use_table(len).await.map(|tick| Reply::Done { tick })
}

fn stream_on<D: Device>(
    device: &mut D,
    fields: Fields,
    profile: Profile,
) -> Result<Reply, Refusal> {
    if !fields.is_valid() {
        return Err(Refusal::Range);
    }
    let tick = device.stream(Some((fields, profile)));
    let sample_bytes = sample_bytes(fields, profile) as u8;
    Ok(Reply::Streaming { tick, fields, profile, sample_bytes })
}

/// Stream first, excite after: everything that can be refused is asked before anything starts.
async fn probe<D: Device>(
    device: &mut D,
    axis: u8,
    generator: &GeneratorSettings,
    fields: Fields,
    profile: Profile,
) -> Result<Reply, Refusal> {
    if usize::from(axis) >= AXES || !fields.is_valid() {
        return Err(Refusal::Range);
    }
    stage(device, axis, generator).await?;
    let before = device.status().stream;
    device.stream(Some((fields, profile)));
    let started = done(device, crate::Command::Start { axes: 1 << axis }).await;
    if started.is_err() {
        device.stream(before);
    }
    started
}

fn parked<D: Device>(device: &D) -> Result<(), Refusal> {
    if crate::Flags(device.status().flags).is_parked() { Ok(()) } else { Err(Refusal::NotParked) }
}

fn reboot<D: Device>(device: &mut D, dfu: bool) -> Result<Reply, Refusal> {
    parked(device)?;
    device.reboot(dfu);
    Ok(Reply::Done { tick: device.status().tick })
}
