//! Host side of the board link: transports, device sessions, recorder, probes and measurements.
//!
//! [`Device::open`] connects to a board on USB, to the emulated board on a socket or to the virtual board in this process; all three
//! speak the frames of [`flexstage::link`]. Samples come in physical units with their tick ([`Sample`]); what was
//! lost is proven by tick and drop counter ([`decode`]).

pub mod decode;
pub mod device;
pub mod error;
pub mod history;
pub mod measure;
pub mod probe;
pub mod pyramid;
pub mod recorder;
pub mod sample;
pub mod serve;
pub mod transport;
pub mod tune;
pub mod virtual_board;
pub mod words;

pub use device::{Batch, Device, DeviceInfo};
pub use error::{Error, Result};
pub use history::History;
pub use sample::{AXES, Channel, Sample};
pub use transport::Target;
