//! The control core against the plant, with the board's converters between them: the three-axis closed loop.
//!
//! Each tick does what the board's does: sample the plant, turn readings into codes, run the controller, and hold the drive
//! of the codes decided in the tick before until the next tick. The emulator and the virtual board use the same
//! [`Converters`], so that all of them agree to the bit.
//!
//! ```
//! use flexstage::{GeneratorSettings, generator::Wave};
//! use host_sim::{Options, Rig, closed_loop::ClosedLoop};
//!
//! let rig = Rig::named("handley").unwrap();
//! let mut stage = ClosedLoop::new(&rig, &host_sim::controller_settings(&rig), Options::default()).unwrap();
//! stage.arm().unwrap();
//! stage.start(&[(0, GeneratorSettings::Sine(Wave::between(0.0, 10.0, 10.0)))]).unwrap();
//! let worst = (0..5_000).map(|_| stage.step()).map(|s| (s.record.axes[0].reference.to_f64() - s.true_um[0]).abs());
//! assert!(worst.fold(0.0, f64::max) < 0.2);
//! ```

use flexstage::{
    AXES, Command, Config, Controller, Generator, GeneratorSettings, Record, Refusal, Sample,
    Settings, SettingsError, State, TICK_HZ, Table,
};
use thiserror::Error;

use crate::plant::{Options, Plant};
use crate::rig::Rig;
use crate::round::nearest;
use crate::simulate::SimError;

/// Why a closed loop could not be built or driven.
#[derive(Debug, Error)]
pub enum ClosedLoopError {
    /// The plant cannot be simulated.
    #[error(transparent)]
    Plant(#[from] SimError),
    /// The controller's settings cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The controller refused a command.
    #[error("{0}")]
    Refused(#[from] Refusal),
    /// The rig has another number of axes than the controller.
    #[error("the controller has {AXES} axes, the rig 1 to {AXES} expected, {0} found")]
    Axes(usize),
    /// The rig has another rate than the controller.
    #[error("the controller runs at {TICK_HZ} Hz, the plant at {0} Hz")]
    Rate(f64),
    /// A fault came up while waiting for the controller.
    #[error("the controller is in state {state}: {faults}")]
    State {
        /// State it is in.
        state: &'static str,
        /// Faults in words.
        faults: String,
    },
}

/// Straight line between a converter's codes and what they stand for.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Line {
    at_zero: f64,
    per_code: f64,
    codes_per_unit: f64,
    full_code: f64,
}

impl Line {
    fn new(at_zero: f32, at_full: f32, full_code: u32) -> Self {
        let at_zero = f64::from(at_zero);
        let full_code = f64::from(full_code);
        let per_code = (f64::from(at_full) - at_zero) / full_code;
        Self { at_zero, per_code, codes_per_unit: per_code.recip(), full_code }
    }
    /// Nearest code within the range; not-a-number reads 0, like an open input.
    #[inline]
    fn code(&self, value: f64) -> i32 {
        nearest((value - self.at_zero) * self.codes_per_unit).clamp(0.0, self.full_code) as i32
    }
}

/// The analogue boundary of the board: what its converters make of the plant's readings, and of the controller's codes.
///
/// Ideal converters with as many codes as the settings say; their offsets and gains are the settings' own, so that a
/// gain error belongs into the rig, not here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converters {
    gauge: [Line; AXES],
    monitor: [Line; AXES],
    dac: [Line; AXES],
}

impl Converters {
    /// The converters that the settings describe.
    pub fn new(settings: &Settings) -> Self {
        let axes = &settings.axes;
        Self {
            gauge: std::array::from_fn(|k| {
                let c = &axes[k].gauge;
                Line::new(c.at_zero, c.at_full, c.full_code)
            }),
            monitor: std::array::from_fn(|k| {
                let c = &axes[k].monitor;
                Line::new(c.at_zero, c.at_full, c.full_code)
            }),
            dac: std::array::from_fn(|k| {
                let c = &axes[k].dac;
                Line::new(c.at_zero_v, c.at_full_v, c.full_code)
            }),
        }
    }
    /// Gauge code of axis `axis` (from 0) for a reading in metres.
    pub fn gauge_code(&self, axis: usize, sensed_m: f64) -> i32 {
        self.gauge[axis].code(sensed_m * 1.0e6)
    }
    /// Monitor code of axis `axis` (from 0) for a voltage at the amplifier output.
    pub fn monitor_code(&self, axis: usize, monitor_v: f64) -> i32 {
        self.monitor[axis].code(monitor_v)
    }
    /// Voltage commanded at the amplifier output of axis `axis` (from 0) by a DAC code.
    pub fn drive_v(&self, axis: usize, dac: u16) -> f64 {
        let line = &self.dac[axis];
        line.at_zero + f64::from(dac) * line.per_code
    }
    /// The DAC code nearest to a voltage.
    pub fn dac_code(&self, axis: usize, drive_v: f64) -> u16 {
        self.dac[axis].code(drive_v) as u16
    }
    /// A whole sample.
    pub fn sample(&self, readings: &[crate::plant::Sample]) -> Sample {
        let mut sample = Sample::default();
        for axis in 0..AXES {
            // An axis that the rig does not have reads zero, as a grounded input would.
            let reading = readings.get(axis).copied().unwrap_or_default();
            sample.gauge[axis] = self.gauge_code(axis, reading.sensed_m);
            sample.monitor[axis] = self.monitor_code(axis, reading.monitor_v);
        }
        sample
    }
}

/// One tick of a closed loop.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// What the controller saw and decided.
    pub record: Record,
    /// The codes that it was given.
    pub sample: Sample,
    /// True position of each axis at this tick, um.
    pub true_um: [f64; AXES],
}

/// Controller, converters and plant.
pub struct ClosedLoop {
    plant: Plant,
    controller: Controller,
    config: Config,
    table: Table,
    converters: Converters,
    latched: [u16; AXES],
}

impl ClosedLoop {
    /// A controller with these settings on this rig, off, at its safe voltage.
    pub fn new(rig: &Rig, settings: &Settings, options: Options) -> Result<Self, ClosedLoopError> {
        let rate = f64::from(TICK_HZ);
        Self::with_plant(
            Plant::new(rig, Options { sample_rate_hz: Some(rate), ..options })?,
            settings,
        )
    }

    /// A controller with these settings on a plant that runs at the controller's rate.
    pub fn with_plant(plant: Plant, settings: &Settings) -> Result<Self, ClosedLoopError> {
        if !(1..=AXES).contains(&plant.axes()) {
            return Err(ClosedLoopError::Axes(plant.axes()));
        }
        let rate = 1.0 / plant.step_s();
        if (rate - f64::from(TICK_HZ)).abs() > 1.0e-6 {
            return Err(ClosedLoopError::Rate(rate));
        }
        let converters = Converters::new(settings);
        Ok(Self {
            plant,
            controller: Controller::new(),
            config: Config::build(settings)?,
            table: Table::EMPTY,
            converters,
            latched: std::array::from_fn(|axis| {
                converters.dac_code(axis, f64::from(settings.guard.safe_v))
            }),
        })
    }

    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }
    /// The plant.
    pub fn plant(&mut self) -> &mut Plant {
        &mut self.plant
    }
    /// The configuration in effect from the next tick on.
    pub fn config(&self) -> &Config {
        &self.config
    }
    /// Exchange the configuration at the next tick. The converters stay: they are hardware.
    pub fn set_settings(&mut self, settings: &Settings) -> Result<(), SettingsError> {
        self.config = Config::build(settings)?;
        Ok(())
    }
    /// Exchange the arbitrary waveform.
    pub fn set_table(&mut self, points: &[f32]) -> Result<(), SettingsError> {
        self.table.set(points)
    }
    /// Give the controller a command; it acts from the next tick on.
    pub fn command(&mut self, command: Command) -> Result<(), Refusal> {
        self.controller.command(&self.config, command)
    }

    /// One tick.
    pub fn step(&mut self) -> Step {
        let readings = self.plant.sample();
        let sample = self.converters.sample(readings);
        let mut true_um = [0.0; AXES];
        for (to, reading) in true_um.iter_mut().zip(readings) {
            *to = reading.true_m * 1.0e6;
        }
        let record = self.controller.tick(&self.config, &self.table, &sample);
        let drive: [f64; AXES] =
            std::array::from_fn(|axis| self.converters.drive_v(axis, self.latched[axis]));
        self.plant.advance(&drive);
        self.latched = record.axes.map(|axis| axis.dac);
        Step { record, sample, true_um }
    }

    /// Run for a number of ticks.
    pub fn run(&mut self, ticks: u64, mut each: impl FnMut(&Step)) {
        for _ in 0..ticks {
            each(&self.step());
        }
    }

    /// Close the loop and wait until the controller holds.
    pub fn arm(&mut self) -> Result<(), ClosedLoopError> {
        while !self.step().record.flags.is_parked() {}
        self.command(Command::Arm)?;
        loop {
            let record = self.step().record;
            match record.flags.state() {
                State::Arming => {}
                State::Hold => return Ok(()),
                state => {
                    let words: Vec<_> = record.flags.faults().describe().collect();
                    return Err(ClosedLoopError::State {
                        state: state.name(),
                        faults: words.join("; "),
                    });
                }
            }
        }
    }

    /// Start waveforms on axes (from 0), all at the same tick.
    pub fn start(&mut self, waveforms: &[(u8, GeneratorSettings)]) -> Result<(), ClosedLoopError> {
        let mut axes = 0;
        for (axis, settings) in waveforms {
            let generator = Generator::build(settings)?;
            for command in generator.staging(*axis) {
                self.command(command)?;
            }
            axes |= 1 << axis;
        }
        Ok(self.command(Command::Start { axes })?)
    }
}
