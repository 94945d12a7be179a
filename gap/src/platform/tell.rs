//! What a free return cannot tell, said plainly.
//!
//! Masses: of strongly damped chains they only set roots that have died before the first sample. The common scale of all
//! forces: without a force there is only motion. The order of the springs: with masses too small to matter each spring
//! returns on its own, wherever it sits.

use nalgebra::{DMatrix, DVector};

use host_sim::platform::PlatformRig;

use super::{
    data::Part,
    fit::{Data, Fit},
    model::Knob,
};

/// Growth of chi-squared that a parameter's 95 % limit is worth (one degree of freedom).
const CHI2_95: f64 = 3.841;
/// Relative standard error below which a mass is worth fitting.
const MASS_WORTH_FITTING: f64 = 0.25;

/// Whether the data tells mass `index`, judged on top of everything that the fit turned: relative standard error.
pub fn mass_error(data: Data, fit: &Fit, part: &Part, index: usize) -> f64 {
    let mut model = fit.model.clone();
    model.free(Knob::Mass(index));
    let values = model.values();
    let Some(jacobian) = data.jacobian(&model, &values, part) else { return f64::INFINITY };
    let Some(own) = model.knobs.iter().position(|knob| *knob == Knob::Mass(index)) else {
        return f64::INFINITY;
    };
    let column = DVector::from(jacobian.column(own));
    let others = jacobian.remove_column(own);
    1.0 / rest_norm(&others, &column).max(1e-12)
}

/// Whether [`mass_error`] is small enough for the mass to be fitted.
pub fn tells_mass(data: Data, fit: &Fit, part: &Part, index: usize) -> bool {
    mass_error(data, fit, part, index) < MASS_WORTH_FITTING
}

/// Largest value (kg) of a mass that the data does not refuse at 95 %, all fitted parameters free to make up for it;
/// `None` when there is no such limit below a tonne.
pub fn largest_mass_kg(data: Data, fit: &Fit, part: &Part, index: usize) -> Option<f64> {
    let base = data.whitened(&fit.model.rig, part)?;
    let jacobian = data.jacobian(&fit.model, &fit.values, part)?;
    let refused = |mass_kg: f64| {
        let mut rig = fit.model.rig.clone();
        rig.masses[index].mass_kg = mass_kg;
        data.whitened(&rig, part)
            .is_none_or(|moved| rest_norm(&jacobian, &(moved - &base)).powi(2) > CHI2_95)
    };
    let mut low = fit.model.rig.masses[index].mass_kg;
    let mut high = low;
    while !refused(high) {
        low = high;
        high *= 2.0;
        if high > 1000.0 {
            return None;
        }
    }
    for _ in 0..12 {
        let middle = (low * high).sqrt();
        if refused(middle) { high = middle } else { low = middle }
    }
    Some(high)
}

/// Norm of what is left of a vector when the columns of a matrix have explained what they can.
fn rest_norm(columns: &DMatrix<f64>, vector: &DVector<f64>) -> f64 {
    if columns.ncols() == 0 {
        return vector.norm();
    }
    let svd = columns.clone().svd(true, false);
    let Some(u) = svd.u else { return vector.norm() };
    let largest = svd.singular_values.amax();
    let mut rest = vector.clone();
    for (i, value) in svd.singular_values.iter().enumerate() {
        if *value > 1e-10 * largest {
            let direction = u.column(i);
            let part = direction.dot(vector);
            rest -= direction * part;
        }
    }
    rest.norm()
}

/// Statements about everything that was not fitted, for people.
pub fn statements(data: Data, fit: &Fit, part: &Part) -> Vec<String> {
    let rig = &fit.model.rig;
    let mut lines = vec![format!(
        "Common scale of forces: a free return tells ratios only. The static stiffness of the rig ({:.4} N/m) is kept; a \
         static test that gives another one scales every stiffness, damper and mass by the same factor.",
        rig.static_stiffness_n_per_m()
    )];
    for index in 0..rig.masses.len() {
        if fit.model.knobs.contains(&Knob::Mass(index)) {
            continue;
        }
        let name = mass_name(rig, index);
        let kept = rig.masses[index].mass_kg;
        lines.push(match largest_mass_kg(data, fit, part, index) {
            Some(limit) => format!(
                "Mass of {name}: not told by this return; {kept} kg is kept, anything below {limit:.2} kg fits as well \
                 (95 %)."
            ),
            None => format!("Mass of {name}: not told by this return; {kept} kg is kept."),
        });
    }
    if rig.masses.len() > 1 && order_is_free(data, fit, part) {
        lines.push(
            "Order of the springs: the return is the same with the slow spring next to the ground or next to the \
             platform; the slow one is put next to the ground. The position of an inner joint during a return would tell."
                .to_owned(),
        );
    }
    lines
}

/// What people call a mass of a chain.
pub fn mass_name(rig: &PlatformRig, index: usize) -> String {
    if index + 1 == rig.masses.len() {
        format!("mass {} (the platform)", index + 1)
    } else {
        format!("mass {}", index + 1)
    }
}

/// Whether exchanging the first and the last spring makes no difference that the data would see.
fn order_is_free(data: Data, fit: &Fit, part: &Part) -> bool {
    let mut rig = fit.model.rig.clone();
    let last = rig.masses.len() - 1;
    let springs = rig.stiffness_n_per_m();
    let dampers: Vec<f64> = rig.masses.iter().map(|m| m.damping_n_s_per_m).collect();
    for (a, b) in [(0, last), (last, 0)] {
        rig.masses[a].flexure = None;
        rig.masses[a].stiffness_n_per_m = Some(springs[b]);
        rig.masses[a].damping_n_s_per_m = dampers[b];
        rig.masses[a].effects = fit.model.rig.masses[b].effects.clone();
    }
    data.chi2(&rig, part) - fit.chi2 < CHI2_95
}

/// The chain with its springs (and their dampers and effects) sorted by rate, slow ones next to the ground; `None` if they
/// are.
pub fn slow_springs_inside(rig: &PlatformRig) -> Option<PlatformRig> {
    let springs = rig.stiffness_n_per_m();
    let rate = |i: usize| springs[i] / rig.masses[i].damping_n_s_per_m.max(1e-12);
    let mut order: Vec<usize> = (0..springs.len()).collect();
    order.sort_by(|a, b| rate(*a).total_cmp(&rate(*b)));
    if order.is_sorted() {
        return None;
    }
    let mut sorted = rig.clone();
    for (place, from) in order.into_iter().enumerate() {
        let mass = &mut sorted.masses[place];
        mass.flexure = None;
        mass.stiffness_n_per_m = Some(springs[from]);
        mass.damping_n_s_per_m = rig.masses[from].damping_n_s_per_m;
        mass.effects = rig.masses[from].effects.clone();
    }
    Some(sorted)
}
