//! The board on USB through `nusb`: no driver to install anywhere (Microsoft OS descriptors on Windows, udev rule on Linux).
//!
//! Eight IN transfers stay queued: embassy-usb's bulk IN endpoint is single-buffered, so the host must never let it wait
//! for a buffer; at 540 kB/s eight of 4096 bytes cover 60 ms without this thread being scheduled.

use std::time::Duration;

use flexstage::link::{
    USB_ENDPOINT_IN, USB_ENDPOINT_OUT, USB_PRODUCT, USB_PRODUCT_ID, USB_VENDOR_ID,
};
use nusb::transfer::{Bulk, In, Out, TransferError};
use nusb::{DeviceInfo, Endpoint, ErrorKind, MaybeFuture};

use super::Transport;
use crate::{Error, Result};

/// IN transfers kept queued.
const QUEUED: usize = 8;
/// Bytes of one IN transfer: a multiple of the packet size.
const TRANSFER_BYTES: usize = 4096;
/// Longest wait for an OUT transfer; the board takes commands within a millisecond.
const SEND_TIMEOUT: Duration = Duration::from_secs(1);

/// A board seen on the bus.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct UsbBoard {
    /// USB serial number: the microcontroller's 96-bit id in hexadecimal.
    pub serial: String,
    /// Product string.
    pub product: String,
    /// Bus.
    pub bus: String,
    /// Address on the bus.
    pub address: u8,
}

fn is_board(device: &DeviceInfo) -> bool {
    device.vendor_id() == USB_VENDOR_ID
        && device.product_id() == USB_PRODUCT_ID
        // The id is a shared test id: the product string tells us apart. Some systems do not show it before opening.
        && device.product_string().is_none_or(|product| product == USB_PRODUCT)
}

fn boards() -> Result<Vec<DeviceInfo>> {
    let devices = nusb::list_devices().wait().map_err(|error| {
        Error::Invalid(format!(
            "the system does not list its USB devices ({error}): is this a container? --virtual and --connect need no USB"
        ))
    })?;
    Ok(devices.filter(is_board).collect())
}

fn serial_of(device: &DeviceInfo) -> String {
    device.serial_number().unwrap_or("unknown").to_owned()
}

/// Boards on the bus, opened by nobody here.
pub fn list() -> Result<Vec<UsbBoard>> {
    Ok(boards()?
        .iter()
        .map(|d| UsbBoard {
            serial: serial_of(d),
            product: d.product_string().unwrap_or(USB_PRODUCT).to_owned(),
            bus: d.bus_id().to_owned(),
            address: d.device_address(),
        })
        .collect())
}

/// The two bulk endpoints of an opened board.
pub struct UsbTransport {
    serial: String,
    input: Endpoint<Bulk, In>,
    output: Endpoint<Bulk, Out>,
}

impl UsbTransport {
    /// Open the board with this serial number, or the only one.
    pub fn open(serial: Option<&str>) -> Result<Self> {
        let mut found = boards()?;
        if let Some(serial) = serial {
            found.retain(|d| serial_of(d).eq_ignore_ascii_case(serial));
        }
        let device = match found.as_slice() {
            [] => return Err(Error::NoBoard { serial: serial.map(str::to_owned) }),
            [one] => one,
            many => {
                return Err(Error::ManyBoards { serials: many.iter().map(serial_of).collect() });
            }
        };
        let serial = serial_of(device);
        let refused = |error: nusb::Error| match error.kind() {
            ErrorKind::Busy => Error::Busy { board: format!("board {serial}") },
            ErrorKind::Disconnected | ErrorKind::NotFound => Error::Lost {
                board: format!("board {serial}"),
                reason: "it was unplugged while being opened".into(),
            },
            _ => Error::NotAllowed { serial: serial.clone(), reason: error.to_string() },
        };
        let opened = device.open().wait().map_err(refused)?;
        // Claiming is exclusive: a second client is refused here by the operating system.
        let interface = opened.claim_interface(0).wait().map_err(refused)?;
        let mut input = interface.endpoint::<Bulk, In>(USB_ENDPOINT_IN).map_err(refused)?;
        let output = interface.endpoint::<Bulk, Out>(USB_ENDPOINT_OUT).map_err(refused)?;
        for _ in 0..QUEUED {
            let buffer = input.allocate(TRANSFER_BYTES);
            input.submit(buffer);
        }
        Ok(Self { serial, input, output })
    }

    fn lost(&self, error: TransferError) -> Error {
        let reason = match error {
            TransferError::Disconnected => "it was unplugged or restarted".to_owned(),
            other => format!("USB transfer failed ({other})"),
        };
        Error::Lost { board: self.name(), reason }
    }
}

impl Transport for UsbTransport {
    fn name(&self) -> String {
        format!("board {}", self.serial)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<()> {
        let done = self.output.transfer_blocking(bytes.to_vec().into(), SEND_TIMEOUT);
        done.status.map(|_| ()).map_err(|error| self.lost(error))
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>> {
        let Some(done) = self.input.wait_next_complete(timeout) else { return Ok(None) };
        done.status.map_err(|error| self.lost(error))?;
        let bytes = done.buffer[..].to_vec();
        self.input.submit(done.buffer);
        Ok(Some(bytes))
    }
}
