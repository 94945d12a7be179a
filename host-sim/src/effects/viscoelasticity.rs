//! viscoelasticity: part of the mechanism's stiffness relaxes.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{LinearBlock, Model, StateKind};

pub(super) struct Viscoelasticity;

pub(super) const EFFECT: Viscoelasticity = Viscoelasticity;

static INFO: Info = Info {
    name: "viscoelasticity",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("branch_n_per_m", "N/m", 0.0, (0.0, 1.0e10), 5.0e5, "stiffness that relaxes"),
        Parameter::size("damping_n_s_per_m", "N s/m", 0.0, (0.0, 1.0e9), 500.0, "damper in parallel"),
        Parameter::shape("time_constant_s", "s", (1.0e-4, 1.0e3), 0.3, "time in which it relaxes").by_ratio(),
        Parameter::shape(
            "relaxed_share",
            "1",
            (0.0, 1.0),
            0.0,
            "0: the rig's stiffness is the relaxed one; 1: the one before relaxing",
        ),
        Parameter::shape(
            "spread_decades",
            "1",
            (0.0, 1.5),
            0.0,
            "standard deviation of the logarithm of the relaxation times",
        ),
        Parameter::shape(
            "power",
            "1",
            (-1.0, 1.0),
            0.0,
            "power of its time that the stiffness of a branch goes with, where times spread; that of a springpot, negative",
        ),
    ],
    threshold: false,
    physics: "A Maxwell branch (spring branch, damper branch * time_constant) and a damper beside the mechanism's spring: \
              polymer in the load path, glue. One exponential after each step, in proportion to force; one loss peak. \
              A polymer's relaxation times spread over decades, alike in all of them or by a power law: five branches stand for them. \
              Propagated exactly.",
    source: "nylon platform of the second paper, relaxation of about 1 s (notes/physics.md, section 6); power-law relaxation: Nutting, J. Franklin Inst. 191 (1921) 679",
    revealed_by: "held steps, triangles from 0.1 to 20 Hz",
    confused_with: &["creep", "hysteresis-rate", "sensor-drift", "inertia"],
};

struct MaxwellBranch {
    stiffness: f64,
    time_constant_s: f64,
}

impl LinearBlock for MaxwellBranch {
    fn states(&self) -> &'static [StateKind] {
        &[StateKind::Position]
    }

    /// State y is the damper's displacement: y' = (x - y)/tau, force -k (x - y).
    fn assemble(&self, a: &mut nalgebra::DMatrix<f64>, at: usize, mass_kg: f64) {
        a[(at, 0)] += 1.0 / self.time_constant_s;
        a[(at, at)] -= 1.0 / self.time_constant_s;
        a[(1, 0)] -= self.stiffness / mass_kg;
        a[(1, at)] += self.stiffness / mass_kg;
    }
}

/// Branches that spread times are cut into: each stands for a fifth of the decades.
const BRANCHES: usize = 5;

/// Shares of the branches and the decades by which their times are off: the middles of equal parts of a range that spreads so far.
fn branches(spread_decades: f64, power: f64) -> impl Iterator<Item = (f64, f64)> {
    let count = if spread_decades > 0.0 { BRANCHES } else { 1 };
    // A range of one has a standard deviation of 1 over the root of 12.
    let part = spread_decades * 12_f64.sqrt() / count as f64;
    let off = move |k: usize| part * (k as f64 - 0.5 * (count - 1) as f64);
    let strength = move |k: usize| 10_f64.powf(power * off(k));
    let all: f64 = (0..count).map(strength).sum();
    (0..count).map(move |k| (strength(k) / all, off(k)))
}

impl Effect for Viscoelasticity {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [stiffness, damping, time_constant_s, relaxed_share, spread_decades, power] = values[..6]
        else {
            return;
        };
        let axis = &mut model.axes[place.on()];
        let stack = axis.piezo.stiffness_n_per_m;
        let mechanism = &mut axis.mechanism;
        mechanism.damping_n_s_per_m += damping;
        if stiffness > 0.0 {
            mechanism.stiffness_n_per_m =
                (mechanism.stiffness_n_per_m - relaxed_share * stiffness).max(-0.99 * stack);
            for (share, off_decades) in branches(spread_decades, power) {
                mechanism.linear.push(Box::new(MaxwellBranch {
                    stiffness: share * stiffness,
                    time_constant_s: time_constant_s * 10_f64.powf(off_decades),
                }));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Storage and loss modulus of branches (stiffness, time constant in s) at a frequency.
    fn moduli(branches: &[(f64, f64)], hz: f64) -> [f64; 2] {
        branches.iter().fold([0.0; 2], |[storage, loss], (stiffness, time_constant_s)| {
            let turn = std::f64::consts::TAU * hz * time_constant_s;
            let share = stiffness * turn / (1.0 + turn * turn);
            [storage + share * turn, loss + share]
        })
    }

    /// Many branches over four decades, alike, and over four and a half, by two powers of their time (springpots that end somewhere); the five
    /// that were fitted to them by least squares, with a spring beside them.
    #[test]
    fn five_branches_stand_for_many() {
        // Branches, times in s, power; then spread, power, time in s, stiffness over theirs, and the spring.
        let many = [
            (11, (1.0e-3, 10.0), 0.0, [1.2507, 0.0013, 0.0959, 0.9801, 0.0129]),
            (14, (1.0e-3, 30.0), -0.17, [1.2701, -0.1589, 0.1009, 0.9611, 0.028]),
            (14, (1.0e-3, 30.0), -0.35, [1.1333, -0.3287, 0.0561, 0.9709, 0.0173]),
        ];
        for (count, (fastest_s, slowest_s), slope, [spread, power, time_s, stiffness, spring]) in many {
            let times_s = (0..count).map(|j| {
                fastest_s * f64::powf(slowest_s / fastest_s, f64::from(j) / f64::from(count - 1))
            });
            let all: f64 = times_s.clone().map(|t| t.powf(slope)).sum();
            let theirs: Vec<_> = times_s.map(|t| (t.powf(slope) / all, t)).collect();
            let ours: Vec<_> = branches(spread, power)
                .map(|(share, off)| (stiffness * share, time_s * 10_f64.powf(off)))
                .collect();
            let (mut left, mut square) = (0.0, 0.0);
            for n in 0..120 {
                let hz = 0.01 * f64::powf(5.0e4, f64::from(n) / 119.0);
                let ([a, b], [c, d]) = (moduli(&theirs, hz), moduli(&ours, hz));
                left += (a - c - spring).powi(2) + (b - d).powi(2);
                square += a * a + b * b;
            }
            let rms = f64::sqrt(left / square);
            assert!(rms < 0.015, "{count} branches, power {slope}: {rms}");
        }
    }
}
