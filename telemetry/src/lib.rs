//! Host side of the board link: transports, device sessions, recorder, probes and measurements.

pub mod history;
pub mod measure;
pub mod pyramid;
pub mod sample;
