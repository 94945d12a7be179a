//! Elements that give way before they slip: the loops of a stack that forgets, where small cycles pull the memory to their middle.
//!
//! An element of Maxwell's kind holds until it slips. Here it follows the charge by less the more it is stretched,
//! `dz = dq (1 - y sgn(dq) z / slip)` with the yield `y` from 0 to 1, and slips at `|z| = slip` as before: Dahl's law of solid
//! friction (P. R. Dahl, "A solid friction model", Aerospace Corp. TOR-0158(3107-18)-1, 1968), of which a slip element
//! (`y = 0`) is one end. Loops become rounder, a reversal begins steeper than the virgin curve, and minor loops do not close where
//! they began: what is called accommodation in magnets (E. Della Torre, "Magnetic Hysteresis", IEEE Press 1999, chapter 5).
//!
//! On the way back, while `sgn(dq) z < 0`, the yield is `r y` with the recoil `r` from 0 to 1: one is Dahl's law, none lets an element come
//! back as it went before it gave way. With a yield of one that is the law of Bouc and Wen with an exponent of one, whose beta and gamma are
//! `(1 + r) / 2` and `(1 - r) / 2` (Y. K. Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. Div. ASCE 102(2), 1976); its usual choice
//! of both the same has no recoil.
//!
//! Over a tick the law is solved by its (1,1) Pade form, which is exact to the third order in the charge drawn over the slip charge,
//! and stays between `z` and the slip limit for any charge. The step in which an element comes through zero takes the yield of where it
//! began, which is an error of the second order in the charge of one step, once a reversal.

use super::wen::{Wen, WenLoop};
use super::{Branch, SlipElements};

/// Residual at which the charge is found, V (about 1e-18 m).
const TOLERANCE_V: f64 = 1.0e-11;
/// Error of a voltage that is taken for rounding, of that voltage.
const ROUNDING: f64 = 4.0e-15;
/// Most by which a first tangent is expected to fall short.
const MOST_SHORT: f64 = 1.5;
/// Elements done at once.
const LANES: usize = 4;
/// Slip charge of the lanes that are left over, C: more than any stack draws.
const NEVER_C: f64 = 1.0e3;

/// State and parameters of the elements of one stack. Element i stands at `z_i` coulombs, `|z_i| <= scale slip_i`.
#[derive(Debug, Clone)]
pub struct Yielding {
    groups: Vec<Group>,
    /// A loop of another law beside them, the last of the voltages.
    beside: Option<Wen>,
    count: usize,
    charge_c: f64,
    /// Factor on the slip charges now.
    scale: f64,
    sum_v: f64,
    /// Slopes if the charge falls or rises from here, V/C.
    tangents: [f64; 2],
    /// Share of the yield on the way back.
    recoil: f64,
    /// Whether it rose last.
    rising: bool,
    /// Charge drawn in the tick before, in units of what its first tangent led to.
    short: f64,
    next: Trial,
}

/// The end of a tick as last solved; where the elements then stand is in their groups.
#[derive(Debug, Clone, Copy, Default)]
struct Trial {
    drawn_c: f64,
    scale: f64,
    sum_v: f64,
    short: f64,
}

#[derive(Debug, Clone, Copy)]
struct Group {
    slip_c: [f64; LANES],
    slope: [f64; LANES],
    /// Yield over slip charge, 1/C.
    give: [f64; LANES],
    z_c: [f64; LANES],
    next_z_c: [f64; LANES],
}

impl Group {
    const NONE: Self = Self {
        slip_c: [NEVER_C; LANES],
        slope: [0.0; LANES],
        give: [0.0; LANES],
        z_c: [0.0; LANES],
        next_z_c: [0.0; LANES],
    };

    /// Sum of the voltages (V) and slopes (V/C) after drawing `drawn` coulombs, which is `far` without its sign.
    #[inline(always)]
    fn draw(
        &mut self,
        (drawn, far, sign): (f64, f64, f64),
        (scale, recoil): (f64, f64),
    ) -> (f64, f64) {
        let (mut volts, mut slope) = ([0.0; LANES], [0.0; LANES]);
        // A yield shares the slip charge's factor.
        let soft = 1.0 / scale;
        for lane in 0..LANES {
            let slip = self.slip_c[lane] * scale;
            let back = if sign * self.z_c[lane] < 0.0 { recoil } else { 1.0 };
            let give = self.give[lane] * soft * back;
            let half = 0.5 * give * far;
            let inverse = 1.0 / (1.0 + half);
            let free = (self.z_c[lane] * (1.0 - half) + drawn) * inverse;
            let below = if free < slip { free } else { slip };
            let held = if below > -slip { below } else { -slip };
            self.next_z_c[lane] = held;
            volts[lane] = self.slope[lane] * held;
            let steep = (1.0 - sign * give * self.z_c[lane]) * inverse * inverse;
            slope[lane] = if held == free { self.slope[lane] * steep } else { 0.0 };
        }
        (
            (volts[0] + volts[1]) + (volts[2] + volts[3]),
            (slope[0] + slope[1]) + (slope[2] + slope[3]),
        )
    }

    /// Slopes if the charge falls and rises from where it stands, V/C.
    #[inline(always)]
    fn tangents(&self, scale: f64, recoil: f64) -> [f64; 2] {
        let (mut down, mut up) = ([0.0; LANES], [0.0; LANES]);
        let soft = 1.0 / scale;
        for lane in 0..LANES {
            let (z, slip) = (self.z_c[lane], self.slip_c[lane] * scale);
            let bent = self.give[lane] * soft * z;
            let back = bent * recoil;
            let (rise, fall) = if z < 0.0 { (back, bent) } else { (bent, back) };
            up[lane] = if z < slip { self.slope[lane] * (1.0 - rise) } else { 0.0 };
            down[lane] = if z > -slip { self.slope[lane] * (1.0 + fall) } else { 0.0 };
        }
        [(down[0] + down[1]) + (down[2] + down[3]), (up[0] + up[1]) + (up[2] + up[3])]
    }
}

impl Yielding {
    /// Elements from slopes (V/C), limits (V), the yield and the recoil (both 0 to 1), and a loop beside them, virgin.
    pub fn new(
        slopes: &[f64],
        limits: &[f64],
        (share, recoil): (f64, f64),
        beside: Option<WenLoop>,
    ) -> Self {
        let mut groups = vec![Group::NONE; slopes.len().div_ceil(LANES)];
        for (i, (&slope, &limit)) in slopes.iter().zip(limits).enumerate() {
            // An element without a slope or a limit holds nothing, whatever its slip charge.
            if slope > 0.0 && limit > 0.0 {
                let (group, lane) = (&mut groups[i / LANES], i % LANES);
                group.slip_c[lane] = limit / slope;
                group.slope[lane] = slope;
                group.give[lane] = share.clamp(0.0, 1.0) * slope / limit;
            }
        }
        let mut made = Self {
            groups,
            beside: beside.map(Wen::new),
            count: slopes.len(),
            charge_c: 0.0,
            scale: 1.0,
            sum_v: 0.0,
            tangents: [0.0; 2],
            recoil: recoil.clamp(0.0, 1.0),
            rising: true,
            short: 1.0,
            next: Trial::default(),
        };
        made.look_around();
        made
    }

    /// Voltages of the elements in the order in which they were given, V.
    pub fn voltages(&self) -> Vec<f64> {
        let volts =
            |group: &Group| std::array::from_fn::<f64, LANES, _>(|l| group.slope[l] * group.z_c[l]);
        let beside = self.beside.iter().map(Wen::voltage_v);
        self.groups.iter().flat_map(volts).take(self.count).chain(beside).collect()
    }

    /// Sum of the element voltages, V.
    pub fn sum_v(&self) -> f64 {
        self.sum_v
    }

    /// Put the elements where `voltage_of(slope, limit, index)` says, held inside their limits.
    pub fn set_voltages(&mut self, voltage_of: impl Fn(f64, f64, usize) -> f64) {
        for (at, group) in self.groups.iter_mut().enumerate() {
            for lane in 0..LANES {
                let (slope, slip) = (group.slope[lane], group.slip_c[lane]);
                let limit = slope * slip;
                let volts = voltage_of(slope, limit, at * LANES + lane).clamp(-limit, limit);
                group.z_c[lane] = if slope > 0.0 { volts / slope } else { 0.0 };
            }
        }
        if let Some(beside) = &mut self.beside {
            beside.set_voltage(|slope, limit| voltage_of(slope, limit, self.count));
        }
        (self.scale, self.rising, self.short) = (1.0, true, 1.0);
        self.sum_v = self.voltages().iter().sum();
        self.look_around();
    }

    /// Say what charge the present state belongs to, C.
    pub fn set_charge(&mut self, charge_c: f64) {
        self.charge_c = charge_c;
    }

    /// Tangents where the elements stand.
    #[inline]
    fn look_around(&mut self) {
        let mut tangents = [0.0; 2];
        for group in &self.groups {
            let [down, up] = group.tangents(self.scale, self.recoil);
            tangents = [tangents[0] + down, tangents[1] + up];
        }
        if let Some(beside) = &self.beside {
            let [down, up] = beside.tangents(self.scale);
            tangents = [tangents[0] + down, tangents[1] + up];
        }
        self.tangents = tangents;
    }

    /// Sum of the voltages and slopes after drawing `drawn` coulombs in the direction of `sign`.
    #[inline]
    fn draw(&mut self, drawn: f64, sign: f64, scale: f64) -> (f64, f64) {
        let step = (drawn, drawn.abs(), sign);
        let mut sums = (0.0, 0.0);
        for group in &mut self.groups {
            let (volts, slope) = group.draw(step, (scale, self.recoil));
            sums = (sums.0 + volts, sums.1 + slope);
        }
        if let Some(beside) = &mut self.beside {
            let (volts, slope) = beside.draw(step, scale);
            sums = (sums.0 + volts, sums.1 + slope);
        }
        sums
    }
}

impl SlipElements for Yielding {
    #[inline]
    fn tangent_v_per_c(&self) -> f64 {
        self.tangents[usize::from(self.rising)]
    }

    #[inline]
    fn tangent_towards(&self, rising: bool) -> f64 {
        self.tangents[usize::from(rising)]
    }

    #[inline]
    fn charge_c(&self) -> f64 {
        self.charge_c
    }

    #[inline]
    fn drawn_c(&self) -> f64 {
        self.next.drawn_c
    }

    fn solve(&mut self, branch: &Branch) -> f64 {
        let elastance = 1.0 / branch.capacitance_f;
        let start = self.charge_c - branch.charge_at_zero_c;
        let (skew, drag, scale) = (branch.skew_per_c, branch.drag_v_per_c, branch.limit_scale);
        let whole = branch.sum_scale;
        // All of it rises with the charge, so the error where it is tells the direction. From there the elements only give way:
        // tangents stay short of the answer.
        let weight_at = |charge: f64| whole * (1.0 + skew * charge);
        let still = scale == self.scale;
        let mut sum = if still { self.sum_v } else { self.draw(0.0, 1.0, scale).0 };
        let mut error = start * elastance + sum * weight_at(self.charge_c) - branch.input_v;
        let sign = if error <= 0.0 { 1.0 } else { -1.0 };
        let mut slope = if still {
            self.tangents[usize::from(sign > 0.0)]
        } else {
            self.draw(0.0, sign, scale).1
        };
        let (mut drawn, mut weight) = (0.0, weight_at(self.charge_c));
        let mut moved = !still;
        let mut first = 0.0;
        for _ in 0..100 {
            // A simulation that runs away is not followed to the last digit, nor one that is no number.
            let small = TOLERANCE_V.max(ROUNDING * (start + drawn).abs() * elastance);
            if error.is_nan() || error.abs() <= small {
                break;
            }
            let tangent = elastance + slope * weight + whole * skew * sum + drag;
            let next = drawn - error / tangent;
            // Only a strong skew bends it the other way.
            drawn = if next * sign >= 0.0 { next } else { 0.5 * drawn };
            if first == 0.0 {
                // The first tangent falls short by about as much as it did in the tick before.
                first = drawn;
                drawn *= if (sign > 0.0) == self.rising { self.short } else { 1.0 };
            }
            (sum, slope) = self.draw(drawn, sign, scale);
            weight = weight_at(self.charge_c + drawn);
            error = (start + drawn) * elastance + sum * weight + drag * drawn - branch.input_v;
            moved = true;
        }
        if !moved {
            self.draw(0.0, sign, scale);
        }
        let short = if first == 0.0 { 1.0 } else { (drawn / first).clamp(1.0, MOST_SHORT) };
        self.next = Trial { drawn_c: drawn, scale, sum_v: sum, short };
        (start + drawn) * elastance
    }

    #[inline]
    fn commit(&mut self) {
        let Trial { drawn_c, scale, sum_v, short } = self.next;
        if drawn_c != 0.0 {
            self.rising = drawn_c > 0.0;
        }
        for group in &mut self.groups {
            group.z_c = group.next_z_c;
        }
        if let Some(beside) = &mut self.beside {
            beside.commit();
        }
        self.charge_c += drawn_c;
        (self.scale, self.sum_v, self.short) = (scale, sum_v, short);
        self.look_around();
    }
}
