//! ADC1 to ADC5: injected and single regular conversions, hardware oversampling, calibration (RM0440 21).
//!
//! A conversion's value is taken from the analogue world as the mean over the instants at which the sampling switch
//! really opens: trigger + latency, then one every (sampling + 12.5) ADC clocks, as many as the oversampler adds up.
//! Left out: continuous and discontinuous regular sequences, DMA, dual modes, injected queue (JQM, always as with
//! JQDIS), analogue watchdogs, auto-injection, differential offsets and gain compensation, auto-delay.

use super::analog::{Analog, Window};
use crate::time::{NEVER, Time};

/// JEXTSEL of TIM6_TRGO on every ADC (RM0440 tables 163 to 166).
const INJECTED_TIM6: u32 = 14;
/// ADC clocks times two from trigger to the start of sampling (RM0440 21.4.18, t_LATR of the data sheet: 2 to 3.5).
const LATENCY_HALF_CLOCKS: Time = 5;
/// Sampling times in half ADC clocks (RM0440 21.4.12).
const SAMPLING_HALF_CLOCKS: [Time; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
/// 12.5 ADC clocks for 12 bits.
const CONVERSION_HALF_CLOCKS: Time = 25;

const ADRDY: u32 = 1;
const EOC: u32 = 1 << 2;
const EOS: u32 = 1 << 3;
const OVR: u32 = 1 << 4;
const JEOC: u32 = 1 << 5;
const JEOS: u32 = 1 << 6;

struct Running {
    rank: usize,
    ends: Time,
    window: Window,
}

/// One converter.
pub struct Adc {
    /// 1 to 5.
    pub number: u8,
    isr: u32,
    ier: u32,
    cr: u32,
    cfgr: u32,
    cfgr2: u32,
    smpr: [u32; 2],
    sqr1: u32,
    jsqr: u32,
    jdr: [u32; 4],
    dr: u32,
    difsel: u32,
    calibrated: Time,
    injected: Option<Running>,
    regular: Option<Running>,
    /// Triggers that came while a sequence was still running.
    pub missed_triggers: u64,
    /// Sequences finished.
    pub sequences: u64,
    /// Fault injection: triggers are ignored, nothing ever ends.
    pub dead: bool,
}

/// The clock of a pair or triple of ADCs: CCR and CSR (RM0440 21.8).
#[derive(Default)]
pub struct AdcCommon {
    ccr: u32,
}

impl AdcCommon {
    /// One ADC clock from one AHB clock; the asynchronous clock is taken as SYSCLK (CCIPR.ADCxSEL = 2).
    fn clock(&self, ahb: Time) -> Time {
        const ASYNC: [Time; 16] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256, 1, 1, 1, 1];
        ahb * match self.ccr >> 16 & 3 {
            0 => ASYNC[(self.ccr >> 18 & 15) as usize],
            1 => 1,
            2 => 2,
            _ => 4,
        }
    }

    /// ADC clock in Hz.
    pub fn clock_hz(&self, ahb: Time) -> f64 {
        crate::time::SECOND as f64 / self.clock(ahb) as f64
    }

    /// CCR.
    pub fn read(&self, offset: u32) -> u32 {
        if offset == 8 { self.ccr } else { 0 }
    }

    /// CCR.
    pub fn write(&mut self, offset: u32, value: u32) {
        if offset == 8 {
            self.ccr = value;
        }
    }
}

impl Adc {
    /// Out of reset: in deep power-down.
    pub fn new(number: u8) -> Adc {
        Adc {
            number,
            isr: 0,
            ier: 0,
            cr: 0x2000_0000,
            cfgr: 0x8000_0000,
            cfgr2: 0,
            smpr: [0; 2],
            sqr1: 0,
            jsqr: 0,
            jdr: [0; 4],
            dr: 0,
            difsel: 0,
            calibrated: NEVER,
            injected: None,
            regular: None,
            missed_triggers: 0,
            sequences: 0,
            dead: false,
        }
    }

    fn ratio(&self, enable_bit: u32) -> u32 {
        if self.cfgr2 >> enable_bit & 1 == 0 { 1 } else { 2 << (self.cfgr2 >> 2 & 7) }
    }

    fn shift(&self, enable_bit: u32) -> u32 {
        if self.cfgr2 >> enable_bit & 1 == 0 { 0 } else { self.cfgr2 >> 5 & 15 }
    }

    fn sampling(&self, channel: u32) -> Time {
        let (r, i) = if channel < 10 { (0, channel) } else { (1, channel - 10) };
        SAMPLING_HALF_CLOCKS[(self.smpr[r] >> (3 * i) & 7) as usize]
    }

    fn run(&self, rank: usize, channel: u32, start: Time, ratio: u32, clock: Time) -> Running {
        let sampling = self.sampling(channel);
        let period = (sampling + CONVERSION_HALF_CLOCKS) * clock / 2;
        let first = start + sampling * clock / 2;
        let window = Window { first, period, count: ratio };
        Running { rank, ends: start + period * ratio as Time, window }
    }

    fn injected_channel(&self, rank: usize) -> u32 {
        self.jsqr >> (9 + 6 * rank) & 0x1f
    }

    /// A rising edge of TIM6_TRGO.
    pub fn trigger_tim6(&mut self, at: Time, common: &AdcCommon, ahb: Time) {
        let armed = self.cr & 8 != 0
            && self.jsqr >> 7 & 3 & 1 == 1
            && self.jsqr >> 2 & 0x1f == INJECTED_TIM6;
        if armed {
            self.start_injected(at, common, ahb);
        }
    }

    fn start_injected(&mut self, at: Time, common: &AdcCommon, ahb: Time) {
        if self.injected.is_some() {
            self.missed_triggers += 1;
        } else if !self.dead {
            let clock = common.clock(ahb);
            let start = at + LATENCY_HALF_CLOCKS * clock / 2;
            self.injected =
                Some(self.run(0, self.injected_channel(0), start, self.ratio(1), clock));
        }
    }

    /// When a conversion or calibration ends.
    #[inline]
    pub fn next_event(&self) -> Time {
        let i = self.injected.as_ref().map_or(NEVER, |r| r.ends);
        let r = self.regular.as_ref().map_or(NEVER, |r| r.ends);
        i.min(r).min(self.calibrated)
    }

    /// Finishes what ends by `now`.
    pub fn update(&mut self, now: Time, common: &AdcCommon, ahb: Time, analog: &mut dyn Analog) {
        if now >= self.calibrated {
            self.calibrated = NEVER;
            self.cr &= !0x8000_0000;
        }
        while let Some(run) = self.injected.take_if(|r| r.ends <= now) {
            let channel = self.injected_channel(run.rank);
            self.jdr[run.rank] = self.value(channel, &run.window, self.shift(1), analog);
            self.isr |= JEOC;
            if run.rank == (self.jsqr & 3) as usize {
                self.isr |= JEOS;
                self.sequences += 1;
                if self.jsqr >> 7 & 3 == 0 {
                    self.cr &= !8;
                }
            } else {
                let next = run.rank + 1;
                let channel = self.injected_channel(next);
                self.injected =
                    Some(self.run(next, channel, run.ends, self.ratio(1), common.clock(ahb)));
            }
        }
        while let Some(run) = self.regular.take_if(|r| r.ends <= now) {
            let channel = self.sqr1 >> (6 + 6 * run.rank) & 0x1f;
            if self.isr & EOC != 0 {
                self.isr |= OVR;
            }
            self.dr = self.value(channel, &run.window, self.shift(0), analog);
            self.isr |= EOC;
            if run.rank == (self.sqr1 & 15).min(3) as usize {
                self.isr |= EOS;
                self.cr &= !4;
            } else {
                let next = run.rank + 1;
                let channel = self.sqr1 >> (6 + 6 * next) & 0x1f;
                self.regular =
                    Some(self.run(next, channel, run.ends, self.ratio(0), common.clock(ahb)));
            }
        }
    }

    fn value(&self, channel: u32, window: &Window, shift: u32, analog: &mut dyn Analog) -> u32 {
        analog.convert(self.number, channel as u8, window) >> shift & 0xffff
    }

    /// Interrupt line.
    #[inline]
    pub fn line(&self) -> bool {
        self.isr & self.ier & 0x7ff != 0
    }

    /// Register read.
    pub fn read(&mut self, offset: u32) -> u32 {
        match offset {
            0x00 => self.isr,
            0x04 => self.ier,
            0x08 => self.cr,
            0x0c => self.cfgr,
            0x10 => self.cfgr2,
            0x14 | 0x18 => self.smpr[(offset as usize - 0x14) / 4],
            0x30 => self.sqr1,
            0x40 => {
                self.isr &= !EOC;
                self.dr
            }
            0x4c => self.jsqr,
            0x80..=0x8c => self.jdr[(offset as usize - 0x80) / 4],
            0xb0 => self.difsel,
            _ => 0,
        }
    }

    /// Register write.
    pub fn write(&mut self, offset: u32, value: u32, now: Time, common: &AdcCommon, ahb: Time) {
        match offset {
            0x00 => self.isr &= !value,
            0x04 => self.ier = value,
            0x08 => self.control(value, now, common, ahb),
            0x0c => self.cfgr = value,
            0x10 => self.cfgr2 = value,
            0x14 | 0x18 => self.smpr[(offset as usize - 0x14) / 4] = value,
            0x30 => self.sqr1 = value,
            0x4c => self.jsqr = value,
            0xb0 => self.difsel = value,
            _ => {}
        }
    }

    fn control(&mut self, value: u32, now: Time, common: &AdcCommon, ahb: Time) {
        // ADVREGEN, DEEPPWD and ADCALDIF are plain; the low bits and ADCAL are set-only.
        let powered = value & 0x2000_0000 == 0 && value & 0x1000_0000 != 0;
        self.cr = self.cr & 0x8000_003f | value & 0x7000_0000;
        if !powered {
            self.cr &= 0x7000_0000;
            return;
        }
        if value & 0x8000_0000 != 0 && self.cr & 1 == 0 {
            self.cr |= 0x8000_0000;
            self.calibrated = now + 116 * common.clock(ahb);
        }
        if value & 1 != 0 && self.cr & 0x8000_0000 == 0 {
            self.cr |= 1;
            self.isr |= ADRDY;
        }
        if value & 2 != 0 {
            self.cr &= !0xf;
            self.isr &= !ADRDY;
            (self.injected, self.regular) = (None, None);
        }
        if value & 0x10 != 0 {
            self.cr &= !4;
            self.regular = None;
        }
        if value & 0x20 != 0 {
            self.cr &= !8;
            self.injected = None;
        }
        if self.cr & 1 == 0 {
            return;
        }
        if value & 8 != 0 {
            self.cr |= 8;
            if self.jsqr >> 7 & 3 == 0 {
                self.start_injected(now, common, ahb);
            }
        }
        if value & 4 != 0 && self.regular.is_none() && !self.dead {
            self.cr |= 4;
            let clock = common.clock(ahb);
            let start = now + LATENCY_HALF_CLOCKS * clock / 2;
            self.regular = Some(self.run(0, self.sqr1 >> 6 & 0x1f, start, self.ratio(0), clock));
        }
    }
}
