//! Creep of a held position, in the form in which the controller compensates it.
//!
//! After a step a stack goes on growing with the logarithm of time (Vieira 1986; Jung and Gweon 2000: 1 to 2 % a decade). The controller's
//! form is a chain of Kelvin-Voigt elements of equal gain a decade apart, `x = e + c sum z_j`, `tau_j z_j' = e - z_j`
//! ([`host_sim::tuning::log_creep`]): with `z` computed from the whole motion before, `c` is a line through the held stretch.

use host_sim::tuning;

use super::series::Series;

/// Shortest hold that says something, s: from [`FROM_S`] on a decade.
const HOLD_S: f64 = 2.2;
/// Before this time the amplifier, the mechanism and the onset of creep are still in it, s.
const FROM_S: f64 = 0.2;
/// The drive counts as held within this share of its span.
const HELD: f64 = 0.002;
/// A step is at least this share of the drive's span ...
const STEP: f64 = 0.1;
/// ... within this time, s.
const STEP_S: f64 = 0.5;
/// Stretches that follow on each other within this time have nothing in between, s.
const SAME_S: f64 = 0.02;
/// The chain is driven by what is left without creep: again and again with the creep found.
const ROUNDS: usize = 6;

/// Kelvin-Voigt chain that follows a motion.
pub(super) struct Chain {
    per_decade: f64,
    /// Time constant (s) and strain, in um of elastic motion.
    strains: Vec<(f64, f64)>,
}

impl Chain {
    /// For growth by `per_decade`, with these strains (um) to start from.
    pub fn new(per_decade: f64, strains_um: &[f64]) -> Self {
        let times = tuning::log_creep(1.0, 0.0).map(|e| f64::from(e.time_constant_s));
        Self { per_decade, strains: times.zip(strains_um.iter().copied()).collect() }
    }

    /// The strains, um of elastic motion, after the chain was at a position for ever.
    pub fn settled_um(um: f64) -> Vec<f64> {
        tuning::log_creep(1.0, 0.0).map(|_| um).collect()
    }

    /// The strains, um of elastic motion.
    pub fn strains_um(&self) -> Vec<f64> {
        self.strains.iter().map(|(_, z)| *z).collect()
    }

    /// Sum of the strains, before the gain.
    pub fn strain_um(&self) -> f64 {
        self.strains.iter().map(|(_, z)| z).sum()
    }

    /// What of a position is not creep; then it is held there for a time.
    pub fn elastic(&mut self, um: f64, lasts_s: f64) -> f64 {
        let elastic = um - self.per_decade * self.strain_um();
        for (tau_s, z) in &mut self.strains {
            *z -= (-lasts_s / *tau_s).exp_m1() * (elastic - *z);
        }
        elastic
    }
}

/// Let the strains run on from stretch to stretch on the session's clock; in between the drives are at 0 V. Where the clock does
/// not tell of a before, the first position was held for ever.
pub(super) fn remember(series: &mut [Series]) {
    let mut before: Option<(Chain, f64)> = None;
    for series in series {
        let (_, position, row_s) = series.rows();
        let Some(&first) = position.first() else { continue };
        let mut chain = match before.take() {
            Some((mut chain, end_s)) if series.start_s >= end_s - SAME_S => {
                if series.start_s > end_s + SAME_S {
                    chain.elastic(0.0, series.start_s - end_s);
                }
                chain
            }
            _ => Chain::new(0.0, &Chain::settled_um(first)),
        };
        series.strains_um = chain.strains_um();
        position.iter().for_each(|&um| {
            chain.elastic(um, row_s);
        });
        let length_s = series.drive_v.len() as f64 / series.rate_hz;
        before = Some((chain, series.start_s + length_s));
    }
}

/// Creep that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Creep {
    /// Growth a decade of time, over the stroke.
    pub per_decade: f64,
    /// Its standard error.
    pub sd: f64,
    /// Length of the held stretch, s.
    pub held_s: f64,
}

/// Creep from the longest stretch of the session in which the drive is held after a step.
pub(super) fn creep(series: &[Series], span_v: f64) -> Option<Creep> {
    let (mut longest, mut best) = (0.0, None);
    for series in series {
        let (drive, position, row_s) = series.rows();
        for (from, to) in holds(&drive, row_s, span_v) {
            let held_s = (to - from) as f64 * row_s;
            if held_s > longest {
                longest = held_s;
                best = Some((position.clone(), &series.strains_um, row_s, from, to));
            }
        }
    }
    let (position, strains_um, row_s, from, to) = best?;
    let start = from + (FROM_S / row_s).round() as usize;
    let (mut per_decade, mut sd) = (0.0, 0.0);
    for _ in 0..ROUNDS {
        let mut chain = Chain::new(per_decade, strains_um);
        let strains: Vec<f64> = position[..to]
            .iter()
            .map(|x| {
                let strain = chain.strain_um();
                chain.elastic(*x, row_s);
                strain
            })
            .collect();
        // Rows are even in time; in the logarithm late ones crowd, so each counts by its share of a decade.
        let rows: Vec<(f64, f64, f64)> =
            (start..to).map(|n| (1.0 / (n - from) as f64, strains[n], position[n])).collect();
        (per_decade, sd) = line(&rows);
    }
    Some(Creep { per_decade, sd, held_s: longest })
}

/// Slope of rows (weight, x, y), and its standard error.
fn line(rows: &[(f64, f64, f64)]) -> (f64, f64) {
    let mean = |f: &dyn Fn(&(f64, f64, f64)) -> f64| {
        rows.iter().map(|r| r.0 * f(r)).sum::<f64>() / rows.iter().map(|r| r.0).sum::<f64>()
    };
    let (mx, my) = (mean(&|r| r.1), mean(&|r| r.2));
    let sxx = mean(&|r| (r.1 - mx).powi(2));
    if sxx <= 0.0 {
        return (0.0, f64::INFINITY);
    }
    let slope = mean(&|r| (r.1 - mx) * (r.2 - my)) / sxx;
    let left = mean(&|r| (r.2 - my - slope * (r.1 - mx)).powi(2));
    // What is left is a drift rather than noise: it counts as ten independent values, not as thousands.
    (slope, (left / sxx / 10.0).sqrt())
}

/// Stretches (rows) in which the drive is held after a step.
fn holds(drive: &[f64], row_s: f64, span_v: f64) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let before = (STEP_S / row_s).ceil() as usize;
    let mut from = 0;
    while from < drive.len() {
        let held = |v: &f64| (v - drive[from]).abs() <= HELD * span_v;
        let to = from + drive[from..].iter().take_while(|v| held(v)).count();
        let is_long = (to - from) as f64 * row_s >= HOLD_S;
        let after_step = drive[from.saturating_sub(before)..from]
            .iter()
            .any(|v| (v - drive[from]).abs() >= STEP * span_v);
        if is_long && after_step {
            found.push((from, to));
        }
        from = if is_long { to } else { from + 1 };
    }
    found
}
