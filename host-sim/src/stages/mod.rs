//! The chain drive -> amplifier -> piezo -> mechanism -> sensor, one file a stage, in f64.
//!
//! A tick is exact for a held drive: the amplifier is propagated in closed form, the force between two ticks is
//! interpolated with the amplifier's own exponential, and under that force the linear mechanism is propagated by its
//! matrix exponential. What is left is one scalar, monotone, piecewise linear equation for the charge (the
//! Goldfarb-Celanovic hysteresis). So a 32 kHz stack mode costs nothing and the step hardly matters.

pub mod amplifier;
pub mod axis;
pub mod creep;
pub mod group;
pub mod hysteresis;
mod knee;
pub mod mechanism;
pub mod model;
pub mod pace;
pub mod sensor;
pub(crate) mod speed;
