//! A USB host: controller, root hub port and the stack above it.
//!
//! [`bus`] puts transactions on the wire with the timing of full speed; [`enumerate`] does what an operating system
//! does with a new device and checks every descriptor field; [`Host`] is what a driver sees: transfers.

pub mod bus;
pub mod descriptors;
pub mod enumerate;
pub mod transfer;

pub use bus::Host;
pub use descriptors::Device;
pub use enumerate::Stack;
pub use transfer::{Completion, Pipe, Status};
