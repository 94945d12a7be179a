//! NVIC, SCB and SysTick: which exception runs next (ARM DDI 0403E B1.5, B3; PM0214 4.3, 4.4).
//!
//! Exceptions are numbered as in IPSR (2 NMI, 3 HardFault ... 15 SysTick, 16 + n interrupt n), in one bit set of 128.
//! Left out: the MPU (its registers hold values, nothing is enforced), lazy FP stacking (frames are always stacked
//! eagerly: FPCCR reads as written), tail-chaining and late arrival (each entry and return is charged in full),
//! SLEEPDEEP (treated as sleep).

use crate::time::{NEVER, Time};

/// Exception numbers.
pub mod exception {
    /// Non-maskable interrupt: flash ECC errors, clock security.
    pub const NMI: u32 = 2;
    /// Hard fault.
    pub const HARD_FAULT: u32 = 3;
    /// Bus fault.
    pub const BUS_FAULT: u32 = 5;
    /// Usage fault.
    pub const USAGE_FAULT: u32 = 6;
    /// Supervisor call.
    pub const SV_CALL: u32 = 11;
    /// Pended service call.
    pub const PEND_SV: u32 = 14;
    /// System tick.
    pub const SYS_TICK: u32 = 15;
    /// Interrupt `n` of the vector table (RM0440 table 97).
    pub const fn irq(n: u32) -> u32 {
        16 + n
    }
}

/// Priorities run from -2 (NMI) to 255; this is "nothing active".
pub const IDLE: i16 = 256;

/// The interrupt controller and its neighbours in the system control space.
pub struct Nvic {
    enabled: u128,
    pending: u128,
    active: u128,
    lines: u128,
    priority: [i16; 128],
    /// Vector table address.
    pub vtor: u32,
    prigroup: u32,
    shcsr: u32,
    cfsr: u32,
    hfsr: u32,
    bfar: u32,
    scr: u32,
    plain: std::collections::BTreeMap<u32, u32>,
    /// AIRCR.SYSRESETREQ was written.
    pub reset_request: bool,
    /// Event register of WFE.
    pub event: bool,
    systick: SysTick,
    active_priority: i16,
}

#[derive(Default)]
struct SysTick {
    csr: u32,
    rvr: u32,
    start: Time,
    wraps: u64,
    unit: Time,
}

impl SysTick {
    fn period(&self) -> Time {
        (self.rvr as Time + 1) * self.unit
    }
    fn next(&self) -> Time {
        if self.csr & 1 == 0 || self.rvr == 0 {
            NEVER
        } else {
            self.start + (self.wraps + 1) * self.period()
        }
    }
}

impl Default for Nvic {
    fn default() -> Self {
        let mut priority = [0; 128];
        priority[exception::NMI as usize] = -2;
        priority[exception::HARD_FAULT as usize] = -1;
        let always = 1 << exception::NMI
            | 1 << exception::HARD_FAULT
            | 1 << exception::SV_CALL
            | 1 << exception::PEND_SV
            | 1 << exception::SYS_TICK;
        Nvic {
            enabled: always,
            pending: 0,
            active: 0,
            lines: 0,
            priority,
            vtor: 0x0800_0000,
            prigroup: 0,
            shcsr: 0,
            cfsr: 0,
            hfsr: 0,
            bfar: 0,
            scr: 0,
            plain: Default::default(),
            reset_request: false,
            event: false,
            systick: SysTick { unit: 1, ..Default::default() },
            active_priority: IDLE,
        }
    }
}

impl Nvic {
    /// Level of the interrupt lines, as a set of exception numbers. A line that is high pends its interrupt unless
    /// that is active; when the handler returns with the line still high, it pends again.
    #[inline]
    pub fn set_lines(&mut self, lines: u128) {
        self.lines = lines;
        self.pending |= lines & !self.active;
    }

    /// Pends an exception.
    pub fn pend(&mut self, exception: u32) {
        self.pending |= 1 << exception;
    }

    /// Whether any enabled exception waits, whatever its priority: wakes WFI.
    #[inline]
    pub fn any_pending(&self) -> bool {
        self.pending & self.enabled != 0
    }

    /// The exception to take now: highest priority among the pending, if it preempts what runs. `mask` is the lowest
    /// priority value that PRIMASK, FAULTMASK or BASEPRI holds back.
    #[inline]
    pub fn next_exception(&self, mask: i16) -> Option<u32> {
        let mut waiting = self.pending & self.enabled;
        let mut best = None;
        let mut best_priority = self.active_priority.min(mask);
        while waiting != 0 {
            let n = waiting.trailing_zeros();
            waiting &= waiting - 1;
            let p = self.group(self.priority[n as usize]);
            if p < best_priority {
                best_priority = p;
                best = Some(n);
            }
        }
        best
    }

    /// Whether a pending exception would preempt what runs if nothing were masked: wakes WFI under PRIMASK.
    pub fn would_wake(&self) -> bool {
        self.next_exception(IDLE).is_some()
    }

    /// The preempting part of a priority (AIRCR.PRIGROUP).
    fn group(&self, p: i16) -> i16 {
        if p < 0 { p } else { p & !((2i16 << self.prigroup) - 1) & 0xf0 }
    }

    /// The handler of `exception` starts.
    pub fn enter(&mut self, exception: u32) {
        self.pending &= !(1 << exception);
        self.active |= 1 << exception;
        self.event = true;
        self.refresh();
    }

    /// The handler of `exception` returns.
    pub fn leave(&mut self, exception: u32) {
        self.active &= !(1 << exception);
        self.event = true;
        self.pending |= self.lines & !self.active;
        self.refresh();
    }

    fn refresh(&mut self) {
        let mut active = self.active;
        self.active_priority = IDLE;
        while active != 0 {
            let n = active.trailing_zeros();
            active &= active - 1;
            self.active_priority = self.active_priority.min(self.group(self.priority[n as usize]));
        }
    }

    /// Priority of what runs now.
    pub fn active_priority(&self) -> i16 {
        self.active_priority
    }

    /// Priority of an exception, as programmed.
    pub fn priority_of(&self, exception: u32) -> i16 {
        self.priority[exception as usize]
    }

    /// Whether interrupt `n` is enabled.
    pub fn is_enabled(&self, exception: u32) -> bool {
        self.enabled >> exception & 1 != 0
    }

    /// Sets the fault status for a fault of kind `exception` and says which exception handles it: itself when enabled
    /// and not blocked, else HardFault; `None` is lockup (ARM DDI 0403E B1.5.15).
    pub fn fault(&mut self, exception: u32, cfsr: u32, address: Option<u32>) -> Option<u32> {
        self.cfsr |= cfsr;
        if let Some(a) = address {
            self.bfar = a;
        }
        let p = self.group(self.priority[exception as usize]);
        if exception != exception::HARD_FAULT
            && self.is_enabled(exception)
            && p < self.active_priority
        {
            return Some(exception);
        }
        self.hfsr |= 1 << 30;
        (self.active_priority > -1).then_some(exception::HARD_FAULT)
    }

    /// Fault registers, for a crash report: CFSR, HFSR, BFAR.
    pub fn fault_status(&self) -> (u32, u32, u32) {
        (self.cfsr, self.hfsr, self.bfar)
    }

    /// SysTick counts core cycles of `unit`.
    pub fn set_clock(&mut self, now: Time, unit: Time) {
        self.systick.unit = unit;
        self.systick.start = now;
        self.systick.wraps = 0;
    }

    /// When SysTick wraps next.
    pub fn next_event(&self) -> Time {
        self.systick.next()
    }

    /// Brings SysTick up to `now`.
    pub fn update(&mut self, now: Time) {
        while self.systick.next() <= now {
            self.systick.wraps += 1;
            self.systick.csr |= 1 << 16;
            if self.systick.csr & 2 != 0 {
                self.pend(exception::SYS_TICK);
            }
        }
    }

    /// SCR.SLEEPONEXIT.
    pub fn sleep_on_exit(&self) -> bool {
        self.scr & 2 != 0
    }

    /// Reads a word at `offset` from 0xE000_E000.
    pub fn read(&mut self, offset: u32, now: Time, ipsr: u32) -> u32 {
        let word = |set: u128, o: u32| (set >> (16 + (o & 0xf) * 8)) as u32;
        match offset {
            0x010 => {
                let csr = self.systick.csr;
                self.systick.csr &= !(1 << 16);
                csr
            }
            0x014 => self.systick.rvr,
            0x018 if self.systick.csr & 1 != 0 && self.systick.rvr != 0 => {
                let phase = (now - self.systick.start) % self.systick.period();
                self.systick.rvr - (phase / self.systick.unit) as u32
            }
            0x100..=0x10c | 0x180..=0x18c => word(self.enabled, offset),
            0x200..=0x20c | 0x280..=0x28c => word(self.pending, offset),
            0x300..=0x30c => word(self.active, offset),
            0x400..=0x46c => {
                let i = (offset - 0x400) as usize + 16;
                (0..4).fold(0, |w, k| w | (self.priority[i + k] as u32 & 0xff) << (8 * k))
            }
            0xd00 => 0x410f_c241,
            0xd04 => {
                let waiting = (self.pending & self.enabled).trailing_zeros() & 127;
                ipsr | waiting << 12
                    | ((self.pending >> 14) as u32 & 1) << 28
                    | ((self.pending >> 15) as u32 & 1) << 26
            }
            0xd08 => self.vtor,
            0xd0c => 0xfa05_0000 | self.prigroup << 8,
            0xd10 => self.scr,
            0xd18..=0xd20 => {
                let i = (offset - 0xd18) as usize + 4;
                (0..4).fold(0, |w, k| w | (self.priority[i + k] as u32 & 0xff) << (8 * k))
            }
            0xd24 => self.shcsr,
            0xd28 => self.cfsr,
            0xd2c => self.hfsr,
            0xd38 => self.bfar,
            0xd90 => 0x0000_0800,
            _ => self.plain.get(&offset).copied().unwrap_or(0),
        }
    }

    /// Writes `size` bytes at `offset` from 0xE000_E000. Priorities are bytes, the rest words.
    pub fn write(&mut self, offset: u32, size: usize, value: u32, now: Time) {
        let bits = |o: u32| (value as u128) << (16 + (o & 0xf) * 8);
        match offset {
            0x010 => {
                if value & 1 != 0 && self.systick.csr & 1 == 0 {
                    self.systick.start = now;
                    self.systick.wraps = 0;
                }
                self.systick.csr = value & 7;
            }
            0x014 => self.systick.rvr = value & 0xff_ffff,
            0x018 => {
                self.systick.start = now;
                self.systick.wraps = 0;
            }
            0x100..=0x10c => self.enabled |= bits(offset),
            0x180..=0x18c => self.enabled &= !bits(offset),
            0x200..=0x20c => self.pending |= bits(offset),
            0x280..=0x28c => {
                self.pending = self.pending & !bits(offset) | self.lines & !self.active
            }
            0x400..=0x46f => self.set_priorities((offset - 0x400) as usize + 16, size, value),
            0xd18..=0xd23 => self.set_priorities((offset - 0xd18) as usize + 4, size, value),
            0xd04 => {
                for (bit, n, set) in [
                    (31, 2, true),
                    (28, 14, true),
                    (27, 14, false),
                    (26, 15, true),
                    (25, 15, false),
                ] {
                    if value >> bit & 1 != 0 {
                        if set { self.pending |= 1 << n } else { self.pending &= !(1u128 << n) }
                    }
                }
            }
            0xd08 => self.vtor = value & !0x7f,
            0xd0c if value >> 16 == 0x05fa => {
                self.prigroup = value >> 8 & 7;
                self.reset_request |= value & 4 != 0;
                self.refresh();
            }
            0xd10 => self.scr = value,
            0xd24 => {
                self.shcsr = value;
                for (bit, n) in [(16, 4), (17, 5), (18, 6)] {
                    if value >> bit & 1 != 0 {
                        self.enabled |= 1 << n
                    } else {
                        self.enabled &= !(1u128 << n)
                    }
                }
            }
            0xd28 => self.cfsr &= !value,
            0xd2c => self.hfsr &= !value,
            0xf00 => self.pend(16 + (value & 0x7f)),
            _ => {
                self.plain.insert(offset, value);
            }
        }
    }

    fn set_priorities(&mut self, first: usize, size: usize, value: u32) {
        for k in 0..size {
            if let Some(p) = self.priority.get_mut(first + k) {
                *p = (value >> (8 * k) & 0xf0) as i16;
            }
        }
        self.refresh();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_urgent_pending_interrupt_preempts_and_masks_hold_back() {
        let mut n = Nvic::default();
        n.write(0x100, 4, 1 << 18 | 1 << 20, 0);
        n.write(0x400 + 18, 1, 0x00, 0);
        n.write(0x400 + 20, 1, 0x60, 0);
        n.pend(exception::irq(20));
        assert_eq!(n.next_exception(IDLE), Some(36));
        n.enter(36);
        n.pend(exception::irq(20));
        assert_eq!(n.next_exception(IDLE), None, "an interrupt does not preempt itself");
        n.pend(exception::irq(18));
        assert_eq!(n.next_exception(IDLE), Some(34));
        assert_eq!(n.next_exception(0), None, "PRIMASK");
        n.enter(34);
        n.leave(34);
        n.leave(36);
        assert_eq!(n.next_exception(0x60), None, "BASEPRI 0x60 holds priority 6 back");
        assert_eq!(n.next_exception(0x70), Some(36));
    }

    #[test]
    fn a_line_that_stays_high_pends_again_on_return() {
        let mut n = Nvic::default();
        n.write(0x100, 4, 1 << 28, 0);
        n.set_lines(1 << 44);
        n.enter(44);
        n.set_lines(1 << 44);
        assert!(!n.any_pending());
        n.leave(44);
        assert_eq!(n.next_exception(IDLE), Some(44));
    }

    #[test]
    fn system_handler_priorities_and_faults_escalate() {
        let mut n = Nvic::default();
        n.write(0xd22, 1, 0xf0, 0); // PendSV
        assert_eq!(n.priority_of(exception::PEND_SV), 0xf0);
        assert_eq!(
            n.fault(exception::BUS_FAULT, 1 << 9, Some(0x3000_0000)),
            Some(exception::HARD_FAULT)
        );
        n.enter(exception::HARD_FAULT);
        assert_eq!(
            n.fault(exception::BUS_FAULT, 1 << 9, None),
            None,
            "fault in HardFault is lockup"
        );
    }
}
