//! Voltage that a stack's ferroelectric hysteresis takes from the drive, as a function of the charge's history.
//!
//! Five classes of operator. The nominal one is a sum of plays (the dual of the slip elements of Goldfarb and Celanovic,
//! IEEE Control Systems 17(3), 1997); the others stand for stacks that are not built like the model: many uneven and
//! one-sided plays (generalised Prandtl-Ishlinskii), a Bouc-Wen loop, a Preisach operator in Everett form,
//! and a Bouc-Wen loop beside plays.

use rand::{Rng, RngExt};

use crate::rig::Axis;

/// One play of half-width `width_c` (C) and slope `slope` (V/C); `skew` makes the way down wider than the way up.
#[derive(Clone, Debug)]
struct Play {
    slope: f64,
    up_c: f64,
    down_c: f64,
    center_c: f64,
}

/// A hysteresis with its memory.
#[derive(Clone, Debug)]
pub struct Hysteresis {
    class: Class,
    charge_c: f64,
}

#[derive(Clone, Debug)]
enum Class {
    Plays(Vec<Play>),
    /// `z` in -1 to 1; voltage `height_v` z, initial slope `height_v / width_c`, exponent, and pinching of the loop's way back.
    BoucWen {
        height_v: f64,
        width_c: f64,
        exponent: f64,
        back: f64,
        z: f64,
    },
    Preisach(Preisach),
    /// Several, whose voltages add up.
    Sum(Vec<Class>),
}

impl Class {
    /// Voltage (V) and slope (V/C) if the charge went from `last` to `q`.
    fn at(&self, q: f64, last: f64) -> (f64, f64) {
        match self {
            Self::Plays(plays) => {
                let (mut voltage, mut slope) = (0.0, 0.0);
                for play in plays {
                    let stretch = q - play.center_c;
                    let held = stretch.clamp(-play.down_c, play.up_c);
                    voltage += play.slope * held;
                    slope += if held == stretch { play.slope } else { 0.0 };
                }
                (voltage, slope)
            }
            &Self::BoucWen { height_v, width_c, exponent, back, z } => {
                let slope = bouc_wen_slope(z, q - last, width_c, exponent, back);
                (height_v * (z + slope * (q - last)), height_v * slope)
            }
            Self::Preisach(operator) => operator.at(q, last),
            Self::Sum(classes) => classes.iter().fold((0.0, 0.0), |sum, class| {
                let (voltage, slope) = class.at(q, last);
                (sum.0 + voltage, sum.1 + slope)
            }),
        }
    }

    /// Moves from charge `last` to `q`.
    fn commit(&mut self, q: f64, last: f64) {
        match self {
            Self::Plays(plays) => {
                for play in plays {
                    play.center_c = play.center_c.clamp(q - play.up_c, q + play.down_c);
                }
            }
            Self::BoucWen { width_c, exponent, back, z, .. } => {
                let slope = bouc_wen_slope(*z, q - last, *width_c, *exponent, *back);
                *z = (*z + slope * (q - last)).clamp(-1.0, 1.0);
            }
            Self::Preisach(operator) => operator.commit(q, last),
            Self::Sum(classes) => classes.iter_mut().for_each(|class| class.commit(q, last)),
        }
    }

    /// Back to the virgin curve.
    fn forget(&mut self) {
        match self {
            Self::Plays(plays) => plays.iter_mut().for_each(|play| play.center_c = 0.0),
            Self::BoucWen { z, .. } => *z = 0.0,
            Self::Preisach(operator) => {
                operator.turns.clear();
                operator.rising = true;
                operator.voltage_v = 0.0;
            }
            Self::Sum(classes) => classes.iter_mut().for_each(Self::forget),
        }
    }
}

/// Preisach operator by its Everett function E(d, m): rise of the voltage after a reversal, over the distance d from it.
#[derive(Clone, Debug)]
struct Preisach {
    height_v: f64,
    width_c: f64,
    skew_per_c: f64,
    /// Reversals (charge, voltage), oldest first; the last one is where the present branch began.
    turns: Vec<(f64, f64)>,
    rising: bool,
    voltage_v: f64,
}

impl Preisach {
    /// Voltage and slope at charge `q` on the branch that began at the last turn.
    fn branch(&self, turns: &[(f64, f64)], q: f64) -> (f64, f64) {
        let (from, start) = turns.last().copied().unwrap_or((0.0, 0.0));
        let distance = (q - from).abs();
        let middle = 1.0 + self.skew_per_c * 0.5 * (q + from);
        // Steep at first, then saturating: E = 2 h d / (d + 2 w), the way a Maxwell sum with decreasing stiffness goes.
        let scale = distance + 2.0 * self.width_c;
        let rise = 2.0 * self.height_v * distance / scale;
        let slope = 4.0 * self.height_v * self.width_c / (scale * scale);
        let sign = if q >= from { 1.0 } else { -1.0 };
        (start + sign * rise * middle, slope * middle + sign * rise * self.skew_per_c * 0.5)
    }

    fn at(&self, q: f64, last: f64) -> (f64, f64) {
        let rising = if q == last { self.rising } else { q > last };
        let mut turns = self.turns.as_slice();
        let turned;
        if rising != self.rising {
            turned = [turns, &[(last, self.voltage_v)]].concat();
            turns = &turned;
        }
        self.branch(left(turns, rising, q), q)
    }

    fn turn(&mut self, at: f64) {
        self.turns.push((at, self.voltage_v));
        self.rising = !self.rising;
    }

    fn commit(&mut self, q: f64, last: f64) {
        if q == last {
            return;
        }
        if (q > last) != self.rising {
            self.turn(last);
        }
        self.turns.truncate(left(&self.turns, self.rising, q).len());
        self.voltage_v = self.branch(&self.turns, q).0;
        // A memory of 64 nested reversals is beyond what any excitation here writes; the innermost ones are the smallest.
        if self.turns.len() > 64 {
            self.turns.drain(1..3);
        }
    }
}

/// Wiping out: passing an earlier extremum closes the minor loop and continues the branch before it.
fn left(mut turns: &[(f64, f64)], rising: bool, q: f64) -> &[(f64, f64)] {
    while turns.len() >= 3 {
        let earlier = turns[turns.len() - 2].0;
        if (rising && q <= earlier) || (!rising && q >= earlier) {
            break;
        }
        turns = &turns[..turns.len() - 2];
    }
    turns
}

impl Hysteresis {
    /// The nominal stack's: a play for each slip element.
    pub fn nominal(axis: &Axis) -> Self {
        Self { class: Class::Plays(nominal_plays(axis)), charge_c: 0.0 }
    }

    /// Many plays with uneven widths and slopes, optionally wider on the way down: the sum is `size` times the nominal height
    /// where every play slips.
    pub fn uneven(axis: &Axis, size: f64, skew: f64, rng: &mut impl Rng) -> Self {
        let (height, widest) = envelope(axis);
        let count = rng.random_range(20..60);
        let bend: f64 = rng.random_range(-0.6..0.6);
        let mut plays = Vec::new();
        for index in 0..count {
            let along = (f64::from(index) + rng.random_range(0.2..0.8)) / f64::from(count);
            let width = widest * along.powf(1.0 + bend.abs()) + 1e-8;
            // Weight of the voltage limits: more in small or in large plays.
            let weight = 1.0 + bend * (2.0 * along - 1.0);
            plays.push((width, weight * along));
        }
        let sum: f64 = plays.iter().map(|(_, weight)| weight).sum();
        let plays = plays.into_iter().map(|(width, weight)| {
            let limit = size * height * weight / sum;
            Play {
                slope: limit / width,
                up_c: width * (1.0 - skew),
                down_c: width * (1.0 + skew),
                center_c: 0.0,
            }
        });
        Self { class: Class::Plays(plays.collect()), charge_c: 0.0 }
    }

    /// Bouc-Wen loop whose height is `size` times the nominal one.
    pub fn bouc_wen(axis: &Axis, size: f64, rng: &mut impl Rng) -> Self {
        let (height, widest) = envelope(axis);
        let class = Class::BoucWen {
            height_v: size * height,
            width_c: widest * rng.random_range(0.4..0.7),
            exponent: rng.random_range(0.8..1.3),
            back: rng.random_range(0.5..0.95),
            z: 0.0,
        };
        Self { class, charge_c: 0.0 }
    }

    /// Preisach operator (Everett form) whose height is `size` times the nominal one.
    pub fn preisach(axis: &Axis, size: f64, rng: &mut impl Rng) -> Self {
        let (height, widest) = envelope(axis);
        let operator = Preisach {
            height_v: 1.3 * size * height,
            width_c: widest * rng.random_range(0.35..0.6),
            skew_per_c: rng.random_range(-0.15..0.15) / 2e-4,
            turns: vec![(0.0, 0.0)],
            rising: true,
            voltage_v: 0.0,
        };
        Self { class: Class::Preisach(operator), charge_c: 0.0 }
    }

    /// A Bouc-Wen loop in place of this share of the nominal elements, which stay as they are otherwise.
    pub fn partly_wen(axis: &Axis, share: f64, rng: &mut impl Rng) -> Self {
        let mut plays = nominal_plays(axis);
        plays.iter_mut().for_each(|play| play.slope *= 1.0 - share);
        let (height, widest) = envelope(axis);
        let loop_beside = Class::BoucWen {
            height_v: share * height * rng.random_range(0.8..1.3),
            width_c: widest * rng.random_range(0.3..0.7),
            exponent: rng.random_range(1.0..2.2),
            back: rng.random_range(0.4..0.9),
            z: 0.0,
        };
        Self { class: Class::Sum(vec![Class::Plays(plays), loop_beside]), charge_c: 0.0 }
    }

    /// Voltage (V) and slope (V/C) if the charge went to `q` now.
    pub fn at(&self, q: f64) -> (f64, f64) {
        self.class.at(q, self.charge_c)
    }

    /// Moves to charge `q` and remembers it.
    pub fn commit(&mut self, q: f64) {
        self.class.commit(q, self.charge_c);
        self.charge_c = q;
    }

    /// Charge now (C).
    pub fn charge_c(&self) -> f64 {
        self.charge_c
    }

    /// Back to the virgin curve.
    fn forget(&mut self) {
        self.charge_c = 0.0;
        self.class.forget();
    }

    /// Leaves a random memory: what an unknown past between -0.1 and 1 of the charge `top_c` (C) has written.
    pub fn scramble(&mut self, top_c: f64, rng: &mut impl Rng) {
        self.forget();
        let mut swing = top_c;
        while swing > 0.01 * top_c {
            let q = swing * rng.random_range(-0.1..1.0);
            // In small steps: the Bouc-Wen state is a differential one.
            let from = self.charge_c;
            for step in 1..=200 {
                self.commit(from + (q - from) * f64::from(step) / 200.0);
            }
            swing *= rng.random_range(0.3..0.9);
        }
    }
}

/// A play for each slip element.
fn nominal_plays(axis: &Axis) -> Vec<Play> {
    let play = |&(capacitance, limit): &(f64, f64)| {
        let half = capacitance * limit;
        Play { slope: 1.0 / capacitance, up_c: half, down_c: half, center_c: 0.0 }
    };
    axis.slip.iter().map(play).collect()
}

fn bouc_wen_slope(z: f64, dq: f64, width_c: f64, exponent: f64, back: f64) -> f64 {
    // gamma + beta = 1 keeps |z| <= 1; on the way back (z dq < 0) the loop opens with slope 1 + (beta - gamma) |z|^n.
    let magnitude = z.abs().powf(exponent);
    let factor = if z * dq >= 0.0 { 1.0 - magnitude } else { 1.0 + (2.0 * back - 1.0) * magnitude };
    factor.max(0.0) / width_c
}

/// Height (V) of the nominal loop's flank and charge (C) at which every element slips.
fn envelope(axis: &Axis) -> (f64, f64) {
    let height = axis.slip.iter().map(|slip| slip.1).sum();
    let widest = axis.slip.iter().map(|slip| slip.0 * slip.1).fold(0.0, f64::max);
    (height, widest)
}
