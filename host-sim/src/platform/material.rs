//! Materials, and the stiffness of a flexure from its geometry.
//!
//! The paper gives nylon in its Table 1 and finds about 4·10³ N/m for both platforms with finite elements. Where a rig
//! file gives the geometry of the links instead of a stiffness, the slender-beam formulas here serve (Euler-Bernoulli,
//! small deflections; e.g. Roark's Formulas for Stress and Strain, table 8.1).

use serde::{Deserialize, Serialize};

/// Elastic properties of a material.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Young's modulus in Pa.
    pub young_modulus_pa: f64,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Density in kg/m³.
    pub density_kg_per_m3: f64,
    /// Stress at which it yields, in Pa.
    pub yield_strength_pa: f64,
    /// Stress at which it breaks (lowest of the range), in Pa.
    pub ultimate_strength_pa: f64,
    /// Elongation at break, as a fraction.
    pub elongation: f64,
}

/// Nylon as in Table 1 of the paper (ultimate strength: 40 to 70 MPa, the lower end here).
pub const NYLON: Material = Material {
    young_modulus_pa: 2.1e9,
    poisson_ratio: 0.4,
    density_kg_per_m3: 1.125e3,
    yield_strength_pa: 40.0e6,
    ultimate_strength_pa: 40.0e6,
    elongation: 0.5,
};

/// Materials known by name.
pub const TABLE: [(&str, Material); 1] = [("nylon", NYLON)];

/// How the far end of a flexure is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ends {
    /// Fixed at one end, free to tilt at the other: k = 3 E I / L³.
    Cantilever,
    /// Fixed at one end, sliding without tilt at the other: k = 12 E I / L³.
    Guided,
}

/// Parallel rectangular leaf springs that carry one mass of the chain.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flexure {
    /// How many leaves act in parallel (three legs in the paper's spatial platform).
    pub leaves: u32,
    /// Free length in metres.
    pub length_m: f64,
    /// Width, across the bending plane, in metres.
    pub width_m: f64,
    /// Thickness, in the bending plane, in metres.
    pub thickness_m: f64,
    /// How the far end is held.
    pub ends: Ends,
}

impl Flexure {
    /// Second moment of area of one leaf, in m⁴.
    pub fn second_moment_m4(&self) -> f64 {
        self.width_m * self.thickness_m.powi(3) / 12.0
    }

    /// Stiffness of all leaves together, in N/m.
    pub fn stiffness_n_per_m(&self, material: &Material) -> f64 {
        let factor = match self.ends {
            Ends::Cantilever => 3.0,
            Ends::Guided => 12.0,
        };
        let bending = material.young_modulus_pa * self.second_moment_m4();
        f64::from(self.leaves) * factor * bending / self.length_m.powi(3)
    }

    /// Largest bending stress at a deflection of the far end, in Pa: beyond the yield strength the model does not hold.
    pub fn stress_pa(&self, material: &Material, deflection_m: f64) -> f64 {
        let factor = match self.ends {
            Ends::Cantilever => 1.5,
            Ends::Guided => 3.0,
        };
        factor * material.young_modulus_pa * self.thickness_m * deflection_m.abs()
            / self.length_m.powi(2)
    }

    /// Mass of all leaves together, in kg.
    pub fn mass_kg(&self, material: &Material) -> f64 {
        f64::from(self.leaves)
            * self.length_m
            * self.width_m
            * self.thickness_m
            * material.density_kg_per_m3
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A leaf of 1 mm x 10 mm x 20 mm by hand: I = 8.333e-13 m⁴, 12 E I / L³ = 2 625 N/m.
    #[test]
    fn guided_leaf_by_hand() {
        let leaf = Flexure {
            leaves: 1,
            length_m: 0.02,
            width_m: 0.01,
            thickness_m: 0.001,
            ends: Ends::Guided,
        };
        assert!((leaf.stiffness_n_per_m(&NYLON) - 2625.0).abs() < 1e-9 * 2625.0);
        let cantilever = Flexure { ends: Ends::Cantilever, leaves: 4, ..leaf };
        assert!((cantilever.stiffness_n_per_m(&NYLON) - 2625.0).abs() < 1e-9 * 2625.0);
        assert!((leaf.mass_kg(&NYLON) - 0.225e-3).abs() < 1e-12);
    }

    /// Stress is moment over section modulus, with the end force from the stiffness: two routes to one number.
    #[test]
    fn stress_agrees_with_the_end_force() {
        for (ends, lever) in [(Ends::Cantilever, 1.0), (Ends::Guided, 0.5)] {
            let leaf =
                Flexure { leaves: 1, length_m: 0.015, width_m: 0.004, thickness_m: 0.0012, ends };
            let deflection = 0.3e-3;
            let force = leaf.stiffness_n_per_m(&NYLON) * deflection;
            let stress =
                force * leaf.length_m * lever * (leaf.thickness_m / 2.0) / leaf.second_moment_m4();
            assert!((leaf.stress_pa(&NYLON, deflection) / stress - 1.0).abs() < 1e-12);
        }
    }
}
