//! The control tick: the interrupt at the end of the gauge conversions, 10 000 times a second.
//!
//! # Design
//! [`ADC3`] runs at P0, alone with the deadline monitor [`TIM7_DAC`] and above everything else, from CCM RAM (no flash wait states,
//! no stall while flash is written). It takes the samples, at most one order of the tasks, steps the [`Controller`], writes the
//! outputs that TIM6 latches at the next trigger, and leaves a record in a lock-free queue. It shares nothing but atomics, these
//! buffers and three single-producer, single-consumer queues with the rest of the program; it calls
//! nothing outside CCM, which `cargo xtask firmware` proves from the image.
//!
//! Configurations are double-buffered: a task writes the one that is not in use and exchanges the pointer. The tick cannot be in the
//! middle of anything while a task runs, so the next tick sees the new one whole. The waveform table is only written while the
//! loop is open, and the tick is given none from the first write until the table is put into use.
//!
//! # Limits
//! A missing sample of a converter is replaced by its last one for [`CONVERTER_PATIENCE`] ticks, then it is a fault.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicPtr, AtomicU8, AtomicU32, Ordering};

use embassy_stm32::interrupt;
use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::{ConstStaticCell, StaticCell};

use super::timebase::TICK_CYCLES;
use super::{converters, outputs, records, timebase};
use crate::generator::Multisines;
use crate::link::message::{HISTOGRAM_BIN_CYCLES, HISTOGRAM_BINS};
use crate::{AXES, Command, Config, Controller, Faults, Flags, Record, Refusal, Sample, Table};

/// Orders to the tick, and answers, that may wait.
const ORDERS: usize = 4;
/// Ticks for which staging waits at most: less than the tasks wait for an answer.
const STAGING_PATIENCE: u32 = 30;
/// Cycles by which a tick may begin earlier than the one before says, after its trigger: converters and interrupt entry are not to the cycle.
const EARLY_CYCLES: u32 = 500;
/// Ticks for which a converter may deliver nothing.
const CONVERTER_PATIENCE: u32 = 5;
/// Ticks without a sign of life from the tasks until the drives are returned: 250 ms, well before the watchdog bites.
const TASK_PATIENCE: u32 = 2_500;

/// Opens the loop, once: one value for both that are urgent, as each tick has to look.
const STOP: u8 = 1;
/// Returns the drives, for good.
const RETURN: u8 = 2;

/// Answer to a command: the tick from which it acts.
pub type Answer = Result<u32, Refusal>;

/// The tasks' ends of the queues.
pub struct Ends {
    /// Records of every tick.
    pub records: records::Consumer,
    /// Orders to the tick.
    pub orders: Producer<'static, Command>,
    /// Answers of the tick.
    pub answers: Consumer<'static, Answer>,
}

struct State {
    controller: Controller<&'static mut [Multisines; AXES]>,
    records: records::Producer,
    orders: Consumer<'static, Command>,
    answers: Producer<'static, Answer>,
    codes: converters::Codes,
    missing_ticks: u32,
    /// From when the next tick may begin, cycles: by the sample clock, whenever the ticks before ran.
    due: u32,
    was_late: bool,
    beat: u32,
    silent_ticks: u32,
    /// Ticks for which a staging order has waited.
    waited: u32,
}

/// Memory that the tick shares with start-up code or with one task.
struct Shared<T>(UnsafeCell<MaybeUninit<T>>);
// SAFETY: each use says why no two sides touch the content at once.
unsafe impl<T> Sync for Shared<T> {}

impl<T> Shared<T> {
    const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }
    const fn get(&self) -> *mut T {
        self.0.get().cast()
    }
}

static STATE: Shared<State> = Shared::new();
/// Half as large as the stack, so never moved; all zero, so not in flash.
static MULTISINES: ConstStaticCell<[Multisines; AXES]> =
    ConstStaticCell::new([Multisines::NONE; AXES]);
static CONFIGS: [Shared<Config>; 2] = [Shared::new(), Shared::new()];
#[unsafe(link_section = ".ccm_bss")]
static TABLE: Shared<Table> = Shared::new();
/// What the tick tells the tasks, and the one thing that they tell it. Together, so that the tick needs one address for all of it.
pub struct Shown {
    /// Number of the next tick.
    pub ticks: AtomicU32,
    /// Status word of the last tick.
    pub flags: AtomicU32,
    /// Ticks missed, or not finished before the next trigger.
    pub overruns: AtomicU32,
    /// Records that found the queue full.
    pub lost_records: AtomicU32,
    /// Cycles of the last tick.
    pub cycles_last: AtomicU32,
    /// Most cycles of any tick.
    pub cycles_max: AtomicU32,
    /// Ticks by cycles.
    pub cycles_histogram: [AtomicU32; HISTOGRAM_BINS],
    /// Incremented by the tasks while they run.
    pub heartbeat: AtomicU32,
    config: AtomicPtr<Config>,
    has_table: AtomicBool,
    /// What the next tick does whatever is ordered: [`STOP`], [`RETURN`], or nothing.
    urgent: AtomicU8,
}

/// See [`Shown`].
pub static SHOWN: Shown = Shown {
    ticks: AtomicU32::new(0),
    flags: AtomicU32::new(0),
    overruns: AtomicU32::new(0),
    lost_records: AtomicU32::new(0),
    cycles_last: AtomicU32::new(0),
    cycles_max: AtomicU32::new(0),
    cycles_histogram: [const { AtomicU32::new(0) }; HISTOGRAM_BINS],
    heartbeat: AtomicU32::new(0),
    // The configuration in use. A pointer, not an index: with an index the compiler knows both addresses, and chooses between
    // them at each access to a field instead of once.
    config: AtomicPtr::new(core::ptr::null_mut()),
    has_table: AtomicBool::new(false),
    urgent: AtomicU8::new(0),
};

/// Sets up what the tick needs. Once, before its interrupt is enabled.
pub fn init(config: Config, faults: Faults) -> Ends {
    static ORDER_QUEUE: StaticCell<Queue<Command, ORDERS>> = StaticCell::new();
    static ANSWER_QUEUE: StaticCell<Queue<Answer, ORDERS>> = StaticCell::new();
    // SAFETY: start-up calls this once.
    let (records_in, records) = unsafe { records::split() };
    let (orders, orders_out) = ORDER_QUEUE.init_with(Queue::new).split();
    let (answers_in, answers) = ANSWER_QUEUE.init_with(Queue::new).split();
    let mut controller = Controller::with(MULTISINES.take());
    controller.trip(faults);
    let state = State {
        controller,
        records: records_in,
        orders: orders_out,
        answers: answers_in,
        codes: converters::Codes { gauge: [0; AXES], monitor: [0; AXES] },
        missing_ticks: 0,
        due: timebase::cycles(),
        was_late: false,
        beat: 0,
        silent_ticks: 0,
        waited: 0,
    };
    // SAFETY: the interrupt that uses these is not enabled yet; everything is written before it is.
    unsafe {
        STATE.get().write(state);
        for cell in &CONFIGS {
            cell.get().write(config.clone());
            SHOWN.config.store(cell.get(), Ordering::Release);
        }
        TABLE.get().write_bytes(0, 1);
    }
    Ends { records, orders, answers }
}

/// Puts a configuration into effect at the next tick, which is returned. Called by one task only.
pub fn exchange_config(config: &Config) -> u32 {
    let [first, second] = &CONFIGS;
    let in_use = SHOWN.config.load(Ordering::Relaxed);
    let next = if in_use == first.get() { second.get() } else { first.get() };
    // SAFETY: the tick reads only the other one until the pointer changes, and one task calls this.
    unsafe { (*next).clone_from(config) };
    let before = SHOWN.ticks.load(Ordering::SeqCst);
    SHOWN.config.store(next, Ordering::SeqCst);
    let after = SHOWN.ticks.load(Ordering::SeqCst);
    // A tick that came in between says itself whether it was the first one with it.
    let has_acted = after != before && Flags(SHOWN.flags.load(Ordering::Relaxed)).is_swapped();
    after.wrapping_sub(u32::from(has_acted))
}

/// Changes the table, which is out of use until [`use_table`]. Called by one task only.
pub fn with_table<R>(change: impl FnOnce(&mut Table) -> R) -> R {
    SHOWN.has_table.store(false, Ordering::SeqCst);
    // SAFETY: the tick does not look at the table while the flag is down, and one task calls this.
    change(unsafe { &mut *TABLE.get() })
}

/// Puts the table into use at the next tick, which is returned. Called by one task only, while the loop is open.
pub fn use_table() -> u32 {
    loop {
        let before = SHOWN.ticks.load(Ordering::SeqCst);
        SHOWN.has_table.store(true, Ordering::SeqCst);
        if SHOWN.ticks.load(Ordering::SeqCst) == before {
            return before;
        }
        // A tick came in between, before or after: once more, as nobody sees the table come and go in an open loop.
        SHOWN.has_table.store(false, Ordering::SeqCst);
    }
}

/// The host wants the loop open: the next tick opens it, and the ones after it until none of the orders waits that were given before.
pub fn stop() {
    // Not instead of what a crash wants.
    let _ = SHOWN.urgent.compare_exchange(0, STOP, Ordering::Release, Ordering::Relaxed);
}

/// Code outside the tick has crashed: the tick returns the drives.
pub fn return_drives() {
    SHOWN.urgent.store(RETURN, Ordering::Release);
}

/// Triggers are counted from the first tick on: called just before it is enabled.
pub fn count_from_here() {
    // SAFETY: `init` has run, and the tick, which alone uses the state, is not enabled yet.
    let state = unsafe { &mut *STATE.get() };
    // So late that the first one is too early, and is asked when it was.
    state.due = timebase::cycles().wrapping_add(2 * TICK_CYCLES);
}

/// Whether the drives are at their safe voltage.
pub fn is_parked() -> bool {
    Flags(SHOWN.flags.load(Ordering::Relaxed)).is_parked()
}

/// The tick.
#[interrupt]
#[unsafe(link_section = ".ccm.tick")]
unsafe fn ADC3() {
    let entered = timebase::cycles();
    // SAFETY: `init` has run before the interrupt was enabled, and only this handler uses the state.
    let state = unsafe { &mut *STATE.get() };
    // SAFETY: `init` has stored a pointer; tasks write only the configuration that is not in use, and none can run while this
    // handler does.
    let config = unsafe { &*SHOWN.config.load(Ordering::Acquire) };
    // SAFETY: no task changes the table while the flag is up.
    let table =
        if SHOWN.has_table.load(Ordering::Acquire) { Some(unsafe { &*TABLE.get() }) } else { None };
    timebase::clear_trigger();
    timebase::postpone_deadline();
    let missing = converters::take(&mut state.codes);

    state.look_around(missing != 0);
    let missed = state.count_missed(entered);
    let can_wait = state.look_at_order(config);

    let converters::Codes { gauge, monitor } = state.codes;
    let sample = Sample {
        gauge: gauge.map(i32::from),
        monitor: monitor.map(i32::from),
        overrun: missed || state.was_late,
    };
    let place = state.records.place();
    // SAFETY: the place is the tick's own until it is published; a record is integers, of which any bits will do. Gauges and cycles are
    // written below.
    let record: &mut Record = unsafe { &mut (*place).record };
    state.controller.tick_into(config, table, &sample, record);
    let [a, b, c] = &record.axes;
    outputs::write([a.dac, b.dac, c.dac]);
    SHOWN.flags.store(record.flags.0, Ordering::Relaxed);
    // A trigger since the entry means that the outputs were written too late for it.
    state.was_late = timebase::has_triggered();
    if can_wait {
        state.stage_unless_busy(config);
    }

    let cycles = timebase::cycles().wrapping_sub(entered);
    // SAFETY: as above.
    unsafe {
        (*place).gauge = gauge;
        (*place).cycles = cycles.min(0xffff) as u16;
    }
    if !state.records.publish() {
        bump(&SHOWN.lost_records, 1);
    }
    bump(&SHOWN.ticks, 1);
    account(timebase::cycles().wrapping_sub(entered), state.was_late);
}

/// Half a period after a trigger whose tick has not run: the converters did not end, so it has to run without them.
#[interrupt]
#[unsafe(link_section = ".ccm.deadline")]
unsafe fn TIM7_DAC() {
    timebase::clear_deadline();
    // Unless the tick came in between.
    if timebase::has_triggered() {
        cortex_m::peripheral::NVIC::pend(interrupt::ADC3);
    }
}

impl State {
    /// Obeys the order that comes next, if there is one. Whether it is one that can wait for the end of the tick.
    #[inline(always)]
    fn look_at_order(&mut self, config: &Config) -> bool {
        self.assume_lengths();
        match self.orders.peek() {
            None => false,
            Some(command) if command.is_staging() => true,
            Some(_) => {
                self.obey(config);
                false
            }
        }
    }

    /// Staging changes nothing before the start: it is done in a tick that has little else to do, or when it has waited for long.
    #[cold]
    #[inline(never)]
    #[unsafe(link_section = ".ccm.core")]
    fn stage_unless_busy(&mut self, config: &Config) {
        if self.controller.is_busy() && self.waited < STAGING_PATIENCE {
            self.waited += 1;
        } else {
            self.waited = 0;
            self.obey(config);
        }
    }

    /// Obeys the order that comes next.
    #[inline(never)]
    #[unsafe(link_section = ".ccm.core")]
    fn obey(&mut self, config: &Config) {
        self.assume_lengths();
        // Read where it lies: a copy of the longest would be a call.
        if let Some(command) = self.orders.peek() {
            let tick = SHOWN.ticks.load(Ordering::Relaxed);
            let answer = self.controller.obey(config, command).map(|()| tick);
            self.assume_lengths();
            // One command waits for its answer at a time, so there is room.
            let _ = self.answers.enqueue(answer);
        }
        self.assume_lengths();
        let _ = self.orders.dequeue();
    }

    /// The ends of a queue have forgotten its length: this lets indices wrap by a mask instead of a division that could be by zero.
    #[inline(always)]
    fn assume_lengths(&self) {
        // SAFETY: `init` made them from queues of this length; one place always stays empty.
        unsafe {
            core::hint::assert_unchecked(self.orders.capacity() == ORDERS - 1);
            core::hint::assert_unchecked(self.answers.capacity() == ORDERS - 1);
        }
    }

    /// Looks for faults that the controller cannot see, and for what is urgent.
    #[inline(always)]
    fn look_around(&mut self, is_missing: bool) {
        self.missing_ticks = if is_missing { self.missing_ticks.saturating_add(1) } else { 0 };
        let beat = SHOWN.heartbeat.load(Ordering::Relaxed);
        self.silent_ticks = if beat == self.beat { self.silent_ticks.saturating_add(1) } else { 0 };
        self.beat = beat;
        if self.missing_ticks > CONVERTER_PATIENCE
            || self.silent_ticks > TASK_PATIENCE
            || SHOWN.urgent.load(Ordering::Relaxed) != 0
        {
            self.intervene();
        }
    }

    /// Opens the loop, for one reason or another: seldom.
    #[inline(always)]
    fn intervene(&mut self) {
        let urgent = SHOWN.urgent.load(Ordering::Relaxed);
        if urgent == STOP {
            self.assume_lengths();
            // An order that still waits may be one to close it: the next tick opens it again, before any drive has moved.
            if self.orders.is_empty() {
                SHOWN.urgent.store(0, Ordering::Relaxed);
            }
            self.controller.disarm();
        }
        let is_starved = self.silent_ticks > TASK_PATIENCE || urgent == RETURN;
        let faults = Faults::CONVERTER
            .when(self.missing_ticks > CONVERTER_PATIENCE)
            .with(Faults::STARVED.when(is_starved));
        self.controller.trip(faults);
    }

    /// Counts triggers that had no tick: one that takes longer than a period now and then begins late, and two that wait become one. Their
    /// numbers are skipped and their records lost, so that a recording keeps its time and says where it has none.
    #[inline(always)]
    fn count_missed(&mut self, entered: u32) -> bool {
        let late = entered.wrapping_sub(self.due);
        self.due = self.due.wrapping_add(TICK_CYCLES);
        // Without a sign: too early is odd as well.
        late >= TICK_CYCLES && self.skip(late)
    }

    /// A tick at an odd time, and whether triggers went by without one: seldom.
    #[cold]
    #[inline(never)]
    #[unsafe(link_section = ".ccm.core")]
    fn skip(&mut self, late: u32) -> bool {
        let signed = late as i32;
        if signed >= 0 {
            let missed = late / TICK_CYCLES;
            self.controller.skip(missed);
            self.due = self.due.wrapping_add(missed * TICK_CYCLES);
            bump(&SHOWN.ticks, missed);
            bump(&SHOWN.overruns, missed);
            bump(&SHOWN.lost_records, missed);
            return true;
        }
        let is_first = SHOWN.ticks.load(Ordering::Relaxed) == 0;
        if is_first || signed > -(TICK_CYCLES as i32 / 2) {
            // The first one, or one before it had begun late.
            self.due = self.due.wrapping_add(late).wrapping_sub(EARLY_CYCLES);
        }
        // By more than half a period: the tick before began just as this one's trigger came, and counted it as missed. It is skipped already.
        false
    }
}

/// Adds to a counter that only the tick writes: no exclusive access is needed.
#[inline(always)]
fn bump(counter: &AtomicU32, by: u32) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(by), Ordering::Relaxed);
}

#[inline(always)]
fn account(cycles: u32, was_late: bool) {
    SHOWN.cycles_last.store(cycles, Ordering::Relaxed);
    if cycles > SHOWN.cycles_max.load(Ordering::Relaxed) {
        SHOWN.cycles_max.store(cycles, Ordering::Relaxed);
    }
    let bin = (cycles / HISTOGRAM_BIN_CYCLES).min(HISTOGRAM_BINS as u32 - 1) as usize;
    if let Some(counter) = SHOWN.cycles_histogram.get(bin) {
        bump(counter, 1);
    }
    if was_late {
        bump(&SHOWN.overruns, 1);
    }
}
