//! Elements in the order of their slip charge: a tick looks at the next one to slip and at sums over the rest.
//!
//! Write element i as `v_i = k_i z_i`, `|z_i| <= D_i`. Whatever the charge has done, neighbours in the order of `D` obey
//! `|z_i - z_j| <= |D_i - D_j|` (the memory curve of play operators, Krasnosel'skii and Pokrovskii 1983). So while the
//! charge goes one way the elements start to slip in that order: the slipping ones are the first `p`, the others have
//! kept `z_i - q` since they last slipped, and `H(q) = +-sum_(i<p) k_i D_i + sum_(i>=p) k_i (z_i - q) + q sum_(i>=p) k_i`.
//! All three sums are tabulated over `p`. Each element is touched once when it starts to slip and once at the next
//! reversal, and nothing is subtracted from a running sum, so that nothing drifts in a long run.

use super::{Branch, SlipElements};

/// Deviation from the order of slipping that is taken for rounding, of the largest slip charge.
const ROUNDING: f64 = 1.0e-12;

#[derive(Debug, Clone, Copy, Default)]
struct Rung {
    /// Charge from the middle to slipping, C; infinite above the last element.
    slip_c: f64,
    /// `z - q` while this element holds, C.
    anchor_c: f64,
    /// Its slope, V/C.
    slope: f64,
    /// Sum of the slopes from this element on, V/C.
    holding: f64,
    /// Sum of `slope anchor` from this element on, V.
    anchored_v: f64,
    /// Sum of the limits before this element, V.
    slipping_v: f64,
}

/// State and parameters of the elements of one stack.
#[derive(Debug, Clone)]
pub struct Ladder {
    /// One more than elements.
    rungs: Vec<Rung>,
    /// Place of each rung's element among those given.
    order: Vec<usize>,
    charge_c: f64,
    /// +1 while the charge rises, -1 while it falls.
    sign: f64,
    /// How many elements slip in that direction.
    slipping: usize,
    next_charge_c: f64,
    next_slipping: usize,
    /// The segment last solved and the inverse of its slope: mostly the next tick has the same.
    segment: Segment,
}

#[derive(Debug, Clone, Copy)]
struct Segment {
    slipping: usize,
    capacitance_f: f64,
    drag_v_per_c: f64,
    elastance: f64,
    inverse: f64,
}

impl Ladder {
    /// Elements from slopes (V/C) and limits (V), virgin.
    pub fn new(slopes: &[f64], limits: &[f64]) -> Self {
        let slip = |i: usize| if slopes[i] > 0.0 { limits[i] / slopes[i] } else { 0.0 };
        let mut order: Vec<usize> = (0..slopes.len()).collect();
        order.sort_by(|&a, &b| slip(a).total_cmp(&slip(b)));
        let mut rungs: Vec<Rung> = order
            .iter()
            .map(|&i| Rung { slip_c: slip(i), slope: slopes[i], ..Rung::default() })
            .collect();
        rungs.push(Rung { slip_c: f64::INFINITY, ..Rung::default() });
        for i in (0..order.len()).rev() {
            rungs[i].holding = rungs[i + 1].holding + rungs[i].slope;
        }
        for i in 0..order.len() {
            rungs[i + 1].slipping_v = rungs[i].slipping_v + limits[order[i]];
        }
        Self {
            rungs,
            order,
            charge_c: 0.0,
            sign: 1.0,
            slipping: 0,
            next_charge_c: 0.0,
            next_slipping: 0,
            segment: Segment {
                slipping: usize::MAX,
                capacitance_f: 0.0,
                drag_v_per_c: 0.0,
                elastance: 0.0,
                inverse: 0.0,
            },
        }
    }

    /// Slopes (V/C) and limits (V) as they were given.
    pub fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        let (mut slopes, mut limits) = (vec![0.0; self.order.len()], vec![0.0; self.order.len()]);
        for (rung, &i) in self.rungs.iter().zip(&self.order) {
            slopes[i] = rung.slope;
            limits[i] = rung.slope * rung.slip_c;
        }
        (slopes, limits)
    }

    /// Voltages of the elements in the order in which they were given, V.
    pub fn voltages(&self) -> Vec<f64> {
        let mut volts = vec![0.0; self.order.len()];
        for (at, &i) in self.order.iter().enumerate() {
            volts[i] = self.rungs[at].slope * self.position_c(at);
        }
        volts
    }

    /// Sum of the element voltages, V.
    pub fn sum_v(&self) -> f64 {
        let rung = &self.rungs[self.slipping];
        self.sign * rung.slipping_v + rung.anchored_v + rung.holding * self.charge_c
    }

    /// Put the elements where `voltage_of(slope, limit, index)` says, held inside their limits; `false` if no history
    /// of charge leaves them there, and then the state means nothing.
    pub fn set_voltages(&mut self, voltage_of: impl Fn(f64, f64, usize) -> f64) -> bool {
        self.charge_c = 0.0;
        self.sign = 1.0;
        self.slipping = 0;
        let mut before = (0.0, 0.0);
        let full = self.order.len().checked_sub(1).map_or(0.0, |last| self.rungs[last].slip_c);
        for (at, &i) in self.order.iter().enumerate() {
            let Rung { slip_c, slope, .. } = self.rungs[at];
            let limit = slope * slip_c;
            let volts = voltage_of(slope, limit, i).clamp(-limit, limit);
            let z = if slope > 0.0 { (volts / slope).clamp(-slip_c, slip_c) } else { 0.0 };
            let room = (slip_c - z, slip_c + z);
            if room.0 < before.0 - ROUNDING * full || room.1 < before.1 - ROUNDING * full {
                return false;
            }
            before = (room.0.max(before.0), room.1.max(before.1));
            self.rungs[at].anchor_c = z;
        }
        self.tabulate(self.order.len());
        true
    }

    /// Say what charge the present state belongs to, C.
    pub fn set_charge(&mut self, charge_c: f64) {
        for at in 0..self.order.len() {
            self.rungs[at].anchor_c = self.position_c(at) - charge_c;
        }
        self.charge_c = charge_c;
        self.slipping = 0;
        self.tabulate(self.order.len());
    }

    /// Charge at the end of the tick if the first `slipping` elements slip, C.
    #[inline]
    fn charge_on(&mut self, branch: &Branch, slipping: usize) -> f64 {
        let rung = &self.rungs[slipping];
        let (capacitance, drag) = (branch.capacitance_f, branch.drag_v_per_c);
        // Voltage of the elements at no charge.
        let offset_v = self.sign * rung.slipping_v + rung.anchored_v;
        let pull = branch.charge_at_zero_c
            + capacitance * (branch.input_v - offset_v + drag * self.charge_c);
        if self.segment.slipping != slipping
            || self.segment.capacitance_f != capacitance
            || self.segment.drag_v_per_c != drag
        {
            self.segment = Segment {
                slipping,
                capacitance_f: capacitance,
                drag_v_per_c: drag,
                elastance: 1.0 / capacitance,
                inverse: 1.0 / (1.0 + capacitance * (rung.holding + drag)),
            };
        }
        if branch.skew_per_c == 0.0 {
            return pull * self.segment.inverse;
        }
        // (offset + holding q)(1 + skew q) instead: a quadratic, of which the root that goes over into the line.
        let square = capacitance * rung.holding * branch.skew_per_c;
        let slope = 1.0 + capacitance * (rung.holding + offset_v * branch.skew_per_c + drag);
        2.0 * pull / (slope + (slope * slope + 4.0 * square * pull).max(0.0).sqrt())
    }

    /// Reverse the direction at the present charge: the elements that slipped hold from here.
    fn turn(&mut self) {
        let slipping = std::mem::take(&mut self.slipping);
        for rung in &mut self.rungs[..slipping] {
            rung.anchor_c = self.sign * rung.slip_c - self.charge_c;
        }
        self.tabulate(slipping);
        self.sign = -self.sign;
    }

    /// Bring the sums of the anchors up to date below rung `end`.
    fn tabulate(&mut self, end: usize) {
        let mut anchored_v = self.rungs[end].anchored_v;
        for rung in self.rungs[..end].iter_mut().rev() {
            anchored_v += rung.slope * rung.anchor_c;
            rung.anchored_v = anchored_v;
        }
        // The segment holds no sum of anchors: it stays valid.
    }

    /// Where the element on a rung stands, C.
    fn position_c(&self, at: usize) -> f64 {
        let rung = &self.rungs[at];
        if at < self.slipping {
            self.sign * rung.slip_c
        } else {
            (rung.anchor_c + self.charge_c).clamp(-rung.slip_c, rung.slip_c)
        }
    }
}

impl SlipElements for Ladder {
    #[inline]
    fn tangent_v_per_c(&self) -> f64 {
        self.rungs[self.slipping].holding
    }

    #[inline]
    fn tangent_towards(&self, rising: bool) -> f64 {
        let from = if rising == (self.sign > 0.0) { self.slipping } else { 0 };
        self.rungs[from].holding
    }

    #[inline]
    fn charge_c(&self) -> f64 {
        self.charge_c
    }

    #[inline]
    fn drawn_c(&self) -> f64 {
        self.next_charge_c - self.charge_c
    }

    #[inline(always)]
    fn solve(&mut self, branch: &Branch) -> f64 {
        let mut slipping = self.slipping;
        let mut charge = self.charge_on(branch, slipping);
        if (charge - self.charge_c) * self.sign < 0.0 {
            self.turn();
            slipping = 0;
            charge = self.charge_on(branch, slipping);
        }
        // An element that gives way lets the charge go further, never back: the walk ends at the solution.
        while (self.rungs[slipping].anchor_c + charge) * self.sign > self.rungs[slipping].slip_c {
            slipping += 1;
            charge = self.charge_on(branch, slipping);
        }
        self.next_charge_c = charge;
        self.next_slipping = slipping;
        (charge - branch.charge_at_zero_c) * self.segment.elastance
    }

    #[inline]
    fn commit(&mut self) {
        self.charge_c = self.next_charge_c;
        self.slipping = self.next_slipping;
    }
}
