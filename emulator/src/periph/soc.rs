//! The chip: address decoding, interrupt lines, and the next moment at which a peripheral has something to do.
//!
//! Time advances with executed instructions (one cycle each, times [`Soc::cycles_per_instruction`]); peripherals are
//! brought up to date when their deadline passes or their registers are touched. Registers that no model claims keep
//! what is written to them and are listed in [`Soc::plain_registers`], so that nothing is silently pretended:
//! SYSCFG, CRS, EXTI, DBGMCU, DMA, DMAMUX, VREFBUF and OPAMP are of this kind. A peripheral whose clock is gated
//! reads 0 and ignores writes, which is listed in [`Soc::violations`].

use std::collections::{BTreeMap, BTreeSet};

use super::adc::{Adc, AdcCommon};
use super::analog::Analog;
use super::dac::Dac;
use super::flash::Flash;
use super::gpio::Gpio;
use super::iwdg::Iwdg;
use super::nvic::{Nvic, exception};
use super::rcc::{Rcc, ResetCause};
use super::tim::Timer;
use super::usb::Usb;
use crate::cpu::memory::Memory;
use crate::time::{CYCLE, NEVER, Time};
use crate::usb_host::Stack;

mod decode;

/// Interrupt numbers (RM0440 table 97).
mod irq {
    pub const PVD: u32 = 1;
    pub const FLASH: u32 = 4;
    pub const ADC1_2: u32 = 18;
    pub const USB_LP: u32 = 20;
    pub const TIM2: u32 = 28;
    pub const TIM3: u32 = 29;
    pub const TIM4: u32 = 30;
    pub const ADC3: u32 = 47;
    pub const TIM5: u32 = 50;
    pub const TIM6: u32 = 54;
    pub const TIM7: u32 = 55;
    pub const ADC4: u32 = 61;
    pub const ADC5: u32 = 62;
}

/// Everything on the chip but the core.
pub struct Soc {
    /// Now.
    pub now: Time,
    /// When a peripheral, the host or the caller next needs a look.
    pub deadline: Time,
    /// The run stops here.
    pub stop_at: Time,
    /// Set when translated code has to be left at the next block.
    pub attention: bool,
    /// One instruction.
    pub insn_unit: Time,
    /// One AHB cycle.
    ahb: Time,
    /// Cycles charged for an instruction, in sixteenths: 16 is one. Results must not depend on it.
    pub cycles_per_instruction: Time,
    /// Instructions executed since power-on.
    pub instructions: u64,
    /// Interrupt controller.
    pub nvic: Nvic,
    /// Clocks.
    pub rcc: Rcc,
    /// Flash bank 2.
    pub flash: Flash,
    /// TIM2 to TIM7.
    pub tim: [Timer; 6],
    /// ADC1 to ADC5.
    pub adc: [Adc; 5],
    common: [AdcCommon; 2],
    /// DAC1 and DAC2.
    pub dac: [Dac; 2],
    /// Ports A to G.
    pub gpio: [Gpio; 7],
    /// Independent watchdog.
    pub iwdg: Iwdg,
    /// USB device.
    pub usb: Usb,
    /// The computer at the other end of the cable.
    pub stack: Stack,
    /// The board and the plant.
    pub analog: Box<dyn Analog>,
    /// The watchdog fired.
    pub watchdog_reset: bool,
    /// Silicon rules broken, each once.
    pub violations: BTreeSet<String>,
    plain: BTreeMap<u32, u32>,
    /// Registers used that no model claims: address, whether written.
    pub plain_registers: BTreeSet<(u32, bool)>,
    /// TIM6 trigger edges since power-on.
    pub triggers: u64,
    /// Time of the last trigger edge.
    pub last_trigger: Time,
    /// Longest and shortest time between two edges.
    pub trigger_period: (Time, Time),
    cyccnt_base: (Time, u32),
    dwt_on: bool,
    uid: [u32; 3],
    /// Accesses to peripherals.
    pub accesses: u64,
    /// Supply below the PVD threshold.
    pub brown: bool,
    /// Value of IPSR for ICSR reads.
    pub ipsr: u32,
}

impl Soc {
    /// A chip on a board, unpowered until [`Soc::reset`].
    pub fn new(analog: Box<dyn Analog>, packet_memory: Memory, hse_hz: u64) -> Soc {
        Soc {
            now: 0,
            deadline: 0,
            stop_at: NEVER,
            attention: false,
            insn_unit: 255,
            ahb: 255,
            cycles_per_instruction: 16,
            instructions: 0,
            nvic: Nvic::default(),
            rcc: Rcc::new(ResetCause::PowerOn, hse_hz),
            flash: Flash::default(),
            tim: Self::timers(),
            adc: [1, 2, 3, 4, 5].map(Adc::new),
            common: Default::default(),
            dac: Default::default(),
            gpio: std::array::from_fn(Gpio::new),
            iwdg: Iwdg::default(),
            usb: Usb::new(packet_memory),
            stack: Stack::new(),
            analog,
            watchdog_reset: false,
            violations: BTreeSet::new(),
            plain: BTreeMap::new(),
            plain_registers: BTreeSet::new(),
            triggers: 0,
            last_trigger: 0,
            trigger_period: (NEVER, 0),
            cyccnt_base: (0, 0),
            dwt_on: false,
            uid: [0x0032_001d, 0x3439_5106, 0x2031_3356],
            accesses: 0,
            brown: false,
            ipsr: 0,
        }
    }

    fn timers() -> [Timer; 6] {
        [u32::MAX, 0xffff, 0xffff, u32::MAX, 0xffff, 0xffff].map(Timer::new)
    }

    /// The 96-bit unique identifier.
    pub fn uid(&self) -> [u32; 3] {
        self.uid
    }

    /// All registers to their reset values; flash, host and board stay.
    pub fn reset(&mut self, cause: ResetCause) {
        let Rcc { hse_hz, hse_dies_after, .. } = self.rcc;
        self.rcc = Rcc::new(cause, hse_hz);
        self.rcc.hse_dies_after = hse_dies_after;
        self.nvic = Nvic::default();
        self.flash.reset();
        self.tim = Self::timers();
        let dead = self.adc.each_ref().map(|a| a.dead);
        self.adc = [1, 2, 3, 4, 5].map(Adc::new);
        for (a, d) in self.adc.iter_mut().zip(dead) {
            a.dead = d;
        }
        self.common = Default::default();
        self.dac = Default::default();
        self.gpio = std::array::from_fn(Gpio::new);
        self.iwdg = Iwdg::default();
        self.usb = Usb::new(self.usb.memory.clone());
        self.watchdog_reset = false;
        self.plain.clear();
        self.trigger_period = (NEVER, 0);
        self.last_trigger = 0;
        self.dwt_on = false;
        self.clocks_changed();
        self.drive();
        for port in 0..self.gpio.len() {
            self.pins(port);
        }
        let Soc { stack, usb, now, .. } = self;
        stack.update(*now, usb);
        self.sync();
    }

    fn clocks_changed(&mut self) {
        let unit = self.rcc.ahb_unit();
        let count = self.cyccnt();
        self.ahb = unit;
        for t in &mut self.tim {
            t.set_clock(self.now, unit);
        }
        self.nvic.set_clock(self.now, unit);
        self.insn_unit = unit * self.cycles_per_instruction / 16;
        self.cyccnt_base = (self.now, count);
        self.check_clock_rules();
    }

    /// Charges `sixteenths` of a cycle per instruction from now on.
    pub fn set_cycles_per_instruction(&mut self, sixteenths: Time) {
        self.cycles_per_instruction = sixteenths;
        self.insn_unit = self.ahb * sixteenths / 16;
    }

    fn cyccnt(&self) -> u32 {
        let (base, count) = self.cyccnt_base;
        if self.dwt_on { count.wrapping_add(((self.now - base) / self.ahb) as u32) } else { count }
    }

    /// Rules a chip would punish silently (DS12288 5.3, RM0440 3.3.3, 6.1.5, 21.4.3, 22.7.17).
    fn check_clock_rules(&mut self) {
        let hz = self.rcc.sysclk_hz().unwrap_or(0);
        let mut broken = Vec::new();
        if hz > 34_000_000 && self.flash.latency() < ((hz - 1) / 34_000_000) as u32 {
            broken.push(format!("flash latency {} at {hz} Hz", self.flash.latency()));
        }
        if hz > 150_000_000 && self.plain.get(&0x4000_7080).copied().unwrap_or(0x100) & 0x100 != 0 {
            broken.push(format!(
                "{hz} Hz without range 1 boost (PWR_CR5.R1MODE) {:x?} at {}",
                self.plain.get(&0x4000_7080),
                self.now
            ));
        }
        if hz > 170_000_000 {
            broken.push(format!("{hz} Hz, the core runs at 170 MHz at most"));
        }
        if !self.rcc.apb_undivided() {
            broken.push("an APB prescaler is not 1: timer clocks here would be wrong".into());
        }
        self.violations.extend(broken);
    }

    fn drive(&mut self) {
        let codes = [self.dac[0].output(0), self.dac[0].output(1), self.dac[1].output(0)];
        self.analog.drive(self.now, codes, false);
    }

    fn pins(&mut self, port: usize) {
        let (outputs, levels) = self.gpio[port].outputs();
        self.analog.pins(self.now, port, outputs, levels);
    }

    /// Brings every peripheral up to now, sets interrupt lines, finds the next deadline.
    pub fn sync(&mut self) {
        let now = self.now;
        if now >= self.nvic.next_event() {
            self.nvic.update(now);
        }
        for t in self.tim.iter_mut().filter(|t| t.running()) {
            t.update(now);
        }
        if let Some(at) = self.tim[4].take_trgo() {
            self.trigger(at);
        }
        let ahb = self.ahb;
        for (i, a) in self.adc.iter_mut().enumerate() {
            if a.next_event() <= now {
                a.update(now, &self.common[(i >= 2) as usize], ahb, &mut *self.analog);
            }
        }
        self.flash.update(now);
        if std::mem::take(&mut self.flash.nmi) {
            self.nvic.pend(exception::NMI);
        }
        if now >= self.iwdg.next_event() {
            self.watchdog_reset = true;
        }
        if now >= self.stack.next_event(now) {
            self.stack.update(now, &mut self.usb);
        }
        self.lines();
        self.find_deadline();
    }

    fn find_deadline(&mut self) {
        let now = self.now;
        let mut d = self.nvic.next_event().min(self.flash.next_event()).min(self.iwdg.next_event());
        for t in self.tim.iter_mut().filter(|t| t.running()) {
            d = d.min(t.next_event(now));
        }
        for a in &self.adc {
            d = d.min(a.next_event());
        }
        self.deadline = d.min(self.stack.next_event(now)).min(self.stop_at);
        self.attention = self.nvic.any_pending() || self.wants_out();
    }

    /// Whether the machine has to look at the chip between two blocks for another reason than an interrupt.
    #[inline]
    pub fn wants_out(&self) -> bool {
        self.now >= self.stop_at
            || self.watchdog_reset
            || self.nvic.reset_request
            || self.flash.power_lost
    }

    fn trigger(&mut self, at: Time) {
        self.triggers += 1;
        if self.last_trigger != 0 {
            let d = at - self.last_trigger;
            self.trigger_period = (self.trigger_period.0.min(d), self.trigger_period.1.max(d));
        }
        self.last_trigger = at;
        let ahb = self.ahb;
        // Short-circuiting would leave the second converter without its edge.
        let latched = self.dac[0].trigger_tim6() | self.dac[1].trigger_tim6();
        let codes = [self.dac[0].output(0), self.dac[0].output(1), self.dac[1].output(0)];
        self.analog.drive(at, codes, true);
        if latched {
            let hz = crate::time::SECOND as f64 / ahb as f64;
            if !self.dac.iter().all(|d| d.output(0).is_none() || d.high_frequency_ok(hz)) {
                self.violations.insert(format!("DAC_MCR.HFSEL does not suit AHB at {hz} Hz"));
            }
        }
        for (i, a) in self.adc.iter_mut().enumerate() {
            let common = &self.common[(i >= 2) as usize];
            a.trigger_tim6(at, common, ahb);
            if a.next_event() != NEVER && common.clock_hz(ahb) > 60.0e6 {
                self.violations.insert(format!("ADC{} clock above 60 MHz", i + 1));
            }
        }
    }

    fn lines(&mut self) {
        let mut lines = 0u128;
        let mut set = |n: u32, high: bool| lines |= (high as u128) << exception::irq(n);
        set(irq::TIM2, self.tim[0].line());
        set(irq::TIM3, self.tim[1].line());
        set(irq::TIM4, self.tim[2].line());
        set(irq::TIM5, self.tim[3].line());
        set(irq::TIM6, self.tim[4].line());
        set(irq::TIM7, self.tim[5].line());
        set(irq::ADC1_2, self.adc[0].line() || self.adc[1].line());
        set(irq::ADC3, self.adc[2].line());
        set(irq::ADC4, self.adc[3].line());
        set(irq::ADC5, self.adc[4].line());
        set(irq::USB_LP, self.usb.line());
        set(irq::FLASH, self.flash.line());
        // PWR_CR2.PVDE and EXTI_IMR1.IM16.
        let plain = |address: u32| self.plain.get(&address).copied().unwrap_or(0);
        set(irq::PVD, self.brown && plain(0x4000_7004) & plain(0x4001_0400) >> 16 & 1 != 0);
        self.nvic.set_lines(lines);
    }

    /// Jumps to the next deadline: the core sleeps.
    pub fn skip(&mut self) {
        if self.deadline > self.now && self.deadline != NEVER {
            self.now = self.deadline;
        }
        self.sync();
    }

    /// One core cycle.
    #[inline]
    pub fn cycle(&self) -> Time {
        self.ahb
    }

    /// Core frequency.
    pub fn core_hz(&self) -> f64 {
        crate::time::SECOND as f64 / self.ahb as f64
    }

    /// One core cycle now; 170 MHz is [`CYCLE`].
    pub fn full_speed(&self) -> bool {
        self.ahb == CYCLE
    }
}
