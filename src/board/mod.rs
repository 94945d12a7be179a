//! The controller board.
pub mod converters;
pub mod critical;
pub mod outputs;
pub mod timebase;

/// Runs the firmware.
pub fn run() -> ! {
    loop {}
}
