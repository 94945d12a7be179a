//! Ways to a board: USB, the socket of the emulated board, the virtual board in this process.
//!
//! A transport moves whole bulk transfers and knows nothing of what is in them; [`crate::device`] does the talking.

mod socket;
mod usb;
pub(crate) mod wire;

use std::time::Duration;

pub use socket::SocketTransport;
pub use usb::{UsbBoard, UsbTransport, list as list_usb};

use crate::Result;

/// What a second client of a socket is told.
pub(crate) const ANOTHER_CLIENT: &str = "another client has this board";

/// Moves bulk transfers. Used from one thread.
pub trait Transport: Send {
    /// Which board this is, for messages: `board 0123abcd`, `the emulated board at 127.0.0.1:7474`.
    fn name(&self) -> String;

    /// One bulk OUT transfer.
    fn send(&mut self, bytes: &[u8]) -> Result<()>;

    /// Waits for the next bulk IN transfer; `None` when none came within `timeout`. An error is final.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>>;
}

/// Where a board is.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a program holds one, and it is not moved in a loop")]
pub enum Target {
    /// On USB, by serial number when more than one is connected.
    Usb {
        /// Serial number, or any when there is only one board.
        serial: Option<String>,
    },
    /// The emulated board, or one that `flexstage serve` offers: `host:port` or `unix:/path`.
    Socket(String),
    /// Simulated in this process.
    Virtual(crate::virtual_board::Options),
}
