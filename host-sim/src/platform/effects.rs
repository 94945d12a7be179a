//! Effects beyond the chain of masses, springs and dampers, as tables of a platform's rig file.
//!
//! Those of a spring stand under its mass (`[mass.effects.viscoelasticity]`), those of the sensor at the top
//! (`[effects.sensor-gain]`). What is not there is not written.

use serde::{Deserialize, Serialize};

/// Effects in one spring of the chain.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct MassEffects {
    /// Relaxing springs in parallel with the elastic one (generalised Maxwell solid).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub viscoelasticity: Option<Viscoelasticity>,
    /// Stiffness that grows with the square of the deflection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_hardening: Option<StiffnessHardening>,
    /// Dry friction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<Friction>,
}

impl MassEffects {
    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Branches of a generalised Maxwell solid: a spring and a damper in series each, all in parallel with the elastic
/// spring. Relaxed (zero force) after a long hold, so that the static stiffness stays that of the elastic spring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Viscoelasticity {
    /// Spring of each branch in N/m.
    pub stiffness_n_per_m: Vec<f64>,
    /// Damper of each branch in N·s/m.
    pub damping_n_s_per_m: Vec<f64>,
}

impl Viscoelasticity {
    /// The branches one by one.
    pub fn branches(&self) -> impl Iterator<Item = Relaxation> + '_ {
        self.stiffness_n_per_m
            .iter()
            .zip(&self.damping_n_s_per_m)
            .map(|(k, c)| Relaxation { stiffness_n_per_m: *k, damping_n_s_per_m: *c })
    }
}

/// One Maxwell branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// Its spring in N/m.
    pub stiffness_n_per_m: f64,
    /// Its damper in N·s/m.
    pub damping_n_s_per_m: f64,
}

/// Spring force k d + cubic d³.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StiffnessHardening {
    /// Cubic coefficient in N/m³; positive hardens.
    pub cubic_n_per_m3: f64,
}

/// Coulomb friction in a joint, smoothed below [`Friction::REGULAR_M_PER_S`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Friction {
    /// Friction force in N.
    pub force_n: f64,
}

impl Friction {
    /// Speed below which the friction is taken as viscous, in m/s: 0.1 um/s, far below what a recording resolves in seconds.
    pub const REGULAR_M_PER_S: f64 = 1.0e-7;
}

/// What the sensor does to the position beyond noise. Zero and one are "not there".
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct SensorEffects {
    /// Wrong scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_gain: Option<SensorGain>,
    /// Wrong zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_offset: Option<SensorOffset>,
    /// Zero that moves with time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_drift: Option<SensorDrift>,
    /// First-order low-pass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_bandwidth: Option<SensorBandwidth>,
    /// Curved characteristic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_nonlinearity: Option<SensorNonlinearity>,
}

impl SensorEffects {
    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// What a noiseless sensor reads (m) when the low-passed position is `position_m`, `time_s` after the start of the
    /// session.
    pub fn reading_m(&self, position_m: f64, time_s: f64) -> f64 {
        let gain = self.sensor_gain.map_or(1.0, |e| e.factor);
        let curve = self.sensor_nonlinearity.map_or(0.0, |e| e.quadratic_per_m);
        let offset = self.sensor_offset.map_or(0.0, |e| e.offset_m);
        let drift = self.sensor_drift.map_or(0.0, |e| e.drift_m_per_s);
        gain * position_m + curve * position_m * position_m + offset + drift * time_s
    }

    /// Time constant of the low-pass in s, if there is one.
    pub fn lag_s(&self) -> Option<f64> {
        self.sensor_bandwidth.map(|e| e.time_constant_s).filter(|t| *t > 0.0)
    }
}

/// Reading = factor × position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorGain {
    /// Reading over position; 1 is right.
    pub factor: f64,
}

/// Reading = position + offset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorOffset {
    /// Offset in metres.
    pub offset_m: f64,
}

/// Reading = position + drift × session time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorDrift {
    /// Drift in m/s.
    pub drift_m_per_s: f64,
}

/// First-order low-pass between position and reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorBandwidth {
    /// Time constant in s.
    pub time_constant_s: f64,
}

/// Reading = position + quadratic × position².
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorNonlinearity {
    /// Quadratic coefficient in 1/m.
    pub quadratic_per_m: f64,
}
