//! Axes that springs tie together, solved together; an axis on its own is a group of one.

use std::ops::Range;

use super::axis::AxisSim;
use super::mechanism::substeps;
use super::model::{AxisModel, CouplingSpring};
use super::pace::{self, LEAP, Pace};
use crate::rig::MAX_AXES;
use crate::start::Initial;

/// Displacement at which neighbours agree, m.
const TOLERANCE_M: f64 = 1.0e-15;
/// Sweeps over the group at most; each gains the ratio of coupling to own stiffness, squared.
const MAX_SWEEPS: usize = 100;

/// A group of axes with the springs between them.
pub struct Group {
    /// Numbers of the axes in the rig.
    pub members: Vec<usize>,
    axes: Vec<AxisSim>,
    springs: Vec<CouplingSpring>,
    step_s: f64,
    substeps: usize,
}

impl Group {
    /// Build the axes of a rig for ticks of `step_s`, in groups by the springs between them; `leaps`: their commands are known ahead, and
    /// [`follow`](Self::follow) may take several calm ticks at once.
    pub fn split(
        axes: Vec<AxisModel>,
        springs: &[CouplingSpring],
        step_s: f64,
        leaps: bool,
    ) -> Vec<Group> {
        let mut label: Vec<usize> = (0..axes.len()).collect();
        for spring in springs {
            let (a, b) = (label[spring.axes.0], label[spring.axes.1]);
            for l in &mut label {
                if *l == a.max(b) {
                    *l = a.min(b);
                }
            }
        }
        let mut models: Vec<(Vec<usize>, Vec<AxisModel>)> = Vec::new();
        let mut group_of = vec![usize::MAX; axes.len()];
        for (index, axis) in axes.into_iter().enumerate() {
            let first = label[index];
            if group_of[first] == usize::MAX {
                group_of[first] = models.len();
                models.push((Vec::new(), Vec::new()));
            }
            let (members, models) = &mut models[group_of[first]];
            members.push(index);
            models.push(axis);
        }
        let build = |(members, models): (Vec<usize>, Vec<AxisModel>)| {
            let substeps = models.iter().map(|axis| substeps(axis, step_s)).max().unwrap_or(1);
            let is_alone = leaps && models.len() == 1;
            let sim = |axis| {
                let leap = if is_alone { pace::leap(&axis, substeps) } else { None };
                AxisSim::new(axis, step_s, substeps, leap)
            };
            let axes = models.into_iter().map(sim).collect();
            Group { members, axes, springs: Vec::new(), step_s, substeps }
        };
        let mut groups: Vec<Group> = models.into_iter().map(build).collect();
        for spring in springs {
            let group = &mut groups[group_of[label[spring.axes.0]]];
            let place = |axis: usize| {
                group.members.iter().position(|&member| member == axis).expect("in its group")
            };
            let axes = (place(spring.axes.0), place(spring.axes.1));
            group.springs.push(CouplingSpring { axes, ..*spring });
        }
        groups
    }

    /// The axes, in the order of `members`.
    #[inline]
    pub fn axes(&self) -> &[AxisSim] {
        &self.axes
    }

    /// Come to rest: `command(axis)` is the first command, `initial(axis)` the unknown past, `output(axis)` the
    /// amplifier output where it is known.
    pub fn start<'a>(
        &mut self,
        command: impl Fn(usize) -> f64 + Copy,
        initial: impl Fn(usize) -> &'a Initial,
        output: impl Fn(usize) -> Option<f64>,
        time_s: f64,
    ) {
        for (axis, &member) in self.axes.iter_mut().zip(&self.members) {
            let target = axis.amplifier.target_v(member, command);
            axis.start(initial(member), target, time_s, output(member));
        }
        if self.springs.is_empty() {
            return;
        }
        for _ in 0..MAX_SWEEPS {
            let mut moved: f64 = 0.0;
            for index in 0..self.axes.len() {
                let force = self.outside_n(index, |axis| axis.position_m());
                let before = self.axes[index].position_m();
                self.axes[index].rest(force);
                moved = moved.max((self.axes[index].position_m() - before).abs());
            }
            if moved <= TOLERANCE_M {
                break;
            }
        }
    }

    /// Whether this is one axis, which [`follow`](Self::follow) takes.
    #[inline]
    pub fn is_alone(&self) -> bool {
        self.springs.is_empty() && self.axes.len() == 1
    }

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
            let axis = &self.axes[0];
            let asked = |tick: usize| {
                let target = || axis.amplifier.target_v(member, |other| command(tick, other));
                output(tick, member).unwrap_or_else(target)
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
            *v = output(tick, member).unwrap_or_else(|| {
                let target = axis.amplifier.target_v(member, |other| command(tick, other));
                let sooner = |steps: usize| time_s(tick) - steps as f64 * part_s;
                axis.amplifier.advance_by(substeps, target, load, sooner)
            });
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
    fn stretch(
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

    /// Hold `command(axis)` to the next tick, at session time `time_s`; or go to `output(axis)` if that is known.
    #[inline]
    pub fn advance(
        &mut self,
        command: impl Fn(usize) -> f64 + Copy,
        output: impl Fn(usize) -> Option<f64> + Copy,
        time_s: f64,
    ) {
        if self.is_alone() && self.substeps == 1 {
            let member = self.members[0];
            self.axes[0].follow(
                1,
                |amplifier, _, load| match output(member) {
                    Some(end_v) => end_v,
                    None => amplifier.advance(amplifier.target_v(member, command), load, time_s),
                },
                |_, _, _| {},
            );
            return;
        }
        if self.is_alone() {
            let command = |_: usize, axis: usize| command(axis);
            let output = |_: usize, axis: usize| output(axis);
            self.stretch(0..1, &command, &output, &|_| time_s, &mut |_, _, _| {});
            return;
        }
        if self.substeps == 1 {
            self.substep(command, output, time_s);
            return;
        }
        let part = 1.0 / self.substeps as f64;
        for left in (0..self.substeps).rev() {
            // A measured output is taken to go straight from tick to tick.
            let share = 1.0 / (left + 1) as f64;
            let now: [f64; MAX_AXES] = std::array::from_fn(|axis| {
                let slot = self.members.iter().position(|&member| member == axis);
                slot.map_or(0.0, |slot| self.axes[slot].output_v())
            });
            let partly =
                |axis: usize| output(axis).map(|end| now[axis] + share * (end - now[axis]));
            self.substep(command, partly, time_s - left as f64 * part * self.step_s);
        }
    }

    #[inline]
    fn substep(
        &mut self,
        command: impl Fn(usize) -> f64 + Copy,
        output: impl Fn(usize) -> Option<f64>,
        time_s: f64,
    ) {
        for (axis, &member) in self.axes.iter_mut().zip(&self.members) {
            match output(member) {
                Some(output_v) => axis.begin_at(output_v),
                None => {
                    let target = axis.amplifier.target_v(member, command);
                    axis.begin(target, time_s);
                }
            }
        }
        if let ([axis], true) = (&mut self.axes[..], self.springs.is_empty()) {
            axis.solve(0.0);
            axis.commit();
            return;
        }
        for _ in 0..MAX_SWEEPS {
            let mut moved: f64 = 0.0;
            for index in 0..self.axes.len() {
                let force = self.outside_n(index, AxisSim::next_position_m);
                let before = self.axes[index].next_position_m();
                moved = moved.max((self.axes[index].solve(force) - before).abs());
            }
            if moved <= TOLERANCE_M {
                break;
            }
        }
        self.axes.iter_mut().for_each(AxisSim::commit);
    }

    fn outside_n(&self, index: usize, position: impl Fn(&AxisSim) -> f64) -> f64 {
        let mut force = 0.0;
        for spring in &self.springs {
            let (a, b) = spring.axes;
            if a == index {
                force -= spring.stiffness_n_per_m * position(&self.axes[b]);
            } else if b == index {
                force -= spring.stiffness_n_per_m * position(&self.axes[a]);
            }
        }
        force
    }
}
