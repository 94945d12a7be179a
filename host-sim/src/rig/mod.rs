//! The rig as it is known: nominal values of every stage of every axis, plus the settings of effects.
//!
//! SI units unless a name ends in another one. Axes are counted from 0 here, from 1 in files and messages. Reading and
//! writing the TOML file is in `file`; what a value must satisfy is in `validate`; rigs shipped with the program are
//! in `library`.

mod file;
mod library;
mod physical;
mod settings;
mod validate;

use serde::{Deserialize, Serialize};

pub(crate) use file::read_text;
pub use settings::Setting;
pub use validate::MAX_AXES;

/// Why a rig cannot be used: one line that names the file and the key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{source_name}: {message}")]
pub struct RigError {
    /// Where the rig came from: a path, or the name of an embedded rig.
    pub source_name: String,
    /// What was expected and what was found.
    pub message: String,
}

impl RigError {
    /// An error about the rig read from `source`.
    pub fn new(source: impl Into<String>, message: impl Into<String>) -> Self {
        Self { source_name: source.into(), message: message.into() }
    }
}

/// A stage of `axes` piezo-driven axes: what the simulator is built from.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// Name, for people and for the metadata of recordings.
    pub name: String,
    /// Rate of the controller and of the converters, Hz.
    pub sample_rate_hz: f64,
    /// One entry an axis.
    pub axes: Vec<Axis>,
    /// What the sensors see of the axes (m per m): a row a sensor, a column an axis. `None` is the identity.
    pub output_map: Option<Vec<Vec<f64>>>,
    /// Effects beyond the nominal model, in catalogue order.
    pub effects: Vec<Setting>,
}

/// Nominal model of one axis: amplifier, stack, mechanism, sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// High-voltage amplifier.
    pub amplifier: Amplifier,
    /// Piezo stack.
    pub piezo: Piezo,
    /// Flexure mechanism as seen at the stack.
    pub mechanism: Mechanism,
    /// Strain gauge and its conditioner.
    pub sensor: Sensor,
    /// Measurement of the amplifier output, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub monitor: Option<Monitor>,
}

impl Axis {
    /// Displacement of the axis at rest for a volt at the transducer, m/V.
    pub fn rest_m_per_v(&self) -> f64 {
        let stiffness_n_per_m = self.piezo.stiffness_n_per_m + self.mechanism.stiffness_n_per_m;
        self.piezo.transformer_n_per_v / stiffness_n_per_m
    }
}

/// First-order amplifier with rails (first paper, section 3.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Amplifier {
    /// Time constant, s; 0 is an ideal amplifier.
    pub time_constant_s: f64,
    /// Lower rail, V.
    pub min_v: f64,
    /// Upper rail, V.
    pub max_v: f64,
}

/// Goldfarb-Celanovic stack: `v_in = v_z + v_h(q)`, `q = T x + C v_z`, `F = T v_z - k_p x` (IEEE CSM 17(3), 1997).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Piezo {
    /// Transformer ratio T, N/V (= C/m).
    pub transformer_n_per_v: f64,
    /// Clamped capacitance C, F.
    pub capacitance_f: f64,
    /// Short-circuit stiffness k_p, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Effective mass, kg.
    pub mass_kg: f64,
    /// Generalized Maxwell (elasto-slip) model of the hysteresis.
    pub hysteresis: Hysteresis,
}

/// Maxwell slip elements: element i gives `clamp(charge / capacitance_f[i], +-limit_v[i])`, dragging its origin.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hysteresis {
    /// Inverse slope of each element, F.
    pub capacitance_f: Vec<f64>,
    /// Voltage at which each element slips, V.
    pub limit_v: Vec<f64>,
}

/// The mechanism at the stack: spring, mass and damper to ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mechanism {
    /// Stiffness k, N/m.
    pub stiffness_n_per_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Damping, N s/m.
    pub damping_n_s_per_m: f64,
}

/// Position sensor: a gain of one with white noise, rounding and an optional zero offset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// White noise, m rms a sample.
    pub noise_rms_m: f64,
    /// Rounding step, m; 0 is none.
    pub resolution_m: f64,
    /// Reading at zero displacement, m.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub offset_m: f64,
}

/// Measurement of the amplifier output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Monitor {
    /// White noise, V rms a sample.
    pub noise_rms_v: f64,
    /// Rounding step, V; 0 is none.
    pub resolution_v: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl Hysteresis {
    /// Slope of each element, V/C.
    pub fn slopes(&self) -> impl Iterator<Item = f64> + '_ {
        self.capacitance_f.iter().map(|c| 1.0 / c)
    }

    /// Charge travel at which the last element slips, C.
    pub fn full_slip_charge_c(&self) -> f64 {
        self.capacitance_f.iter().zip(&self.limit_v).map(|(c, v)| c * v).fold(0.0, f64::max)
    }
}
