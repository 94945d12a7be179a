//! Transfers: what a host controller is asked for, and how it ended.

use crate::time::Time;

/// A pipe to an endpoint of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pipe {
    /// Endpoint 0.
    Control,
    /// Bulk IN endpoint number.
    In(u8),
    /// Bulk OUT endpoint number.
    Out(u8),
}

/// How a transfer ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// All of it.
    Done,
    /// The device answered STALL.
    Stall,
    /// The device did not answer (three tries), or went away.
    Gone,
    /// Not within its time.
    Timeout,
    /// Taken back by the host.
    Cancelled,
}

/// A finished transfer.
#[derive(Clone, Debug)]
pub struct Completion {
    /// As `submit` returned it.
    pub id: u64,
    /// Where.
    pub pipe: Pipe,
    /// How it ended.
    pub status: Status,
    /// Bytes received (IN and control reads).
    pub data: Vec<u8>,
    /// When.
    pub at: Time,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Setup,
    DataIn,
    DataOut,
    StatusIn,
    StatusOut,
}

pub(super) struct Transfer {
    pub(super) id: u64,
    pub(super) pipe: Pipe,
    pub(super) setup: [u8; 8],
    pub(super) stage: Stage,
    pub(super) data: Vec<u8>,
    pub(super) sent: usize,
    pub(super) want: usize,
    pub(super) zlp: bool,
    pub(super) toggle: bool,
    pub(super) silent: u8,
    pub(super) deadline: Time,
}
