//! The STM32G474's peripherals that the firmware uses, one file each, with the RM0440 section it follows and what it
//! leaves out. [`soc`] puts them on the bus and keeps time.

pub mod adc;
pub mod analog;
pub mod dac;
pub mod flash;
pub mod gpio;
pub mod iwdg;
pub mod nvic;
pub mod rcc;
pub mod soc;
pub mod tim;
pub mod usb;

pub use analog::{Analog, Window};
pub use rcc::ResetCause;
pub use soc::Soc;
