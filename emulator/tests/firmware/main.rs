//! Proof of the firmware, on its own image: one binary, so that CI links unicorn once.
//!
//! The image comes from `cargo xtask firmware` by way of the environment variable FLEXSTAGE_FIRMWARE_ELF; without it the
//! tests are skipped in one line, and fail where CI=true.

mod boot;
mod common;
mod counts;
mod faults;
mod flash;
mod hostile;
mod identity;
mod probe;
mod resolution;
mod restarts;
mod socket;
mod stalls;
mod stream;
mod usb;
