//! Effects that a platform can have beyond its chain, as changes of a [`Model`].
//!
//! Names and stages are those of the project's catalogue; `damping` (a damper with another value) and `third-mass` (one
//! mass more than two) are added, because a platform can have them and nothing else may be renamed into them.

use host_sim::platform::{Mass, PlatformRig};

use super::{
    fit::Fit,
    model::{Knob, Model},
};
use crate::diagnosis::CauseKind;

/// An effect that may be added to a chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// Dampers (and shares of the deflection) with other values.
    Damping,
    /// One more mass than the chain has: two links a leg (the paper's finding).
    SecondMass,
    /// One more mass on a chain that has two already.
    ThirdMass,
    /// The softest spring relaxes.
    Viscoelasticity,
    /// Stiffness grows with deflection.
    StiffnessHardening,
    /// Dry friction.
    Friction,
    /// Masses with another value.
    Inertia,
    /// Wrong scale of the position.
    SensorGain,
    /// Wrong zero of the position.
    SensorOffset,
    /// Zero that drifts.
    SensorDrift,
    /// Lag of the position measurement.
    SensorBandwidth,
    /// Curved characteristic of the position measurement.
    SensorNonlinearity,
}

/// All effects, the more likely first: where two explain the data alike, the first is named and the other one is listed as
/// indistinguishable.
pub const CATALOGUE: [Effect; 12] = [
    Effect::Damping,
    Effect::SecondMass,
    Effect::ThirdMass,
    Effect::Viscoelasticity,
    Effect::StiffnessHardening,
    Effect::Inertia,
    Effect::Friction,
    Effect::SensorOffset,
    Effect::SensorDrift,
    Effect::SensorGain,
    Effect::SensorBandwidth,
    Effect::SensorNonlinearity,
];

impl Effect {
    /// Name in diagnosis.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::Damping => "damping",
            Self::SecondMass => "second-mass",
            Self::ThirdMass => "third-mass",
            Self::Viscoelasticity => "viscoelasticity",
            Self::StiffnessHardening => "stiffness-hardening",
            Self::Friction => "friction",
            Self::Inertia => "inertia",
            Self::SensorGain => "sensor-gain",
            Self::SensorOffset => "sensor-offset",
            Self::SensorDrift => "sensor-drift",
            Self::SensorBandwidth => "sensor-bandwidth",
            Self::SensorNonlinearity => "sensor-nonlinearity",
        }
    }

    /// Stage of the chain from drive to environment.
    pub fn stage(self) -> &'static str {
        match self {
            Self::SensorGain
            | Self::SensorOffset
            | Self::SensorDrift
            | Self::SensorBandwidth
            | Self::SensorNonlinearity => "sensor",
            _ => "mechanism",
        }
    }

    /// Wrong value or missing physics.
    pub fn kind(self) -> CauseKind {
        match self {
            Self::Damping | Self::Inertia | Self::SensorGain | Self::SensorOffset => {
                CauseKind::Parametric
            }
            _ => CauseKind::Structural,
        }
    }

    /// Whether the chain is no longer linear with it and has to be integrated step by step.
    pub fn is_stepped(self) -> bool {
        matches!(self, Self::StiffnessHardening | Self::Friction)
    }

    /// Whether it can be added to this chain.
    pub fn applies(self, rig: &PlatformRig) -> bool {
        let effects = &rig.masses[rig.masses.len() - 1].effects;
        match self {
            Self::SecondMass => rig.masses.len() == 1,
            Self::ThirdMass => rig.masses.len() >= 2 && rig.masses.len() < 6,
            Self::Viscoelasticity => rig.masses.iter().all(|m| m.effects.viscoelasticity.is_none()),
            Self::StiffnessHardening => {
                rig.masses.iter().all(|m| m.effects.stiffness_hardening.is_none())
            }
            Self::Friction => effects.friction.is_none(),
            _ => true,
        }
    }

    /// The chain with this effect, and starting points of the fit. Dampers are free in every one: they are what the paper
    /// leaves free, and no effect may be credited with what a damper explains.
    pub fn extend(self, from: &Fit) -> (Model, Vec<Vec<f64>>) {
        let mut model = from.model.clone();
        model.free_chain();
        match self {
            Self::Damping => return with_rates(model),
            Self::SecondMass | Self::ThirdMass => return another_mass(&model),
            Self::Viscoelasticity => return relaxing(model),
            Self::Inertia => {
                for i in 0..model.rig.masses.len() {
                    model.free(Knob::Mass(i));
                }
                let start = model.values();
                let starts = [0.0, 4.0, 8.0]
                    .into_iter()
                    .map(|more| {
                        let moved = model.knobs.iter().zip(&start);
                        moved
                            .map(
                                |(knob, v)| {
                                    if matches!(knob, Knob::Mass(_)) { v + more } else { *v }
                                },
                            )
                            .collect()
                    })
                    .collect();
                return (model, starts);
            }
            Self::StiffnessHardening => return started(model, Knob::Hardening, &[0.1, -0.1, 2.0]),
            Self::Friction => return started(model, Knob::Friction, &[0.01, 0.2]),
            Self::SensorGain => model.free(Knob::SensorGain),
            Self::SensorOffset => model.free(Knob::SensorOffset),
            Self::SensorDrift => model.free(Knob::SensorDrift),
            Self::SensorBandwidth => return started(model, Knob::SensorLag, &[-5.0, -2.0]),
            Self::SensorNonlinearity => model.free(Knob::SensorCurve),
        }
        let start = model.values();
        (model, vec![start])
    }
}

/// Several starting values of one new knob.
fn started(mut model: Model, knob: Knob, values: &[f64]) -> (Model, Vec<Vec<f64>>) {
    model.free(knob);
    let start = model.values();
    let starts = values
        .iter()
        .map(|value| {
            let knobs = model.knobs.iter().zip(&start);
            knobs.map(|(own, old)| if *own == knob { *value } else { *old }).collect()
        })
        .collect();
    (model, starts)
}

/// Rates from a tenth to ten times where they stand.
fn with_rates(model: Model) -> (Model, Vec<Vec<f64>>) {
    let start = model.values();
    let starts = [0.0, -2.3, 2.3, 4.6]
        .into_iter()
        .map(|shift| {
            let knobs = model.knobs.iter().zip(&start);
            knobs
                .map(
                    |(knob, value)| {
                        if matches!(knob, Knob::Rate(_)) { value + shift } else { *value }
                    },
                )
                .collect()
        })
        .collect();
    (model, starts)
}

/// One mass more: the outermost spring is split in two, the new one at the platform. Lumped masses are split in halves (no
/// free return tells them); the faster of two springs goes outside. Its share and rate are tried over the range that a
/// recording can hold.
fn another_mass(from: &Model) -> (Model, Vec<Vec<f64>>) {
    let mut rig = from.rig.clone();
    let springs = rig.stiffness_n_per_m();
    let last = rig.masses.len() - 1;
    let (inner_share, outer_share) = (2.0 / 3.0, 1.0 / 3.0);
    let half = rig.masses[last].mass_kg / 2.0;
    let rate = springs[last] / rig.masses[last].damping_n_s_per_m.max(1e-12);
    rig.masses[last].mass_kg = half;
    rig.masses[last].flexure = None;
    rig.masses[last].stiffness_n_per_m = Some(springs[last] / inner_share);
    rig.masses[last].damping_n_s_per_m /= inner_share;
    let outer = springs[last] / outer_share;
    rig.masses.push(Mass {
        mass_kg: half,
        stiffness_n_per_m: Some(outer),
        damping_n_s_per_m: outer / (8.0 * rate),
        ..Mass::default()
    });
    let mut model = Model { rig, knobs: from.knobs.clone() };
    model.free_chain();
    let base = model.values();
    let mut starts = Vec::new();
    for (slower, faster, share) in
        [(0.6, 8.0, 0.33), (0.85, 4.0, 0.3), (0.8, 30.0, 0.2), (0.95, 150.0, 0.05), (0.3, 1.3, 0.7)]
    {
        let knobs = model.knobs.iter().zip(&base);
        let start = knobs
            .map(|(knob, value)| match *knob {
                Knob::Rate(i) if i == last => f64::ln(rate * slower),
                Knob::Rate(i) if i == last + 1 => f64::ln(rate * faster),
                Knob::Share(i) if i == last => f64::ln((1.0 - share) / share),
                _ => *value,
            })
            .collect();
        starts.push(start);
    }
    (model, starts)
}

/// A Maxwell branch in the softest spring.
fn relaxing(mut model: Model) -> (Model, Vec<Vec<f64>>) {
    let springs = model.rig.stiffness_n_per_m();
    let softest =
        (0..springs.len()).min_by(|a, b| springs[*a].total_cmp(&springs[*b])).unwrap_or(0);
    let rate = Knob::Rate(softest).get(&model.rig);
    model.free(Knob::BranchStrength(softest, 0));
    model.free(Knob::BranchRate(softest, 0));
    let base = model.values();
    let mut starts = Vec::new();
    for (own, strength, branch) in
        [(1.2, 0.3, 1.5), (0.7, 0.0, 0.5), (2.0, 1.0, 2.0), (0.2, -1.0, 3.0), (0.5, 1.0, 0.0)]
    {
        let knobs = model.knobs.iter().zip(&base);
        let start = knobs
            .map(|(knob, value)| match knob {
                Knob::Rate(i) if *i == softest => rate + own,
                Knob::BranchStrength(..) => strength,
                Knob::BranchRate(..) => rate + branch,
                _ => *value,
            })
            .collect();
        starts.push(start);
    }
    (model, starts)
}
