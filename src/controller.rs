//! The controller: state of all axes, commands, and the tick that ties the parts together.
//!
//! A tick is called once every 0.1 ms with the codes sampled at that instant. The DAC codes of its record are latched by
//! the next trigger: the drive acts one period after the sample, for one period, whatever the interrupt's jitter.

use crate::config::{AxisConfig, Config};
use crate::feedback::FeedbackState;
use crate::feedforward::FeedforwardState;
use crate::generator::Table;
use crate::guard::{Command, Refusal, Seen, WatchState};
use crate::record::{Faults, Flags, Limits, Record, Sample, State};
use crate::trajectory::{Motion, Trajectory};
use crate::units::{Um, Volt};
use crate::{AXES, MAX_CREEP, creep};

/// State of one axis.
#[derive(Clone, Copy, Debug)]
struct Axis {
    trajectory: Trajectory,
    feedforward: FeedforwardState,
    feedback: FeedbackState,
    watch: WatchState,
    /// Motion two ticks ahead, and where the next two axes (in cyclic order) will be.
    motion: Motion,
    others: [Um; 2],
    position: Um,
    monitor: Volt,
    /// Commanded in the tick before: acts now.
    drive: Volt,
    /// What the limits took off it.
    excess: Volt,
    /// Step that a change of state or configuration would have made; fades out.
    bump: Volt,
    /// Rounding error of the last DAC code, in 2^-16 codes.
    dac_error: i32,
    limits: Limits,
}

impl Axis {
    const REST: Self = Self {
        trajectory: Trajectory::at(Um::ZERO),
        feedforward: FeedforwardState::REST,
        feedback: FeedbackState::REST,
        watch: WatchState::REST,
        motion: Motion::REST,
        others: [Um::ZERO; 2],
        position: Um::ZERO,
        monitor: Volt::ZERO,
        drive: Volt::ZERO,
        excess: Volt::ZERO,
        bump: Volt::ZERO,
        dac_error: 0,
        limits: Limits::NONE,
    };
}

/// State of the controller. Holds no configuration.
#[derive(Clone, Debug)]
pub struct Controller {
    axes: [Axis; AXES],
    state: State,
    faults: Faults,
    faulted_axes: u32,
    gauge_faults: Faults,
    tick: u32,
    silence: u32,
    arming: u32,
    digest: u32,
    /// Weight of the bumps, 2^32 - 1 to 0.
    bump_weight: u32,
    bump_step: u32,
    creep_clock: u32,
    /// The loop closes at this tick: memories start from the present.
    closing: bool,
    parked: bool,
}

impl Default for Controller {
    fn default() -> Self {
        Self::new()
    }
}

impl Controller {
    /// Off, with every drive at 0 V.
    pub const fn new() -> Self {
        Self {
            axes: [Axis::REST; AXES],
            state: State::Off,
            faults: Faults::NONE,
            faulted_axes: 0,
            gauge_faults: Faults::NONE,
            tick: 0,
            silence: 0,
            arming: 0,
            digest: 0,
            bump_weight: 0,
            bump_step: 0,
            creep_clock: 0,
            closing: false,
            parked: false,
        }
    }

    /// State of the guard.
    pub const fn state(&self) -> State {
        self.state
    }
    /// Latched faults.
    pub const fn faults(&self) -> Faults {
        self.faults
    }
    /// Limits and reasons of one axis (from 0), apart from the others.
    pub fn axis_limits(&self, axis: usize) -> Limits {
        self.axes.get(axis).map_or(Limits::NONE, |axis| axis.limits)
    }

    /// Take a command; it acts from the next tick on. Call it where [`Controller::tick`] is called, before it.
    #[inline(always)]
    pub fn command(&mut self, config: &Config, command: Command) -> Result<(), Refusal> {
        self.silence = 0;
        match command {
            Command::KeepAlive => Ok(()),
            Command::Arm => self.arm(config),
            Command::Disarm => {
                if self.state.is_active() {
                    self.state = State::Off;
                }
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
            Command::Stage { axis, generator } => match self.axes.get_mut(axis as usize) {
                Some(axis) => {
                    axis.trajectory.stage(&generator);
                    Ok(())
                }
                None => Err(Refusal::NoSuchAxis),
            },
            Command::Start { axes } => self.start(axes as u32),
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
                Ok(())
            }
            _ => Err(Refusal::AlreadyArmed),
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
        for axis in &mut self.axes {
            if axes & bit != 0 {
                axis.trajectory.start_staged();
            }
            bit <<= 1;
        }
        Ok(())
    }

    /// Latch a fault that only the caller can see, like a damaged configuration.
    #[inline(always)]
    pub fn trip(&mut self, faults: Faults) {
        if !faults.is_empty() {
            self.faults = self.faults.with(faults);
            self.state = State::Fault;
        }
    }

    /// One sample in, one decision out. `table`: the arbitrary waveform, if there is one.
    #[inline(always)]
    pub fn tick<'t>(
        &mut self,
        config: &Config,
        table: impl Into<Option<&'t Table>>,
        sample: &Sample,
    ) -> Record {
        let mut record = Record::default();
        self.tick_into(config, table, sample, &mut record);
        record
    }

    /// As [`Controller::tick`]; all of `record` is written.
    #[inline(always)]
    pub fn tick_into<'t>(
        &mut self,
        config: &Config,
        table: impl Into<Option<&'t Table>>,
        sample: &Sample,
        record: &mut Record,
    ) {
        let table = table.into();
        self.measure(config, sample);
        self.guard(config, sample);
        let swapped = self.digest != config.digest;
        self.digest = config.digest;
        if self.state.is_active() {
            self.control(config, table, swapped);
        } else {
            self.retreat(config);
        }
        self.record(config, swapped, record);
    }

    /// Codes to quantities.
    #[inline(always)]
    fn measure(&mut self, config: &Config, sample: &Sample) {
        for (((axis, settings), gauge), monitor) in
            self.axes.iter_mut().zip(&config.axes).zip(&sample.gauge).zip(&sample.monitor)
        {
            axis.position = Um::from_bits(settings.gauge.value(*gauge));
            axis.monitor = Volt::from_bits(settings.monitor.value(*monitor));
        }
        if let Some(map) = &config.gauge_map {
            let [a, b, c] = &mut self.axes;
            let gauges = [a.position, b.position, c.position];
            let [map_a, map_b, map_c] = map;
            a.position = row(map_a, gauges);
            b.position = row(map_b, gauges);
            c.position = row(map_c, gauges);
        }
    }

    /// Look for faults and move the state machine.
    #[inline(always)]
    fn guard(&mut self, config: &Config, sample: &Sample) {
        let active = self.state.is_active();
        let mut faults = Faults::NONE;
        let mut faulted_axes = 0;
        let mut bit = 1;
        for ((axis, settings), code) in self.axes.iter_mut().zip(&config.axes).zip(&sample.gauge) {
            let seen = Seen {
                code: *code,
                position: axis.position,
                // On the tick that closes the loop there is no reference yet.
                reference: if self.closing { axis.position } else { axis.trajectory.now() },
                drive: axis.drive,
                monitor: axis.monitor,
                active,
            };
            let found = axis.watch.step(&settings.watch, seen);
            if !found.is_empty() {
                faulted_axes |= bit;
            }
            faults = faults.with(found);
            bit <<= 1;
        }
        self.gauge_faults = faults;
        if !active {
            return;
        }
        self.silence = self.silence.saturating_add(1);
        let timeout = config.guard.timeout_ticks;
        faults = faults
            .with(Faults::OVERRUN.when(sample.overrun))
            .with(Faults::COMMAND_TIMEOUT.when(timeout != 0 && self.silence > timeout));
        if !faults.is_empty() {
            self.faulted_axes |= faulted_axes;
            self.trip(faults);
        }
    }

    /// The control law of all axes.
    #[inline(always)]
    fn control(&mut self, config: &Config, table: Option<&Table>, swapped: bool) {
        let closing = self.closing;
        self.closing = false;
        let rebase = swapped || closing;
        if rebase {
            self.bump_weight = u32::MAX;
            self.bump_step =
                if closing { config.guard.arming_step } else { config.guard.transition_step };
        }
        self.bump_weight = self.bump_weight.saturating_sub(self.bump_step);
        let weight = self.bump_weight >> 1;

        let mut moving = false;
        for (axis, settings) in self.axes.iter_mut().zip(&config.axes) {
            if rebase || !axis.trajectory.is_asleep() {
                axis.lead(settings, table, closing);
                moving |= axis.trajectory.is_moving();
            }
        }
        self.advance_state(moving);

        if config.is_crossed {
            self.exchange(config);
        }

        // Creep: in 100 ticks every element of every axis has its turn; the axes take turns too.
        self.creep_clock =
            if self.creep_clock >= creep::DIVIDER - 1 { 0 } else { self.creep_clock + 1 };
        let mut creep_slot = self.creep_clock as usize;
        for (axis, settings) in self.axes.iter_mut().zip(&config.axes) {
            axis.control(settings, creep_slot, rebase, weight);
            creep_slot = creep_slot.wrapping_sub(MAX_CREEP);
        }
    }

    /// Tell each axis where the others will be.
    #[inline(always)]
    fn exchange(&mut self, config: &Config) {
        let [c0, c1, c2] = &config.axes;
        let [a0, a1, a2] = &mut self.axes;
        let d0 = c0.feedforward.displacement(&a0.motion);
        let d1 = c1.feedforward.displacement(&a1.motion);
        let d2 = c2.feedforward.displacement(&a2.motion);
        a0.others = [d1, d2];
        a1.others = [d2, d0];
        a2.others = [d0, d1];
    }

    /// Arming ends by time; run and hold follow the references.
    #[inline(always)]
    fn advance_state(&mut self, moving: bool) {
        self.state = match self.state {
            State::Arming if self.arming > 0 => {
                self.arming -= 1;
                State::Arming
            }
            _ if moving => State::Run,
            _ => State::Hold,
        };
    }

    /// Bring every drive back to the safe voltage.
    #[inline(always)]
    fn retreat(&mut self, config: &Config) {
        let guard = &config.guard;
        let mut parked = true;
        for axis in &mut self.axes {
            let safe = guard.safe;
            let next = safe.limit(axis.drive - guard.return_step, axis.drive + guard.return_step);
            axis.drive = next;
            axis.limits = Limits::NONE;
            parked &= next == safe;
            axis.trajectory.reset(axis.position);
        }
        self.parked = parked;
        self.closing = false;
    }

    #[inline(always)]
    fn record(&mut self, config: &Config, swapped: bool, record: &mut Record) {
        record.tick = self.tick;
        self.tick = self.tick.wrapping_add(1);
        let mut limits = Limits::NONE;
        for ((axis, settings), out) in self.axes.iter_mut().zip(&config.axes).zip(&mut record.axes)
        {
            limits = limits.with(axis.limits);
            out.reference = axis.trajectory.now();
            out.position = axis.position;
            out.drive = axis.drive;
            out.monitor = axis.monitor;
            out.dac = settings.dac.code(axis.drive, &mut axis.dac_error);
        }
        let parked = self.parked && !self.state.is_active();
        record.flags = Flags(
            self.state as u32
                | if parked { Flags::PARKED } else { 0 }
                | if swapped { Flags::SWAPPED } else { 0 }
                | (limits.to_bits() as u32) << 8
                | (self.faults.to_bits() as u32 & 0x1fff) << 16
                | self.faulted_axes << 29,
        );
    }
}

impl Axis {
    /// Where the reference goes. On the tick that closes the loop it starts where the stage is, and nothing is remembered.
    #[inline(always)]
    fn lead(&mut self, config: &AxisConfig, table: Option<&Table>, closing: bool) {
        if closing {
            self.trajectory.reset(self.position);
            self.feedforward.reset();
            self.feedback.reset();
            self.excess = Volt::ZERO;
        }
        let [low, high] = config.travel;
        self.motion = self.trajectory.step(table, low, high);
    }

    /// Drive of one axis. `weight`: of what is left of the last bump, Q0.31.
    #[inline(always)]
    fn control(&mut self, config: &AxisConfig, creep_slot: usize, rebase: bool, weight: u32) {
        let forward = if self.trajectory.is_asleep() && !rebase && config.feedforward.can_rest() {
            config.feedforward.rest(&self.feedforward)
        } else {
            config.feedforward.step(
                &mut self.feedforward,
                self.motion,
                self.others,
                creep_slot,
                rebase,
            )
        };
        let (back, integral_at_limit) = config.feedback.step(
            &mut self.feedback,
            self.trajectory.now(),
            self.trajectory.last_change(),
            self.position,
            self.excess,
            rebase,
        );
        let wanted = forward + back;
        if rebase {
            self.bump = self.drive - wanted;
        }
        let wanted = if weight == 0 {
            wanted
        } else {
            let bump = (self.bump.to_bits() as i64).wrapping_mul(weight as i64) >> 31;
            wanted + Volt::from_bits(bump as i32)
        };

        let [low, high] = config.drive;
        let in_range = wanted.limit(low, high);
        let next = in_range.limit(self.drive - config.slew, self.drive + config.slew);
        self.excess = wanted - next;
        let mut limits = Limits::TRAVEL
            .when(self.trajectory.is_clipped())
            .with(Limits::INTEGRAL.when(integral_at_limit));
        if next != wanted {
            limits = limits
                .with(Limits::VOLTAGE_HIGH.when(wanted > high))
                .with(Limits::VOLTAGE_LOW.when(wanted < low))
                .with(Limits::SLEW.when(next != in_range));
        }
        self.limits = limits;
        self.drive = next;
    }
}

/// One row of a matrix times the gauges.
#[inline(always)]
fn row(row: &[crate::units::Gain<Um, Um>; AXES], gauges: [Um; AXES]) -> Um {
    let [a, b, c] = *row;
    let [x, y, z] = gauges;
    (a * x + b * y + c * z).narrow()
}
