//! Axes that springs tie together, solved together; an axis on its own is a group of one.

use super::axis::AxisSim;
use super::model::CouplingSpring;
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
}

impl Group {
    /// Split axes into groups by the springs between them.
    pub fn split(axes: Vec<AxisSim>, springs: &[CouplingSpring]) -> Vec<Group> {
        let mut label: Vec<usize> = (0..axes.len()).collect();
        for spring in springs {
            let (a, b) = (label[spring.axes.0], label[spring.axes.1]);
            for l in &mut label {
                if *l == a.max(b) {
                    *l = a.min(b);
                }
            }
        }
        let mut groups: Vec<Group> = Vec::new();
        let mut group_of = vec![usize::MAX; axes.len()];
        for (index, axis) in axes.into_iter().enumerate() {
            let first = label[index];
            if group_of[first] == usize::MAX {
                group_of[first] = groups.len();
                groups.push(Group { members: Vec::new(), axes: Vec::new(), springs: Vec::new() });
            }
            let group = &mut groups[group_of[first]];
            group.members.push(index);
            group.axes.push(axis);
        }
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

    /// Hold `command(axis)` to the next tick, at session time `time_s`; or go to `output(axis)` if that is known.
    #[inline]
    pub fn advance(
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
