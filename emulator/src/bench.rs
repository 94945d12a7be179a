//! A powered board with a rig and a host, ready to be talked to: what the tests and `cargo xtask emulate` use.

use std::rc::Rc;

use anyhow::{Context, Result, anyhow, bail};
use flexstage::link::Identity;
use flexstage::link::message::{Command, Reply};
use flexstage::link::{Fields, Profile};
use flexstage::{GeneratorSettings, Settings, State};
use host_sim::{Options, Rig};

use crate::board::{Board, SharedBoard};
use crate::cpu::image::Image;
use crate::cpu::{Event, Machine};
use crate::link::Link;
use crate::time::{MILLISECOND, SECOND, Time, milliseconds};
use crate::usb_host::Device;

/// The crystal on the board (docs/board.md).
pub const CRYSTAL_HZ: u64 = 24_000_000;
/// How often the host program looks at what arrived.
const LOOK: Time = MILLISECOND;
/// Longest wait for a reply: a save erases two pages.
const REPLY: Time = 2 * SECOND;

/// Chip, board, rig, cable and host program.
pub struct Bench {
    /// The chip.
    pub machine: Machine,
    /// The rig and what is broken about it.
    pub board: SharedBoard,
    /// Decoder of what the device sends.
    pub link: Link,
    /// Resets, boot loader entries, power cuts: since power-on.
    pub events: Vec<(Time, Event)>,
}

impl Bench {
    /// Powers the board with a rig on it; nothing has run yet.
    pub fn new(
        image: Rc<Image>,
        rig: &Rig,
        settings: &Settings,
        options: Options,
    ) -> Result<Bench> {
        let board = SharedBoard::new(Board::new(rig, settings, options)?);
        let mut machine = Machine::new(image, Box::new(board.clone()), CRYSTAL_HZ)?;
        machine.soc_mut().stack.reading = true;
        Ok(Bench { machine, board, link: Link::default(), events: Vec::new() })
    }

    /// A board with the first paper's rig and the settings that suit it.
    pub fn handley(image: Rc<Image>, seed: u64) -> Result<Bench> {
        let rig = Rig::named("handley").context("rig handley")?;
        let settings = host_sim::controller_settings(&rig);
        Bench::new(image, &rig, &settings, Options { seed, ..Options::default() })
    }

    /// Now.
    pub fn now(&self) -> Time {
        self.machine.now()
    }

    /// Runs for so long; resets on the way are noted and run through.
    pub fn run_for(&mut self, time: Time) -> Result<()> {
        let until = self.now() + time;
        while self.now() < until {
            if let Some(event) = self.slice(until.min(self.now() + LOOK))?
                && matches!(event, Event::PowerLost | Event::Bootloader)
            {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Runs to `until` and hands what arrived to the link.
    fn slice(&mut self, until: Time) -> Result<Option<Event>> {
        let event = self.machine.run_until(until)?;
        while let Some((_, bytes)) = self.machine.soc_mut().stack.received.pop_front() {
            self.link.transfer(&bytes);
        }
        if event == Event::Time {
            return Ok(None);
        }
        self.events.push((self.now(), event));
        Ok(Some(event))
    }

    /// Runs until `done`, at most for `patience`.
    pub fn run_until(
        &mut self,
        patience: Time,
        what: &str,
        mut done: impl FnMut(&mut Bench) -> bool,
    ) -> Result<Time> {
        let start = self.now();
        while !done(self) {
            if self.now() - start > patience {
                bail!(
                    "no {what} within {:.1} ms; the core is at {}; log:\n{}",
                    milliseconds(patience),
                    self.machine.location(),
                    self.log_tail(12)
                );
            }
            self.slice(self.now() + LOOK)?;
        }
        Ok(self.now() - start)
    }

    /// The last lines of the firmware's log.
    pub fn log_tail(&self, lines: usize) -> String {
        let all = &self.machine.rtt.lines;
        let tail = &all[all.len().saturating_sub(lines)..];
        tail.iter()
            .map(|l| format!("{:10.3} ms {:5} {}\n", milliseconds(l.at), l.level, l.text))
            .collect()
    }

    /// Runs until the device is enumerated and configured.
    pub fn enumerate(&mut self) -> Result<Device> {
        self.run_until(3 * SECOND, "configured USB device", |b| {
            let stack = &b.machine.soc().stack;
            stack.device().is_some() || stack.failed()
        })?;
        let stack = &self.machine.soc().stack;
        stack.device().cloned().ok_or_else(|| anyhow!("enumeration failed: {:?}", stack.log))
    }

    /// Sends bytes to the device as one bulk OUT transfer.
    pub fn send(&mut self, bytes: Vec<u8>) -> Result<()> {
        self.machine.soc_mut().stack.send(bytes).context("no USB device is configured")?;
        Ok(())
    }

    /// Sends a command and waits for its reply.
    pub fn ask(&mut self, command: &Command) -> Result<Reply> {
        let (sequence, bytes) = self.link.command(command);
        self.send(bytes)?;
        let mut reply = None;
        self.run_until(REPLY, &format!("reply to {command:?}"), |b| {
            reply = b.link.reply(sequence);
            reply.is_some()
        })?;
        reply.context("reply")
    }

    /// As [`Bench::ask`]; a refusal is an error.
    pub fn command(&mut self, command: &Command) -> Result<Reply> {
        match self.ask(command)? {
            Reply::Refused(why) => bail!(
                "{command:?} was refused: {why}; resets so far: {:?}; log:\n{}",
                self.machine.resets,
                self.log_tail(6)
            ),
            reply => Ok(reply),
        }
    }

    /// As [`Bench::command`]; the tick at which it acts.
    pub fn act(&mut self, command: &Command) -> Result<u32> {
        match self.command(command)? {
            Reply::Done { tick }
            | Reply::Configured { tick, .. }
            | Reply::Streaming { tick, .. } => Ok(tick),
            other => bail!("{command:?} was answered by {other:?}"),
        }
    }

    /// Asks who the device is.
    pub fn identify(&mut self) -> Result<Identity> {
        self.link.identity = None;
        let bytes = self.link.identify();
        self.send(bytes)?;
        self.run_until(REPLY, "identity", |b| b.link.identity.is_some())?;
        self.link.identity.context("identity")
    }

    /// Status word of the newest sample, or of a status reply.
    pub fn status(&mut self) -> Result<flexstage::link::message::Status> {
        match self.command(&Command::Status)? {
            Reply::Status(status) => Ok(status),
            other => bail!("Status was answered by {other:?}"),
        }
    }

    /// The board's counters.
    pub fn counters(&mut self) -> Result<flexstage::link::message::Counters> {
        match self.command(&Command::Counters)? {
            Reply::Counters(counters) => Ok(counters),
            other => bail!("Counters was answered by {other:?}"),
        }
    }

    /// Streams these fields of every tick.
    pub fn stream(&mut self, fields: Fields, profile: Profile) -> Result<u32> {
        self.act(&Command::StreamOn { fields, profile })
    }

    /// Arms and waits until the loop runs; the tick at which arming began.
    pub fn arm(&mut self) -> Result<u32> {
        let tick = self.act(&Command::Arm)?;
        for _ in 0..200 {
            let status = self.status()?;
            let state = flexstage::Flags(status.flags).state();
            match state {
                State::Run | State::Hold => return Ok(tick),
                State::Fault => {
                    bail!("arming ended in a fault: {:?}", flexstage::Flags(status.flags).faults())
                }
                State::Off | State::Arming => self.run_for(10 * MILLISECOND)?,
            }
        }
        bail!("not armed after 2 s")
    }

    /// Stages waveforms and starts them together; the tick.
    pub fn start(&mut self, waves: &[(u8, GeneratorSettings)]) -> Result<u32> {
        let mut axes = 0;
        for (axis, generator) in waves {
            self.command(&Command::Stage { axis: *axis, generator: *generator })?;
            axes |= 1 << axis;
        }
        self.act(&Command::Start { axes })
    }
}
