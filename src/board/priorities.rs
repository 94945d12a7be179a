//! Interrupt priorities: the tick first, everything else explicitly below.
//!
//! | priority | interrupt | |
//! | --- | --- | --- |
//! | P0 | ADC3, TIM7_DAC | the tick and its deadline; never masked |
//! | P3 | TIM2 | embassy's clock |
//! | P5 | USB_LP | USB packets |
//! | P6 | UART4 | executor of the USB tasks (the UART is not used, its interrupt is pended by software) |
//! | P15 | UART5 | executor of the watch and the lamps (as UART4) |
//! | P15 | all others | those of the DMA, which embassy enables and nothing uses |
//!
//! Every interrupt starts at P0 after reset, and embassy, whose initialisation enables the clock's and the DMA's, leaves it there.

use embassy_stm32::interrupt::{self, InterruptExt, Priority};

/// Number of interrupts of the STM32G474 (RM0440 table 97).
const INTERRUPTS: usize = 102;

/// Sets them all. Before the tick is enabled, which nothing else may hold up.
pub fn set() {
    // SAFETY: byte writes to NVIC_IPR, each of its own interrupt; what is enabled by now runs as well at any priority.
    unsafe {
        let nvic = &*cortex_m::peripheral::NVIC::PTR;
        for ipr in nvic.ipr.iter().take(INTERRUPTS) {
            ipr.write(0xf0);
        }
    }
    interrupt::TIM2.set_priority(Priority::P3);
    interrupt::USB_LP.set_priority(Priority::P5);
    interrupt::UART4.set_priority(Priority::P6);
    interrupt::ADC3.set_priority(Priority::P0);
    interrupt::TIM7_DAC.set_priority(Priority::P0);
}

/// Lets the tick run.
pub fn enable_tick() {
    // SAFETY: the handlers' state is initialised; they take part in no critical section.
    unsafe {
        interrupt::ADC3.enable();
        interrupt::TIM7_DAC.enable();
    }
}
