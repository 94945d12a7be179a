//! The probe suite: experiments that tell one unmodelled effect from another (`notes/gap.md`, section 3, "Probe suite").
//!
//! [`mod@plan`] says what is driven, in volts, as [`waveform`]s; [`limits`] checks it before anything moves; [`mod@run`] drives it on a
//! board, open loop, and writes a session folder in the contract's format that goes straight into `flexstage diagnose`.

pub mod limits;
pub mod plan;
pub mod run;
pub mod waveform;

pub use plan::{Experiment, LOWEST_MAX_V, Length, Options, Phase, plan};
pub use run::{Mode, Progress, Report, capture, run};
