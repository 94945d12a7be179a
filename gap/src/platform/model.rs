//! A rig with parameters that may be turned, in coordinates of order one.
//!
//! Springs are turned as shares of the static compliance and dampers as rates k/c, so that the static stiffness of the
//! chain (known from the static test) stays what it is.

use host_sim::platform::{
    PlatformRig,
    rig::{
        Friction, SensorBandwidth, SensorDrift, SensorGain, SensorNonlinearity, SensorOffset,
        StiffnessHardening, Viscoelasticity,
    },
};

/// One parameter that may be turned. Springs, masses and branches are counted from the ground, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knob {
    /// ln of the compliance of spring i over that of the last one; rates are kept.
    Share(usize),
    /// ln of k_i / c_i in 1/s.
    Rate(usize),
    /// ln of mass i in kg.
    Mass(usize),
    /// ln of the stiffness of a branch of spring i over the spring's own; the branch's rate is kept.
    BranchStrength(usize, usize),
    /// ln of the relaxation rate k/c of a branch in 1/s.
    BranchRate(usize, usize),
    /// Cubic force over linear force at a stretch of 1 mm, the same for all springs.
    Hardening,
    /// Friction force over the force at 1 mm of static deflection, in the last spring.
    Friction,
    /// Gain of the sensor minus one.
    SensorGain,
    /// Offset of the sensor in 10 um.
    SensorOffset,
    /// Drift of the sensor in um/s.
    SensorDrift,
    /// ln of the sensor's time constant in s.
    SensorLag,
    /// Quadratic part of the sensor over its linear part at 1 mm.
    SensorCurve,
}

const REFERENCE_M: f64 = 1.0e-3;

impl Knob {
    /// Limits: wide, but such that every number stays representable.
    fn limits(self) -> (f64, f64) {
        match self {
            Self::Share(_) => (-7.0, 7.0),
            Self::Rate(_) | Self::BranchRate(..) => (-7.0, 10.0),
            Self::Mass(_) => (-12.0, 7.0),
            Self::BranchStrength(..) => (-7.0, 9.0),
            Self::Hardening => (-0.45, 50.0),
            Self::Friction => (0.0, 10.0),
            Self::SensorGain => (-0.5, 1.0),
            Self::SensorOffset | Self::SensorDrift => (-100.0, 100.0),
            Self::SensorLag => (-9.0, 3.0),
            Self::SensorCurve => (-0.5, 0.5),
        }
    }

    /// Where the knob stands in a rig.
    pub fn get(self, rig: &PlatformRig) -> f64 {
        let springs = rig.stiffness_n_per_m();
        let branch = |spring: usize, index: usize| {
            rig.masses[spring]
                .effects
                .viscoelasticity
                .as_ref()
                .and_then(|e| e.branches().nth(index))
        };
        let floor = |value: f64| value.max(1e-30).ln();
        let value = match self {
            Self::Share(i) => (springs[springs.len() - 1] / springs[i]).ln(),
            Self::Rate(i) => floor(springs[i] / rig.masses[i].damping_n_s_per_m.max(1e-12)),
            Self::Mass(i) => rig.masses[i].mass_kg.ln(),
            Self::BranchStrength(i, b) => {
                branch(i, b).map_or(-5.0, |e| floor(e.stiffness_n_per_m / springs[i]))
            }
            Self::BranchRate(i, b) => {
                branch(i, b).map_or(0.0, |e| floor(e.stiffness_n_per_m / e.damping_n_s_per_m))
            }
            Self::Hardening => rig.masses[0]
                .effects
                .stiffness_hardening
                .map_or(0.0, |e| e.cubic_n_per_m3 * REFERENCE_M.powi(2) / springs[0]),
            Self::Friction => rig.masses[springs.len() - 1]
                .effects
                .friction
                .map_or(0.0, |e| e.force_n / (rig.static_stiffness_n_per_m() * REFERENCE_M)),
            Self::SensorGain => rig.effects.sensor_gain.map_or(0.0, |e| e.factor - 1.0),
            Self::SensorOffset => rig.effects.sensor_offset.map_or(0.0, |e| e.offset_m / 1e-5),
            Self::SensorDrift => rig.effects.sensor_drift.map_or(0.0, |e| e.drift_m_per_s / 1e-6),
            Self::SensorLag => {
                rig.effects.sensor_bandwidth.map_or(-6.0, |e| floor(e.time_constant_s))
            }
            Self::SensorCurve => {
                rig.effects.sensor_nonlinearity.map_or(0.0, |e| e.quadratic_per_m * REFERENCE_M)
            }
        };
        let (low, high) = self.limits();
        value.clamp(low, high)
    }

    /// Turn the knob.
    pub fn set(self, rig: &mut PlatformRig, value: f64) {
        let (low, high) = self.limits();
        let value = if value.is_finite() { value.clamp(low, high) } else { low };
        match self {
            Self::Share(i) => set_share(rig, i, value),
            Self::Rate(i) => {
                let stiffness = rig.stiffness_n_per_m()[i];
                rig.masses[i].damping_n_s_per_m = stiffness / value.exp();
            }
            Self::Mass(i) => rig.masses[i].mass_kg = value.exp(),
            Self::BranchStrength(i, b) => {
                let stiffness = rig.stiffness_n_per_m()[i] * value.exp();
                let (own, damping) = branch_mut(rig, i, b);
                *damping *= stiffness / *own;
                *own = stiffness;
            }
            Self::BranchRate(i, b) => {
                let (own, damping) = branch_mut(rig, i, b);
                *damping = *own / value.exp();
            }
            Self::Hardening => {
                let springs = rig.stiffness_n_per_m();
                for (mass, stiffness) in rig.masses.iter_mut().zip(springs) {
                    let cubic_n_per_m3 = value * stiffness / REFERENCE_M.powi(2);
                    mass.effects.stiffness_hardening = Some(StiffnessHardening { cubic_n_per_m3 });
                }
            }
            Self::Friction => {
                let force_n = value * rig.static_stiffness_n_per_m() * REFERENCE_M;
                if let Some(last) = rig.masses.last_mut() {
                    last.effects.friction = Some(Friction { force_n });
                }
            }
            Self::SensorGain => {
                rig.effects.sensor_gain = Some(SensorGain { factor: 1.0 + value });
            }
            Self::SensorOffset => {
                rig.effects.sensor_offset = Some(SensorOffset { offset_m: value * 1e-5 });
            }
            Self::SensorDrift => {
                rig.effects.sensor_drift = Some(SensorDrift { drift_m_per_s: value * 1e-6 });
            }
            Self::SensorLag => {
                rig.effects.sensor_bandwidth =
                    Some(SensorBandwidth { time_constant_s: value.exp() });
            }
            Self::SensorCurve => {
                rig.effects.sensor_nonlinearity =
                    Some(SensorNonlinearity { quadratic_per_m: value / REFERENCE_M });
            }
        }
    }
}

/// Compliance of spring i over the last one's becomes exp(value); other ratios, all rates and the static stiffness stay.
fn set_share(rig: &mut PlatformRig, index: usize, value: f64) {
    let total = rig.static_stiffness_n_per_m();
    let old = rig.stiffness_n_per_m();
    let mut compliance: Vec<f64> = old.iter().map(|k| 1.0 / k).collect();
    let last = compliance[compliance.len() - 1];
    compliance[index] = last * value.exp();
    let sum: f64 = compliance.iter().sum();
    for (i, mass) in rig.masses.iter_mut().enumerate() {
        let stiffness = total * sum / compliance[i];
        let scale = stiffness / old[i];
        mass.flexure = None;
        mass.stiffness_n_per_m = Some(stiffness);
        mass.damping_n_s_per_m *= scale;
        if let Some(effect) = &mut mass.effects.viscoelasticity {
            let parts = effect.stiffness_n_per_m.iter_mut().chain(&mut effect.damping_n_s_per_m);
            parts.for_each(|part| *part *= scale);
        }
    }
}

/// Stiffness and damping of a branch, made if it is not there.
fn branch_mut(rig: &mut PlatformRig, spring: usize, index: usize) -> (&mut f64, &mut f64) {
    let stiffness = rig.stiffness_n_per_m()[spring];
    let effect = rig.masses[spring].effects.viscoelasticity.get_or_insert_with(|| {
        Viscoelasticity { stiffness_n_per_m: Vec::new(), damping_n_s_per_m: Vec::new() }
    });
    while effect.stiffness_n_per_m.len() <= index {
        effect.stiffness_n_per_m.push(stiffness);
        effect.damping_n_s_per_m.push(stiffness);
    }
    (&mut effect.stiffness_n_per_m[index], &mut effect.damping_n_s_per_m[index])
}

/// A rig and the knobs that a fit may turn, in the order in which they are set.
#[derive(Debug, Clone)]
pub struct Model {
    /// The rig with every knob where it stands.
    pub rig: PlatformRig,
    /// Knobs in the order of [`Knob`]'s variants: shares before what depends on them.
    pub knobs: Vec<Knob>,
}

impl Model {
    /// A model without free parameters.
    pub fn fixed(rig: &PlatformRig) -> Self {
        Self { rig: rig.clone(), knobs: Vec::new() }
    }

    /// Free another knob, if it is not free already.
    pub fn free(&mut self, knob: Knob) {
        if !self.knobs.contains(&knob) {
            self.knobs.push(knob);
            self.knobs.sort_by_key(|knob| match knob {
                Knob::Share(i) => (0, *i),
                Knob::Rate(i) => (1, *i),
                Knob::Mass(i) => (2, *i),
                Knob::BranchStrength(i, b) => (3, 100 * i + b),
                Knob::BranchRate(i, b) => (4, 100 * i + b),
                Knob::Hardening => (5, 0),
                Knob::Friction => (5, 1),
                Knob::SensorGain => (6, 0),
                Knob::SensorOffset => (6, 1),
                Knob::SensorDrift => (6, 2),
                Knob::SensorLag => (6, 3),
                Knob::SensorCurve => (6, 4),
            });
        }
    }

    /// Free the dampers of all springs, and the shares of the deflection where there is more than one.
    pub fn free_chain(&mut self) {
        let count = self.rig.masses.len();
        for i in 0..count {
            self.free(Knob::Rate(i));
            if i + 1 < count {
                self.free(Knob::Share(i));
            }
        }
    }

    /// Values of the knobs.
    pub fn values(&self) -> Vec<f64> {
        self.knobs.iter().map(|knob| knob.get(&self.rig)).collect()
    }

    /// The rig with the knobs at `values`.
    pub fn at(&self, values: &[f64]) -> PlatformRig {
        let mut rig = self.rig.clone();
        for (knob, value) in self.knobs.iter().zip(values) {
            knob.set(&mut rig, *value);
        }
        rig
    }
}
