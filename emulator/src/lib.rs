//! Runs the flashed firmware image: Cortex-M4, its peripherals and the plant.
//!
//! Nobody needs the board for the firmware's tests: the ELF that `probe-rs` would flash is executed here instruction
//! by instruction, unmodified, with models of the STM32G474's peripherals around it, a USB host on its cable and the
//! rig of `host-sim` on its converters. Runs are deterministic: the same inputs give the same bytes.
//!
//! What it proves is that the firmware and our reading of the reference manual agree; it is not cycle accurate and
//! says nothing about silicon errata. `README.md` lists what each model leaves out.
//!
//! - [`cpu`] executes, takes exceptions, counts instructions
//! - [`periph`] is the chip, one file for each peripheral
//! - [`usb_host`] is the computer
//! - [`board`] wires the plant to the converters and breaks things, [`faults`] on a schedule
//! - [`rtt`] reads the logs, [`link`] the wire format, [`bench`] ties it together, [`server`] serves it on a socket

pub mod bench;
pub mod board;
pub mod cpu;
pub mod faults;
pub mod link;
pub mod periph;
pub mod rtt;
pub mod server;
pub mod time;
pub mod usb_host;
