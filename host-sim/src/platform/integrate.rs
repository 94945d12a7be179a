//! The chain step by step: implicit Runge-Kutta (Radau IIA of order 5, from the `differential-equations` crate).
//!
//! This is the route for everything that is not linear (hardening springs, friction), and the second opinion on the
//! exact solution of [`super::modes`]. It shares no matrices with it: forces are summed element by element.

use differential_equations::prelude::*;

use super::{PlatformError, PlatformRig, rig::Friction};

/// Relative error per step that the solver is asked for.
const RELATIVE_TOLERANCE: f64 = 1e-8;
/// Fewest steps over the whole time: the solver's interpolation between steps is of third order only, and long steps over
/// slow modes would show (3e-5 of the deflection without this, 1e-8 with it, on the paper's platform).
const FEWEST_STEPS: f64 = 400.0;

/// The chain as a first-order system. State: positions (m), velocities (m/s), branch forces (N), sensor reading (m) if it
/// lags.
struct Forces {
    mass: Vec<f64>,
    stiffness: Vec<f64>,
    damping: Vec<f64>,
    cubic: Vec<f64>,
    friction: Vec<f64>,
    /// Spring index, stiffness (N/m) and relaxation rate (1/s).
    branches: Vec<(usize, f64, f64)>,
    lag_s: Option<f64>,
}

impl Forces {
    fn of(rig: &PlatformRig) -> Self {
        let mut branches = Vec::new();
        for (spring, mass) in rig.masses.iter().enumerate() {
            for branch in mass.effects.viscoelasticity.iter().flat_map(|e| e.branches()) {
                let rate = branch.stiffness_n_per_m / branch.damping_n_s_per_m;
                branches.push((spring, branch.stiffness_n_per_m, rate));
            }
        }
        let masses = &rig.masses;
        Self {
            mass: masses.iter().map(|m| m.mass_kg).collect(),
            stiffness: rig.stiffness_n_per_m(),
            damping: masses.iter().map(|m| m.damping_n_s_per_m).collect(),
            cubic: masses
                .iter()
                .map(|m| m.effects.stiffness_hardening.map_or(0.0, |e| e.cubic_n_per_m3))
                .collect(),
            friction: masses
                .iter()
                .map(|m| m.effects.friction.map_or(0.0, |e| e.force_n))
                .collect(),
            branches,
            lag_s: rig.effects.lag_s(),
        }
    }

    fn size(&self) -> usize {
        2 * self.mass.len() + self.branches.len() + usize::from(self.lag_s.is_some())
    }
}

impl<const N: usize> ODE<f64, [f64; N]> for Forces {
    fn diff(&self, _time: f64, z: &[f64; N], rate: &mut [f64; N]) {
        rate.fill(0.0);
        self.rates(&z[..self.size()], &mut rate[..self.size()]);
    }
}

impl Forces {
    /// Shortest time in s (one radian) at which a lightly damped mass can ring on its own spring; infinite if none can.
    fn ringing_s(&self) -> f64 {
        let springs = self.mass.iter().zip(&self.stiffness).zip(&self.damping);
        springs
            .filter(|((m, k), c)| **c < 2.0 * (*k * *m).sqrt())
            .map(|((m, k), _)| (m / k).sqrt())
            .fold(f64::INFINITY, f64::min)
    }

    /// Time derivative of the state.
    fn rates(&self, z: &[f64], rate: &mut [f64]) {
        let count = self.mass.len();
        let (position, rest) = z.split_at(count);
        let velocity = &rest[..count];
        for i in 0..count {
            rate[i] = velocity[i];
            rate[count + i] = 0.0;
        }
        for i in 0..count {
            let (inner_position, inner_velocity) =
                if i > 0 { (position[i - 1], velocity[i - 1]) } else { (0.0, 0.0) };
            let stretch = position[i] - inner_position;
            let speed = velocity[i] - inner_velocity;
            let mut force = self.stiffness[i] * stretch
                + self.cubic[i] * stretch.powi(3)
                + self.damping[i] * speed
                + self.friction[i] * (speed / Friction::REGULAR_M_PER_S).tanh();
            for (b, (spring, stiffness, relaxation)) in self.branches.iter().enumerate() {
                if *spring == i {
                    let branch = z[2 * count + b];
                    force += branch;
                    rate[2 * count + b] = stiffness * speed - relaxation * branch;
                }
            }
            rate[count + i] -= force / self.mass[i];
            if i > 0 {
                rate[count + i - 1] += force / self.mass[i - 1];
            }
        }
        if let Some(lag) = self.lag_s {
            let last = z.len() - 1;
            rate[last] = (position[count - 1] - z[last]) / lag;
        }
    }
}

/// Positions that the sensor follows (m, before gain and offset) at ascending times (s), from masses at `position_m` and
/// null velocity with relaxed branches.
pub fn platform_m(
    rig: &PlatformRig,
    position_m: &[f64],
    times_s: &[f64],
) -> Result<Vec<f64>, PlatformError> {
    let forces = Forces::of(rig);
    // The solver's states have a size known when it is compiled (it cannot start from vectors): unused places stay zero.
    match forces.size() {
        0..=4 => integrate::<4>(&forces, position_m, times_s),
        5..=8 => integrate::<8>(&forces, position_m, times_s),
        9..=16 => integrate::<16>(&forces, position_m, times_s),
        17..=32 => integrate::<32>(&forces, position_m, times_s),
        size => Err(PlatformError::Integration(format!("{size} states, expected at most 32"))),
    }
}

fn integrate<const N: usize>(
    forces: &Forces,
    position_m: &[f64],
    times_s: &[f64],
) -> Result<Vec<f64>, PlatformError> {
    let count = position_m.len();
    let platform = position_m[count - 1];
    let read = if forces.lag_s.is_some() { forces.size() - 1 } else { count - 1 };
    let mut start = [0.0; N];
    start[..count].copy_from_slice(position_m);
    if forces.lag_s.is_some() {
        start[read] = platform;
    }
    let Some(&end) = times_s.last() else { return Ok(Vec::new()) };
    let later: Vec<f64> = times_s.iter().copied().filter(|t| *t > 0.0).collect();
    let mut out = vec![platform; times_s.len() - later.len()];
    if later.is_empty() {
        return Ok(out);
    }
    let size = position_m.iter().fold(0.0_f64, |m, v| m.max(v.abs())).max(1e-12);
    let method = ImplicitRungeKutta::radau5()
        .rtol(RELATIVE_TOLERANCE)
        .atol(RELATIVE_TOLERANCE * size)
        .h_max((end / FEWEST_STEPS).min(forces.ringing_s() / 16.0))
        .max_steps(200_000);
    let solution = IVP::ode(forces, 0.0, end, start)
        .t_eval(later.clone())
        .method(method)
        .solve()
        .map_err(|error| PlatformError::Integration(one_line(&error)))?;
    if solution.y.len() != later.len() {
        return Err(PlatformError::Integration(format!(
            "{} of {} samples reached",
            solution.y.len(),
            later.len()
        )));
    }
    out.extend(solution.y.iter().map(|z| z[read]));
    Ok(out)
}

fn one_line(error: &impl std::fmt::Debug) -> String {
    let text = format!("{error:?}");
    text.chars().take(200).map(|c| if c == '\n' { ' ' } else { c }).collect()
}
