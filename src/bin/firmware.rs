//! Firmware of the controller board: an STM32G474RE. All of it is in [`flexstage::board`].
#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    flexstage::board::run()
}
