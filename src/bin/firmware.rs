#![no_std]
#![no_main]
use cortex_m_rt::entry;
use defmt_rtt as _;
use embassy_executor as _;
use embassy_stm32 as _;
use embassy_usb as _;
use flexstage as _;
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}
#[entry]
fn main() -> ! {
    loop {}
}
