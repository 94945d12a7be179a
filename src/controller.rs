//! The controller: state of all axes, commands, and the tick that ties the parts together.
//!
//! A tick is called once every 0.1 ms with the codes sampled at that instant. The DAC codes of its record are latched by
//! the next trigger: the drive acts one period after the sample, for one period, whatever the interrupt's jitter.

use core::borrow::BorrowMut;

use crate::config::Config;
use crate::generator::{Multisines, Table};
use crate::record::{AxisRecord, Faults, Flags, Limits, Record, Sample, State};
use crate::units::{Gain, Um};
use crate::{AXES, creep};

mod axis;
mod commands;

use axis::{Axis, Shared};

/// Ticks for which slip elements that take over wait while others slip.
const TAKEOVER_PATIENCE: u32 = 2;

/// State of the controller. Holds no configuration. `M` is where its multisines are: within it, or, where that is too much to be
/// moved, elsewhere.
#[derive(Clone, Debug)]
pub struct Controller<M = [Multisines; AXES]> {
    axes: [Axis; AXES],
    multisines: M,
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
    /// Axes whose slip elements have taken over the newest model: the first ones.
    taken_over: usize,
    /// Ticks for which the others have waited.
    waited: u32,
    /// The loop closes at this tick: memories start from the present.
    closing: bool,
    /// Every drive has been brought back since the loop was last closed.
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
        Self::with([Multisines::NONE; AXES])
    }
}

impl<M: BorrowMut<[Multisines; AXES]>> Controller<M> {
    /// As [`Controller::new`], with room for multisines.
    pub const fn with(multisines: M) -> Self {
        Self {
            axes: [Axis::at_rest(0), Axis::at_rest(1), Axis::at_rest(2)],
            multisines,
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
            taken_over: AXES,
            waited: 0,
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

    /// Sample instants went by without a tick: the next record is of so many later.
    pub fn skip(&mut self, ticks: u32) {
        self.tick = self.tick.wrapping_add(ticks);
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
        self.guard(config, sample);
        let swapped = self.digest != config.digest;
        self.digest = config.digest;
        record.tick = self.tick;
        self.tick = self.tick.wrapping_add(1);
        let is_active = self.state.is_active();
        let limits = if is_active {
            self.control(config, table, swapped, &mut record.axes)
        } else {
            self.retreat(config, &mut record.axes);
            Limits::NONE
        };
        record.flags = Flags(
            self.state as u32
                | if self.parked && !is_active { Flags::PARKED } else { 0 }
                | if swapped { Flags::SWAPPED } else { 0 }
                | (limits.to_bits() as u32) << 8
                | (self.faults.to_bits() as u32 & 0x1fff) << 16
                | self.faulted_axes << 29,
        );
    }

    /// Codes to quantities, and whether to believe them: look for faults and move the state machine.
    #[inline(always)]
    fn guard(&mut self, config: &Config, sample: &Sample) {
        let is_well = match &config.gauge_map {
            None => {
                let [a, b, c] = &mut self.axes;
                let [of_a, of_b, of_c] = &config.axes;
                let ([code_a, code_b, code_c], [volt_a, volt_b, volt_c]) =
                    (&sample.gauge, &sample.monitor);
                // Not `&&`: each has to look.
                a.observe(of_a, *code_a, *volt_a)
                    & b.observe(of_b, *code_b, *volt_b)
                    & c.observe(of_c, *code_c, *volt_c)
            }
            Some(map) => self.observe_mapped(config, map, sample),
        };
        self.silence = self.silence.saturating_add(1);
        let timeout = config.guard.timeout_ticks;
        let is_silent = timeout != 0 && self.silence > timeout;
        if is_well && !is_silent && !sample.overrun {
            self.gauge_faults = Faults::NONE;
        } else {
            self.examine(config, sample, is_silent);
        }
    }

    /// As the usual way in [`Controller::guard`], where each position is a sum of gauges.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    fn observe_mapped(
        &mut self,
        config: &Config,
        map: &[[Gain<Um, Um>; AXES]; AXES],
        sample: &Sample,
    ) -> bool {
        for (((axis, settings), code), volt) in
            self.axes.iter_mut().zip(&config.axes).zip(&sample.gauge).zip(&sample.monitor)
        {
            axis.measure(settings, *code, *volt);
        }
        let [a, b, c] = &self.axes;
        let gauges = [a.position, b.position, c.position];
        let mut is_well = true;
        for (((axis, settings), code), of_axis) in
            self.axes.iter_mut().zip(&config.axes).zip(&sample.gauge).zip(map)
        {
            axis.position = row(of_axis, gauges);
            is_well &= axis.is_well(settings, *code);
        }
        is_well
    }

    /// Something is not as it should be, or was not a moment ago: look closer, and trip.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    fn examine(&mut self, config: &Config, sample: &Sample, is_silent: bool) {
        let active = self.state.is_active();
        let (mut faults, mut faulted_axes, mut bit) = (Faults::NONE, 0, 1);
        for ((axis, settings), code) in self.axes.iter_mut().zip(&config.axes).zip(&sample.gauge) {
            let found = axis.examine(settings, *code, active);
            faulted_axes |= if found.is_empty() { 0 } else { bit };
            faults = faults.with(found);
            bit <<= 1;
        }
        self.gauge_faults = faults;
        faults = faults
            .with(Faults::OVERRUN.when(sample.overrun))
            .with(Faults::COMMAND_TIMEOUT.when(is_silent));
        if active && !faults.is_empty() {
            self.faulted_axes |= faulted_axes;
            self.trip(faults);
        }
    }

    /// The control law of all axes. Returns their limits together.
    #[inline(always)]
    fn control(
        &mut self,
        config: &Config,
        table: Option<&Table>,
        swapped: bool,
        records: &mut [AxisRecord; AXES],
    ) -> Limits {
        let closing = self.closing;
        self.closing = false;
        let rebase = swapped || closing;
        if rebase {
            // The tick of a change holds the drives, whatever the new configuration wants, and nothing fades before all that does is known.
            (self.bump_weight, self.bump_step, self.taken_over) = (u32::MAX, 0, 0);
            if closing {
                self.bump_step = config.guard.arming_step;
                self.bump_weight -= self.bump_step;
                self.taken_over = AXES;
                for axis in &mut self.axes {
                    axis.close();
                }
            }
        } else {
            self.bump_weight = self.bump_weight.saturating_sub(self.bump_step);
        }
        let mut moving = false;
        for (axis, settings) in self.axes.iter_mut().zip(&config.axes) {
            if rebase || !axis.trajectory.is_asleep() {
                axis.lead(settings, table, self.multisines.borrow_mut());
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
        let mut shared =
            Shared { creep_slot: self.creep_clock as usize, weight: self.bump_weight >> 1 };
        let [a, b, c] = &mut self.axes;
        let [of_a, of_b, of_c] = &config.axes;
        let [out_a, out_b, out_c] = records;
        if rebase {
            a.control::<true>(of_a, &shared, out_a);
            shared.next();
            b.control::<true>(of_b, &shared, out_b);
            shared.next();
            c.control::<true>(of_c, &shared, out_c);
            a.limits.with(b.limits).with(c.limits)
        } else {
            a.control::<false>(of_a, &shared, out_a);
            shared.next();
            b.control::<false>(of_b, &shared, out_b);
            shared.next();
            c.control::<false>(of_c, &shared, out_c);
            let limits = a.limits.with(b.limits).with(c.limits);
            if self.taken_over < AXES {
                self.take_over(config);
            }
            limits
        }
    }

    /// In the ticks after a change of configuration the slip elements take over, a few of one axis a tick: all of them in the tick of
    /// the change would cost as much again as two thirds of a tick. They wait while those of other axes slip, but not for long.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    fn take_over(&mut self, config: &Config) {
        if self.is_slipping() && self.waited < TAKEOVER_PATIENCE {
            self.waited += 1;
            return;
        }
        self.waited = 0;
        let k = self.taken_over;
        if let (Some(axis), Some(settings)) = (self.axes.get_mut(k), config.axes.get(k))
            && axis.take_over(settings)
        {
            self.taken_over += 1;
            if self.taken_over == AXES {
                self.bump_step = config.guard.transition_step;
            }
        }
    }

    /// Whether slip elements slipped, or turned, since this was last asked.
    #[inline(always)]
    fn is_slipping(&mut self) -> bool {
        let [a, b, c] = &mut self.axes;
        // Not `||`: each has to be asked.
        a.was_busy() | b.was_busy() | c.was_busy()
    }

    /// Whether the last tick had more to do than usual, or the next one will have: what can wait had better do so.
    #[inline(always)]
    pub fn is_busy(&mut self) -> bool {
        self.is_slipping() || self.taken_over < AXES
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
    fn retreat(&mut self, config: &Config, records: &mut [AxisRecord; AXES]) {
        let mut parked = true;
        for ((axis, settings), out) in self.axes.iter_mut().zip(&config.axes).zip(records) {
            parked &= axis.retreat(settings, &config.guard, out);
        }
        self.parked = parked;
        self.closing = false;
    }
}

/// One row of a matrix times the gauges.
#[inline(always)]
fn row(row: &[Gain<Um, Um>; AXES], gauges: [Um; AXES]) -> Um {
    let [a, b, c] = *row;
    let [x, y, z] = gauges;
    (a * x + b * y + c * z).narrow()
}
