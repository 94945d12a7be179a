//! Least squares on the simulated return (output error), with confidence intervals.
//!
//! Residuals are in units of the measured noise of their recording. Minimised by the `levenberg-marquardt` crate
//! (MINPACK's algorithm) with central differences for the Jacobian. Intervals are those of the linearised fit, from
//! Student's distribution, widened by the memory of the noise.

use host_sim::platform::{PlatformError, PlatformRig, free_return};
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, Owned};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{
    data::{Part, Return},
    model::Model,
    noise::Noise,
};

/// Step of the central differences in knob units (all of order one).
const STEP: f64 = 1e-4;
/// Radians of ringing over the longest return up to which a chain is followed step by step, and in multiples of what the rig as
/// given rings. Platforms creep home; a fit that wanders off to hardly damped ones would take minutes for each of its steps.
const MOST_RINGING_RAD: f64 = 1000.0;
const MOST_RINGING: f64 = 2.0;
/// Residual of a chain that is not followed, in deflections: worse than any that is.
const WALL: f64 = 10.0;

/// Returns and their noise.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    /// Recordings of the session.
    pub returns: &'a [Return],
    /// Noise of each.
    pub noise: &'a [Noise],
    /// Fastest ringing that is followed step by step, rad/s.
    most_ringing_rad_per_s: f64,
}

/// A model fitted to a part of the data.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Knobs that were free and the rig at the best values.
    pub model: Model,
    /// Best values of the knobs.
    pub values: Vec<f64>,
    /// Covariance of the knobs; infinite where the data tells nothing.
    pub covariance: DMatrix<f64>,
    /// Sum of squared residuals in units of the noise.
    pub chi2: f64,
    /// Number of samples.
    pub samples: usize,
}

/// A value with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

impl<'a> Data<'a> {
    /// Returns of a platform that is known as `nominal`.
    pub fn new(nominal: &PlatformRig, returns: &'a [Return], noise: &'a [Noise]) -> Self {
        let longest_s = returns.iter().filter_map(|r| r.time_s.last()).fold(1e-9, |a, b| b.max(a));
        let most_ringing_rad_per_s =
            (MOST_RINGING_RAD / longest_s).max(MOST_RINGING * ringing_rad_per_s(nominal));
        Self { returns, noise, most_ringing_rad_per_s }
    }

    /// Whether a chain can be followed in reasonable time.
    fn follows(&self, rig: &PlatformRig) -> bool {
        rig.is_linear() || ringing_rad_per_s(rig) <= self.most_ringing_rad_per_s
    }

    /// Residuals of a chain that is not followed: an optimiser turns back.
    fn wall(&self, part: &Part) -> DVector<f64> {
        let parts = part.rows.iter().flat_map(|(index, rows)| {
            let residual = WALL * self.returns[*index].initial_m / self.noise[*index].rms_m;
            std::iter::repeat_n(residual, rows.len())
        });
        DVector::from_iterator(part.len(), parts)
    }

    /// What the rig predicts for the rows of a part, minus what was measured, in metres, part by part.
    pub fn residuals_m(
        &self,
        rig: &PlatformRig,
        part: &Part,
    ) -> Result<Vec<Vec<f64>>, PlatformError> {
        part.rows
            .iter()
            .map(|(index, rows)| {
                let data = &self.returns[*index];
                let times: Vec<f64> = rows.iter().map(|row| data.time_s[*row]).collect();
                let predicted = free_return(rig, data.initial_m, &times, data.start_s)?;
                Ok(predicted
                    .iter()
                    .zip(rows)
                    .map(|(predicted, row)| predicted - data.position_m[*row])
                    .collect())
            })
            .collect()
    }

    /// Residuals in units of the noise, end to end.
    pub fn whitened(&self, rig: &PlatformRig, part: &Part) -> Option<DVector<f64>> {
        let residuals = self.residuals_m(rig, part).ok()?;
        let parts = part.rows.iter().zip(residuals).flat_map(|((index, _), residual)| {
            let noise = self.noise[*index].rms_m;
            residual.into_iter().map(move |r| r / noise)
        });
        let all = DVector::from_iterator(part.len(), parts);
        all.iter().all(|r| r.is_finite()).then_some(all)
    }

    /// Sum of squared residuals in units of the noise; infinite where the rig cannot be simulated.
    pub fn chi2(&self, rig: &PlatformRig, part: &Part) -> f64 {
        self.whitened(rig, part).map_or(f64::INFINITY, |r| r.norm_squared())
    }

    /// Derivative of the whitened residuals by every knob.
    pub fn jacobian(&self, model: &Model, values: &[f64], part: &Part) -> Option<DMatrix<f64>> {
        let mut jacobian = DMatrix::zeros(part.len(), values.len());
        for column in 0..values.len() {
            let at = |step: f64| {
                let mut moved = values.to_vec();
                moved[column] += step;
                self.whitened(&model.at(&moved), part)
            };
            jacobian.set_column(column, &((at(STEP)? - at(-STEP)?) / (2.0 * STEP)));
        }
        Some(jacobian)
    }
}

/// Fastest ringing of a lightly damped mass on its own spring, rad/s; 0 if none rings.
fn ringing_rad_per_s(rig: &PlatformRig) -> f64 {
    let springs = rig.stiffness_n_per_m();
    let chain = rig.masses.iter().zip(springs).map(|(m, k)| (m.mass_kg, k, m.damping_n_s_per_m));
    chain
        .filter(|(mass, stiffness, damping)| *damping < 2.0 * (stiffness * mass).sqrt())
        .map(|(mass, stiffness, _)| (stiffness / mass).sqrt())
        .fold(0.0, f64::max)
}

struct Problem<'a> {
    data: Data<'a>,
    part: &'a Part,
    model: &'a Model,
    values: DVector<f64>,
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, values: &DVector<f64>) {
        self.values.copy_from(values);
    }

    fn params(&self) -> DVector<f64> {
        self.values.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let rig = self.model.at(self.values.as_slice());
        if !self.data.follows(&rig) {
            return Some(self.data.wall(self.part));
        }
        self.data.whitened(&rig, self.part)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        self.data.jacobian(self.model, self.values.as_slice(), self.part)
    }
}

/// Fit a model to a part from each of the starting points, and keep the best.
pub fn fit(data: Data, model: &Model, part: &Part, starts: &[Vec<f64>]) -> Option<Fit> {
    if model.knobs.is_empty() {
        let chi2 = data.chi2(&model.rig, part);
        return chi2.is_finite().then(|| Fit {
            model: model.clone(),
            values: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            chi2,
            samples: part.len(),
        });
    }
    let mut best: Option<(f64, Vec<f64>)> = None;
    for start in starts.iter().filter(|start| data.follows(&model.at(start))) {
        let problem = Problem { data, part, model, values: DVector::from_column_slice(start) };
        let (problem, _) = LevenbergMarquardt::new().with_patience(30).minimize(problem);
        let chi2 = data.chi2(&model.at(problem.values.as_slice()), part);
        if chi2.is_finite() && best.as_ref().is_none_or(|(least, _)| chi2 < *least) {
            best = Some((chi2, problem.values.as_slice().to_vec()));
        }
    }
    let (chi2, values) = best?;
    let rig = model.at(&values);
    let model = Model { rig, knobs: model.knobs.clone() };
    let values = model.values(); // inside their limits
    let covariance = data
        .jacobian(&model, &values, part)
        .map(|jacobian| covariance(&jacobian, chi2, part.len()))?;
    Some(Fit { model, values, covariance, chi2, samples: part.len() })
}

/// (JᵀJ)⁻¹ scaled by what the residuals are worse than the noise, by singular values; a direction that the data does not
/// see at all gets a huge variance.
fn covariance(jacobian: &DMatrix<f64>, chi2: f64, samples: usize) -> DMatrix<f64> {
    let knobs = jacobian.ncols();
    let information = jacobian.transpose() * jacobian;
    let eigen = information.symmetric_eigen();
    let freedom = samples.saturating_sub(knobs).max(1) as f64;
    let scale = (chi2 / freedom).max(1.0);
    let variances = eigen.eigenvalues.map(|value| scale / value.max(1e-8));
    &eigen.eigenvectors * DMatrix::from_diagonal(&variances) * eigen.eigenvectors.transpose()
}

impl Fit {
    /// Residual mean square over that of the noise.
    pub fn reduced_chi2(&self) -> f64 {
        self.chi2 / self.samples.saturating_sub(self.values.len()).max(1) as f64
    }

    /// Bayesian information criterion: smaller is better.
    pub fn bic(&self) -> f64 {
        self.chi2 + self.values.len() as f64 * (self.samples as f64).ln()
    }

    /// A quantity of the fitted rig with its interval: the knobs' covariance through its derivative. `memory` widens it for
    /// noise with a memory (1 for white noise). `log` for a quantity that is positive by nature: the interval is taken in
    /// its logarithm.
    pub fn estimate(
        &self,
        memory: f64,
        log: bool,
        quantity: impl Fn(&PlatformRig) -> f64,
    ) -> Estimate {
        let value = quantity(&self.model.rig);
        let scale = |x: f64| if log { x.abs().max(1e-300).ln() } else { x };
        let gradient = DVector::from_iterator(
            self.values.len(),
            (0..self.values.len()).map(|column| {
                let at = |step: f64| {
                    let mut moved = self.values.clone();
                    moved[column] += step;
                    scale(quantity(&self.model.at(&moved)))
                };
                (at(STEP) - at(-STEP)) / (2.0 * STEP)
            }),
        );
        let variance = (gradient.transpose() * &self.covariance * &gradient)[(0, 0)] * memory;
        let reach = quantile(self.samples.saturating_sub(self.values.len())) * variance.sqrt();
        let ci95 = if log {
            [value * (-reach).exp(), value * reach.exp()]
        } else {
            [value - reach, value + reach]
        };
        Estimate { value, ci95 }
    }
}

/// 97.5 % quantile of Student's distribution.
fn quantile(freedom: usize) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1) as f64).map_or(1.96, |t| t.inverse_cdf(0.975))
}
