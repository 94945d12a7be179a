//! The paper's platforms as rigs.
//!
//! The paper gives k of about 4·10³ N/m, the starting deflections and the shape of the answer (seconds); its masses and
//! dampers are not printed. The values here are derived ones that give that answer: two masses of tens of grams, springs
//! in series of 4 000 N/m, and dampers such that half of the planar return takes 0.5 s and the rest six seconds. The
//! one-mass rigs are what somebody who measured k and fitted one damper would have written.

use super::{Mass, PlatformRig, rig::Sensor};

/// Starting deflection of the planar platform (figure 6), in metres.
pub const PLANAR_DEFLECTION_M: f64 = 1.43e-3;
/// Starting deflections of the spatial platform (figure 7 a and b), in metres.
pub const SPATIAL_DEFLECTIONS_M: [f64; 2] = [1.71e-3, 2.68e-3];
/// Rate of the simulated recordings, in Hz.
const SAMPLE_RATE_HZ: f64 = 200.0;
/// Noise of the optical position measurement in the simulated recordings, in metres.
const OPTICAL_NOISE_M: f64 = 4.0e-6;

/// Names that [`named`] knows.
pub const NAMES: [&str; 4] = [
    "belfiore-planar",
    "belfiore-planar-two-mass",
    "belfiore-spatial",
    "belfiore-spatial-two-mass",
];

fn chain(name: &str, masses: &[(f64, f64, f64)]) -> PlatformRig {
    let masses = masses
        .iter()
        .map(|(mass_kg, stiffness, damping)| Mass {
            mass_kg: *mass_kg,
            stiffness_n_per_m: Some(*stiffness),
            damping_n_s_per_m: *damping,
            ..Mass::default()
        })
        .collect();
    let mut rig = PlatformRig::new(name, SAMPLE_RATE_HZ, masses);
    rig.sensor = Some(Sensor { noise_rms_m: OPTICAL_NOISE_M, resolution_m: 0.0 });
    rig
}

/// A platform of the paper by name; see [`NAMES`].
pub fn named(name: &str) -> Option<PlatformRig> {
    Some(match name {
        "belfiore-planar" => chain(name, &[(0.05, 4.0e3, 4.1e3)]),
        "belfiore-planar-two-mass" => chain(name, &[(0.02, 6.0e3, 9600.0), (0.03, 12.0e3, 1440.0)]),
        "belfiore-spatial" => chain(name, &[(0.08, 4.0e3, 6.2e3)]),
        "belfiore-spatial-two-mass" => {
            chain(name, &[(0.03, 6.0e3, 13_200.0), (0.05, 12.0e3, 2400.0)])
        }
        _ => return None,
    })
}
