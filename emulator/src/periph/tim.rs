//! General and basic timers: TIM2 (the executor's time driver) and TIM6 (the control tick) (RM0440 29, 31).
//!
//! Up-counting with prescaler, auto-reload, four compare channels, update and compare interrupts, update as trigger
//! output. Left out: preload timing (ARR and CCR act at once, PSC too), down and centre-aligned counting, capture,
//! outputs, slave modes, one-pulse, DMA.

use crate::time::{NEVER, Time};

/// One timer.
pub struct Timer {
    cr1: u32,
    cr2: u32,
    dier: u32,
    sr: u32,
    psc: u32,
    arr: u32,
    ccr: [u32; 4],
    unit: Time,
    /// When the counter was (or would have been) 0.
    zero: i64,
    /// Counts since `zero` that have been looked at.
    seen: u64,
    /// Counter while stopped.
    held: u32,
    /// The last update event that drove TRGO.
    trgo: Option<Time>,
    /// No flag changes before this: looking at a timer costs divisions.
    quiet_until: Time,
    /// The next event that anybody listens to, once it has been worked out.
    event: Option<Time>,
}

impl Timer {
    /// A timer out of reset; `max` is its largest auto-reload value.
    pub fn new(max: u32) -> Timer {
        Timer {
            cr1: 0,
            cr2: 0,
            dier: 0,
            sr: 0,
            psc: 0,
            arr: max,
            ccr: [0; 4],
            unit: 255,
            zero: 0,
            seen: 0,
            held: 0,
            trgo: None,
            quiet_until: 0,
            event: None,
        }
    }

    /// Whether it counts.
    #[inline]
    pub fn running(&self) -> bool {
        self.cr1 & 1 != 0
    }

    fn step(&self) -> Time {
        (self.psc as Time + 1) * self.unit
    }

    fn period(&self) -> u64 {
        self.arr as u64 + 1
    }

    fn counts(&self, now: Time) -> u64 {
        (now as i64 - self.zero) as u64 / self.step()
    }

    fn at(&self, counts: u64) -> Time {
        (self.zero + (counts * self.step()) as i64) as Time
    }

    /// The timer clock changed.
    pub fn set_clock(&mut self, now: Time, unit: Time) {
        let held = self.count(now);
        self.unit = unit;
        self.rebase(now, held);
        self.touched();
    }

    /// Registers or the clock changed: what was worked out no longer holds.
    fn touched(&mut self) {
        self.quiet_until = 0;
        self.event = None;
    }

    fn rebase(&mut self, now: Time, count: u32) {
        self.held = count;
        self.zero = now as i64 - (count as Time * self.step()) as i64;
        self.seen = self.counts(now);
    }

    /// Counter value.
    pub fn count(&self, now: Time) -> u32 {
        if self.running() { (self.counts(now) % self.period()) as u32 } else { self.held }
    }

    /// Update period, when it runs.
    pub fn update_period(&self) -> Option<Time> {
        self.running().then(|| self.period() * self.step())
    }

    fn drives_trgo(&self) -> bool {
        self.cr2 >> 4 & 7 == 2
    }

    /// Takes the trigger output pulse, with the exact time of its edge.
    #[inline]
    pub fn take_trgo(&mut self) -> Option<Time> {
        self.trgo.take()
    }

    /// Brings flags up to `now`.
    pub fn update(&mut self, now: Time) {
        if !self.running() || now < self.quiet_until {
            return;
        }
        let counts = self.counts(now);
        let period = self.period();
        self.quiet_until = self.at(self.next_count(counts, |_| true));
        if counts == self.seen {
            return;
        }
        self.event = None;
        if counts / period > self.seen / period {
            self.sr |= 1;
            if self.drives_trgo() {
                self.trgo = Some(self.at(counts / period * period));
            }
        }
        for (i, &c) in self.ccr.iter().enumerate() {
            let c = c as u64;
            let hits = |x: u64| if x >= c { (x - c) / period + 1 } else { 0 };
            if c < period && hits(counts) > hits(self.seen) {
                self.sr |= 2 << i;
            }
        }
        self.seen = counts;
    }

    /// The first count after `counts` at which a flag is set: of the update event (0), of channel k (k).
    fn next_count(&self, counts: u64, wanted: impl Fn(usize) -> bool) -> u64 {
        let period = self.period();
        let start = counts / period * period;
        let mut next = if wanted(0) { start + period } else { NEVER };
        for (i, &c) in self.ccr.iter().enumerate() {
            if wanted(i + 1) && (c as u64) < period {
                let k = start + c as u64;
                next = next.min(if k > counts { k } else { k + period });
            }
        }
        next
    }

    /// When something happens that anybody listens to.
    pub fn next_event(&mut self, now: Time) -> Time {
        if !self.running() {
            return NEVER;
        }
        if let Some(at) = self.event
            && now < at
        {
            return at;
        }
        let listens = |k: usize| self.dier >> k & 1 != 0 || k == 0 && self.drives_trgo();
        let at = match self.next_count(self.counts(now), listens) {
            NEVER => NEVER,
            counts => self.at(counts),
        };
        self.event = Some(at);
        at
    }

    /// Interrupt line.
    #[inline]
    pub fn line(&self) -> bool {
        self.sr & self.dier & 0x1f != 0
    }

    /// Register read.
    pub fn read(&mut self, offset: u32, now: Time) -> u32 {
        self.update(now);
        match offset {
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x0c => self.dier,
            0x10 => self.sr,
            0x24 => self.count(now),
            0x28 => self.psc,
            0x2c => self.arr,
            0x34..=0x40 => self.ccr[(offset as usize - 0x34) / 4],
            _ => 0,
        }
    }

    /// Register write.
    pub fn write(&mut self, offset: u32, value: u32, now: Time) {
        self.update(now);
        self.touched();
        match offset {
            0x00 => {
                let count = self.count(now);
                let (was, runs) = (self.running(), value & 1 != 0);
                self.cr1 = value;
                if was != runs {
                    self.rebase(now, count);
                }
            }
            0x04 => self.cr2 = value,
            0x0c => self.dier = value,
            0x10 => self.sr &= value,
            0x14 if value & 1 != 0 => {
                self.rebase(now, 0);
                if self.cr1 & 4 == 0 {
                    self.sr |= 1;
                }
                if self.drives_trgo() {
                    self.trgo = Some(now);
                }
            }
            0x24 => self.rebase(now, value),
            0x28 => {
                let count = self.count(now);
                self.psc = value & 0xffff;
                self.rebase(now, count);
            }
            0x2c => {
                let count = self.count(now);
                self.arr = value;
                self.rebase(now, count);
            }
            0x34..=0x40 => self.ccr[(offset as usize - 0x34) / 4] = value,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::{CYCLE, TICK};

    #[test]
    fn ten_kilohertz_trigger_is_exact() {
        let mut t = Timer::new(0xffff);
        t.set_clock(0, CYCLE);
        t.write(0x2c, 16_999, 0);
        t.write(0x04, 2 << 4, 0);
        t.write(0x14, 1, 0);
        assert_eq!(t.take_trgo(), Some(0), "UG drives TRGO in update mode");
        t.write(0x00, 1, 1_000);
        for k in 1..100 {
            let at = t.next_event(1_000 + (k - 1) * TICK);
            assert_eq!(at, 1_000 + k * TICK);
            t.update(at + 77);
            assert_eq!(t.take_trgo(), Some(at), "the edge, not when it was looked at");
        }
    }

    #[test]
    fn compare_fires_once_a_period() {
        let mut t = Timer::new(0xffff);
        t.set_clock(0, CYCLE);
        t.write(0x28, 169, 0);
        t.write(0x0c, 2, 0);
        t.write(0x34, 100, 0);
        t.write(0x00, 1, 0);
        let at = t.next_event(0);
        assert_eq!(at, 100 * 170 * CYCLE);
        t.update(at);
        assert!(t.line());
        t.write(0x10, !2, at);
        assert!(!t.line());
        assert_eq!(t.read(0x24, at), 100);
        assert_eq!(t.next_event(at), at + 65_536 * 170 * CYCLE);
    }
}
