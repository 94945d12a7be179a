//! The rig file of a platform: a chain of lumped masses from the ground outwards.
//!
//! ```toml
//! name = "belfiore-planar"
//! kind = "platform"
//! sample_rate_hz = 200.0
//!
//! [[mass]]                       # from the ground outwards; the last one is the platform that is recorded
//! mass_kg = 0.05
//! stiffness_n_per_m = 4.0e3      # or: flexure = { leaves, length_m, width_m, thickness_m, ends } and a material
//! damping_n_s_per_m = 4.1e3
//! ```
//!
//! Effects beyond the chain have a table each, under the mass whose spring they belong to
//! (`[mass.effects.viscoelasticity]`, `stiffness-hardening`, `friction`) or at the top for the sensor
//! (`[effects.sensor-gain]`, `sensor-offset`, `sensor-drift`, `sensor-bandwidth`, `sensor-nonlinearity`).
//! An unknown key is an error that names it. What is read is written back by [`PlatformRig::to_toml`].

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};

use super::material::{self, Flexure, Material};

pub use super::effects::*;

/// Why a rig file cannot be used: one line that names the file, the key, and what was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{source_name}: {message}")]
pub struct PlatformRigError {
    source_name: String,
    message: String,
}

impl PlatformRigError {
    /// What is wrong, without the file.
    pub fn message(&self) -> &str {
        &self.message
    }
}

/// A compliant platform as a chain of masses, springs and dampers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlatformRig {
    /// Free text.
    pub name: String,
    kind: PlatformKind,
    /// Rate of the position recordings.
    pub sample_rate_hz: f64,
    /// Material of the flexures, by name: one of [`material::TABLE`] or of `materials`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// Further materials by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub materials: BTreeMap<String, Material>,
    /// Noise of the optical position measurement, for simulated recordings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<Sensor>,
    /// What the sensor does beyond noise.
    #[serde(default, skip_serializing_if = "SensorEffects::is_none")]
    pub effects: SensorEffects,
    /// Masses from the ground outwards; the last is the platform.
    #[serde(rename = "mass")]
    pub masses: Vec<Mass>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum PlatformKind {
    Platform,
}

/// One mass with the spring and damper towards its inner neighbour (or the ground).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mass {
    /// Lumped mass in kg, equivalent in kinetic energy to the links it stands for (see [`super::equivalent`]).
    pub mass_kg: f64,
    /// Spring to the inner neighbour in N/m; left out when `flexure` gives the geometry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_n_per_m: Option<f64>,
    /// Viscous damper to the inner neighbour in N·s/m.
    pub damping_n_s_per_m: f64,
    /// Geometry of the flexure, in place of `stiffness_n_per_m`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flexure: Option<Flexure>,
    /// Effects in the spring between this mass and its inner neighbour.
    #[serde(default, skip_serializing_if = "MassEffects::is_none")]
    pub effects: MassEffects,
}

/// Noise of the position measurement.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// White noise, root mean square, in metres.
    pub noise_rms_m: f64,
    /// Step of the reading in metres; 0 for none.
    #[serde(default)]
    pub resolution_m: f64,
}

impl PlatformRig {
    /// A chain without effects; masses from the ground outwards.
    pub fn new(name: &str, sample_rate_hz: f64, masses: Vec<Mass>) -> Self {
        Self {
            name: name.to_owned(),
            kind: PlatformKind::Platform,
            sample_rate_hz,
            material: None,
            materials: BTreeMap::new(),
            sensor: None,
            effects: SensorEffects::default(),
            masses,
        }
    }

    /// Read a rig file.
    pub fn load(path: &Path) -> Result<Self, PlatformRigError> {
        let source = path.display().to_string();
        match crate::rig::read_text(path) {
            Ok(text) => Self::parse(&text, &source),
            Err(error) => Err(PlatformRigError { source_name: source, message: error.message }),
        }
    }

    /// Read a rig from text; `source` is what an error calls it.
    pub fn parse(text: &str, source: &str) -> Result<Self, PlatformRigError> {
        let rig: Self = toml::from_str(text).map_err(|error| PlatformRigError {
            source_name: source.to_owned(),
            message: one_line(text, &error),
        })?;
        rig.validate().map_err(|error| PlatformRigError {
            source_name: source.to_owned(),
            message: error.message,
        })?;
        Ok(rig)
    }

    /// The rig as a file: reading it gives the same rig.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|error| format!("# cannot be written: {error}\n"))
    }

    /// Check every value: finite, and positive where it must be.
    pub fn validate(&self) -> Result<(), PlatformRigError> {
        let fail =
            |message: String| Err(PlatformRigError { source_name: self.name.clone(), message });
        let positive = |key: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                fail(format!("{key} must be a positive number, found {value}"))
            }
        };
        let not_negative = |key: &str, value: f64| {
            if value.is_finite() && value >= 0.0 {
                Ok(())
            } else {
                fail(format!("{key} must be zero or a positive number, found {value}"))
            }
        };
        let finite = |key: &str, value: f64| {
            if value.is_finite() {
                Ok(())
            } else {
                fail(format!("{key} must be a finite number, found {value}"))
            }
        };
        positive("sample_rate_hz", self.sample_rate_hz)?;
        if self.masses.is_empty() {
            return fail("a platform needs at least one [[mass]]".to_owned());
        }
        for (name, material) in &self.materials {
            positive(&format!("materials.{name}.young_modulus_pa"), material.young_modulus_pa)?;
            positive(&format!("materials.{name}.density_kg_per_m3"), material.density_kg_per_m3)?;
        }
        if let Some(name) = &self.material
            && self.material_properties().is_none()
        {
            let known: Vec<&str> = material::TABLE.iter().map(|(name, _)| *name).collect();
            return fail(format!(
                "material \"{name}\" is neither known ({}) nor in [materials]",
                known.join(", ")
            ));
        }
        for (index, mass) in self.masses.iter().enumerate() {
            let at = format!("mass {}", index + 1);
            positive(&format!("{at}: mass_kg"), mass.mass_kg)?;
            not_negative(&format!("{at}: damping_n_s_per_m"), mass.damping_n_s_per_m)?;
            match (mass.stiffness_n_per_m, &mass.flexure) {
                (Some(stiffness), None) => {
                    positive(&format!("{at}: stiffness_n_per_m"), stiffness)?
                }
                (None, Some(flexure)) => {
                    if self.material_properties().is_none() {
                        return fail(format!(
                            "{at}: flexure needs a material (material = \"nylon\")"
                        ));
                    }
                    positive(&format!("{at}: flexure.leaves"), f64::from(flexure.leaves))?;
                    positive(&format!("{at}: flexure.length_m"), flexure.length_m)?;
                    positive(&format!("{at}: flexure.width_m"), flexure.width_m)?;
                    positive(&format!("{at}: flexure.thickness_m"), flexure.thickness_m)?;
                }
                (None, None) => {
                    return fail(format!("{at}: missing key stiffness_n_per_m (or flexure)"));
                }
                (Some(_), Some(_)) => {
                    return fail(format!("{at}: give stiffness_n_per_m or flexure, not both"));
                }
            }
            if let Some(effect) = &mass.effects.viscoelasticity {
                let at = format!("{at}: effects.viscoelasticity");
                if effect.stiffness_n_per_m.len() != effect.damping_n_s_per_m.len() {
                    return fail(format!(
                        "{at}: stiffness_n_per_m has {} branches and damping_n_s_per_m {}",
                        effect.stiffness_n_per_m.len(),
                        effect.damping_n_s_per_m.len()
                    ));
                }
                for branch in effect.branches() {
                    positive(&format!("{at}.stiffness_n_per_m"), branch.stiffness_n_per_m)?;
                    positive(&format!("{at}.damping_n_s_per_m"), branch.damping_n_s_per_m)?;
                }
            }
            if let Some(effect) = &mass.effects.stiffness_hardening {
                finite(
                    &format!("{at}: effects.stiffness-hardening.cubic_n_per_m3"),
                    effect.cubic_n_per_m3,
                )?;
            }
            if let Some(effect) = &mass.effects.friction {
                not_negative(&format!("{at}: effects.friction.force_n"), effect.force_n)?;
            }
        }
        if let Some(sensor) = &self.sensor {
            not_negative("sensor.noise_rms_m", sensor.noise_rms_m)?;
            not_negative("sensor.resolution_m", sensor.resolution_m)?;
        }
        let effects = &self.effects;
        if let Some(effect) = effects.sensor_gain {
            positive("effects.sensor-gain.factor", effect.factor)?;
        }
        if let Some(effect) = effects.sensor_offset {
            finite("effects.sensor-offset.offset_m", effect.offset_m)?;
        }
        if let Some(effect) = effects.sensor_drift {
            finite("effects.sensor-drift.drift_m_per_s", effect.drift_m_per_s)?;
        }
        if let Some(effect) = effects.sensor_bandwidth {
            not_negative("effects.sensor-bandwidth.time_constant_s", effect.time_constant_s)?;
        }
        if let Some(effect) = effects.sensor_nonlinearity {
            finite("effects.sensor-nonlinearity.quadratic_per_m", effect.quadratic_per_m)?;
        }
        Ok(())
    }

    /// Properties of the rig's material, if it names a known one.
    pub fn material_properties(&self) -> Option<Material> {
        let name = self.material.as_deref()?;
        self.materials.get(name).copied().or_else(|| {
            material::TABLE.iter().find(|(known, _)| *known == name).map(|(_, material)| *material)
        })
    }

    /// Stiffness of every spring from the ground outwards, in N/m: as given, or from the geometry.
    pub fn stiffness_n_per_m(&self) -> Vec<f64> {
        let material = self.material_properties();
        self.masses
            .iter()
            .map(|mass| match (mass.stiffness_n_per_m, &mass.flexure, &material) {
                (Some(stiffness), _, _) => stiffness,
                (None, Some(flexure), Some(material)) => flexure.stiffness_n_per_m(material),
                _ => f64::NAN, // refused by `validate`
            })
            .collect()
    }

    /// Stiffness of the platform against the ground for small slow forces, in N/m: the springs in series.
    pub fn static_stiffness_n_per_m(&self) -> f64 {
        1.0 / self.stiffness_n_per_m().iter().map(|k| 1.0 / k).sum::<f64>()
    }

    /// Whether forces are proportional to motion, so that [`super::modes`] applies.
    pub fn is_linear(&self) -> bool {
        self.masses.iter().all(|mass| {
            mass.effects.stiffness_hardening.is_none_or(|e| e.cubic_n_per_m3 == 0.0)
                && mass.effects.friction.is_none_or(|e| e.force_n == 0.0)
        })
    }
}

/// What the TOML reader says, in one line and with the line number.
fn one_line(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().replace('\n', " ");
    match error.span() {
        Some(span) => {
            let line = text[..span.start.min(text.len())].matches('\n').count() + 1;
            format!("line {line}: {message}")
        }
        None => message,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLANAR: &str = "name = \"p\"\nkind = \"platform\"\nsample_rate_hz = 200.0\n[[mass]]\nmass_kg = 0.05\n\
                          stiffness_n_per_m = 4.0e3\ndamping_n_s_per_m = 4.1e3\n";

    fn error(text: &str) -> String {
        let message = PlatformRig::parse(text, "rig.toml").unwrap_err().to_string();
        assert!(!message.contains('\n'), "one line: {message}");
        assert!(message.starts_with("rig.toml: "), "{message}");
        message
    }

    #[test]
    fn every_key_survives_a_round_trip() {
        let text = format!(
            "material = \"pom\"\n{PLANAR}[mass.effects.viscoelasticity]\nstiffness_n_per_m = [1e3]\n\
             damping_n_s_per_m = [2e2]\n[mass.effects.stiffness-hardening]\ncubic_n_per_m3 = 1e9\n\
             [mass.effects.friction]\nforce_n = 0.1\n[[mass]]\nmass_kg = 0.01\ndamping_n_s_per_m = 10.0\n\
             flexure = {{ leaves = 3, length_m = 0.02, width_m = 0.01, thickness_m = 0.001, ends = \"guided\" }}\n\
             [sensor]\nnoise_rms_m = 4e-6\n[effects.sensor-gain]\nfactor = 1.01\n[effects.sensor-offset]\n\
             offset_m = 1e-6\n[effects.sensor-drift]\ndrift_m_per_s = 1e-7\n[effects.sensor-bandwidth]\n\
             time_constant_s = 0.01\n[effects.sensor-nonlinearity]\nquadratic_per_m = 2.0\n[materials.pom]\n\
             young_modulus_pa = 2.8e9\npoisson_ratio = 0.35\ndensity_kg_per_m3 = 1410.0\n\
             yield_strength_pa = 65e6\nultimate_strength_pa = 65e6\nelongation = 0.3\n"
        );
        let rig = PlatformRig::parse(&text, "rig.toml").unwrap();
        let again = PlatformRig::parse(&rig.to_toml(), "again").unwrap();
        assert_eq!(rig, again);
        assert_eq!(rig.masses.len(), 2);
        assert!((rig.stiffness_n_per_m()[1] / (3.0 * 2625.0 * 2.8 / 2.1) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_unknown_key_is_named() {
        assert!(error(&PLANAR.replace("mass_kg", "mass_g")).contains("`mass_g`"));
        assert!(error(&format!("colour = 1\n{PLANAR}")).contains("`colour`"));
        let effect = format!("{PLANAR}[mass.effects.creep]\nrate = 1.0\n");
        assert!(error(&effect).contains("`creep`"));
    }

    #[test]
    fn impossible_values_are_named() {
        assert!(error(&PLANAR.replace("0.05", "0.0")).contains("mass 1: mass_kg"));
        assert!(error(&PLANAR.replace("4.1e3", "nan")).contains("damping_n_s_per_m"));
        assert!(error(&PLANAR.replace("4.0e3", "-1.0")).contains("stiffness_n_per_m"));
        assert!(error(&PLANAR.replace("stiffness_n_per_m = 4.0e3\n", "")).contains("missing key"));
        assert!(
            error("name = \"p\"\nkind = \"platform\"\nsample_rate_hz = 200.0\nmass = []\n")
                .contains("[[mass]]")
        );
        assert!(error(&PLANAR.replace("\"platform\"", "\"ship\"")).contains("ship"));
    }
}
