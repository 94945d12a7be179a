//! The board's side of the conversation, without the board: frames in, actions of a [`Device`], frames out.
//!
//! The firmware and the virtual board of the host share it, so that both answer alike. It decides nothing about control: it
//! checks what can be checked without the controller, asks the device, and says what took effect.
//!
//! Large messages (settings, table points) are dealt with before anything waits, so that the board need not keep them.
#![expect(
    clippy::result_large_err,
    reason = "a refusal names the setting that cannot be used, and nothing can be allocated"
)]

use super::frame::{Frame, Kind};
use super::identity::Identity;
use super::message::{
    self, Command, Counters, Crash, MessageError, Refusal, Reply, SCHEMA_HASH, Status,
};
use super::stream::{Fields, Profile, sample_bytes};
use crate::generator::PeakSearch;
use crate::settings::{AxisSettings, Check};
use crate::{
    AXES, Config, Flags, Generator, GeneratorSettings, Settings, SettingsError, TABLE_POINTS,
};

/// What a board does. Methods that wait for the tick are asynchronous; a device without hardware returns at once.
#[expect(async_fn_in_trait, reason = "used on one executor only; the futures need not be Send")]
pub trait Device {
    /// Who it is.
    fn identity(&self) -> Identity;
    /// Its state.
    fn status(&self) -> Status;
    /// Its counters; those of commands are the session's and overwritten by it.
    fn counters(&self) -> Counters;
    /// How its last run ended.
    fn crash(&self) -> Crash;
    /// The settings in effect.
    fn settings(&self) -> &Settings;
    /// Whether settings are for this device's converters.
    ///
    /// # Errors
    /// The first one that is not.
    fn fits(&self, settings: &Settings) -> Result<(), SettingsError>;
    /// Puts a checked configuration into effect and keeps the settings it came from; the tick from which it acts.
    fn configure(&mut self, settings: &Settings, config: Config) -> Result<u32, Refusal>;
    /// Writes points of the table, which is out of use until [`Device::use_table`]; the range is checked. Only called while the loop
    /// is open.
    fn write_table(&mut self, offset: usize, points: &[f32]) -> Result<(), Refusal>;
    /// Puts the table into use; the tick from which. Only called while the loop is open.
    fn use_table(&mut self, len: usize) -> Result<u32, Refusal>;
    /// Starts a stream, in place of the one that is on, or ends that; the tick from which.
    fn stream(&mut self, stream: Option<(Fields, Profile)>) -> u32;
    /// Restarts once the reply is out, into the DFU loader if `dfu`. Only called while parked.
    fn reboot(&mut self, dfu: bool);
    /// Passes a command to the controller; the tick at which it acts.
    async fn control(&mut self, command: crate::Command) -> Result<u32, Refusal>;
    /// Writes the settings in effect to permanent memory; number and slot of the copy. Only called while parked.
    async fn save(&mut self) -> Result<(u32, u8), Refusal>;
    /// Lets others run, in the midst of something long. A device that is alone has nobody to let.
    async fn pause(&mut self) {}
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

/// What is left of a command once its large parts are dealt with.
enum Next {
    /// The answer is written and this long.
    Answered(usize),
    /// For the controller.
    Control(crate::Command),
    /// Keep a waveform.
    Stage { axis: u8, generator: Generator },
    /// Stage, stream, start.
    Probe { axis: u8, generator: Generator, fields: Fields, profile: Profile },
    /// Write to flash.
    Save,
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
        let sequence = frame.sequence;
        match self.begin(device, frame, framing_errors, out) {
            Next::Answered(length) => length,
            Next::Control(command) => {
                let result = device.control(command).await;
                self.done(sequence, result, out)
            }
            Next::Stage { axis, generator } => {
                let result = stage(device, axis, generator).await;
                self.done(sequence, result, out)
            }
            Next::Probe { axis, generator, fields, profile } => {
                let result = probe(device, axis, generator, fields, profile).await;
                self.done(sequence, result, out)
            }
            Next::Save => {
                let result = device.save().await;
                self.saved(sequence, result, out)
            }
        }
    }

    /// Everything that needs no waiting.
    fn begin<D: Device>(
        &mut self,
        device: &mut D,
        frame: &Frame<'_>,
        framing_errors: u32,
        out: &mut [u8],
    ) -> Next {
        match frame.kind {
            Kind::Identify => Next::Answered(identify(device, frame.sequence, out)),
            Kind::Command => self.decode(device, frame, framing_errors, out),
            // A device never answers what only devices send.
            Kind::Stream | Kind::Reply | Kind::Identity => {
                self.malformed = self.malformed.saturating_add(1);
                Next::Answered(0)
            }
        }
    }

    /// Not inlined, here and below: what lies on the board's stack at once are the parts of one command, not all of them.
    #[inline(never)]
    fn decode<D: Device>(
        &mut self,
        device: &mut D,
        frame: &Frame<'_>,
        framing_errors: u32,
        out: &mut [u8],
    ) -> Next {
        match message::decode_command(frame) {
            Ok(command) => {
                self.commands = self.commands.saturating_add(1);
                self.execute(device, &command, framing_errors, frame.sequence, out)
            }
            Err(MessageError::Schema { .. }) => {
                self.malformed = self.malformed.saturating_add(1);
                Next::Answered(identify(device, frame.sequence, out))
            }
            Err(MessageError::Kind | MessageError::Payload) => {
                self.malformed = self.malformed.saturating_add(1);
                Next::Answered(self.refuse(frame.sequence, Refusal::Malformed, out))
            }
        }
    }

    #[inline(never)]
    fn done(&mut self, sequence: u16, result: Result<u32, Refusal>, out: &mut [u8]) -> usize {
        self.answer(sequence, result.map(|tick| Reply::Done { tick }), out)
    }

    #[inline(never)]
    fn saved(
        &mut self,
        sequence: u16,
        result: Result<(u32, u8), Refusal>,
        out: &mut [u8],
    ) -> usize {
        self.answer(sequence, result.map(|(version, slot)| Reply::Saved { version, slot }), out)
    }

    #[inline(never)]
    fn refuse(&mut self, sequence: u16, refusal: Refusal, out: &mut [u8]) -> usize {
        self.answer(sequence, Err(refusal), out)
    }

    #[inline(never)]
    fn configured<D: Device>(
        &mut self,
        device: &mut D,
        settings: &Settings,
        sequence: u16,
        out: &mut [u8],
    ) -> usize {
        match configure(device, settings) {
            Ok((tick, digest)) => self.took_effect(sequence, tick, digest, out),
            Err(refusal) => self.refuse(sequence, refusal, out),
        }
    }

    #[inline(never)]
    fn took_effect(&mut self, sequence: u16, tick: u32, digest: u32, out: &mut [u8]) -> usize {
        self.answer(sequence, Ok(Reply::Configured { tick, digest }), out)
    }

    #[inline(never)]
    fn at_once<D: Device>(
        &mut self,
        device: &mut D,
        command: &Command,
        framing_errors: u32,
        sequence: u16,
        out: &mut [u8],
    ) -> usize {
        let result = small(self, device, command, framing_errors);
        self.answer(sequence, result, out)
    }

    fn answer(&mut self, sequence: u16, result: Result<Reply, Refusal>, out: &mut [u8]) -> usize {
        if result.is_err() {
            self.refused = self.refused.saturating_add(1);
        }
        let reply = result.unwrap_or_else(Reply::Refused);
        message::encode_reply(out, sequence, &reply).map_or(0, <[u8]>::len)
    }

    #[inline(never)]
    fn execute<D: Device>(
        &mut self,
        device: &mut D,
        command: &Command,
        framing_errors: u32,
        sequence: u16,
        out: &mut [u8],
    ) -> Next {
        use crate::Command as Control;
        let next = match command {
            Command::Arm => Ok(Next::Control(Control::Arm)),
            Command::Disarm => Ok(Next::Control(Control::Disarm)),
            Command::Hold => Ok(Next::Control(Control::Hold)),
            Command::ClearFaults => Ok(Next::Control(Control::ClearFaults)),
            Command::KeepAlive => Ok(Next::Control(Control::KeepAlive)),
            Command::Start { axes } => Ok(Next::Control(Control::Start { axes: *axes })),
            Command::Stage { axis, generator } => {
                build(generator).map(|generator| Next::Stage { axis: *axis, generator })
            }
            Command::Probe { axis, generator, fields, profile } => {
                prepare_probe(*axis, generator, *fields, *profile)
            }
            Command::Save => parked(device).map(|()| Next::Save),
            Command::ReadSettings => {
                Ok(Next::Answered(message::encode_settings(out, sequence, device.settings())))
            }
            Command::SetSettings(settings) => {
                return Next::Answered(self.configured(device, settings, sequence, out));
            }
            _ => {
                let length = self.at_once(device, command, framing_errors, sequence, out);
                return Next::Answered(length);
            }
        };
        next.unwrap_or_else(|refusal| Next::Answered(self.refuse(sequence, refusal, out)))
    }
}

/// Commands that are answered at once, with little.
fn small<D: Device>(
    session: &Session,
    device: &mut D,
    command: &Command,
    framing_errors: u32,
) -> Result<Reply, Refusal> {
    match command {
        Command::Status => Ok(Reply::Status(device.status())),
        Command::Counters => Ok(Reply::Counters(Counters {
            commands: session.commands,
            refused: session.refused,
            malformed: session.malformed.saturating_add(framing_errors),
            ..device.counters()
        })),
        Command::Crash => Ok(Reply::Crash(device.crash())),
        Command::WriteTable { offset, points } => write_table(device, usize::from(*offset), points),
        Command::UseTable { len } => use_table(device, usize::from(*len)),
        Command::StreamOn { fields, profile } => stream_on(device, *fields, *profile),
        Command::StreamOff => Ok(Reply::Done { tick: device.stream(None) }),
        Command::Reboot => reboot(device, false),
        Command::RebootToDfu => reboot(device, true),
        Command::ReadSettings
        | Command::Arm
        | Command::Disarm
        | Command::Hold
        | Command::ClearFaults
        | Command::KeepAlive
        | Command::Stage { .. }
        | Command::Start { .. }
        | Command::SetSettings(_)
        | Command::Probe { .. }
        | Command::Save => Err(Refusal::Malformed),
    }
}

fn prepare_probe(
    axis: u8,
    generator: &GeneratorSettings,
    fields: Fields,
    profile: Profile,
) -> Result<Next, Refusal> {
    if usize::from(axis) >= AXES || !fields.is_valid() {
        return Err(Refusal::Range);
    }
    build(generator).map(|generator| Next::Probe { axis, generator, fields, profile })
}

fn identify<D: Device>(device: &D, sequence: u16, out: &mut [u8]) -> usize {
    let payload = Identity { schema: SCHEMA_HASH, ..device.identity() }.to_bytes();
    super::encode(out, Kind::Identity, sequence, &payload).map_or(0, <[u8]>::len)
}

/// But for what takes long, which [`stage`] does.
fn build(generator: &GeneratorSettings) -> Result<Generator, Refusal> {
    Generator::outline(generator).map_err(bad_setting)
}

/// Checked whole, then in effect; the tick and what was built.
#[inline(never)]
fn configure<D: Device>(device: &mut D, settings: &Settings) -> Result<(u32, u32), Refusal> {
    acceptable(device, settings).map_err(bad_setting)?;
    let config = Config::build(settings).map_err(bad_setting)?;
    let digest = config.digest();
    device.configure(settings, config).map(|tick| (tick, digest))
}

fn acceptable<D: Device>(device: &D, settings: &Settings) -> Result<(), SettingsError> {
    device.fits(settings)?;
    let is_parked = Flags(device.status().flags).is_parked();
    if is_parked { Ok(()) } else { stays_in_place(device.settings(), settings) }
}

#[inline(never)]
fn bad_setting(error: SettingsError) -> Refusal {
    Refusal::Settings(error.into())
}

/// Whether drives that are up stay where they are: the line from drive to code is the last thing before the pin, behind the slew limit and
/// what makes a change of settings bumpless, and limits that close in on a stage would throw it inside.
#[inline(never)]
fn stays_in_place(before: &Settings, after: &Settings) -> Result<(), SettingsError> {
    const VOLTS: &str = "V while not parked: disarm first";
    // Whether it may be smaller and larger.
    const FIELDS: [(&str, &str, &str, bool, bool); 7] = [
        ("dac", "at_zero_v", VOLTS, false, false),
        ("dac", "at_full_v", VOLTS, false, false),
        ("dac", "full_code", "while not parked: disarm first", false, false),
        ("limits", "min_v", VOLTS, true, false),
        ("limits", "max_v", VOLTS, false, true),
        ("limits", "min_um", "um while not parked: disarm first", true, false),
        ("limits", "max_um", "um while not parked: disarm first", false, true),
    ];
    let numbers = |axis: &AxisSettings| {
        let (dac, limits) = (&axis.dac, &axis.limits);
        let codes = dac.full_code as f32;
        let (volts, travel) = ([limits.min_v, limits.max_v], [limits.min_um, limits.max_um]);
        [dac.at_zero_v, dac.at_full_v, codes, volts[0], volts[1], travel[0], travel[1]]
    };
    for (k, (before, after)) in before.axes.iter().zip(&after.axes).enumerate() {
        let pairs = numbers(before).into_iter().zip(numbers(after));
        for ((group, field, unit, smaller, larger), (old, new)) in FIELDS.into_iter().zip(pairs) {
            let least = if smaller { f32::MIN } else { old };
            let most = if larger { f32::MAX } else { old };
            Check::axis(group, k).range(field, new, least, most, unit)?;
        }
    }
    Ok(())
}

fn write_table<D: Device>(device: &mut D, offset: usize, points: &[f32]) -> Result<Reply, Refusal> {
    not_active(device)?;
    // The comparison is false for not-a-number.
    if offset + points.len() > TABLE_POINTS || !points.iter().all(|point| point.abs() <= 1.0) {
        return Err(Refusal::Range);
    }
    device.write_table(offset, points)?;
    Ok(Reply::Done { tick: device.status().tick })
}

fn use_table<D: Device>(device: &mut D, len: usize) -> Result<Reply, Refusal> {
    if !(1..=TABLE_POINTS).contains(&len) {
        return Err(Refusal::Range);
    }
    not_active(device)?;
    device.use_table(len).map(|tick| Reply::Done { tick })
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

/// Everything that a waveform needs before its start; the tick from which it waits.
async fn stage<D: Device>(
    device: &mut D,
    axis: u8,
    mut generator: Generator,
) -> Result<u32, Refusal> {
    let mut search = PeakSearch::NEW;
    while !generator.scale(&mut search) {
        device.pause().await;
    }
    let mut staged = Err(Refusal::NotReady);
    for command in generator.staging(axis) {
        staged = device.control(command).await;
        if staged.is_err() {
            break;
        }
    }
    staged
}

/// Stream first, excite after, so that the record holds all of the excitation; as before if it is refused. A stream that is like it already
/// is not begun anew, which would cost it samples and its count of those dropped.
async fn probe<D: Device>(
    device: &mut D,
    axis: u8,
    generator: Generator,
    fields: Fields,
    profile: Profile,
) -> Result<u32, Refusal> {
    can_start(device)?;
    stage(device, axis, generator).await?;
    // Staging may take long.
    can_start(device)?;
    let (before, wanted) = (device.status().stream, Some((fields, profile)));
    if before != wanted {
        device.stream(wanted);
    }
    let started = device.control(crate::Command::Start { axes: 1 << axis }).await;
    if started.is_err() && before != wanted {
        device.stream(before);
    }
    started
}

/// What the controller will say to a start, by the state that it was in at the last tick.
#[inline(never)]
fn can_start<D: Device>(device: &D) -> Result<(), Refusal> {
    use crate::State;
    match Flags(device.status().flags).state() {
        State::Run | State::Hold => Ok(()),
        State::Arming => Err(Refusal::Control(crate::Refusal::StillArming)),
        State::Fault => Err(Refusal::Control(crate::Refusal::Faulted)),
        State::Off => Err(Refusal::Control(crate::Refusal::NotArmed)),
    }
}

fn not_active<D: Device>(device: &D) -> Result<(), Refusal> {
    if Flags(device.status().flags).state().is_active() { Err(Refusal::Armed) } else { Ok(()) }
}

fn parked<D: Device>(device: &D) -> Result<(), Refusal> {
    if Flags(device.status().flags).is_parked() { Ok(()) } else { Err(Refusal::NotParked) }
}

fn reboot<D: Device>(device: &mut D, dfu: bool) -> Result<Reply, Refusal> {
    parked(device)?;
    device.reboot(dfu);
    Ok(Reply::Done { tick: device.status().tick })
}

/// The result of a future that never waits, like those of a [`Device`] without hardware; `None` if it does wait.
pub fn ready<F: Future>(future: F) -> Option<F::Output> {
    let mut context = core::task::Context::from_waker(core::task::Waker::noop());
    match core::pin::pin!(future).poll(&mut context) {
        core::task::Poll::Ready(output) => Some(output),
        core::task::Poll::Pending => None,
    }
}

#[cfg(test)]
mod tests;
