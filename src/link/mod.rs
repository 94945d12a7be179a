//! Wire format between the board and the host: what travels over the two bulk endpoints, and in the files that keep it.
//!
//! Everything is a [frame]: a fixed header (magic, version, kind, schema hash, length, sequence number), a payload, and a CRC-32.
//! Three kinds of payload travel in frames:
//!
//! - [`stream`]: samples of consecutive ticks, device to host, laid out by hand in little-endian order because they are
//!   99 % of the traffic and the host wants to read them without parsing.
//! - [`message`]: commands and replies, [postcard]-encoded. They change with every feature, so their schema is hashed into each frame:
//!   a host and a board that were built from different definitions find out at once instead of misreading each other.
//! - [`identity`]: the one payload whose layout never changes, so that any host can tell what any board is.
//!
//! Nothing here allocates, panics on input, or knows hardware: the board encodes with it, the host decodes with it, and
//! the same code runs in the tests of both.

pub mod frame;
pub mod identity;
pub mod message;
pub mod session;
pub mod stream;

pub use frame::{Deframer, Frame, FrameError, Kind, MAX_FRAME, encode};
pub use identity::Identity;
pub use stream::{Fields, Profile, Sample, StreamError, StreamFrame, StreamWriter};

/// Version of the frame header and of the [`identity`] payload. Both only ever change together with this number.
pub const VERSION: u8 = 1;

/// USB vendor id (pid.codes test range: a product needs its own).
pub const USB_VENDOR_ID: u16 = 0x1209;
/// USB product id within [`USB_VENDOR_ID`].
pub const USB_PRODUCT_ID: u16 = 0x0001;
/// Product string of the USB device descriptor, by which the host tells the board from other users of the test id.
pub const USB_PRODUCT: &str = "flexstage controller";
/// Manufacturer string of the USB device descriptor.
pub const USB_MANUFACTURER: &str = "flexstage";
/// Bulk endpoint device to host.
pub const USB_ENDPOINT_IN: u8 = 0x81;
/// Bulk endpoint host to device.
pub const USB_ENDPOINT_OUT: u8 = 0x01;
/// Packet size of both bulk endpoints (full speed).
pub const USB_PACKET_BYTES: usize = 64;
