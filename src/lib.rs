//! Control core of flexstage: three piezo-driven flexure axes at 10 kHz, in fixed point, without hardware.
//!
//! The same code runs in the board's interrupt, in the emulator and against the plant of `host-sim`, bit for bit.
//! [`Settings`] (physical numbers) are checked and turned into a [`Config`] off the hot path; [`Controller::tick`] then takes
//! one [`Sample`] of raw converter codes to one [`Record`] with the codes to write:
//!
//! ```text
//! sample -> guard -> reference -> feedforward (stiffness, damping, inertia) -> hysteresis -> amplifier lead
//!        -> feedback (P, I, filtered D, notches) -> limits -> DAC codes -> record
//! ```
//!
//! Configuration and state are different types. The controller holds no configuration: each tick is given a reference
//! to one, so that a new configuration takes effect whole, at a tick, without a copy, and without a step in the drive.
//!
//! ```
//! use flexstage::{Command, Config, Controller, Sample, Settings, State, Table};
//!
//! let settings = Settings::default(); // the first paper's rig, feedforward only
//! let config = Config::build(&settings)?;
//! let mut controller = Controller::new();
//! let at_rest = Sample { gauge: [config.gauge_code(0, 0.0); 3], monitor: [config.monitor_code(0, 0.0); 3], overrun: false };
//! controller.tick(&config, &Table::EMPTY, &at_rest);
//! controller.command(&config, Command::Arm).unwrap();
//! let record = controller.tick(&config, &Table::EMPTY, &at_rest);
//! assert_eq!(record.flags.state(), State::Arming);
//! # Ok::<(), flexstage::SettingsError>(())
//! ```
#![no_std]

#[cfg(test)]
#[macro_use]
extern crate std;

#[cfg(all(feature = "board", target_os = "none"))]
pub mod board;
pub mod config;
pub mod controller;
pub mod creep;
pub mod feedback;
pub mod feedforward;
pub mod filter;
pub mod generator;
pub mod guard;
pub mod hysteresis;
pub mod link;
pub mod math;
pub mod record;
pub mod settings;
pub mod store;
pub mod trajectory;
pub mod units;

pub use config::Config;
pub use controller::Controller;
pub use generator::{Generator, GeneratorSettings, Table};
pub use guard::{Command, Refusal};
pub use record::{AxisRecord, Faults, Flags, Limits, Record, Sample, State};
pub use settings::{Settings, SettingsError};
pub use units::{MicroCoulomb, Um, Volt};

/// Axes of the stage. All three always run; an axis that is not wired is left at its safe voltage by its limits.
pub const AXES: usize = 3;
/// Samples, and therefore control decisions, per second.
pub const TICK_HZ: u32 = 10_000;
/// Length of a tick in seconds.
pub const TICK_S: f32 = 1.0e-4;
/// Most Maxwell slip elements in one hysteresis model.
pub const MAX_MAXWELL: usize = 16;
/// Most Kelvin-Voigt elements in one creep model.
pub const MAX_CREEP: usize = 5;
/// Notch filters an axis.
pub const MAX_NOTCH: usize = 2;
/// Most points of the arbitrary waveform.
pub const TABLE_POINTS: usize = 1024;
/// Most tones of a multisine.
pub const MAX_TONES: u8 = 16;
