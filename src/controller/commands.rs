//! What commands do to the controller, and which it refuses in which state.

use core::borrow::BorrowMut;

use super::Controller;
use super::axis::Axis;
use crate::AXES;
use crate::config::Config;
use crate::generator::Multisines;
use crate::guard::{Command, Refusal};
use crate::record::{Faults, State};

impl<M: BorrowMut<[Multisines; AXES]>> Controller<M> {
    /// Take a command; it acts from the next tick on. Call it where [`Controller::tick`] is called, before it.
    #[inline(always)]
    pub fn command(&mut self, config: &Config, command: Command) -> Result<(), Refusal> {
        self.obey(config, &command)
    }

    /// As [`Controller::command`], of a command that stays where it is.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub fn obey(&mut self, config: &Config, command: &Command) -> Result<(), Refusal> {
        self.silence = 0;
        match command {
            Command::KeepAlive => Ok(()),
            Command::Arm => self.arm(config),
            Command::Disarm => {
                self.disarm();
                Ok(())
            }
            Command::ClearFaults => {
                self.faults = Faults::NONE;
                self.faulted_axes = 0;
                if self.state == State::Fault {
                    self.state = State::Off;
                }
                Ok(())
            }
            Command::Hold => {
                self.require_armed()?;
                for axis in &mut self.axes {
                    axis.trajectory.stop();
                }
                Ok(())
            }
            Command::Stage { axis, generator } => {
                self.require_closed()?;
                let (axis, multisines) = self.axis(*axis)?;
                axis.trajectory.stage(multisines, generator);
                Ok(())
            }
            Command::StagePart { axis, part, words } => {
                self.require_closed()?;
                let (axis, multisines) = self.axis(*axis)?;
                if axis.trajectory.stage_part(multisines, usize::from(*part), words) {
                    Ok(())
                } else {
                    Err(Refusal::NothingStaged)
                }
            }
            Command::Start { axes } => self.start(u32::from(*axes)),
        }
    }

    #[inline(always)]
    fn axis(&mut self, axis: u8) -> Result<(&mut Axis, &mut Multisines), Refusal> {
        let k = usize::from(axis);
        match (self.axes.get_mut(k), self.multisines.borrow_mut().get_mut(k)) {
            (Some(axis), Some(multisines)) => Ok((axis, multisines)),
            _ => Err(Refusal::NoSuchAxis),
        }
    }

    #[inline(always)]
    fn arm(&mut self, config: &Config) -> Result<(), Refusal> {
        match self.state {
            State::Fault => Err(Refusal::Faulted),
            State::Off if !self.gauge_faults.is_empty() => Err(Refusal::GaugeFault),
            State::Off if !self.parked => Err(Refusal::NotParked),
            State::Off => {
                self.state = State::Arming;
                self.arming = config.guard.arming_ticks;
                self.closing = true;
                // Until the drives have been brought back: several commands may come before the same tick.
                self.parked = false;
                Ok(())
            }
            _ => Err(Refusal::AlreadyArmed),
        }
    }

    /// Open the loop, as [`Command::Disarm`] does.
    #[inline(always)]
    pub fn disarm(&mut self) {
        if self.state.is_active() {
            self.state = State::Off;
        }
    }

    /// What is staged waits for a start, and an open loop would forget it.
    #[inline(always)]
    fn require_closed(&self) -> Result<(), Refusal> {
        match self.state {
            State::Fault => Err(Refusal::Faulted),
            State::Off => Err(Refusal::NotArmed),
            State::Arming | State::Run | State::Hold => Ok(()),
        }
    }

    #[inline(always)]
    fn require_armed(&self) -> Result<(), Refusal> {
        match self.state {
            State::Run | State::Hold => Ok(()),
            State::Arming => Err(Refusal::StillArming),
            State::Fault => Err(Refusal::Faulted),
            State::Off => Err(Refusal::NotArmed),
        }
    }

    #[inline(always)]
    fn start(&mut self, axes: u32) -> Result<(), Refusal> {
        self.require_armed()?;
        if axes >> AXES != 0 {
            return Err(Refusal::NoSuchAxis);
        }
        let mut bit = 1;
        for axis in &self.axes {
            if axes & bit != 0 && !axis.trajectory.is_staged() {
                return Err(Refusal::NothingStaged);
            }
            bit <<= 1;
        }
        let mut bit = 1;
        for (axis, multisines) in self.axes.iter_mut().zip(self.multisines.borrow_mut()) {
            if axes & bit != 0 {
                axis.trajectory.start_staged(multisines);
            }
            bit <<= 1;
        }
        Ok(())
    }
}
