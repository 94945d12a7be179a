//! Axes that springs tie together, solved together; an axis on its own is a group of one.

mod alone;
mod tied;

use super::amplifier::AmplifierSim;
use super::axis::{AxisSim, Load};
use super::mechanism::substeps;
use super::model::{AxisModel, CouplingSpring};
use super::pace;
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
    /// [`follow`](Self::follow) may take several calm ticks at once, [`follow_tied`](Self::follow_tied) a whole one.
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
            let is_alone = models.len() == 1;
            let sim = |axis| {
                // Axes that are tied take whole ticks at most.
                let leap = pace::leap(&axis, substeps).filter(|&most| is_alone || most == 1);
                AxisSim::new(axis, step_s, substeps, leap.filter(|_| leaps))
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
        self.settle();
    }

    /// Solve for the end of a tick that every axis has begun, and accept it.
    #[inline]
    fn settle(&mut self) {
        self.sweep();
        self.axes.iter_mut().for_each(AxisSim::commit);
    }

    /// Solve for the end of a tick that every axis has begun.
    #[inline]
    fn sweep(&mut self) {
        // What each was last solved under.
        let mut under_n = [None; MAX_AXES];
        for _ in 0..MAX_SWEEPS {
            let mut is_settled = true;
            for (index, solved_n) in under_n.iter_mut().enumerate().take(self.axes.len()) {
                let force = self.outside_n(index, AxisSim::next_position_m);
                let axis = &mut self.axes[index];
                let further_m = |before_n: f64| (force - before_n) * axis.metres_per_newton();
                // One that its neighbours push no further stays where it is.
                if solved_n.is_none_or(|before_n| further_m(before_n).abs() > TOLERANCE_M) {
                    axis.solve(force);
                    (*solved_n, is_settled) = (Some(force), false);
                }
            }
            if is_settled {
                break;
            }
        }
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

/// What the amplifier of an axis is asked for: its target under the commands of all, or what is known of its output, V.
#[inline]
fn asked_v(
    amplifier: &AmplifierSim,
    member: usize,
    command: impl Fn(usize) -> f64,
    known_v: Option<f64>,
) -> f64 {
    known_v.unwrap_or_else(|| amplifier.target_v(member, command))
}

/// Output at the end of a tick at `time_s`, V: the known one, or where the amplifier gets to in so many parts of so many seconds.
#[inline]
fn end_v(
    amplifier: &mut AmplifierSim,
    member: usize,
    load: Load,
    (command, known_v): (impl Fn(usize) -> f64, Option<f64>),
    (parts, part_s): (usize, f64),
    time_s: f64,
) -> f64 {
    known_v.unwrap_or_else(|| {
        let target = amplifier.target_v(member, command);
        amplifier.advance_by(parts, target, load, |left| time_s - left as f64 * part_s)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Rig;
    use crate::{Place, stages::model::Model};

    #[test]
    fn neighbours_agree_once_they_were_swept() {
        for (stiffness, opens) in [(1.0e9, 0.0), (-1.0e9, 0.0), (1.0e9, 0.9)] {
            let mut rig = Rig::named("handley").unwrap();
            for (on, from) in [(0, 1), (1, 2)] {
                // Held to what leaves the three of them stable.
                let pair = Place::Pair { on, from };
                rig.set("stiffness-coupling", pair, "stiffness_n_per_m", stiffness).unwrap();
            }
            rig.set("preload-loss", Place::Axis(1), "lost_share", opens).unwrap();
            let model = Model::new(&rig, 1.0e-4);
            let mut groups = Group::split(model.axes, &model.springs, 1.0e-4, false);
            let [group] = &mut groups[..] else { panic!("one group of three") };
            let rested = Initial::default();
            group.start(|_| 0.0, |_| &rested, |_| None, 0.0);
            let mut farthest_m: f64 = 0.0;
            for tick in 1..400 {
                for (slot, axis) in group.axes.iter_mut().enumerate() {
                    axis.begin_at(40.0 + 35.0 * (0.02 * tick as f64 + slot as f64).sin());
                }
                group.sweep();
                for slot in 0..3 {
                    let force = group.outside_n(slot, AxisSim::next_position_m);
                    let before_m = group.axes[slot].next_position_m();
                    let off_m = (group.axes[slot].solve(force) - before_m).abs();
                    assert!(off_m < 1.0e-13, "{stiffness} N/m, axis {slot}: {off_m} m");
                    farthest_m = farthest_m.max(before_m.abs());
                }
                group.axes.iter_mut().for_each(AxisSim::commit);
            }
            assert!(farthest_m > 1.0e-6, "{farthest_m} m");
        }
    }
}
