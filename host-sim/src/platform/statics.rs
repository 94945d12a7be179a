//! The static test (section III of the paper) and the static balance that a free return starts from.
//!
//! A force on the platform stretches all springs of the chain alike. The inner masses of a platform that is held away
//! sit where the forces on each balance ("the mass 1 initial position has been evaluated by imposing an initial force
//! balance on the mass 1 itself").

use nalgebra::{DMatrix, DVector};

use super::{PlatformError, PlatformRig};

/// One point of a force-displacement test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticPoint {
    /// Force on the platform in N.
    pub force_n: f64,
    /// Displacement of the platform in metres.
    pub displacement_m: f64,
}

/// Stretch of every spring (m) and the force (N) when the platform is held at `displacement_m`.
fn balance(rig: &PlatformRig, displacement_m: f64) -> Result<(Vec<f64>, f64), PlatformError> {
    let stiffness = rig.stiffness_n_per_m();
    let static_stiffness = rig.static_stiffness_n_per_m();
    let mut stretch: Vec<f64> =
        stiffness.iter().map(|k| displacement_m * static_stiffness / k).collect();
    let cubic: Vec<f64> = rig
        .masses
        .iter()
        .map(|m| m.effects.stiffness_hardening.map_or(0.0, |e| e.cubic_n_per_m3))
        .collect();
    if cubic.iter().all(|c| *c == 0.0) {
        return Ok((stretch, displacement_m * static_stiffness));
    }
    // Newton on the unknown stretches and the common force: k d + c d³ = F for every spring, sum of d = displacement.
    let springs = stretch.len();
    let mut force = displacement_m * static_stiffness;
    for _ in 0..100 {
        let mut matrix = DMatrix::<f64>::zeros(springs + 1, springs + 1);
        let mut right = DVector::<f64>::zeros(springs + 1);
        for i in 0..springs {
            matrix[(i, i)] = stiffness[i] + 3.0 * cubic[i] * stretch[i] * stretch[i];
            matrix[(i, springs)] = -1.0;
            right[i] = force - stiffness[i] * stretch[i] - cubic[i] * stretch[i].powi(3);
            matrix[(springs, i)] = 1.0;
        }
        right[springs] = displacement_m - stretch.iter().sum::<f64>();
        let Some(step) = matrix.lu().solve(&right) else { break };
        for i in 0..springs {
            stretch[i] += step[i];
        }
        force += step[springs];
        let moved = step.rows(0, springs).amax();
        if !moved.is_finite() {
            break;
        }
        if moved <= 1e-12 * displacement_m.abs() {
            let stable =
                (0..springs).all(|i| stiffness[i] + 3.0 * cubic[i] * stretch[i] * stretch[i] > 0.0);
            if stable {
                return Ok((stretch, force));
            }
            break;
        }
    }
    Err(PlatformError::Statics { displacement_m })
}

/// Positions of all masses (m, from the ground outwards) when the platform is held at `displacement_m`.
pub fn held_positions_m(rig: &PlatformRig, displacement_m: f64) -> Result<Vec<f64>, PlatformError> {
    let (stretch, _) = balance(rig, displacement_m)?;
    let mut position = 0.0;
    let mut positions: Vec<f64> = stretch
        .iter()
        .map(|d| {
            position += d;
            position
        })
        .collect();
    if let Some(last) = positions.last_mut() {
        *last = displacement_m; // free of rounding
    }
    Ok(positions)
}

/// The static test: the force that holds the platform at each displacement.
pub fn static_test(
    rig: &PlatformRig,
    displacements_m: &[f64],
) -> Result<Vec<StaticPoint>, PlatformError> {
    displacements_m
        .iter()
        .map(|displacement_m| {
            balance(rig, *displacement_m)
                .map(|(_, force_n)| StaticPoint { force_n, displacement_m: *displacement_m })
        })
        .collect()
}

/// Stiffness (N/m) of a measured force-displacement test by least squares with a free offset of the force; `None` when
/// the displacements do not differ.
pub fn stiffness_from_test(points: &[StaticPoint]) -> Option<f64> {
    let count = points.len() as f64;
    let mean_x = points.iter().map(|p| p.displacement_m).sum::<f64>() / count;
    let mean_f = points.iter().map(|p| p.force_n).sum::<f64>() / count;
    let (mut sxx, mut sxf) = (0.0, 0.0);
    for point in points {
        sxx += (point.displacement_m - mean_x).powi(2);
        sxf += (point.displacement_m - mean_x) * (point.force_n - mean_f);
    }
    (sxx > 0.0).then(|| sxf / sxx)
}
