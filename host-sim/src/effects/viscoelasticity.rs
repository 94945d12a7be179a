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
    ],
    threshold: false,
    physics: "A Maxwell branch (spring branch, damper branch * time_constant) and a damper beside the mechanism's spring: \
              polymer in the load path, glue. One exponential after each step, in proportion to force; one loss peak. \
              A polymer's relaxation times spread: five branches have the first nine moments of the normal distribution of their logarithm. \
              Propagated exactly.",
    source: "nylon platform of the second paper, relaxation of about 1 s (notes/physics.md, section 6)",
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

/// Shares of the branches and the standard deviations by which the logarithms of their times are off: Gauss-Hermite quadrature of order 5
/// (Abramowitz and Stegun, table 25.10, rescaled to a standard deviation of one).
fn nodes(spread_decades: f64) -> &'static [(f64, f64)] {
    const ONE: [(f64, f64); 1] = [(1.0, 0.0)];
    const FIVE: [(f64, f64); 5] = [
        (0.011_257_411_327_720_69, -2.856_970_013_872_805_7),
        (0.222_075_922_005_612_65, -1.355_626_179_974_266),
        (0.533_333_333_333_333_3, 0.0),
        (0.222_075_922_005_612_65, 1.355_626_179_974_266),
        (0.011_257_411_327_720_69, 2.856_970_013_872_805_7),
    ];
    if spread_decades > 0.0 { &FIVE } else { &ONE }
}

impl Effect for Viscoelasticity {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [stiffness, damping, time_constant_s, relaxed_share, spread_decades] = values[..5] else { return };
        let axis = &mut model.axes[place.on()];
        let stack = axis.piezo.stiffness_n_per_m;
        let mechanism = &mut axis.mechanism;
        mechanism.damping_n_s_per_m += damping;
        if stiffness > 0.0 {
            mechanism.stiffness_n_per_m =
                (mechanism.stiffness_n_per_m - relaxed_share * stiffness).max(-0.99 * stack);
            for &(share, deviations) in nodes(spread_decades) {
                mechanism.linear.push(Box::new(MaxwellBranch {
                    stiffness: share * stiffness,
                    time_constant_s: time_constant_s * 10_f64.powf(deviations * spread_decades),
                }));
            }
        }
    }
}
