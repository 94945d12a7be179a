//! hysteresis-shape: loops of another height, width, fullness or symmetry.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, PiezoModel};

pub(super) struct HysteresisShape;

pub(super) const EFFECT: HysteresisShape = HysteresisShape;

static INFO: Info = Info {
    name: "hysteresis-shape",
    stage: Stage::Piezo,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("strength", "1", 1.0, (0.0, 10.0), 1.1, "slope of every element over the nominal one"),
        Parameter::size("slip", "1", 1.0, (0.05, 20.0), 1.1, "slip charge of every element over the nominal one")
            .by_ratio(),
        Parameter::size(
            "tilt",
            "1",
            0.0,
            (-5.0, 5.0),
            0.2,
            "shifts strength from elements that slip early to those that slip late: e^(tilt (Delta_i/Delta_max - 1/2))",
        ),
        Parameter::size("skew", "1", 0.0, (-2.0, 2.0), 0.05, "growth of the hysteresis voltage over the full slip charge: a loop that is not symmetric about its centre"),
    ],
    threshold: false,
    physics: "Element i: slope k_i' = strength e^(tilt (Delta_i/Delta_max - 1/2)) k_i, slip charge slip Delta_i; the \
              hysteresis voltage is multiplied by 1 + skew q/Delta_max. Rate-independent, resets at reversals, grows \
              with amplitude. A stack whose rig has no elements gets ten of equal slope, in proportion to \
              strength - 1, spread over half the charge of its voltage range.",
    source: "Goldfarb and Celanovic, IEEE CSM 17(3), 1997; loops 10 to 15 % at full stroke, 2 % small (notes/physics.md, 4)",
    revealed_by: "slow triangles at several strokes, nested loops; phase towards 0 Hz that grows with level",
    confused_with: &["hysteresis-rate", "friction", "piezo-gain", "creep"],
};

/// Number of elements given to a stack that has none.
const ADDED: usize = 10;

impl HysteresisShape {
    /// Slip charges and slopes at twice the nominal strength for a stack without elements.
    fn family(piezo: &PiezoModel, range_v: f64) -> (Vec<f64>, Vec<f64>) {
        let stiffness = piezo.stiffness_n_per_m;
        let free_f = piezo.capacitance_f + piezo.transformer_n_per_v * piezo.transformer_n_per_v / stiffness;
        let reach_c = 0.5 * free_f * range_v;
        let slip = (1..=ADDED).map(|i| reach_c * i as f64 / ADDED as f64).collect();
        (vec![0.5 / free_f / ADDED as f64; ADDED], slip)
    }
}

impl Effect for HysteresisShape {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [strength, slip, tilt, skew] = values[..4] else { return };
        let axis = &mut model.axes[place.on()];
        let range_v = axis.amplifier.max_v - axis.amplifier.min_v;
        let piezo = &mut axis.piezo;
        let (slopes, charges, strength) = if piezo.slopes_v_per_c.is_empty() {
            let (slopes, charges) = Self::family(piezo, range_v);
            (slopes, charges, (strength - 1.0).max(0.0))
        } else {
            let slopes = std::mem::take(&mut piezo.slopes_v_per_c);
            let charges = piezo.limits_v.iter().zip(&slopes).map(|(v, k)| v / k).collect();
            (slopes, charges, strength)
        };
        let full = charges.iter().copied().fold(0.0, f64::max);
        let weight = |charge: f64| strength * (tilt * (charge / full - 0.5)).exp();
        piezo.slopes_v_per_c =
            slopes.iter().zip(&charges).map(|(slope, charge)| slope * weight(*charge)).collect();
        piezo.limits_v = piezo
            .slopes_v_per_c
            .iter()
            .zip(&charges)
            .map(|(slope, charge)| slope * charge * slip)
            .collect();
        piezo.skew_per_c = skew / full;
    }
}
