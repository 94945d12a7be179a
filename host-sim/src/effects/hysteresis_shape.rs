//! hysteresis-shape: loops of another height, width, fullness, symmetry or memory.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::hysteresis::WenLoop;
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
        Parameter::size("bend", "1", 0.0, (-12.0, 12.0), 1.0, "shifts strength from elements in the middle to those that slip first and last"),
        Parameter::size("skew", "1", 0.0, (-2.0, 2.0), 0.05, "growth of the hysteresis voltage over the full slip charge: a loop that is not symmetric about its centre"),
        Parameter::size("imprint_v", "V", 0.0, (-30.0, 30.0), 1.0, "voltage about which the loops lie: an internal bias of the ceramic"),
        Parameter::size("yield", "1", 0.0, (0.0, 1.0), 0.3, "by how much every element gives way before it slips: rounder loops, a memory that small cycles wear off"),
        Parameter::size("spread", "1", 0.0, (0.0, 1.0), 0.5, "spread of the slip charge within an element, over the least slip charge: a continuum instead of steps"),
        Parameter::size("recoil", "1", 1.0, (0.0, 1.0), 0.5, "share of the yield on the way back: 1 for Dahl's law, 0 for that of Bouc and Wen with beta = gamma"),
        Parameter::size("beside_v", "V", 0.0, (0.0, 60.0), 1.0, "height of a loop of Bouc and Wen's law beside the elements"),
        Parameter::shape("beside_c", "C", (1.0e-9, 1.0), 5.0e-5, "charge in which it would come to that at its first slope").by_ratio(),
        Parameter::shape("beside_exponent", "1", (0.5, 6.0), 1.0, "how late it bends: Wen's n"),
        Parameter::shape("beside_recoil", "1", (-1.0, 1.0), 0.0, "share of the bend on the way back: (beta - gamma) / (beta + gamma)"),
    ],
    threshold: false,
    physics: "Element i: slope k_i' = strength e^(tilt u + bend (u^2 - 1/12)) k_i with u = Delta_i/Delta_max - 1/2, slip charge slip Delta_i; the \
              hysteresis voltage is multiplied by 1 + skew q/Delta_max and shifted by the imprint. With a yield y an element follows the charge by \
              dz = dq (1 - y sgn(dq) z/Delta_i) until it slips (Dahl's law), on the way back with recoil y (Bouc and Wen's). Beside them the loop beside_v z, dz = dq/beside_c (1 - |z|^n), whose minor loops do not \
              close. Rate-independent, resets at reversals, grows \
              with amplitude. A stack whose rig has no elements gets ten of equal slope, in proportion to \
              strength - 1, spread over half the charge of its voltage range.",
    source: "Goldfarb and Celanovic, IEEE CSM 17(3), 1997; P. R. Dahl, Aerospace Corp. TOR-0158(3107-18)-1, 1968; Y. K. Wen, J. Eng. Mech. Div. ASCE 102(2), 1976; internal bias: Carl and Haerdtl, Ferroelectrics 17, 473, 1978; loops 10 to 15 % at full stroke, 2 % small (notes/physics.md, 4)",
    revealed_by: "slow triangles at several strokes, nested loops; phase towards 0 Hz that grows with level",
    confused_with: &["hysteresis-rate", "friction", "piezo-gain", "creep"],
};

/// Parts of an element whose slip charge is spread out.
const GRAINS: usize = 4;
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

impl HysteresisShape {
    /// Slopes and slip charges of elements that slip in equal parts, over `spread` times the least slip charge below and above their own.
    fn grains(slopes: &[f64], charges: &[f64], spread: f64) -> Vec<(f64, f64)> {
        let elements = slopes.iter().copied().zip(charges.iter().copied());
        if spread == 0.0 {
            return elements.collect();
        }
        let width = spread * charges.iter().copied().fold(f64::INFINITY, f64::min);
        let part = |(slope, charge): (f64, f64), j: usize| {
            let along = (2 * j + 1) as f64 / GRAINS as f64 - 1.0;
            (slope / GRAINS as f64, charge + width * along)
        };
        elements.flat_map(|element| (0..GRAINS).map(move |j| part(element, j))).collect()
    }
}

impl Effect for HysteresisShape {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [strength, slip, tilt, bend, skew, imprint_v, element_yield, spread, recoil] =
            values[..9]
        else {
            return;
        };
        let [limit_v, slip_c, exponent, back] = values[9..13] else { return };
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
        let weight = |charge: f64| {
            let u = charge / full - 0.5;
            strength * (tilt * u + bend * (u * u - 1.0 / 12.0)).exp()
        };
        let grains = Self::grains(&slopes, &charges, spread);
        piezo.slopes_v_per_c =
            grains.iter().map(|(slope, charge)| slope * weight(*charge)).collect();
        let strong = grains.iter().zip(&piezo.slopes_v_per_c);
        piezo.limits_v = strong.map(|((_, charge), slope)| slope * charge * slip).collect();
        piezo.skew_per_c = skew / full;
        piezo.imprint_v = imprint_v;
        piezo.element_yield = element_yield;
        piezo.element_recoil = recoil;
        piezo.loop_beside = (limit_v > 0.0).then_some(WenLoop { limit_v, slip_c, exponent, recoil: back });
    }
}
