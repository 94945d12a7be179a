//! embassy's USB driver with halts of endpoints that end.
//!
//! # Design
//! embassy-stm32 0.6 answers CLEAR_FEATURE(ENDPOINT_HALT) with a loop that ends only where the endpoint is disabled or halted: it never ends
//! where it is not, and lifts no halt where it is. Hosts send this request unasked, to start over. So the bus is wrapped, and
//! this one of its functions replaced (RM0440 section 45, USB_EPnR; USB 2.0 section 9.4.5): the request sets the data toggle to DATA0 whether
//! the endpoint was halted or not, and one that was goes on where it was: a packet that waited to be sent, or to be read, still does.
//!
//! # Limits
//! A packet that goes out between the read of the register and the write of the toggle would leave the wrong one. The host sends no token to an
//! endpoint whose toggle it resets.

use embassy_stm32::pac::usb::regs::Epr;
use embassy_stm32::pac::usb::vals::Stat;
use embassy_stm32::peripherals::USB;
use embassy_stm32::{pac, usb};
use embassy_usb::driver as interface;
use embassy_usb::driver::{
    Direction, EndpointAddress, EndpointAllocError, EndpointType, Event, Unsupported,
};

use crate::link::{USB_ENDPOINT_IN, USB_ENDPOINT_OUT};

/// embassy's driver.
pub struct Driver(pub usb::Driver<'static, USB>);

impl interface::Driver<'static> for Driver {
    type EndpointOut = usb::Endpoint<'static, USB, usb::Out>;
    type EndpointIn = usb::Endpoint<'static, USB, usb::In>;
    type ControlPipe = usb::ControlPipe<'static, USB>;
    type Bus = Bus;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.0.alloc_endpoint_out(kind, address, max_packet_size, interval_ms)
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        self.0.alloc_endpoint_in(kind, address, max_packet_size, interval_ms)
    }

    fn start(self, control_max_packet_size: u16) -> (Bus, Self::ControlPipe) {
        let (inner, pipe) = self.0.start(control_max_packet_size);
        (Bus { inner, resume_in: Stat::NAK, resume_out: Stat::VALID }, pipe)
    }
}

/// embassy's bus.
pub struct Bus {
    inner: usb::Bus<'static, USB>,
    /// What a halted endpoint returns to.
    resume_in: Stat,
    resume_out: Stat,
}

/// Whether an endpoint can be halted. The control pipe cannot, and embassy panics at numbers that the chip does not have.
fn is_ours(address: EndpointAddress) -> bool {
    [USB_ENDPOINT_IN, USB_ENDPOINT_OUT].contains(&address.into())
}

fn stat(register: Epr, direction: Direction) -> Stat {
    match direction {
        Direction::In => register.stat_tx(),
        Direction::Out => register.stat_rx(),
    }
}

/// The value that changes the state of one direction, if asked resets its toggle, and leaves all else: flags stay where 1 is written, states and
/// toggles where 0 is.
fn change(now: Epr, direction: Direction, to: Stat, reset_toggle: bool) -> Epr {
    let bits = Stat::from_bits(stat(now, direction).to_bits() ^ to.to_bits());
    let mut value = Epr(0);
    value.set_ea(now.ea());
    value.set_ep_type(now.ep_type());
    value.set_ep_kind(now.ep_kind());
    value.set_ctr_rx(true);
    value.set_ctr_tx(true);
    match direction {
        Direction::In => {
            value.set_stat_tx(bits);
            value.set_dtog_tx(reset_toggle && now.dtog_tx());
        }
        Direction::Out => {
            value.set_stat_rx(bits);
            value.set_dtog_rx(reset_toggle && now.dtog_rx());
        }
    }
    value
}

impl Bus {
    fn resume(&mut self, direction: Direction) -> &mut Stat {
        match direction {
            Direction::In => &mut self.resume_in,
            Direction::Out => &mut self.resume_out,
        }
    }
}

impl interface::Bus for Bus {
    async fn enable(&mut self) {
        self.inner.enable().await;
    }

    async fn disable(&mut self) {
        self.inner.disable().await;
    }

    async fn poll(&mut self) -> Event {
        self.inner.poll().await
    }

    fn endpoint_set_enabled(&mut self, address: EndpointAddress, enabled: bool) {
        self.inner.endpoint_set_enabled(address, enabled);
    }

    fn endpoint_set_stalled(&mut self, address: EndpointAddress, stalled: bool) {
        if !is_ours(address) {
            return;
        }
        let direction = address.direction();
        let register = pac::USB.epr(address.index());
        let now = register.read();
        match (stat(now, direction), stalled) {
            // Not configured, or halted already.
            (Stat::DISABLED, _) | (Stat::STALL, true) => {}
            (before, true) => {
                register.write_value(change(now, direction, Stat::STALL, false));
                let now = register.read();
                let is_off = stat(now, direction) == Stat::DISABLED;
                if is_off {
                    // A packet that ended just before the write had made NAK of VALID, and the write this of it.
                    register.write_value(change(now, direction, Stat::STALL, false));
                }
                *self.resume(direction) = if is_off { Stat::NAK } else { before };
            }
            (Stat::STALL, false) => {
                // While the endpoint is halted this does nothing but wake the task that waits for it, which runs after this one.
                self.inner.endpoint_set_stalled(address, false);
                let to = *self.resume(direction);
                register.write_value(change(now, direction, to, true));
            }
            (before, false) => register.write_value(change(now, direction, before, true)),
        }
    }

    fn endpoint_is_stalled(&mut self, address: EndpointAddress) -> bool {
        is_ours(address) && self.inner.endpoint_is_stalled(address)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.inner.remote_wakeup().await
    }
}
