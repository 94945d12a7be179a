//! hysteresis-rate: loops that widen with speed.

use std::f64::consts::LOG10_E;

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, RateLaw, StrainLoss};

pub(super) struct HysteresisRate;

pub(super) const EFFECT: HysteresisRate = HysteresisRate;

static INFO: Info = Info {
    name: "hysteresis-rate",
    stage: Stage::Piezo,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("per_decade", "1", 0.0, (-0.5, 2.0), 0.05, "growth of the slip limits a decade of current"),
        Parameter::size("resistance_ohm", "Ohm", 0.0, (0.0, 1.0e6), 50.0, "loss in series with the elements, at a current of 1 mA"),
        Parameter::shape("reference_a", "A", (1.0e-8, 10.0), 1.0e-4, "current from which the limits grow").by_ratio(),
        Parameter::shape("stiffening", "1", (0.0, 1.0), 0.5, "share of the growth that the elements' stiffness takes part in"),
        Parameter::shape("loss_exponent", "1", (0.1, 1.0), 1.0, "power of the current that the voltage of the series loss goes with"),
        Parameter::size("strain_loss_v", "V", 0.0, (0.0, 50.0), 0.2, "loss between charge and strain: growth by a factor of e of the current"),
        Parameter::shape("strain_loss_a", "A", (1.0e-7, 10.0), 2.0e-3, "current from which it grows with the logarithm").by_ratio(),
        Parameter::shape("strain_onset", "1", (1.0, 3.0), 1.0, "power of the current that it goes with below that"),
    ],
    threshold: false,
    physics: "limit_i' = limit_i (1 + per_decade lg(1 + |i|/reference)), i the current into the free stack, followed within 0.1 ms, and resistance 1 mA (|dq/dt| / 1 mA)^loss_exponent in series: domain \
              walls need a larger field to move faster. With stiffening 1 the whole hysteresis voltage grows instead. A reference beyond all currents makes the growth linear in \
              speed. Strain may also come later than charge: the stack pushes strain_loss ln(1 + u^onset)/onset, u = |dq/dt|/strain_loss_a, less \
              towards where it goes. Loop width at 0 Hz is untouched.",
    source: "rate-dependent Prandtl-Ishlinskii models, thresholds alpha + beta |du/dt|, 10.5772/58984 (notes/physics.md, 2)",
    revealed_by: "the same triangle at 0.1, 1, 10, 100 Hz",
    confused_with: &["hysteresis-shape", "amplifier-bandwidth", "drive-delay", "viscoelasticity", "creep"],
};

struct LimitGrowth {
    per_decade: f64,
    reference_a: f64,
    stiffening: f64,
}

impl RateLaw for LimitGrowth {
    fn scales(&self, current_a: f64) -> (f64, f64) {
        let growth = self.per_decade * (current_a / self.reference_a).ln_1p() * LOG10_E;
        let whole = (1.0 + self.stiffening * growth).max(0.05);
        ((1.0 + growth).max(0.05) / whole, whole)
    }
}

impl Effect for HysteresisRate {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let piezo = &mut model.axes[place.on()].piezo;
        piezo.resistance_ohm += values[1];
        piezo.loss_exponent = values[4];
        if values[5] != 0.0 {
            piezo.strain_loss =
                Some(StrainLoss { voltage_v: values[5], current_a: values[6], onset: values[7] });
        }
        if values[0] != 0.0 {
            piezo.rate =
                Some(Box::new(LimitGrowth { per_decade: values[0], reference_a: values[2], stiffening: values[3] }));
        }
    }
}
