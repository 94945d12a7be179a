//! The linear mechanism: mass, damper and spring of stack and mechanism, and whatever linear blocks hang on them,
//! propagated exactly over a tick.
//!
//! Between two ticks the force goes from `f0` to `f1` along `(1 - e^(-t/tau)) / (1 - e^(-h/tau))`, the way an
//! amplifier of time constant tau goes to a held target. That makes the state at the end of the tick
//! `phi s + gamma0 f0 + gamma1 f1` with constant matrices: `x1 = a + beta f1`.

use nalgebra::{DMatrix, DVector};

use super::model::{AxisModel, StateKind};

/// Most linear states of an axis.
pub const MAX_STATES: usize = 12;

/// Discrete linear mechanism of one axis with its state `[x, velocity, ...]`.
#[derive(Debug, Clone)]
pub struct LinearMechanism {
    states: usize,
    phi: [[f64; MAX_STATES]; MAX_STATES],
    gamma0: [f64; MAX_STATES],
    gamma1: [f64; MAX_STATES],
    static_shape: [f64; MAX_STATES],
    state: [f64; MAX_STATES],
}

impl LinearMechanism {
    /// Build for a tick of `step_s` under forces that follow a time constant of `shape_s` (0: a step).
    pub fn new(model: &AxisModel, step_s: f64, shape_s: f64) -> Self {
        let mass = model.piezo.mass_kg + model.mechanism.mass_kg;
        let damping = model.piezo.damping_n_s_per_m + model.mechanism.damping_n_s_per_m;
        let stiffness = model.piezo.stiffness_n_per_m + model.mechanism.stiffness_n_per_m;
        let rate = (stiffness / mass).sqrt();
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
        let mut input = DVector::<f64>::zeros(n);
        input[1] = 1.0 / mass;

        let static_shape = (-&a).lu().solve(&input).unwrap_or_else(|| DVector::zeros(n));
        // Velocities in units of rate * metre: keeps the exponential well conditioned.
        let unit = |i: usize| if kinds[i] == StateKind::Velocity { rate } else { 1.0 };
        // Force = P + Q e^(-t/tau) (or P + Q t/h for a slow amplifier), as two further states.
        let shape = Shape::new(step_s, shape_s);
        let mut generator = DMatrix::<f64>::zeros(n + 2, n + 2);
        for row in 0..n {
            for column in 0..n {
                generator[(row, column)] = a[(row, column)] * unit(column) / unit(row) * step_s;
            }
            // In units of the static displacement under one newton, so that entries are of one size.
            let push = input[row] / unit(row) * step_s * stiffness;
            generator[(row, n)] = push;
            generator[(row, n + 1)] = push;
        }
        shape.generate(&mut generator, n);
        let transition = generator.exp();
        let mut this = Self {
            states: n,
            phi: [[0.0; MAX_STATES]; MAX_STATES],
            gamma0: [0.0; MAX_STATES],
            gamma1: [0.0; MAX_STATES],
            static_shape: [0.0; MAX_STATES],
            state: [0.0; MAX_STATES],
        };
        for row in 0..n {
            for column in 0..n {
                this.phi[row][column] = transition[(row, column)] * unit(row) / unit(column);
            }
            let constant = transition[(row, n)] * unit(row) / stiffness;
            let varying = transition[(row, n + 1)] * unit(row) / stiffness;
            (this.gamma0[row], this.gamma1[row]) = shape.weights(constant, varying);
            this.static_shape[row] = static_shape[row];
        }
        this
    }

    /// Displacement, m.
    #[inline]
    pub fn position_m(&self) -> f64 {
        self.state[0]
    }

    /// Static displacement a newton, m/N.
    pub fn compliance_m_per_n(&self) -> f64 {
        self.static_shape[0]
    }

    /// Come to rest under a constant force, N.
    pub fn rest_under(&mut self, force_n: f64) {
        for i in 0..self.states {
            self.state[i] = self.static_shape[i] * force_n;
        }
    }

    /// Displacement at the end of the tick without the part of its end force: `x1 = a + beta f1`.
    #[inline]
    pub fn free_position_m(&self, force0_n: f64) -> f64 {
        if self.states == 2 {
            return self.phi[0][0] * self.state[0]
                + self.phi[0][1] * self.state[1]
                + self.gamma0[0] * force0_n;
        }
        let mut sum = self.gamma0[0] * force0_n;
        for i in 0..self.states {
            sum += self.phi[0][i] * self.state[i];
        }
        sum
    }

    /// Displacement a newton of end force, m/N.
    #[inline]
    pub fn beta_m_per_n(&self) -> f64 {
        self.gamma1[0]
    }

    /// Go to the end of the tick.
    #[inline]
    pub fn advance(&mut self, force0_n: f64, force1_n: f64) {
        if self.states == 2 {
            let [x, w, ..] = self.state;
            self.state[0] = self.phi[0][0] * x
                + self.phi[0][1] * w
                + self.gamma0[0] * force0_n
                + self.gamma1[0] * force1_n;
            self.state[1] = self.phi[1][0] * x
                + self.phi[1][1] * w
                + self.gamma0[1] * force0_n
                + self.gamma1[1] * force1_n;
            return;
        }
        let before = self.state;
        for row in 0..self.states {
            let mut sum = self.gamma0[row] * force0_n + self.gamma1[row] * force1_n;
            for column in 0..self.states {
                sum += self.phi[row][column] * before[column];
            }
            self.state[row] = sum;
        }
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
