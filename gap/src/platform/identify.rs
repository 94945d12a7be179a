//! The parameters of a chain as it is: dampers (the paper's free variables), shares of the deflection, and masses where
//! the data tells them. Nothing is added to the chain.

use host_sim::platform::PlatformRig;
use recording::Session;

use super::{
    data::{self, Part, PlatformDataError, Return},
    fit::{Data, Estimate, Fit, fit},
    model::{Knob, Model},
    noise::{self, Noise},
    tell,
};

/// A refitted chain.
#[derive(Debug, Clone)]
pub struct Identified {
    /// The rig with its parameters refitted.
    pub rig: PlatformRig,
    /// Gap over all scored samples before, nm.
    pub before_nm: f64,
    /// Gap over all scored samples after, nm.
    pub after_nm: f64,
    /// Noise floor, nm.
    pub floor_nm: f64,
    /// Every parameter with its interval.
    pub parameters: Vec<Named>,
    /// What was found and what cannot be told, line by line.
    pub lines: Vec<String>,
}

/// A parameter with name, unit and interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Named {
    /// Name with the number of the mass, e.g. `damping_n_s_per_m_1`.
    pub name: String,
    /// Value and 95 % interval.
    pub estimate: Estimate,
    /// Unit.
    pub unit: &'static str,
}

/// Refit the chain's parameters to all returns of a session.
pub fn identify(rig: &PlatformRig, session: &Session) -> Result<Identified, PlatformDataError> {
    let returns = data::returns(session)?;
    let noise: Vec<Noise> = returns.iter().map(noise::measure).collect();
    let data = Data::new(rig, &returns, &noise);
    let part = Part::all(&returns);
    let unusable =
        |message: &str| PlatformDataError { file: rig.name.clone(), message: message.to_owned() };
    let refit = chain_fit(data, rig, &part)
        .ok_or_else(|| unusable("the chain cannot be simulated with any parameters near these"))?;
    let before =
        rms_m(data, rig, &part).ok_or_else(|| unusable("the chain cannot be simulated"))?;
    let after = rms_m(data, &refit.model.rig, &part).unwrap_or(f64::NAN);
    let memory = fit_memory(data, &refit, &part);
    let parameters = chain_parameters(&refit, memory);
    let floor = floor_m(&returns, &noise);

    let mut lines = vec![format!(
        "Gap to {} return{}: {:.2} um before, {:.2} um after, noise {:.2} um.",
        returns.len(),
        if returns.len() == 1 { "" } else { "s" },
        before * 1e6,
        after * 1e6,
        floor * 1e6
    )];
    lines.extend(parameters.iter().map(Named::line));
    if after > 1.2 * floor {
        lines.push(format!(
            "A chain of {} mass{} leaves {:.1} times the noise whatever its parameters: run `flexstage diagnose`. The \
             intervals hold for this chain only.",
            rig.masses.len(),
            if rig.masses.len() == 1 { "" } else { "es" },
            after / floor
        ));
    }
    lines.extend(tell::statements(data, &refit, &part));
    lines.extend(returns.iter().filter_map(Return::doubt));
    let scale = 1e9;
    Ok(Identified {
        rig: refit.model.rig,
        before_nm: before * scale,
        after_nm: after * scale,
        floor_nm: floor * scale,
        parameters,
        lines,
    })
}

/// Fit dampers and shares, then masses that the data tells.
pub fn chain_fit(data: Data, rig: &PlatformRig, part: &Part) -> Option<Fit> {
    let mut model = Model::fixed(rig);
    model.free_chain();
    let nominal = model.values();
    let starts: Vec<Vec<f64>> = [0.0, -2.3, 2.3, 4.6]
        .into_iter()
        .map(|shift| {
            let knobs = model.knobs.iter().zip(&nominal);
            knobs
                .map(
                    |(knob, value)| {
                        if matches!(knob, Knob::Rate(_)) { value + shift } else { *value }
                    },
                )
                .collect()
        })
        .collect();
    let mut best = fit(data, &model, part, &starts)?;
    for index in 0..rig.masses.len() {
        if tell::tells_mass(data, &best, part, index) {
            let mut model = best.model.clone();
            model.free(Knob::Mass(index));
            let start = model.values();
            if let Some(better) = fit(data, &model, part, &[start])
                && better.bic() < best.bic()
            {
                best = better;
            }
        }
    }
    Some(best)
}

/// Stiffness, damper, time constant and, where fitted, mass of every element.
pub fn chain_parameters(fit: &Fit, memory: f64) -> Vec<Named> {
    let mut list = Vec::new();
    for i in 0..fit.model.rig.masses.len() {
        let number = i + 1;
        if fit.model.rig.masses.len() > 1 {
            list.push(Named {
                name: format!("stiffness_n_per_m_{number}"),
                estimate: fit.estimate(memory, true, |rig| rig.stiffness_n_per_m()[i]),
                unit: "N/m",
            });
        }
        list.push(Named {
            name: format!("damping_n_s_per_m_{number}"),
            estimate: fit.estimate(memory, true, |rig| rig.masses[i].damping_n_s_per_m),
            unit: "N s/m",
        });
        list.push(Named {
            name: format!("time_constant_s_{number}"),
            estimate: fit.estimate(memory, true, |rig| {
                rig.masses[i].damping_n_s_per_m / rig.stiffness_n_per_m()[i]
            }),
            unit: "s",
        });
        if fit.model.knobs.contains(&Knob::Mass(i)) {
            list.push(Named {
                name: format!("mass_kg_{number}"),
                estimate: fit.estimate(memory, true, |rig| rig.masses[i].mass_kg),
                unit: "kg",
            });
        }
    }
    list
}

impl Named {
    /// One line for people.
    pub fn line(&self) -> String {
        let Estimate { value, ci95: [low, high] } = self.estimate;
        let [value, low, high] = [value, low, high].map(|v| digits(v, 5));
        format!("{} = {value} {} (95 %: {low} to {high})", self.name, self.unit)
    }
}

/// Memory of the noise, from the residuals of a fit.
pub fn fit_memory(data: Data, fit: &Fit, part: &Part) -> f64 {
    let Ok(residuals) = data.residuals_m(&fit.model.rig, part) else { return 1.0 };
    residuals.iter().map(|r| noise::memory(r)).fold(1.0, f64::max)
}

/// Root mean square gap over a part, m.
pub fn rms_m(data: Data, rig: &PlatformRig, part: &Part) -> Option<f64> {
    let residuals = data.residuals_m(rig, part).ok()?;
    let energy: f64 = residuals.iter().flatten().map(|r| r * r).sum();
    Some((energy / part.len().max(1) as f64).sqrt())
}

/// Noise over all returns, m.
pub fn floor_m(returns: &[Return], noise: &[Noise]) -> f64 {
    let samples: usize = returns.iter().map(|r| r.scored().len()).sum();
    let energy: f64 =
        returns.iter().zip(noise).map(|(r, n)| n.rms_m.powi(2) * r.scored().len() as f64).sum();
    (energy / samples.max(1) as f64).sqrt()
}

/// A number with so many significant digits, in scientific notation where it would be long.
pub fn digits(value: f64, significant: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let exponent = value.abs().log10().floor() as i32;
    if !(-4..7).contains(&exponent) {
        return format!("{value:.*e}", significant.saturating_sub(1));
    }
    let decimals = (significant as i32 - 1 - exponent).max(0) as usize;
    format!("{value:.decimals$}")
}
