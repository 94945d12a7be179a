//! What the sensor sees: free return from a held deflection, and the response to a force on the platform.

use nalgebra::{Complex, DVector};

use super::{
    PlatformError, PlatformRig, integrate,
    modes::{self, Release},
    statics,
};

/// Noiseless reading of the platform position (m) at ascending times (s) after the release from `displacement_m`.
///
/// The platform was held long enough for everything in it to relax; inner masses start in static balance and all at null
/// velocity. Linear chains are solved exactly ([`modes`]), others step by step ([`integrate`]). `start_s` is the time of the
/// release on the session's clock, which slow sensor effects run on.
pub fn free_return(
    rig: &PlatformRig,
    displacement_m: f64,
    times_s: &[f64],
    start_s: f64,
) -> Result<Vec<f64>, PlatformError> {
    check_times(times_s)?;
    let followed = if rig.is_linear() {
        Release::from_rest(rig, displacement_m)?.platform_m(times_s, rig.effects.lag_s())
    } else {
        let held = statics::held_positions_m(rig, displacement_m)?;
        integrate::platform_m(rig, &held, times_s)?
    };
    Ok(followed
        .into_iter()
        .zip(times_s)
        .map(|(position, time)| rig.effects.reading_m(position, start_s + time))
        .collect())
}

/// Platform position (m) of a linear chain at rest under a force on the platform (N), one value a sample period, each held
/// to the next sample; the position at a sample is before that sample's force acts. Exact for such a force.
pub fn forced_response(
    rig: &PlatformRig,
    force_n: &[f64],
    period_s: f64,
) -> Result<Vec<f64>, PlatformError> {
    if !rig.is_linear() {
        return Err(PlatformError::Integration(
            "a forced response needs a linear chain (no hardening, no friction)".to_owned(),
        ));
    }
    check_times(&[period_s])?;
    let a = modes::state_matrix(rig);
    let size = a.nrows();
    let count = rig.masses.len();
    // [A B; 0 0] over one period gives the exact step for a held input.
    let mut wide = a.resize(size + 1, size + 1, 0.0);
    wide[(2 * count - 1, size)] = 1.0 / rig.masses[count - 1].mass_kg;
    let step = (wide * period_s).exp();
    let mut z = DVector::zeros(size + 1);
    Ok(force_n
        .iter()
        .map(|force| {
            let position = z[count - 1];
            z[size] = *force;
            z = &step * &z;
            position
        })
        .collect())
}

/// Compliance of the platform (m/N, complex) at a frequency: displacement of the platform over a force on it.
pub fn compliance_m_per_n(rig: &PlatformRig, frequency_hz: f64) -> Complex<f64> {
    let s = Complex::new(0.0, std::f64::consts::TAU * frequency_hz);
    let springs = rig.stiffness_n_per_m();
    let mut inner: Option<Complex<f64>> = None;
    for (mass, stiffness) in rig.masses.iter().zip(&springs) {
        let mut element = s * mass.damping_n_s_per_m + *stiffness;
        for branch in mass.effects.viscoelasticity.iter().flat_map(|e| e.branches()) {
            let rate = branch.stiffness_n_per_m / branch.damping_n_s_per_m;
            element += s * branch.stiffness_n_per_m / (s + rate);
        }
        let held = match inner {
            None => element,
            Some(inner) => element * inner / (element + inner),
        };
        inner = Some(held + s * s * mass.mass_kg);
    }
    inner.map_or(Complex::new(0.0, 0.0), |dynamic| dynamic.inv())
}

/// First time (s) at which the reading falls to `fraction` of `start` and stays below it; `None` if it never does.
/// Linear between samples.
pub fn time_to_fraction_s(
    times_s: &[f64],
    position: &[f64],
    start: f64,
    fraction: f64,
) -> Option<f64> {
    let level = fraction * start.abs();
    let above = position.iter().rposition(|x| x.abs() > level)?;
    let next = above + 1;
    if next >= position.len() {
        return None;
    }
    let (a, b) = (position[above].abs(), position[next].abs());
    let part = if a > b { (a - level) / (a - b) } else { 0.0 };
    Some(times_s[above] + part * (times_s[next] - times_s[above]))
}

fn check_times(times_s: &[f64]) -> Result<(), PlatformError> {
    let mut last = 0.0;
    for time in times_s {
        if !time.is_finite() || *time < last {
            return Err(PlatformError::Time(*time));
        }
        last = *time;
    }
    Ok(())
}
