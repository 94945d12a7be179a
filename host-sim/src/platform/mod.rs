//! The second paper: compliant platforms as chains of lumped masses (`kind = "platform"`).
//!
//! A micro-platform of nylon is pulled away by its tendons and let go; it takes seconds to come back. The paper
//! (Belfiore, Scaccia, Di Vasta, Ianniello, *Dynamic Performance of Micro-Compliant Platforms*) models it by one and
//! by two masses, each held by a spring and a viscous damper, and finds that two masses match and one does not.
//!
//! ```text
//! ground ──k1,c1── m1 ──k2,c2── m2 ── … ── mn = platform, whose position is recorded
//! ```
//!
//! | file | what |
//! | --- | --- |
//! | [`rig`] | the TOML file: chain, material, sensor |
//! | [`effects`] | what may be added to the chain and the sensor |
//! | [`material`] | nylon (Table 1 of the paper) and beam stiffness from geometry |
//! | [`equivalent`] | masses that keep the kinetic energy of the links |
//! | [`statics`] | the force-displacement test, and where the inner masses start |
//! | [`modes`] | the exact solution from the roots of det(lambda² M + lambda C + K) = 0 |
//! | [`integrate`] | the same chain step by step (implicit Runge-Kutta), and every non-linear one |
//! | [`response`] | free return and forced response, as the sensor reads them |
//! | [`presets`] | the paper's planar and spatial platforms |
//!
//! Everything is in SI units. With 4 000 N/m, about a second and tens of grams, the chain is strongly overdamped: its
//! slow roots are near 1 s⁻¹ and its fast ones near 10⁵ s⁻¹, so explicit steps at 10 kHz are unstable.

pub mod effects;
pub mod equivalent;
pub mod integrate;
pub mod material;
pub mod modes;
pub mod presets;
pub mod response;
pub mod rig;
pub mod statics;

pub use response::{compliance_m_per_n, forced_response, free_return, time_to_fraction_s};
pub use rig::{Mass, PlatformRig, PlatformRigError};

/// A chain that cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlatformError {
    /// The eigenvalue solver did not converge, or the roots do not reproduce the starting state.
    #[error("the roots of the chain cannot be found: {0}")]
    Roots(String),
    /// The step-by-step solver gave up.
    #[error("the chain cannot be integrated: {0}")]
    Integration(String),
    /// The inner masses find no static balance.
    #[error("no static balance at a platform displacement of {displacement_m} m")]
    Statics {
        /// Displacement of the platform that was asked for, in metres.
        displacement_m: f64,
    },
    /// A time that the solution is not defined at.
    #[error("times must be finite, not negative and ascending; found {0} s")]
    Time(f64),
}
