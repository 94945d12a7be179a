//! An axis that no spring ties to another one, through many ticks at once: several of them in one step where it is calm (see
//! [`crate::stages::pace`]).

use std::ops::Range;

use super::{Group, asked_v, end_v};
use crate::stages::pace::{self, LEAP, Pace};

impl Group {
    /// `advance` through many ticks at once, for a group that is one axis alone: `command(tick, axis)`,
    /// `output(tick, axis)`, session time at the end of a tick; `reached(tick, position_m, output_v)` hears of that end.
    #[inline]
    pub fn follow(
        &mut self,
        ticks: usize,
        command: impl Fn(usize, usize) -> f64,
        output: impl Fn(usize, usize) -> Option<f64>,
        time_s: impl Fn(usize) -> f64,
        mut reached: impl FnMut(usize, f64, f64),
    ) {
        let Some(most) = self.axes[0].leap() else {
            self.stretch(0..ticks, &command, &output, &time_s, &mut reached);
            return;
        };
        let member = self.members[0];
        let mut pace = Pace::new(&self.axes[0], self.substeps);
        let mut done = 0;
        while done < ticks {
            let part = done..ticks.min(done + LEAP);
            let amplifier = &self.axes[0].amplifier;
            let asked = |tick: usize| {
                asked_v(amplifier, member, |other| command(tick, other), output(tick, member))
            };
            let is_calm = pace.is_calm(part.clone().map(asked)) && part.len() >= most;
            done = part.end;
            let mut heard = |tick, position_m, output_v| {
                pace.saw(position_m, output_v);
                reached(tick, position_m, output_v);
            };
            if is_calm {
                for start in part.step_by(most) {
                    self.leap(start, most, &command, &output, &time_s, &mut heard);
                }
            } else {
                self.stretch(part, &command, &output, &time_s, &mut heard);
            }
        }
        self.axes[0].set_leaping(false);
    }

    /// So many ticks from `start` on in one step, if the amplifier goes one way in them, and one by one otherwise.
    #[inline]
    fn leap(
        &mut self,
        start: usize,
        ticks: usize,
        command: &impl Fn(usize, usize) -> f64,
        output: &impl Fn(usize, usize) -> Option<f64>,
        time_s: &impl Fn(usize) -> f64,
        reached: &mut impl FnMut(usize, f64, f64),
    ) {
        let (member, substeps) = (self.members[0], self.substeps);
        let part_s = self.step_s / substeps as f64;
        let axis = &mut self.axes[0];
        let (before_v, load) = (axis.output_v(), axis.load());
        let mut volts = [0.0; LEAP];
        let volts = &mut volts[..ticks];
        for (tick, v) in (start..).zip(volts.iter_mut()) {
            let asked = |other| command(tick, other);
            let known = output(tick, member);
            *v = end_v(
                &mut axis.amplifier,
                member,
                load,
                (asked, known),
                (substeps, part_s),
                time_s(tick),
            );
        }
        if !pace::is_one_way(before_v, volts) {
            let known = |tick: usize, _: usize| Some(volts[tick - start]);
            self.stretch(start..start + ticks, command, &known, time_s, reached);
            return;
        }
        let end_v = volts[ticks - 1];
        axis.set_leaping(true);
        if ticks == 1 {
            axis.follow(1, |_, _, _| end_v, |_, position_m, _| reached(start, position_m, end_v));
            return;
        }
        let (from_m, first) = (axis.position_m(), axis.metres_per_volt());
        let mut to_m = from_m;
        axis.follow(1, |_, _, _| end_v, |_, position_m, _| to_m = position_m);
        let slopes = [first, axis.metres_per_volt()];
        let way = pace::Way::new((before_v, from_m), (end_v, to_m), slopes);
        for (k, &v) in volts.iter().enumerate() {
            let position_m = if k + 1 == ticks { to_m } else { way.at(v, k + 1, ticks) };
            reached(start + k, position_m, v);
        }
    }

    /// Some ticks of [`follow`](Self::follow), one by one.
    #[inline]
    pub(super) fn stretch(
        &mut self,
        stretch: Range<usize>,
        command: &impl Fn(usize, usize) -> f64,
        output: &impl Fn(usize, usize) -> Option<f64>,
        time_s: &impl Fn(usize) -> f64,
        reached: &mut impl FnMut(usize, f64, f64),
    ) {
        self.axes[0].set_leaping(false);
        let (member, substeps) = (self.members[0], self.substeps);
        let part_s = self.step_s / substeps as f64;
        // Sub-steps left after this one, and the tick that they belong to.
        let (mut tick, mut left) = (stretch.start, substeps);
        let mut ended = 0;
        self.axes[0].follow(
            stretch.len() * substeps,
            |amplifier, before_v, load| {
                left -= 1;
                let voltage = match output(tick, member) {
                    // A measured output is taken to go straight from tick to tick.
                    Some(end_v) => before_v + (end_v - before_v) / (left + 1) as f64,
                    None => {
                        let target = amplifier.target_v(member, |axis| command(tick, axis));
                        amplifier.advance(target, load, time_s(tick) - left as f64 * part_s)
                    }
                };
                if left == 0 {
                    left = substeps;
                    tick += 1;
                }
                voltage
            },
            |substep, position_m, output_v| {
                if substep + 1 == (ended + 1) * substeps {
                    reached(stretch.start + ended, position_m, output_v);
                    ended += 1;
                }
            },
        );
    }
}
