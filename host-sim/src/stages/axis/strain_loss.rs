//! The loss between charge and strain, as a force that is solved for together with the charge.

use crate::stages::model::StrainLoss;
use crate::stages::speed::EndSpeed;

/// The loss with the charge that it remembers.
#[derive(Debug, Clone, Copy)]
pub(super) struct StrainLossSim {
    force_n: f64,
    /// 1/current, per coulomb a tick.
    per_c: f64,
    onset: f64,
    charge_c: f64,
    rate: EndSpeed,
    /// Charge drawn in the tick before the last one, C.
    earlier_c: f64,
    /// At the end of the tick that was last solved.
    pub(super) next_charge_c: f64,
    /// Force there, N.
    pub(super) next_force_n: f64,
}

impl StrainLossSim {
    /// What the force may differ by from the one that was solved for, as the charge that it makes, C: 1e-15 m of a stack of 10 N/V.
    pub(super) const TOLERANCE_C: f64 = 1.0e-14;
    /// Most rounds of a solve.
    pub(super) const ROUNDS: usize = 40;

    pub(super) fn new(loss: StrainLoss, transformer: f64, step_s: f64) -> Self {
        Self {
            force_n: transformer * loss.voltage_v,
            per_c: 1.0 / (loss.current_a * step_s),
            onset: loss.onset,
            charge_c: 0.0,
            rate: EndSpeed::default(),
            earlier_c: 0.0,
            next_charge_c: 0.0,
            next_force_n: 0.0,
        }
    }

    /// At rest with a charge.
    pub(super) fn rest(&mut self, charge_c: f64) {
        (self.charge_c, self.next_charge_c, self.next_force_n) = (charge_c, charge_c, 0.0);
        (self.rate, self.earlier_c) = (EndSpeed::default(), 0.0);
    }

    /// Begin a tick: the charge is expected to go on as in the one before.
    #[inline]
    pub(super) fn begin(&mut self) {
        self.next_charge_c = self.charge_c + 2.0 * self.rate.before() - self.earlier_c;
    }

    /// Force (N) and its slope (N/C) if the tick ends with a charge.
    #[inline]
    pub(super) fn force(&self, charge_c: f64) -> (f64, f64) {
        let (rate, faster) = self.rate.at(charge_c - self.charge_c);
        let share = (rate * self.per_c).abs();
        if share == 0.0 {
            let slope = if self.onset > 1.0 { 0.0 } else { self.force_n * self.per_c * faster };
            return (0.0, -slope);
        }
        let power = if self.onset == 1.0 { share } else { (self.onset * share.ln()).exp() };
        let growth = power / share;
        let slope = self.force_n * self.per_c * faster * growth / (1.0 + power);
        (-self.force_n * power.ln_1p() / self.onset * rate.signum(), -slope)
    }

    /// Accept the tick that was last solved.
    #[inline]
    pub(super) fn commit(&mut self) {
        self.earlier_c = self.rate.before();
        self.rate.commit(self.next_charge_c - self.charge_c);
        self.charge_c = self.next_charge_c;
    }
}
