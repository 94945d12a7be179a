//! The exact solution of a linear chain: a sum of exponentials (equation 1 of the paper).
//!
//! The roots of det(lambda² M + lambda C + K) = 0 are the eigenvalues of the chain's state matrix (companion form),
//! found by nalgebra's real Schur decomposition. The slow roots (about 1 s⁻¹) sit beside fast ones (10⁵ s⁻¹) and would
//! lose digits, so each root is polished on the dynamic stiffness D(s) = s² M + s C + K itself, with the mode shape that
//! the chain's own recursion gives. Relaxing branches (generalised Maxwell) only make the springs depend on s:
//!
//! b_i(s) = k_i + c_i s + Σ k_b s / (s + k_b / c_b)
//!
//! All matrices are symmetric, so the amplitude of a mode follows from its shape φ alone (Laplace transform, residue):
//! a = φᵀ[(λ M + C) x0 + M v0 + branches] / (φᵀ D'(λ) φ). Where roots coincide this has no meaning; then the state is
//! carried from sample to sample by the matrix exponential.

use nalgebra::{Complex, DMatrix, DVector};

use super::{PlatformError, PlatformRig, statics};

type C64 = Complex<f64>;

/// Mass, damping and stiffness matrices of a chain (SI units), without relaxing branches.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrices {
    /// M: diagonal, kg.
    pub mass: DMatrix<f64>,
    /// C: tridiagonal, N·s/m.
    pub damping: DMatrix<f64>,
    /// K: tridiagonal, N/m.
    pub stiffness: DMatrix<f64>,
}

/// One exponential of the platform's motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// Root of the characteristic equation, 1/s; negative real part for a stable chain.
    pub root_per_s: C64,
    /// Its amplitude in the platform position, in metres.
    pub amplitude_m: C64,
}

/// Motion of every mass after a release: exact at any time.
#[derive(Debug, Clone)]
pub struct Release {
    modes: Vec<Mode>,
    /// Amplitude of every mass in every mode; `shapes[mode][mass]`.
    amplitudes: Vec<Vec<C64>>,
    /// State matrix and starting state, used where the modes do not span the state (coinciding roots).
    fallback: Option<(DMatrix<f64>, DVector<f64>)>,
    masses: usize,
}

impl Matrices {
    /// M, C and K of a rig's chain.
    pub fn of(rig: &PlatformRig) -> Self {
        let count = rig.masses.len();
        let springs = rig.stiffness_n_per_m();
        let mut mass = DMatrix::zeros(count, count);
        let mut damping = DMatrix::zeros(count, count);
        let mut stiffness = DMatrix::zeros(count, count);
        for (i, element) in rig.masses.iter().enumerate() {
            mass[(i, i)] = element.mass_kg;
            for (matrix, value) in
                [(&mut damping, element.damping_n_s_per_m), (&mut stiffness, springs[i])]
            {
                matrix[(i, i)] += value;
                if i > 0 {
                    matrix[(i - 1, i - 1)] += value;
                    matrix[(i, i - 1)] -= value;
                    matrix[(i - 1, i)] -= value;
                }
            }
        }
        Self { mass, damping, stiffness }
    }
}

/// State matrix A of z' = A z with z = positions, velocities, branch forces (one a Maxwell branch, inner springs first).
pub fn state_matrix(rig: &PlatformRig) -> DMatrix<f64> {
    let count = rig.masses.len();
    let matrices = Matrices::of(rig);
    let branches = branches(rig);
    let size = 2 * count + branches.len();
    let mut a = DMatrix::zeros(size, size);
    for i in 0..count {
        a[(i, count + i)] = 1.0;
        let mass = rig.masses[i].mass_kg;
        for j in 0..count {
            a[(count + i, j)] = -matrices.stiffness[(i, j)] / mass;
            a[(count + i, count + j)] = -matrices.damping[(i, j)] / mass;
        }
    }
    for (b, (spring, stiffness, rate)) in branches.iter().enumerate() {
        let row = 2 * count + b;
        a[(row, row)] = -rate;
        a[(row, count + spring)] = *stiffness;
        a[(count + spring, row)] = -1.0 / rig.masses[*spring].mass_kg;
        if *spring > 0 {
            a[(row, count + spring - 1)] = -*stiffness;
            a[(count + spring - 1, row)] = 1.0 / rig.masses[spring - 1].mass_kg;
        }
    }
    a
}

/// Maxwell branches: spring index, stiffness (N/m), relaxation rate (1/s).
fn branches(rig: &PlatformRig) -> Vec<(usize, f64, f64)> {
    let mut list = Vec::new();
    for (spring, mass) in rig.masses.iter().enumerate() {
        for branch in mass.effects.viscoelasticity.iter().flat_map(|effect| effect.branches()) {
            let rate = branch.stiffness_n_per_m / branch.damping_n_s_per_m;
            list.push((spring, branch.stiffness_n_per_m, rate));
        }
    }
    list
}

/// The chain in the Laplace domain.
struct Chain {
    mass: Vec<f64>,
    stiffness: Vec<f64>,
    damping: Vec<f64>,
    branches: Vec<(usize, f64, f64)>,
}

impl Chain {
    fn of(rig: &PlatformRig) -> Self {
        Self {
            mass: rig.masses.iter().map(|m| m.mass_kg).collect(),
            stiffness: rig.stiffness_n_per_m(),
            damping: rig.masses.iter().map(|m| m.damping_n_s_per_m).collect(),
            branches: branches(rig),
        }
    }

    /// Stiffness of spring `i` at s, and its derivative by s.
    fn element(&self, i: usize, s: C64) -> (C64, C64) {
        let mut value = s * self.damping[i] + self.stiffness[i];
        let mut slope = C64::from(self.damping[i]);
        for (spring, stiffness, rate) in &self.branches {
            if *spring == i {
                let pole = s + *rate;
                value += s * *stiffness / pole;
                slope += C64::from(*stiffness * *rate) / (pole * pole);
            }
        }
        (value, slope)
    }

    /// Shape of the mode at root s: found from the ground outwards, largest entry scaled to one.
    fn shape(&self, s: C64) -> Vec<C64> {
        let count = self.mass.len();
        let mut shape = vec![C64::new(1.0, 0.0); count];
        let mut inner_force = self.element(0, s).0 * shape[0];
        for i in 0..count - 1 {
            let force = inner_force + s * s * self.mass[i] * shape[i];
            shape[i + 1] = shape[i] + force / self.element(i + 1, s).0;
            inner_force = force;
        }
        let largest = shape.iter().map(|v| v.norm()).fold(0.0, f64::max);
        shape.iter().map(|v| v / largest).collect()
    }

    /// φᵀ D(s) φ and φᵀ D'(s) φ.
    fn quadratic(&self, s: C64, shape: &[C64]) -> (C64, C64) {
        let (mut value, mut slope) = (C64::new(0.0, 0.0), C64::new(0.0, 0.0));
        for (i, own) in shape.iter().enumerate() {
            let inner = if i > 0 { shape[i - 1] } else { C64::new(0.0, 0.0) };
            let stretch = own - inner;
            let (element, element_slope) = self.element(i, s);
            value += s * s * self.mass[i] * own * own + element * stretch * stretch;
            slope += s * 2.0 * self.mass[i] * own * own + element_slope * stretch * stretch;
        }
        (value, slope)
    }

    /// Newton on φᵀ D φ (quadratic convergence for symmetric D); keeps the start where it does not settle.
    fn polish(&self, start: C64) -> C64 {
        let mut root = start;
        let mut last = f64::INFINITY;
        for _ in 0..8 {
            let (value, slope) = self.quadratic(root, &self.shape(root));
            let step = value / slope;
            let size = step.norm();
            // A step that does not shrink, or leads away from the start, means a neighbour: leave the root alone.
            if !size.is_finite() || size >= last {
                break;
            }
            if (root - step - start).norm() > 1e-2 * start.norm() {
                return start;
            }
            root -= step;
            last = size;
            if size <= 1e-15 * root.norm() {
                break;
            }
        }
        root
    }
}

/// All roots of the characteristic equation, slowest first. Two a mass, and one a Maxwell branch.
pub fn roots(rig: &PlatformRig) -> Result<Vec<C64>, PlatformError> {
    let a = state_matrix(rig);
    let schur = nalgebra::Schur::try_new(a, f64::EPSILON, 10_000)
        .ok_or_else(|| PlatformError::Roots("the eigenvalue solver did not converge".to_owned()))?;
    let chain = Chain::of(rig);
    let mut roots: Vec<C64> =
        schur.complex_eigenvalues().iter().map(|root| chain.polish(*root)).collect();
    if let Some(root) = roots.iter().find(|root| !root.re.is_finite() || !root.im.is_finite()) {
        return Err(PlatformError::Roots(format!("found the root {root}")));
    }
    roots.sort_by(|a, b| a.norm().total_cmp(&b.norm()).then(a.im.total_cmp(&b.im)));
    Ok(roots)
}

impl Release {
    /// Platform held at `displacement_m` until all branches have relaxed, inner masses in static balance, then let go at
    /// null velocity.
    pub fn from_rest(rig: &PlatformRig, displacement_m: f64) -> Result<Self, PlatformError> {
        let held = statics::held_positions_m(rig, displacement_m)?;
        Self::from_state(rig, &held, &vec![0.0; held.len()])
    }

    /// Any starting positions (m) and velocities (m/s) of the masses; branches relaxed.
    pub fn from_state(
        rig: &PlatformRig,
        position_m: &[f64],
        velocity_m_per_s: &[f64],
    ) -> Result<Self, PlatformError> {
        let chain = Chain::of(rig);
        let count = chain.mass.len();
        let mut modes = Vec::new();
        let mut amplitudes: Vec<Vec<C64>> = Vec::new();
        for root in roots(rig)? {
            let shape = chain.shape(root);
            let (_, slope) = chain.quadratic(root, &shape);
            let mut excitation = C64::new(0.0, 0.0);
            for i in 0..count {
                let inner = |v: &[f64]| if i > 0 { v[i - 1] } else { 0.0 };
                let shape_inner = if i > 0 { shape[i - 1] } else { C64::new(0.0, 0.0) };
                excitation += shape[i]
                    * chain.mass[i]
                    * (root * position_m[i] + C64::from(velocity_m_per_s[i]));
                let mut resistance = C64::from(chain.damping[i]);
                for (spring, stiffness, rate) in &chain.branches {
                    if *spring == i {
                        resistance += C64::from(*stiffness) / (root + *rate);
                    }
                }
                excitation +=
                    resistance * (shape[i] - shape_inner) * (position_m[i] - inner(position_m));
            }
            let scale = excitation / slope;
            let amplitude: Vec<C64> = shape.iter().map(|value| value * scale).collect();
            modes.push(Mode { root_per_s: root, amplitude_m: amplitude[count - 1] });
            amplitudes.push(amplitude);
        }
        // The modes must add up to the starting state; they cannot where roots coincide.
        let size = position_m.iter().fold(0.0_f64, |m, v| m.max(v.abs())).max(f64::MIN_POSITIVE);
        let error = (0..count)
            .map(|i| {
                let sum: C64 = amplitudes.iter().map(|a| a[i]).sum();
                (sum - position_m[i]).norm()
            })
            .fold(0.0_f64, |m, e| if e.is_finite() { m.max(e) } else { f64::INFINITY });
        let moving = velocity_m_per_s.iter().any(|v| *v != 0.0);
        let fallback = (error > 1e-8 * size && !(moving && error < 1e-8)).then(|| {
            let matrix = state_matrix(rig);
            let mut state = DVector::zeros(matrix.nrows());
            for i in 0..count {
                state[i] = position_m[i];
                state[count + i] = velocity_m_per_s[i];
            }
            (matrix, state)
        });
        Ok(Self { modes, amplitudes, fallback, masses: count })
    }

    /// The exponentials of the platform's motion, slowest first.
    pub fn modes(&self) -> &[Mode] {
        &self.modes
    }

    /// Whether the modes are not used because roots coincide.
    pub fn uses_matrix_exponential(&self) -> bool {
        self.fallback.is_some()
    }

    /// Position of the platform (m) at ascending times (s) after the release, through a first-order lag of the sensor if
    /// one is given (the reading starts settled).
    pub fn platform_m(&self, times_s: &[f64], lag_s: Option<f64>) -> Vec<f64> {
        match (&self.fallback, lag_s) {
            (None, None) => self.at(self.masses - 1, times_s),
            (None, Some(lag)) => self.lagged(times_s, lag),
            (Some((matrix, state)), _) => self.stepped(matrix, state, times_s, lag_s),
        }
    }

    /// Position of any mass (0 is the innermost), in metres, at ascending times in s.
    pub fn mass_m(&self, mass: usize, times_s: &[f64]) -> Vec<f64> {
        match &self.fallback {
            None => self.at(mass, times_s),
            Some((matrix, state)) => {
                carry(matrix, state, times_s).into_iter().map(|z| z[mass]).collect()
            }
        }
    }

    fn at(&self, mass: usize, times_s: &[f64]) -> Vec<f64> {
        let terms: Vec<(C64, C64)> = self
            .modes
            .iter()
            .zip(&self.amplitudes)
            .map(|(mode, amplitude)| (mode.root_per_s, amplitude[mass]))
            .collect();
        sum_of_exponentials(&terms, times_s)
    }

    /// Each exponential passes the lag with 1 / (1 + tau lambda); a last one at -1/tau makes the reading start settled.
    fn lagged(&self, times_s: &[f64], lag_s: f64) -> Vec<f64> {
        let mut terms = Vec::with_capacity(self.modes.len() + 1);
        let mut start = C64::new(0.0, 0.0);
        for mode in &self.modes {
            let mut gain = C64::new(1.0, 0.0) + mode.root_per_s * lag_s;
            if gain.norm() < 1e-9 {
                gain = C64::new(1e-9, 0.0); // root on the lag's own pole: the limit, to nine digits
            }
            let amplitude = mode.amplitude_m / gain;
            start += mode.amplitude_m - amplitude;
            terms.push((mode.root_per_s, amplitude));
        }
        terms.push((C64::new(-1.0 / lag_s, 0.0), start));
        sum_of_exponentials(&terms, times_s)
    }

    fn stepped(
        &self,
        matrix: &DMatrix<f64>,
        state: &DVector<f64>,
        times_s: &[f64],
        lag_s: Option<f64>,
    ) -> Vec<f64> {
        let platform = self.masses - 1;
        let Some(lag) = lag_s else {
            return carry(matrix, state, times_s).into_iter().map(|z| z[platform]).collect();
        };
        let size = matrix.nrows();
        let mut wide = matrix.clone().resize(size + 1, size + 1, 0.0);
        wide[(size, platform)] = 1.0 / lag;
        wide[(size, size)] = -1.0 / lag;
        let start = state.clone().push(state[platform]);
        carry(&wide, &start, times_s).into_iter().map(|z| z[size]).collect()
    }
}

/// z(t) by the matrix exponential from one time to the next.
fn carry(matrix: &DMatrix<f64>, state: &DVector<f64>, times_s: &[f64]) -> Vec<DVector<f64>> {
    let mut now = 0.0;
    let mut z = state.clone();
    let mut step = (f64::NAN, DMatrix::zeros(0, 0));
    times_s
        .iter()
        .map(|time| {
            let wanted = time - now;
            if wanted > 0.0 {
                if (wanted - step.0).abs() > 1e-12 * time.abs() || step.0.is_nan() {
                    step = (wanted, (matrix * wanted).exp());
                }
                z = &step.1 * &z;
                now = *time;
            }
            z.clone()
        })
        .collect()
}

fn sum_of_exponentials(terms: &[(C64, C64)], times_s: &[f64]) -> Vec<f64> {
    times_s
        .iter()
        .map(|time| {
            terms
                .iter()
                .map(|(root, amplitude)| {
                    let exponent = root.re * time;
                    if exponent < -745.0 {
                        return 0.0; // exp underflows
                    }
                    let size = exponent.exp();
                    if root.im == 0.0 {
                        amplitude.re * size
                    } else {
                        let (sin, cos) = (root.im * time).sin_cos();
                        size * (amplitude.re * cos - amplitude.im * sin)
                    }
                })
                .sum()
        })
        .collect()
}
