//! Plant model of a piezo-driven flexure stage, running the same control core as the board.
//!
//! - [`Rig`]: the rig as it is known, from TOML, with the settings of effects
//! - [`effects`]: what a rig may do beyond its nominal model, one file each
//! - [`simulate`](fn@simulate): whole recordings without noise, for fits and replays
//! - [`motion`]: the same in two parts, axes and sensors
//! - [`platform`]: the second paper's compliant platforms, chains of lumped masses
//! - [`AnyRig`]: a rig file of either kind
//! - [`Plant`]: a tick at a time with noise and rounding, for closed loops
//! - [`closed_loop`]: the control core against the plant
//!
//! Lengths in m, voltages in V, times in s unless a name ends in another unit.

mod any_rig;
pub mod closed_loop;
pub mod effects;
pub mod experiments;
pub mod flexure;
pub mod motion;
mod noise;
mod plant;
pub mod platform;
pub mod rig;
mod round;
mod simulate;
pub mod stages;
mod start;
pub mod tuning;

pub use any_rig::AnyRig;
pub use effects::Place;
pub use plant::{Options, Plant, Sample};
pub use rig::{Rig, RigError};
pub use simulate::{Axes, Input, MAX_TICKS, Output, RATES_HZ, SimError, simulate};
pub use start::{Initial, Memory, Stretch};
pub use tuning::controller_settings;
