//! The board and the rig on the chip's pins: DAC codes through amplifier, stack, mechanism and gauge to ADC codes.
//!
//! The plant is `host-sim`'s, a tick at a time: at each trigger edge it is sampled (before the drive that is latched
//! by the same edge acts) and advanced by one period under the latched codes. All conversions that a trigger starts
//! convert that sample: the 28 us of the oversampling window are less than a tenth of the amplifier's time constant
//! and are left out, as they are in `host_sim::closed_loop`, so that both agree to the bit. Between triggers that do
//! not come (reset, dead timer) the plant runs on, a period at a time, under the voltage that the pins hold.
//!
//! Wiring, as docs/board.md: gauges 1 to 3 on ADC1_IN1, ADC2_IN2, ADC3_IN1; monitors on ADC4_IN3, ADC4_IN4, ADC5_IN1;
//! drives on DAC1_OUT1, DAC1_OUT2, DAC2_OUT1. A floating DAC pin is held at 0 V drive by the board's resistors.

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::Result;
use flexstage::{AXES, Settings};
use host_sim::closed_loop::Converters;
use host_sim::{Options, Plant, Rig};

use crate::periph::{Analog, Window};
use crate::time::{TICK, Time};

/// What a 16-bit (oversampled) reading of an input at VDDA is: 64 x 4095 / 4.
pub const TOP_CODE: i32 = 65_520;

/// How far from the supplies the buffer before a converter stops: 20 mV of 3.3 V (OPA320 class), in codes.
const BUFFER_END: i32 = 397;

/// Something broken between the gauge and its converter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GaugeFault {
    /// The conditioner's output is at its upper rail (broken bridge), beyond what its buffer gives.
    Open,
    /// At its lower rail (short circuit).
    Short,
    /// Frozen at what it read when it froze.
    Stuck(i32),
    /// Alternating error of this size, in codes of 16 bits.
    Noisy(i32),
    /// Wired to the gauge of another axis (from 0).
    Swapped(usize),
    /// The platform is pushed by this much, um: over-travel.
    Pushed(f64),
}

/// Something wrong with an amplifier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AmplifierFault {
    /// No output: 0 V whatever is asked.
    Dead,
    /// Output at this voltage whatever is asked.
    Railed(f64),
    /// The monitor output reads this much too high, the drive is right.
    Monitor(f64),
}

/// What a tick did outside the chip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickTruth {
    /// The trigger edge.
    pub at: Time,
    /// DAC codes that this edge latched.
    pub codes: [u16; AXES],
    /// True positions at the edge, um.
    pub true_um: [f64; AXES],
    /// Gauge codes presented to the converters.
    pub gauge: [i32; AXES],
    /// Amplifier outputs at the edge, V.
    pub output_v: [f64; AXES],
}

/// The rig, its converters, and what has been done to them.
pub struct Board {
    plant: Plant,
    converters: Converters,
    codes: [u16; AXES],
    park_code: u16,
    last: Option<Time>,
    gauge: [i32; AXES],
    monitor: [i32; AXES],
    /// Broken gauges.
    pub gauge_fault: [Option<GaugeFault>; AXES],
    /// Broken amplifiers.
    pub amplifier_fault: [Option<AmplifierFault>; AXES],
    /// One entry a tick while this is on.
    pub log: Option<Vec<TickTruth>>,
    /// The newest tick.
    pub newest: Option<TickTruth>,
    /// Ticks so far.
    pub ticks: u64,
    /// Fastest change of a drive command, V from tick to tick, since this was last cleared.
    pub fastest_step_v: f64,
    /// Levels of output pins by port: `(outputs, levels)`.
    pub pins: [(u16, u16); 7],
    noise: bool,
}

impl Board {
    /// The rig at rest, converters as the settings describe them.
    pub fn new(rig: &Rig, settings: &Settings, options: Options) -> Result<Board> {
        let plant = Plant::new(rig, Options { sample_rate_hz: Some(10_000.0), ..options })?;
        anyhow::ensure!(
            (1..=AXES).contains(&plant.axes()),
            "the board has {AXES} axes, the rig {}",
            plant.axes()
        );
        let converters = Converters::new(settings);
        let park_code = converters.dac_code(0, f64::from(settings.guard.safe_v));
        Ok(Board {
            plant,
            converters,
            codes: [park_code; AXES],
            park_code,
            last: None,
            gauge: [0; AXES],
            monitor: [0; AXES],
            gauge_fault: [None; AXES],
            amplifier_fault: [None; AXES],
            log: None,
            newest: None,
            ticks: 0,
            fastest_step_v: 0.0,
            pins: [(0, 0); 7],
            noise: false,
        })
    }

    /// The converters, to turn codes into volts.
    pub fn converters(&self) -> &Converters {
        &self.converters
    }

    /// Voltages commanded at the amplifier outputs.
    pub fn drive_v(&self) -> [f64; AXES] {
        std::array::from_fn(|k| self.converters.drive_v(k, self.codes[k]))
    }

    fn commanded(&self) -> [f64; AXES] {
        let mut v = self.drive_v();
        for (v, fault) in v.iter_mut().zip(self.amplifier_fault) {
            match fault {
                Some(AmplifierFault::Dead) => *v = 0.0,
                Some(AmplifierFault::Railed(rail)) => *v = rail,
                _ => {}
            }
        }
        v
    }

    fn advance(&mut self) {
        let v = self.commanded();
        self.plant.advance(&v[..self.plant.axes()]);
    }

    /// Whole periods that passed without a trigger.
    fn catch_up(&mut self, at: Time) {
        let Some(last) = self.last else { return };
        // The plant already stands one period after the last edge.
        let mut stands = last + TICK;
        while stands + TICK / 2 < at {
            self.advance();
            stands += TICK;
        }
        self.last = Some(stands - TICK);
    }

    fn set_codes(&mut self, codes: [Option<u16>; 3]) {
        let before = self.drive_v();
        self.codes = codes.map(|c| c.unwrap_or(self.park_code));
        for (a, b) in before.iter().zip(self.drive_v()) {
            self.fastest_step_v = self.fastest_step_v.max((a - b).abs());
        }
    }

    fn tick(&mut self, at: Time, codes: [Option<u16>; 3]) {
        self.catch_up(at);
        let samples = self.plant.sample();
        let read = self.converters.sample(samples);
        let mut true_um = [0.0; AXES];
        let mut output_v = [0.0; AXES];
        for (k, s) in samples.iter().enumerate() {
            true_um[k] = s.true_m * 1.0e6;
            output_v[k] = s.monitor_v;
        }
        let sensed: [f64; AXES] =
            std::array::from_fn(|k| samples.get(k).map_or(0.0, |s| s.sensed_m));
        self.noise = !self.noise;
        let jitter = if self.noise { 4 } else { -4 };
        self.gauge = read.gauge;
        self.monitor = read.monitor;
        for k in 0..AXES {
            match self.gauge_fault[k] {
                Some(GaugeFault::Open) => self.gauge[k] = TOP_CODE - BUFFER_END + jitter,
                Some(GaugeFault::Short) => self.gauge[k] = BUFFER_END + jitter,
                Some(GaugeFault::Stuck(code)) => self.gauge[k] = code,
                Some(GaugeFault::Noisy(size)) => {
                    self.gauge[k] =
                        (read.gauge[k] + if self.noise { size } else { -size }).clamp(0, TOP_CODE);
                }
                Some(GaugeFault::Swapped(with)) => self.gauge[k] = read.gauge[with],
                Some(GaugeFault::Pushed(um)) => {
                    self.gauge[k] = self.converters.gauge_code(k, sensed[k] + um * 1.0e-6);
                }
                None => {}
            }
            if let Some(AmplifierFault::Monitor(v)) = self.amplifier_fault[k] {
                self.monitor[k] = self.converters.monitor_code(k, output_v[k] + v);
            }
        }
        self.set_codes(codes);
        self.last = Some(at);
        self.ticks += 1;
        let truth = TickTruth { at, codes: self.codes, true_um, gauge: self.gauge, output_v };
        self.newest = Some(truth);
        if let Some(log) = &mut self.log {
            log.push(truth);
        }
    }

    fn code(&self, adc: u8, channel: u8) -> i32 {
        match (adc, channel) {
            (1, 1) => self.gauge[0],
            (2, 2) => self.gauge[1],
            // The drive pins read back on their own ADC inputs: PA4, PA5, PA6.
            (2, 17) => self.codes[0] as i32 * 16,
            (2, 13) => self.codes[1] as i32 * 16,
            (2, 3) => self.codes[2] as i32 * 16,
            (3, 1) => self.gauge[2],
            (4, 3) => self.monitor[0],
            (4, 4) => self.monitor[1],
            (5, 1) => self.monitor[2],
            // VREFINT, 1.212 V typical of 3.3 V; temperature sensor, 0.76 V at 30 C; VBAT/3.
            (1 | 3 | 4 | 5, 18) => 24_068,
            (1, 16) | (5, 4) => 15_092,
            (1 | 5, 17) => 21_845,
            _ => 0,
        }
    }
}

/// A board shared between the chip and whoever watches or breaks it.
#[derive(Clone)]
pub struct SharedBoard(pub Rc<RefCell<Board>>);

impl SharedBoard {
    /// Wraps a board.
    pub fn new(board: Board) -> SharedBoard {
        SharedBoard(Rc::new(RefCell::new(board)))
    }
}

impl Analog for SharedBoard {
    fn convert(&mut self, adc: u8, channel: u8, window: &Window) -> u32 {
        // Codes of 16 bits are sixteen conversions' worth.
        (self.0.borrow().code(adc, channel) as u64 * window.count as u64 / 16) as u32
    }

    fn drive(&mut self, at: Time, codes: [Option<u16>; 3], latched: bool) {
        let board = &mut *self.0.borrow_mut();
        if !latched {
            board.catch_up(at);
            return board.set_codes(codes);
        }
        // The sample is what the old codes led to; the new ones act from here on.
        board.tick(at, codes);
        board.advance();
    }

    fn pins(&mut self, _at: Time, port: usize, outputs: u16, levels: u16) {
        if let Some(p) = self.0.borrow_mut().pins.get_mut(port) {
            *p = (outputs, levels);
        }
    }

    fn inputs(&self, _port: usize) -> u16 {
        0
    }
}
