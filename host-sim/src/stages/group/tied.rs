//! Axes that springs tie together, through many ticks at once: what [`Group::follow`] is to an axis alone.
//!
//! A mass on one of them asks for parts of a tick on all. Where every one is calm the group takes whole ticks, as an axis alone does (see
//! [`crate::stages::pace`]); several ticks at once it does not: how far an axis has gone in between is no matter of its own voltage alone.

use super::{Group, asked_v, end_v};
use crate::rig::MAX_AXES;
use crate::stages::pace::{self, LEAP, Pace};

impl Group {
    /// `advance` through many ticks at once: `command(tick, axis)`, `output(tick, axis)`, session time at the end of a tick;
    /// `reached(slot, position_m, output_v)` hears of the end of each, for every axis.
    pub fn follow_tied(
        &mut self,
        ticks: usize,
        command: impl Fn(usize, usize) -> f64,
        output: impl Fn(usize, usize) -> Option<f64>,
        time_s: impl Fn(usize) -> f64,
        mut reached: impl FnMut(usize, f64, f64),
    ) {
        let substeps = self.substeps;
        // Without parts there is nothing to gain, and one that follows every tick keeps all of them to it.
        if !self.axes.iter().all(|axis| axis.leap() == Some(1)) {
            for tick in 0..ticks {
                self.advance(|axis| command(tick, axis), |axis| output(tick, axis), time_s(tick));
                for (slot, axis) in self.axes.iter().enumerate() {
                    reached(slot, axis.position_m(), axis.output_v());
                }
            }
            return;
        }
        let mut paces: Vec<Pace> = self.axes.iter().map(|a| Pace::new(a, substeps)).collect();
        let mut done = 0;
        while done < ticks {
            let part = done..ticks.min(done + LEAP);
            done = part.end;
            let mut is_calm = true;
            for (slot, pace) in paces.iter_mut().enumerate() {
                let (amplifier, member) = (&self.axes[slot].amplifier, self.members[slot]);
                let asked = |tick: usize| {
                    asked_v(amplifier, member, |other| command(tick, other), output(tick, member))
                };
                // Each has to hear what it is asked for, whatever the others are.
                is_calm &= pace.is_calm(part.clone().map(asked));
            }
            for tick in part {
                let (asked, known) = (|axis| command(tick, axis), |axis| output(tick, axis));
                if is_calm {
                    self.whole_tick(asked, known, time_s(tick));
                } else {
                    self.set_leaping(false);
                    self.advance(asked, known, time_s(tick));
                }
                for (slot, axis) in self.axes.iter().enumerate() {
                    let (position_m, output_v) = (axis.position_m(), axis.output_v());
                    paces[slot].saw(position_m, output_v);
                    reached(slot, position_m, output_v);
                }
            }
        }
        self.set_leaping(false);
    }

    /// One tick in one step, unless an amplifier goes too far in it.
    fn whole_tick(
        &mut self,
        command: impl Fn(usize) -> f64 + Copy,
        output: impl Fn(usize) -> Option<f64>,
        time_s: f64,
    ) {
        let (substeps, part_s) = (self.substeps, self.step_s / self.substeps as f64);
        let mut volts = [0.0; MAX_AXES];
        let mut is_calm = true;
        for (axis, &member) in self.axes.iter_mut().zip(&self.members) {
            let (before_v, load) = (axis.output_v(), axis.load());
            let amplifier = &mut axis.amplifier;
            let asked = (command, output(member));
            volts[member] = end_v(amplifier, member, load, asked, (substeps, part_s), time_s);
            is_calm &= pace::is_one_way(before_v, &[volts[member]]);
        }
        self.set_leaping(is_calm);
        if !is_calm {
            self.advance(command, |axis| Some(volts[axis]), time_s);
            return;
        }
        for (axis, &member) in self.axes.iter_mut().zip(&self.members) {
            axis.begin_at(volts[member]);
        }
        self.settle();
    }

    fn set_leaping(&mut self, is_leaping: bool) {
        self.axes.iter_mut().for_each(|axis| axis.set_leaping(is_leaping));
    }
}
