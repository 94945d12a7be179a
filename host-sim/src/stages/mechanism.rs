//! The linear mechanism: mass, damper and spring of stack and mechanism, and whatever linear blocks hang on them,
//! propagated exactly over a tick.
//!
//! Between two ticks the force goes from `f0` to `f1` along `(1 - e^(-t/tau)) / (1 - e^(-h/tau))`, the way an
//! amplifier of time constant tau goes to a held target. That makes the state at the end of the tick
//! `phi s + gamma0 f0 + gamma1 f1` with constant matrices: `x1 = a + beta f1`.

use std::cell::RefCell;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::model::{AxisModel, StateKind};

/// Most linear states of an axis.
pub const MAX_STATES: usize = 12;

/// Modes slower than this are resolved by sub-steps, rad/s. Faster ones (a bare stack's 32 kHz) are hardly excited by
/// an amplifier of 0.4 ms and are left to the matrix exponential.
const RESOLVED_PER_S: f64 = std::f64::consts::TAU * 20.0e3;
/// Phase of the fastest resolved mode a sub-step, rad.
const PHASE: f64 = 0.45;
/// Phase that a mode makes in the amplifier's time constant, rad, up to which that holds. A faster one is excited the less, and goes so much
/// farther in a sub-step: a stage of 30 g that swings at 7 kHz behind 0.6 ms goes in four of them a tick of 0.1 ms instead of sixteen, and is
/// within 0.06 nm rms of where it should be (`tests/rates.rs`).
const EXCITED: f64 = 10.0;
/// Most sub-steps.
const MAX_SUBSTEPS: usize = 32;

/// `s' = A s` of a model with the kinds of its states; the force acts on row 1 through the mass.
fn continuous(model: &AxisModel) -> (DMatrix<f64>, Vec<StateKind>) {
    let mass = model.piezo.mass_kg + model.mechanism.mass_kg;
    let damping = model.piezo.damping_n_s_per_m + model.mechanism.damping_n_s_per_m;
    let stiffness = model.piezo.stiffness_n_per_m + model.mechanism.stiffness_n_per_m;
    let mut kinds = vec![StateKind::Position, StateKind::Velocity];
    for block in &model.mechanism.linear {
        kinds.extend_from_slice(block.states());
    }
    let n = kinds.len();
    assert!(n <= MAX_STATES, "an axis has at most {MAX_STATES} linear states");
    let mut a = DMatrix::<f64>::zeros(n, n);
    a[(0, 1)] = 1.0;
    a[(1, 0)] = -stiffness / mass;
    a[(1, 1)] = -damping / mass;
    let mut at = 2;
    for block in &model.mechanism.linear {
        block.assemble(&mut a, at, mass);
        at += block.states().len();
    }
    (a, kinds)
}

/// Sub-steps of a tick of `step_s` that resolve how the hysteresis follows the modes of a heavy mechanism: a power of
/// two, 1 for a mechanism without mass.
pub fn substeps(model: &AxisModel, step_s: f64) -> usize {
    if model.piezo.steepest_v_per_c() == 0.0 && model.mechanism.forces.is_empty() {
        return 1;
    }
    let omega = swings_at(model);
    let phase = PHASE * (omega * model.amplifier.time_constant_s / EXCITED).max(1.0);
    let wanted = (omega * step_s / phase).ceil() as usize;
    wanted.clamp(1, MAX_SUBSTEPS).next_power_of_two()
}

/// Fastest resolved mode of a mechanism, rad/s; 0 where none swings.
pub fn swings_at(model: &AxisModel) -> f64 {
    let (a, _) = continuous(model);
    a.complex_eigenvalues()
        .iter()
        // By its natural frequency: a damper makes a fast mode swing slowly, but follow no slower.
        .filter(|mode| mode.norm() < RESOLVED_PER_S)
        .map(|mode| mode.im.abs())
        .fold(0.0, f64::max)
}

/// Discrete linear mechanism of one axis with its state `[x, velocity, ...]`.
///
/// The transducer voltage follows the displacement inside a tick, because the hysteresis branch lets little charge
/// through: as seen by the mechanism the stack is stiffer, the more so the fewer elements slip. There is one set of
/// matrices for each of a few levels of that stiffening; the force that is interpolated contains it, so the level only
/// shapes what happens inside the tick.
#[derive(Debug, Clone)]
pub struct LinearMechanism {
    states: usize,
    propagator: Arc<Propagator>,
    state: [f64; MAX_STATES],
}

/// What a tick does, for every level of the stiffening.
#[derive(Debug)]
struct Propagator {
    levels: Vec<Level>,
    static_shape: [f64; MAX_STATES],
}

/// Propagators that a thread keeps: a fit simulates many recordings of one mechanism, and most of its steps leave the
/// mechanism alone.
const KEPT: usize = 16;

thread_local! {
    /// Last used last, with all that went into them.
    static PROPAGATORS: RefCell<Vec<(Vec<u64>, Arc<Propagator>)>> = const { RefCell::new(Vec::new()) };
}

/// Matrices of one level: `s1 = phi s0 + gamma0 f0 + gamma1 f1`.
#[derive(Debug, Clone)]
pub(super) struct Level {
    /// Stiffness that the branch adds, N/m.
    pub(super) added_n_per_m: f64,
    pub(super) phi: [[f64; MAX_STATES]; MAX_STATES],
    pub(super) gamma0: [f64; MAX_STATES],
    pub(super) gamma1: [f64; MAX_STATES],
    /// 1 / (1 - gamma1 added): solves the end force for the displacement in it.
    pub(super) closing: f64,
}

impl LinearMechanism {
    /// Build for a tick of `step_s` under forces that follow a time constant of `shape_s` (0: a step), stiffened by
    /// each of `added_n_per_m`.
    pub fn new(model: &AxisModel, step_s: f64, shape_s: f64, added_n_per_m: &[f64]) -> Self {
        let (a, kinds) = continuous(model);
        let states = kinds.len();
        let mass = model.piezo.mass_kg + model.mechanism.mass_kg;
        let stiffness = model.piezo.stiffness_n_per_m + model.mechanism.stiffness_n_per_m;
        let mut key: Vec<u64> = [mass, stiffness, step_s, shape_s].map(f64::to_bits).to_vec();
        key.extend(kinds.iter().map(|kind| *kind as u64));
        key.extend(a.iter().chain(added_n_per_m).map(|value| value.to_bits()));
        let propagator = PROPAGATORS.with_borrow_mut(|kept| {
            let entry = match kept.iter().position(|(known, _)| *known == key) {
                Some(at) => kept.remove(at),
                None => {
                    if kept.len() == KEPT {
                        kept.remove(0);
                    }
                    let shape = Shape::new(step_s, shape_s);
                    (
                        key,
                        Arc::new(Propagator::new(
                            &a,
                            &kinds,
                            (mass, stiffness),
                            step_s,
                            &shape,
                            added_n_per_m,
                        )),
                    )
                }
            };
            let propagator = entry.1.clone();
            kept.push(entry);
            propagator
        });
        Self { states, propagator, state: [0.0; MAX_STATES] }
    }

    /// Displacement, m.
    #[inline]
    pub fn position_m(&self) -> f64 {
        self.state[0]
    }

    /// Static displacement a newton, m/N.
    pub fn compliance_m_per_n(&self) -> f64 {
        self.propagator.static_shape[0]
    }

    /// Number of linear states.
    #[inline]
    pub fn states(&self) -> usize {
        self.states
    }

    /// Displacement (m) and velocity (m/s).
    #[inline]
    pub fn motion(&self) -> [f64; 2] {
        [self.state[0], self.state[1]]
    }

    /// Take over the state of the same mechanism in other steps.
    pub fn take_over(&mut self, other: &Self) {
        self.state = other.state;
    }

    /// Put a mechanism of these two states alone somewhere.
    #[inline]
    pub fn set_motion(&mut self, motion: [f64; 2]) {
        self.state[..2].copy_from_slice(&motion);
    }

    /// Matrices of a level.
    pub(super) fn level(&self, level: usize) -> &Level {
        &self.propagator.levels[level]
    }

    /// Number of levels of stiffening.
    #[inline]
    pub fn levels(&self) -> usize {
        self.propagator.levels.len()
    }

    /// Come to rest under a constant force, N.
    pub fn rest_under(&mut self, force_n: f64) {
        for i in 0..self.states {
            self.state[i] = self.propagator.static_shape[i] * force_n;
        }
    }

    /// Displacement at the end of the tick as `a + beta f1`, for a force that is `force0_n` at its start.
    #[inline]
    pub fn end_position(&self, level: usize, force0_n: f64) -> (f64, f64) {
        let level = &self.propagator.levels[level];
        let start_n = force0_n + level.added_n_per_m * self.state[0];
        let mut sum = level.gamma0[0] * start_n;
        if self.states == 2 {
            sum += level.phi[0][0] * self.state[0] + level.phi[0][1] * self.state[1];
        } else {
            for i in 0..self.states {
                sum += level.phi[0][i] * self.state[i];
            }
        }
        (sum * level.closing, level.gamma1[0] * level.closing)
    }

    /// Go to the end of the tick, which is at displacement `x1` under `force1_n`.
    #[inline]
    pub fn advance(&mut self, level: usize, force0_n: f64, force1_n: f64, x1: f64) {
        let level = &self.propagator.levels[level];
        let start_n = force0_n + level.added_n_per_m * self.state[0];
        let end_n = force1_n + level.added_n_per_m * x1;
        if self.states == 2 {
            let [x, w, ..] = self.state;
            self.state[1] = level.phi[1][0] * x
                + level.phi[1][1] * w
                + level.gamma0[1] * start_n
                + level.gamma1[1] * end_n;
        } else {
            let before = self.state;
            for row in 1..self.states {
                let mut sum = level.gamma0[row] * start_n + level.gamma1[row] * end_n;
                for (weight, value) in level.phi[row].iter().zip(&before[..self.states]) {
                    sum += weight * value;
                }
                self.state[row] = sum;
            }
        }
        self.state[0] = x1;
    }
}

impl Propagator {
    fn new(
        a: &DMatrix<f64>,
        kinds: &[StateKind],
        (mass, stiffness): (f64, f64),
        step_s: f64,
        shape: &Shape,
        added_n_per_m: &[f64],
    ) -> Self {
        let n = kinds.len();
        let mut input = DVector::<f64>::zeros(n);
        input[1] = 1.0 / mass;
        let resting = (-a).lu().solve(&input).unwrap_or_else(|| DVector::zeros(n));
        let mut static_shape = [0.0; MAX_STATES];
        static_shape[..n].copy_from_slice(resting.as_slice());
        let rate = (stiffness / mass).sqrt();
        let levels = added_n_per_m
            .iter()
            .map(|&added| {
                let mut stiffer = a.clone();
                stiffer[(1, 0)] -= added / mass;
                Level::new(&stiffer, kinds, (mass, stiffness, rate), step_s, shape, added)
            })
            .collect();
        Self { levels, static_shape }
    }
}

impl Level {
    /// Matrices of `s' = A s + b f / mass`, `b` being the velocity, over a tick.
    fn new(
        a: &DMatrix<f64>,
        kinds: &[StateKind],
        (mass, stiffness, rate): (f64, f64, f64),
        step_s: f64,
        shape: &Shape,
        added_n_per_m: f64,
    ) -> Self {
        let n = kinds.len();
        // Velocities in units of rate * metre: keeps the exponential well conditioned.
        let unit = |i: usize| if kinds[i] == StateKind::Velocity { rate } else { 1.0 };
        // Force = P + Q e^(-t/tau) (or P + Q t/h for a slow amplifier), as two further states.
        let mut generator = DMatrix::<f64>::zeros(n + 2, n + 2);
        for row in 0..n {
            for column in 0..n {
                generator[(row, column)] = a[(row, column)] * unit(column) / unit(row) * step_s;
            }
        }
        // In units of the static displacement under one newton, so that entries are of one size.
        let push = step_s * stiffness / mass / unit(1);
        generator[(1, n)] = push;
        generator[(1, n + 1)] = push;
        shape.generate(&mut generator, n);
        let transition = generator.exp();
        let mut level = Self {
            added_n_per_m,
            phi: [[0.0; MAX_STATES]; MAX_STATES],
            gamma0: [0.0; MAX_STATES],
            gamma1: [0.0; MAX_STATES],
            closing: 1.0,
        };
        for row in 0..n {
            for column in 0..n {
                level.phi[row][column] = transition[(row, column)] * unit(row) / unit(column);
            }
            let constant = transition[(row, n)] * unit(row) / stiffness;
            let varying = transition[(row, n + 1)] * unit(row) / stiffness;
            (level.gamma0[row], level.gamma1[row]) = shape.weights(constant, varying);
        }
        level.closing = 1.0 / (1.0 - level.gamma1[0] * added_n_per_m);
        level
    }
}

/// How a force gets from one tick's value to the next one's.
enum Shape {
    /// At once: an amplifier much faster than the tick.
    Step,
    /// `e^(-t/tau)`, with `tau / h` and the value at the end of the tick.
    Exponential { decay_rate: f64, end: f64 },
    /// Straight: an amplifier much slower than the tick.
    Ramp,
}

impl Shape {
    fn new(step_s: f64, time_constant_s: f64) -> Self {
        let decay_rate = step_s / time_constant_s;
        if decay_rate > 1.0e3 {
            Shape::Step
        } else if decay_rate < 1.0e-3 {
            Shape::Ramp
        } else {
            Shape::Exponential { decay_rate, end: (-decay_rate).exp() }
        }
    }

    /// Fill the last two rows of the generator: states P and Q of the force.
    fn generate(&self, generator: &mut DMatrix<f64>, n: usize) {
        match self {
            Shape::Step => {}
            Shape::Exponential { decay_rate, .. } => generator[(n + 1, n + 1)] = -decay_rate,
            // Force = P, P' = Q / h: the second state feeds the first and acts through it alone.
            Shape::Ramp => {
                generator[(n, n + 1)] = 1.0;
                for row in 0..n {
                    generator[(row, n + 1)] = 0.0;
                }
            }
        }
    }

    /// Weights of the start and end force from the responses to P and Q.
    fn weights(&self, constant: f64, varying: f64) -> (f64, f64) {
        match self {
            Shape::Step => (0.0, constant),
            // P = f0 + d, Q = -d with d = (f1 - f0)/(1 - end).
            Shape::Exponential { end, .. } => {
                let gamma1 = (constant - varying) / (1.0 - end);
                (constant - gamma1, gamma1)
            }
            // P = f0, Q = f1 - f0.
            Shape::Ramp => (constant - varying, varying),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::Model;
    use super::*;
    use crate::Place;
    use crate::rig::Rig;

    const STEP_S: f64 = 1.0e-4;

    /// Parts of a tick for a mechanism with so much mass and damping.
    fn parts(added_kg: f64, damping_n_s_per_m: f64) -> usize {
        let mut rig = Rig::named("handley").unwrap();
        let axis = Place::Axis(0);
        rig.set("inertia", axis, "added_kg", added_kg).unwrap();
        rig.set("inertia", axis, "added_damping_n_s_per_m", damping_n_s_per_m).unwrap();
        substeps(&Model::new(&rig, STEP_S).axes[0], STEP_S)
    }

    #[test]
    fn slow_modes_take_sub_steps() {
        assert_eq!(parts(0.1, 50.0), 8);
        assert_eq!(parts(1.0, 50.0), 2);
        assert_eq!(parts(0.1, 3.7e3), 4);
    }

    #[test]
    fn a_bare_stack_takes_none_however_it_is_damped() {
        // From ringing to a damping ratio of 0.98, where it swings at 6 kHz.
        for damping in [0.0, 200.0, 420.0, 468.0] {
            assert_eq!(parts(0.0, damping), 1, "{damping} N s/m");
        }
    }
}
