//! Elements with limits that change from tick to tick, or with any memory: three zones in the order of slip charge.
//!
//! The first elements slip and go on slipping; the last are far from their limits and hold; only those between are
//! looked at one by one. How far the charge and the limits may go before the last zone has to be drawn anew is known from the
//! margins at which it was drawn. Newton from the last tick's tangent ends after one or two evaluations.

use super::{Branch, SlipElements};

/// Residual at which the charge is found, V (about 1e-18 m).
const TOLERANCE_V: f64 = 1.0e-11;
/// Elements done at once; a zone begins and ends with a group of them.
const LANES: usize = 4;
/// Slip charge of the lanes that are left over, C: more than any stack draws.
const NEVER_C: f64 = 1.0e3;
/// Ticks at the present speed for which the holding zone is drawn.
const TICKS_AHEAD: f64 = 16.0;
/// How slowly the pace that this is measured by fades, a tick.
const PACE: f64 = 0.95;
/// Fall of the limits for which it is drawn, of the limits.
const FALL_AHEAD: f64 = 0.02;

/// State and parameters of the elements of one stack. Element i stands at `z_i` coulombs, `|z_i| <= scale slip_i`.
#[derive(Debug, Clone)]
pub struct Zones {
    /// In the order of slip charge.
    groups: Vec<Group>,
    /// Place of each element among those given.
    order: Vec<usize>,
    /// Sum of the limits before each group, V.
    limits_before_v: Vec<f64>,
    all_slopes: f64,
    charge_c: f64,
    scale: f64,
    /// +1 while the charge rises, -1 while it falls.
    sign: f64,
    tangent: f64,
    sum_v: f64,
    /// Charge drawn a tick lately, C.
    pace_c: f64,
    /// Groups before this one slip: their `z_c` is stale.
    slipping: usize,
    /// Groups from this one on hold: their `z_c` is that at `drawn.charge_c`.
    holding: usize,
    drawn: Drawn,
    next: Trial,
}

#[derive(Debug, Clone, Copy)]
struct Group {
    slip_c: [f64; LANES],
    slope: [f64; LANES],
    z_c: [f64; LANES],
}

impl Group {
    const NONE: Self = Self { slip_c: [NEVER_C; LANES], slope: [0.0; LANES], z_c: [0.0; LANES] };

    /// Sum of the voltages (V) and slopes (V/C) where they stand.
    fn sums(&self) -> (f64, f64) {
        let volts = (0..LANES).map(|lane| self.slope[lane] * self.z_c[lane]).sum();
        (volts, self.slope.iter().sum())
    }
}

/// The holding zone as it was drawn.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    charge_c: f64,
    reach_c: f64,
    least_scale: f64,
    voltage_v: f64,
    slope: f64,
}

impl Drawn {
    /// No element holds; to be drawn before the next tick.
    const NOT: Self =
        Self { charge_c: 0.0, reach_c: -1.0, least_scale: 0.0, voltage_v: 0.0, slope: 0.0 };
}

#[derive(Debug, Clone, Copy, Default)]
struct Trial {
    charge_c: f64,
    scale: f64,
    tangent: f64,
    sum_v: f64,
}

impl Zones {
    /// Elements from slopes (V/C) and limits (V), virgin.
    pub fn new(slopes: &[f64], limits: &[f64]) -> Self {
        let slip = |i: usize| if slopes[i] > 0.0 { limits[i] / slopes[i] } else { 0.0 };
        let mut order: Vec<usize> = (0..slopes.len()).collect();
        order.sort_by(|&a, &b| slip(a).total_cmp(&slip(b)));
        let mut groups = vec![Group::NONE; order.len().div_ceil(LANES)];
        let mut limits_before_v = vec![0.0; groups.len() + 1];
        for (at, &i) in order.iter().enumerate() {
            let group = &mut groups[at / LANES];
            group.slip_c[at % LANES] = slip(i);
            group.slope[at % LANES] = slopes[i];
            limits_before_v[at / LANES + 1] += slopes[i] * slip(i);
        }
        for at in 1..limits_before_v.len() {
            limits_before_v[at] += limits_before_v[at - 1];
        }
        let all_slopes = slopes.iter().sum();
        Self {
            holding: groups.len(),
            groups,
            order,
            limits_before_v,
            all_slopes,
            charge_c: 0.0,
            scale: 1.0,
            sign: 1.0,
            tangent: all_slopes,
            sum_v: 0.0,
            pace_c: 0.0,
            slipping: 0,
            drawn: Drawn::NOT,
            next: Trial::default(),
        }
    }

    /// Voltages of the elements in the order in which they were given, V.
    pub fn voltages(&self) -> Vec<f64> {
        let mut volts = vec![0.0; self.order.len()];
        for (at, &i) in self.order.iter().enumerate() {
            volts[i] = self.groups[at / LANES].slope[at % LANES] * self.position_c(at);
        }
        volts
    }

    /// Sum of the element voltages, V.
    pub fn sum_v(&self) -> f64 {
        self.sum_v
    }

    /// Put the elements where `voltage_of(slope, limit, index)` says, held inside their limits.
    pub fn set_voltages(&mut self, voltage_of: impl Fn(f64, f64, usize) -> f64) {
        for (at, &i) in self.order.iter().enumerate() {
            let (group, lane) = (&mut self.groups[at / LANES], at % LANES);
            let slope = group.slope[lane];
            let limit = slope * group.slip_c[lane];
            let volts = voltage_of(slope, limit, i).clamp(-limit, limit);
            group.z_c[lane] = if slope > 0.0 { volts / slope } else { 0.0 };
        }
        self.pace_c = 0.0;
        (self.scale, self.sign, self.slipping, self.holding) = (1.0, 1.0, 0, self.groups.len());
        self.drawn = Drawn::NOT;
        self.sum_v = self.groups.iter().map(|group| group.sums().0).sum();
        self.tangent = self.all_slopes;
    }

    /// Say what charge the present state belongs to, C.
    pub fn set_charge(&mut self, charge_c: f64) {
        self.settle();
        self.charge_c = charge_c;
    }

    /// Sum of the element voltages after drawing `drawn` coulombs, and its slope.
    #[inline]
    fn evaluate(&mut self, drawn: f64, scale: f64) -> (f64, f64) {
        let moved = (self.charge_c + drawn - self.drawn.charge_c).abs();
        if !(moved <= self.drawn.reach_c && scale >= self.drawn.least_scale) {
            self.draw(drawn, scale);
        }
        let mut sum = [0.0; LANES];
        let mut slope_sum = [0.0; LANES];
        let mut add = |group: &Group, from_c: [f64; LANES]| {
            for lane in 0..LANES {
                let free = from_c[lane] + drawn;
                let held = clamp(free, group.slip_c[lane] * scale);
                sum[lane] += group.slope[lane] * held;
                slope_sum[lane] += if held == free { group.slope[lane] } else { 0.0 };
            }
        };
        let slipping_v = if self.goes_on(drawn, scale) {
            self.sign * scale * self.limits_before_v[self.slipping]
        } else {
            for group in &self.groups[..self.slipping] {
                add(group, group.slip_c.map(|slip| self.sign * self.scale * slip));
            }
            0.0
        };
        for group in &self.groups[self.slipping..self.holding] {
            add(group, group.z_c);
        }
        let moved = self.charge_c + drawn - self.drawn.charge_c;
        let holding_v = self.drawn.voltage_v + self.drawn.slope * moved;
        (
            holding_v + slipping_v + ((sum[0] + sum[1]) + (sum[2] + sum[3])),
            self.drawn.slope + ((slope_sum[0] + slope_sum[1]) + (slope_sum[2] + slope_sum[3])),
        )
    }

    /// Whether all elements that slip do so to the end of a tick: the charge outruns the limit of the widest.
    #[inline]
    fn goes_on(&self, drawn: f64, scale: f64) -> bool {
        let last = self.slipping.checked_sub(1);
        let widest = last.map_or(0.0, |last| self.groups[last].slip_c[LANES - 1]);
        drawn * self.sign >= ((scale - self.scale) * widest).max(0.0)
    }

    /// Draw the holding zone anew, for a tick that draws `drawn` at a limit scale of `scale`.
    #[cold]
    fn draw(&mut self, drawn: f64, scale: f64) {
        self.settle_holding();
        let least_scale = scale.min(self.scale) * (1.0 - FALL_AHEAD);
        let reach_c = TICKS_AHEAD * drawn.abs().max(self.pace_c);
        let free = |group: &Group| {
            (0..LANES)
                .all(|lane| group.slip_c[lane] * least_scale - group.z_c[lane].abs() >= reach_c)
        };
        let tied = self.groups[self.slipping..].iter().rposition(|group| !free(group));
        self.holding = tied.map_or(self.slipping, |last| self.slipping + last + 1);
        let held = self.groups[self.holding..].iter().map(Group::sums);
        let (voltage_v, slope) = held.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        self.drawn = Drawn { charge_c: self.charge_c, reach_c, least_scale, voltage_v, slope };
    }

    /// Bring every element to where it stands, none of them in a zone.
    fn settle(&mut self) {
        self.stop_slipping();
        self.settle_holding();
    }

    fn settle_holding(&mut self) {
        let moved = self.charge_c - self.drawn.charge_c;
        for group in &mut self.groups[self.holding..] {
            group.z_c = group.z_c.map(|z| z + moved);
        }
        self.holding = self.groups.len();
        self.drawn = Drawn::NOT;
    }

    fn stop_slipping(&mut self) {
        for group in &mut self.groups[..self.slipping] {
            group.z_c = group.slip_c.map(|slip| self.sign * self.scale * slip);
        }
        self.slipping = 0;
    }

    /// Where an element stands, C.
    fn position_c(&self, at: usize) -> f64 {
        let (group, lane) = (&self.groups[at / LANES], at % LANES);
        if at / LANES < self.slipping {
            self.sign * self.scale * group.slip_c[lane]
        } else if at / LANES < self.holding {
            group.z_c[lane]
        } else {
            group.z_c[lane] + (self.charge_c - self.drawn.charge_c)
        }
    }
}

impl SlipElements for Zones {
    #[inline]
    fn tangent_v_per_c(&self) -> f64 {
        self.tangent
    }

    #[inline]
    fn tangent_towards(&self, rising: bool) -> f64 {
        if rising == (self.sign > 0.0) { self.tangent } else { self.all_slopes }
    }

    #[inline]
    fn charge_c(&self) -> f64 {
        self.charge_c
    }

    #[inline]
    fn drawn_c(&self) -> f64 {
        self.next.charge_c - self.charge_c
    }

    fn solve(&mut self, branch: &Branch) -> f64 {
        let elastance = 1.0 / branch.capacitance_f;
        let start = self.charge_c - branch.charge_at_zero_c;
        let (skew, drag, scale) = (branch.skew_per_c, branch.drag_v_per_c, branch.limit_scale);
        let whole = branch.sum_scale;
        // The slipping elements follow their limits at once.
        let carried = self.sign * (scale - self.scale) * self.limits_before_v[self.slipping];
        let sum = self.sum_v + carried;
        let gap = branch.input_v - start * elastance - sum * whole * (1.0 + skew * self.charge_c);
        let guess = self.tangent_towards(gap >= 0.0);
        let mut drawn = gap / (elastance + guess * whole + drag);
        for _ in 0..100 {
            let (voltage, tangent) = self.evaluate(drawn, scale);
            let weight = whole * (1.0 + skew * (self.charge_c + drawn));
            let error =
                (start + drawn) * elastance + voltage * weight + drag * drawn - branch.input_v;
            self.next.sum_v = voltage;
            self.next.tangent = tangent;
            if error.abs() <= TOLERANCE_V {
                break;
            }
            drawn -= error / (elastance + tangent * weight + whole * skew * voltage + drag);
        }
        self.next.charge_c = self.charge_c + drawn;
        self.next.scale = scale;
        (start + drawn) * elastance
    }

    #[inline]
    fn commit(&mut self) {
        let Trial { charge_c, scale, tangent, sum_v } = self.next;
        let drawn = charge_c - self.charge_c;
        if !self.goes_on(drawn, scale) {
            self.stop_slipping();
            self.sign = if drawn >= 0.0 { 1.0 } else { -1.0 };
        }
        for group in &mut self.groups[self.slipping..self.holding] {
            for lane in 0..LANES {
                group.z_c[lane] = clamp(group.z_c[lane] + drawn, group.slip_c[lane] * scale);
            }
        }
        let sign = self.sign;
        let slips = |group: &Group| {
            (0..LANES).all(|lane| group.z_c[lane] * sign >= group.slip_c[lane] * scale)
        };
        while self.slipping < self.holding && slips(&self.groups[self.slipping]) {
            self.slipping += 1;
        }
        self.pace_c = drawn.abs().max(PACE * self.pace_c);
        (self.charge_c, self.scale, self.tangent, self.sum_v) = (charge_c, scale, tangent, sum_v);
    }
}

#[inline]
fn clamp(free: f64, limit: f64) -> f64 {
    let below = if free < limit { free } else { limit };
    if below > -limit { below } else { -limit }
}
