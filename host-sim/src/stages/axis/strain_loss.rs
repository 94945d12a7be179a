//! The loss between charge and strain: a force against the current, which takes charge with it.
//!
//! With the loss held the charge would go through the tick as the amplifier does. Every newton that the loss changes by draws so many
//! coulombs, and that current changes the loss: `F = -force ln(1 + u^onset)/onset`, `u = |i|/current`,
//! `i = i_held(t) + coulombs_per_newton dF/dt`. After a turn that settles within a fraction of a tick at 10 kHz where the current is large and
//! in several ticks where it is small, so a tick is taken in parts, each of them solved for its end (implicit Euler, which no
//! stiffness upsets). That is within 1.5 % of the loss in quarters of a tick (`host-sim/tests/rates.rs`).

use crate::stages::model::StrainLoss;

/// Parts of a tick.
const PARTS: usize = 8;
/// Change of the loss in a tick up to which one part will do, over its growth by a factor of e of the current: up to a fifth of the change
/// comes late then.
const STEADY: f64 = 0.01;
/// Error of a current to which a part is solved, as a share of it,
const TOLERANCE: f64 = 1.0e-7;
/// and as charge a tick, C: a loss that holds the charge leaves a current of next to nothing, which rounding does not tell from none.
const LEAST_C: f64 = 1.0e-3 * StrainLossSim::TOLERANCE_C;
/// Most rounds of a part; a bracket is halved to nothing in as many.
const ROUNDS: usize = 60;

/// The loss with what it remembers.
#[derive(Debug, Clone, Copy)]
pub(super) struct StrainLossSim {
    force_n: f64,
    /// 1/current, per coulomb a tick.
    per_c: f64,
    onset: f64,
    /// What of a tick's charge goes in each part, times the parts: the current there over the mean one.
    shape: [f64; PARTS],
    charge_c: f64,
    /// At the start of the tick: the loss, and the current as charge a tick.
    start: Loss,
    /// At the end of the tick that was last solved.
    next: Loss,
    next_charge_c: f64,
}

/// A loss and the current that makes it.
#[derive(Debug, Clone, Copy, Default)]
struct Loss {
    force_n: f64,
    rate_c: f64,
}

impl StrainLossSim {
    /// Charge by which the stack may miss the one that was solved for, C: 1e-14 m of a stack of 10 N/V.
    pub(super) const TOLERANCE_C: f64 = 1.0e-13;
    /// Most rounds of the stack: elements that begin to slip change what a newton draws.
    pub(super) const ROUNDS: usize = 8;

    /// In ticks of `step_s`, behind an amplifier of `shape_s`.
    pub(super) fn new(loss: StrainLoss, transformer: f64, step_s: f64, shape_s: f64) -> Self {
        let part = step_s / (shape_s * PARTS as f64);
        // Of an amplifier that is through within a part, the first one has it all.
        let left = |parts: usize| (-part * parts as f64).exp();
        let shape =
            std::array::from_fn(|k| (left(k) - left(k + 1)) / (1.0 - left(PARTS)) * PARTS as f64);
        Self {
            force_n: transformer * loss.voltage_v,
            per_c: 1.0 / (loss.current_a * step_s),
            onset: loss.onset,
            shape,
            charge_c: 0.0,
            start: Loss::default(),
            next: Loss::default(),
            next_charge_c: 0.0,
        }
    }

    /// At rest with a charge.
    pub(super) fn rest(&mut self, charge_c: f64) {
        (self.charge_c, self.next_charge_c) = (charge_c, charge_c);
        (self.start, self.next) = (Loss::default(), Loss::default());
    }

    /// Force at the start of the tick, N.
    #[inline]
    pub(super) fn held_n(&self) -> f64 {
        self.start.force_n
    }

    /// Force at the end of the tick that was last solved, N.
    #[inline]
    pub(super) fn next_force_n(&self) -> f64 {
        self.next.force_n
    }

    /// Force at the end of a tick (N) that would end with `charge_c` if the force stayed; every newton draws `per_newton_c`.
    pub(super) fn solve(&mut self, charge_c: f64, per_newton_c: f64) -> f64 {
        let held_c = charge_c - self.charge_c;
        let (whole, _) = self.part(self.start, held_c * self.shape[PARTS - 1], per_newton_c);
        self.next = if (whole.force_n - self.start.force_n).abs() <= STEADY * self.force_n {
            whole
        } else {
            let through =
                |now, shape| self.part(now, held_c * shape, per_newton_c * PARTS as f64).0;
            self.shape.into_iter().fold(self.start, through)
        };
        self.next.force_n
    }

    /// A part in which `held_c` a tick would be drawn if the force stayed: `i = held + per_newton (F(i) - F)`. The right side never rises
    /// with the current, so there is one answer, and a tangent points to its side. The loss is against the current: without one
    /// it would go where the held one and the force before drive it, and with one no farther. Rounds that it took come along.
    #[inline]
    fn part(&self, before: Loss, held_c: f64, per_newton_c: f64) -> (Loss, usize) {
        let driven_c = held_c - per_newton_c * before.force_n;
        let (mut low, mut high) = (driven_c.min(0.0), driven_c.max(0.0));
        let mut rate = before.rate_c;
        if rate <= low || rate >= high {
            // As a current begins.
            rate = driven_c / (1.0 - per_newton_c * self.force(0.0).1);
        }
        for round in 1..=ROUNDS {
            let (force_n, slope) = self.force(rate);
            let error = rate - held_c - per_newton_c * (force_n - before.force_n);
            if error.abs() <= (TOLERANCE * rate.abs()).max(LEAST_C) {
                return (Loss { force_n, rate_c: rate }, round);
            }
            if error > 0.0 {
                high = rate;
            } else {
                low = rate;
            }
            let next = rate - error / (1.0 - per_newton_c * slope);
            rate = if next >= low && next <= high { next } else { 0.5 * (low + high) };
        }
        (Loss { force_n: self.force(rate).0, rate_c: rate }, ROUNDS)
    }

    /// Force (N) and its slope (N/C) at a current, as charge a tick.
    #[inline]
    fn force(&self, rate_c: f64) -> (f64, f64) {
        let share = (rate_c * self.per_c).abs();
        if share == 0.0 {
            let slope = if self.onset > 1.0 { 0.0 } else { self.force_n * self.per_c };
            return (0.0, -slope);
        }
        let power = if self.onset == 1.0 { share } else { (self.onset * share.ln()).exp() };
        let slope = self.force_n * self.per_c * (power / share) / (1.0 + power);
        (-self.force_n * power.ln_1p() / self.onset * rate_c.signum(), -slope)
    }

    /// Say where the charge came to.
    #[inline]
    pub(super) fn reached(&mut self, charge_c: f64) {
        self.next_charge_c = charge_c;
    }

    /// Accept the tick that was last solved.
    #[inline]
    pub(super) fn commit(&mut self) {
        (self.charge_c, self.start) = (self.next_charge_c, self.next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decades from one to the other.
    fn decades(from: i32, to: i32) -> impl Iterator<Item = f64> {
        (from..=to).map(|power| 10f64.powi(power))
    }

    #[test]
    fn a_part_is_solved_in_few_rounds_whatever_holds_the_charge() {
        let mut most = 0;
        for onset in [0.5, 1.0, 3.0] {
            for current_a in decades(-8, 1) {
                let loss = StrainLoss { voltage_v: 1.0, current_a, onset };
                let sim = StrainLossSim::new(loss, 10.0, 1.0e-4, 4.0e-4);
                for per_newton_c in decades(-10, -4) {
                    for (held_c, before_c) in decades(-12, -5)
                        .flat_map(|held| decades(-12, -5).map(move |before| (held, -before)))
                        .flat_map(|(held, before)| [(held, before), (held, -before), (0.0, before)])
                    {
                        let before = Loss { force_n: sim.force(before_c).0, rate_c: before_c };
                        let (after, rounds) = sim.part(before, held_c, per_newton_c);
                        let drawn_c = per_newton_c * (after.force_n - before.force_n);
                        let error_c = (after.rate_c - held_c - drawn_c).abs();
                        let driven_c = (held_c - per_newton_c * before.force_n).abs();
                        // Rounding of what drives it counts as well.
                        let least_c = LEAST_C.max(1.0e-14 * driven_c);
                        assert!(
                            error_c <= 2.0 * (TOLERANCE * after.rate_c.abs()).max(least_c),
                            "{error_c} C of {after:?}, {held_c} C and {before:?}, onset {onset}, {current_a} A, {per_newton_c} C/N"
                        );
                        most = most.max(rounds);
                    }
                }
            }
        }
        // 27 were measured.
        assert!(most <= 30, "{most} rounds");
    }
}
