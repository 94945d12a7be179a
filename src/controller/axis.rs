//! One axis of the controller: its state, and the three things that a tick does with it.
//!
//! [`Axis::observe`], [`Axis::lead`] and [`Axis::control`] are functions of their own, called once an axis, and not inlined into one long
//! tick: each then has all registers for the pointers and sums that it needs. Inlined, a third of the tick's instructions moved them to
//! the stack and back.

use crate::config::{AxisConfig, GuardConfig};
use crate::feedback::FeedbackState;
use crate::feedforward::FeedforwardState;
use crate::generator::{Multisines, Table};
use crate::guard::{Seen, WatchState};
use crate::record::{AxisRecord, Faults, Limits};
use crate::trajectory::{Motion, Trajectory};
use crate::units::{Um, Volt};
use crate::{AXES, MAX_CREEP};

/// State of one axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    /// From 0.
    number: usize,
    pub(super) trajectory: Trajectory,
    feedforward: FeedforwardState,
    feedback: FeedbackState,
    watch: WatchState,
    /// Motion two ticks ahead, and where the next two axes (in cyclic order) will be.
    pub(super) motion: Motion,
    pub(super) others: [Um; 2],
    pub(super) position: Um,
    monitor: Volt,
    /// Commanded in the tick before: acts now.
    drive: Volt,
    /// What the limits took off it.
    excess: Volt,
    /// Step that a change of state or configuration would have made; fades out.
    bump: Volt,
    /// Rounding error of the last DAC code, in 2^-16 codes.
    dac_error: i32,
    pub(super) limits: Limits,
}

/// What is the same for all axes in one tick.
pub(super) struct Shared {
    /// Creep element whose turn it is; that of the next axis is [`MAX_CREEP`] earlier.
    pub(super) creep_slot: usize,
    /// Of what is left of the last bump, Q0.31.
    pub(super) weight: u32,
}

impl Shared {
    /// The same for the next axis.
    #[inline(always)]
    pub(super) fn next(&mut self) {
        self.creep_slot = self.creep_slot.wrapping_sub(MAX_CREEP);
    }
}

impl Axis {
    /// Nothing has happened yet.
    pub(super) const fn at_rest(number: usize) -> Self {
        Self {
            number,
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
        }
    }

    /// Takes the codes of gauge and amplifier over. Whether all is well with them; if not, [`Axis::examine`] has to follow.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn observe(&mut self, config: &AxisConfig, code: i32, monitor: i32) -> bool {
        self.measure(config, code, monitor);
        self.is_well(config, code)
    }

    /// The same after [`Axis::measure`].
    #[inline(always)]
    pub(super) fn is_well(&mut self, config: &AxisConfig, code: i32) -> bool {
        let seen = self.seen(code);
        self.watch.is_well(&config.watch, seen)
    }

    /// Codes to quantities.
    #[inline(always)]
    pub(super) fn measure(&mut self, config: &AxisConfig, code: i32, monitor: i32) {
        self.position = Um::from_bits(config.gauge.value(code));
        self.monitor = Volt::from_bits(config.monitor.value(monitor));
    }

    /// What is wrong, after [`Axis::measure`].
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn examine(&mut self, config: &AxisConfig, code: i32, active: bool) -> Faults {
        let seen = self.seen(code);
        self.watch.examine(&config.watch, seen, active)
    }

    #[inline(always)]
    fn seen(&self, code: i32) -> Seen {
        Seen {
            code,
            position: self.position,
            // With the loop open, and on the tick that closes it, the position of the tick before.
            reference: self.trajectory.now(),
            drive: self.drive,
            monitor: self.monitor,
        }
    }

    /// The loop closes: the reference starts where the stage is, and nothing is remembered.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn close(&mut self) {
        // Not what is staged: that came after the order to close.
        self.trajectory.reset(self.position);
        self.feedforward.reset();
        self.feedback.reset();
        self.excess = Volt::ZERO;
    }

    /// Where the reference goes.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn lead(
        &mut self,
        config: &AxisConfig,
        table: Option<&Table>,
        multisines: &mut [Multisines; AXES],
    ) {
        let [low, high] = config.travel;
        let multisine = || multisines.get_mut(self.number).map_or(0, Multisines::step);
        self.motion = self.trajectory.step(table, multisine, low, high);
    }

    /// The control law: the drive, and the axis' part of the record. `REBASE`: coefficients have changed, or the loop was just closed:
    /// present values are the start. One function for these ticks and one for all others, which then has no trace of it.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn control<const REBASE: bool>(
        &mut self,
        config: &AxisConfig,
        shared: &Shared,
        out: &mut AxisRecord,
    ) {
        let rebase = REBASE;
        let forward = if self.trajectory.is_asleep() && !rebase && config.feedforward.can_rest() {
            config.feedforward.rest(&self.feedforward)
        } else {
            config.feedforward.step(
                &mut self.feedforward,
                self.motion,
                self.others,
                shared.creep_slot,
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
        let mut wanted = forward + back;
        if rebase {
            self.bump = self.drive - wanted;
        }
        if shared.weight != 0 {
            let bump = (self.bump.to_bits() as i64).wrapping_mul(shared.weight as i64) >> 31;
            wanted += Volt::from_bits(bump as i32);
        }

        let [low, high] = config.drive;
        let mut limits = Limits::TRAVEL
            .when(self.trajectory.is_clipped())
            .with(Limits::INTEGRAL.when(integral_at_limit));
        // As a rule no limit acts: the signs of all distances tell.
        let change = (wanted - self.drive).to_bits();
        let room = config.slew.to_bits().wrapping_sub(change ^ (change >> 31));
        let is_free = (wanted - low).to_bits() | (high - wanted).to_bits() | room >= 0;
        let mut next = wanted;
        if !is_free {
            let in_range = wanted.limit(low, high);
            next = in_range.limit(self.drive - config.slew, self.drive + config.slew);
            limits = limits
                .with(Limits::VOLTAGE_HIGH.when(wanted > high))
                .with(Limits::VOLTAGE_LOW.when(wanted < low))
                .with(Limits::SLEW.when(next != in_range));
        }
        self.excess = wanted - next;
        self.limits = limits;
        self.drive = next;
        self.record(config, out);
    }

    /// Whether this tick, or one before that was not asked for, had more to do than usual.
    #[inline(always)]
    pub(super) fn was_busy(&mut self) -> bool {
        self.feedforward.hysteresis.has_followed()
    }

    /// The slip elements of a new model of the stack take over, a few a tick. Whether all have: what that changes fades with the step that
    /// the new configuration would have made, of which nothing fades before.
    #[cold]
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn take_over(&mut self, config: &AxisConfig) -> bool {
        // An axis at rest has to find out what its drive is now.
        self.trajectory.wake();
        match config.feedforward.take_over(&mut self.feedforward) {
            Some(change) => {
                self.bump = self.bump - change;
                true
            }
            None => false,
        }
    }

    /// The loop is open: back to the safe voltage. Whether the drive is there.
    #[inline(never)]
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.core"))]
    pub(super) fn retreat(
        &mut self,
        config: &AxisConfig,
        guard: &GuardConfig,
        out: &mut AxisRecord,
    ) -> bool {
        let safe = guard.safe;
        let next = safe.limit(self.drive - guard.return_step, self.drive + guard.return_step);
        self.drive = next;
        self.watch.rest(next);
        self.limits = Limits::NONE;
        self.trajectory.reset(self.position);
        self.trajectory.forget_staged();
        self.record(config, out);
        next == safe
    }

    #[inline(always)]
    fn record(&mut self, config: &AxisConfig, out: &mut AxisRecord) {
        out.reference = self.trajectory.now();
        out.position = self.position;
        out.drive = self.drive;
        out.monitor = self.monitor;
        out.dac = config.dac.code(self.drive, &mut self.dac_error);
    }
}
