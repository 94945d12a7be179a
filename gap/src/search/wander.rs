//! Drift without a period, and hum of a grid whose frequency sways.
//!
//! A gauge may drift to an end, to and fro, or as chance has it; a grid's frequency is 50 Hz to some hundredths, which is a turn in a minute. Both are
//! walks of as many numbers as they have turns, with which an effect makes up for much that it is not. So they are tried where the plain effect is by
//! itself, and have to leave far less.

use std::f64::consts::{PI, TAU};

use host_sim::effects::Parameter;
use host_sim::effects::walk::Walk;
use nalgebra::{DMatrix, DVector};

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::knobs::{AHEAD, WANDER_S, WANDERS, axes_seen};
use crate::fitting::model::{Model, Term};
use crate::judge::accept;
use crate::search::prune::HUM;
use crate::search::select::{CLOSED, Search};
use crate::search::worth::WORTH_ABSOLUTE;
use crate::session::energy::Energies;
use crate::session::floor::Kind;
use crate::session::scene::{Channel, Stack};
use crate::session::spectra::{Envelope, envelope};

/// The effect that drifts.
pub(crate) const DRIFT: &str = "sensor-drift";
/// Share of the gap that a plain drift leaves at most.
const MOST: f64 = 0.9;
/// Share of what the plain effect leaves that one which wanders may leave at most.
const MUCH_LESS: f64 = 0.3;
/// ... and share of it, by cost, that one which leaves that little of the positions has to take off.
const LESS: f64 = 0.1;
/// Parts of a session, as many as a drift has terms, in which a jump is over, and the share of the squares of all changes that it has.
const JUMP: usize = 3;
const MOST_IN_A_JUMP: f64 = 0.8;
/// Iterations of the fit of a drift, which is linear in its sizes, and of a hum.
const ITERATIONS: [usize; 2] = [3, 8];
/// Phase that a recording is taken to tell to, turns.
const TOLD_TURNS: f64 = 0.01;
/// Length of a block in which a phase is told, in periods and s: a window over it keeps other frequencies out.
const PERIODS: f64 = 8.0;
const SHORTEST_S: f64 = 0.2;
/// Size of a block that is listened to, as a multiple of most blocks': short ones, and those where the stage moves, tell another phase.
const LIKE: std::ops::Range<f64> = 0.5..2.0;
/// Time over which the speed of a phase is told, and the least that tells one, s.
const GOES_ON_S: f64 = 2.0;
const TELLS_SPEED_S: f64 = 0.8;

/// Whether a drift with these values at its places goes without a period anywhere.
pub(crate) fn drifts_freely(term: &Term, values: &[f64]) -> bool {
    term.name() == DRIFT && has_any(term, values, &WANDERS)
}

/// Whether an effect with these values at its places goes without a period anywhere: a drift, or the phase of a hum.
pub(crate) fn wanders(term: &Term, values: &[f64]) -> bool {
    drifts_freely(term, values) || has_any(term, values, &AHEAD)
}

/// Whether some of these parameters are not zero at some place.
fn has_any(term: &Term, values: &[f64], names: &[&str]) -> bool {
    let parameters = term.effect.info().parameters;
    let is_one = |(p, value): (&Parameter, &f64)| names.contains(&p.name) && *value != p.zero;
    values.chunks(parameters.len()).any(|here| parameters.iter().zip(here).any(is_one))
}

impl Search<'_> {
    /// `model` of a drift or a hum alone, or the same as it wanders, if that leaves much less.
    pub(crate) fn wandering(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let [term] = model.terms.as_slice() else { return Ok(model) };
        // Other axes may lack something else.
        let places = term.places.iter();
        let mask = places.fold(0, |mask, &p| mask | axes_seen(self.nominal, term.effect, p));
        let gap = self.left_on(&self.base, mask);
        let left = self.left_on(&model.fit.stack, mask);
        if left < CLOSED * gap {
            return Ok(model);
        }
        let (start, iterations) = if term.name() == DRIFT && left < MOST * gap {
            (self.begun_to_drift(term), ITERATIONS[0])
        } else if term.name().ends_with(HUM) {
            (self.begun_to_sway(&model)?, ITERATIONS[1])
        } else {
            return Ok(model);
        };
        let line = model.fit.cost - (1.0 - MUCH_LESS) * left;
        let effort = Effort { iterations, hopeless: f64::INFINITY, ..effort };
        let other = self.fit_model(model.terms.clone(), start, effort)?;
        let is_less = other.fit.cost < line || self.drifts_by_much(&model, &other, mask)?;
        let is_there = is_less && self.goes_on(&other);
        Ok(if is_there { other } else { model })
    }

    /// Whether a drift that wanders takes most of what a plain one leaves of the positions of the axes in `mask`, or may be named there where the
    /// plain one, which has one law, may not. By cost one that goes as chance has it does neither: gauges that drift at rest have that in their
    /// noise, against which slow differences count for little.
    fn drifts_by_much(&self, plain: &Model, wandering: &Model, mask: u32) -> Result<bool, Error> {
        let saved = plain.fit.cost - wandering.fit.cost;
        if !self.ranges.chance_drift
            || wandering.terms[0].name() != DRIFT
            || saved < WORTH_ABSOLUTE.max(LESS * self.left_on(&plain.fit.stack, mask))
        {
            return Ok(false);
        }
        let include = |c: &Channel| (self.include)(c);
        let raw = |rig| self.scene.raw(rig, include);
        let [gap, plain, wandering] =
            [raw(self.nominal)?, raw(&plain.fit.rig)?, raw(&wandering.fit.rig)?];
        let axes = self.nominal.axes.len();
        let is_everywhere = |[before, after]: [&Stack; 2], is_enough: &dyn Fn(f64) -> bool| {
            let energies = Energies::new(self.scene, before, after, &include);
            let closed = accept::closed_by_axis(&energies, axes).into_iter().enumerate();
            let mut here = closed.filter(|(axis, _)| mask >> axis & 1 == 1);
            here.all(|(_, closed)| closed.is_none_or(is_enough))
        };
        Ok(is_everywhere([&plain, &wandering], &|closed| closed > 1.0 - MUCH_LESS)
            || (is_everywhere([&gap, &wandering], &accept::names)
                && !is_everywhere([&gap, &plain], &accept::names_of_one_law)))
    }

    /// Whether a drift goes on, on some axis: one that jumps once and stays is an offset that something before it hid.
    fn goes_on(&self, model: &Model) -> bool {
        let term = &model.terms[0];
        let parameters = term.effect.info().parameters;
        let goes_on = |here: &[f64]| {
            let sizes = parameters.iter().zip(here).filter(|(p, _)| WANDERS.contains(&p.name));
            let sizes: Vec<f64> = sizes.map(|(_, value)| *value).collect();
            let mut walk = Walk::new(&sizes, self.ranges.ends_s);
            let at = |k: usize| walk.at(self.ranges.ends_s * k as f64 / WANDERS.len() as f64);
            let places: Vec<f64> = (0..=WANDERS.len()).map(at).collect();
            let steps: Vec<f64> = places.windows(2).map(|p| (p[1] - p[0]).powi(2)).collect();
            let jump = steps.windows(JUMP).map(|w| w.iter().sum::<f64>()).fold(0.0, f64::max);
            jump < MOST_IN_A_JUMP * steps.iter().sum::<f64>()
        };
        term.name() != DRIFT || model.fit.values.chunks(parameters.len()).any(goes_on)
    }

    /// Values of a drift that may go anywhere: any sizes but none, since a law that does nothing is frozen.
    fn begun_to_drift(&self, term: &Term) -> Vec<f64> {
        let value = |parameter: &Parameter| match parameter.name {
            WANDER_S => self.ranges.ends_s,
            name if WANDERS.contains(&name) => 1.0e-3 * parameter.typical,
            _ => parameter.zero,
        };
        let here: Vec<f64> = term.effect.info().parameters.iter().map(value).collect();
        here.repeat(term.places.len())
    }

    /// Values of a hum whose phase goes as that of what was recorded does, on the axis with most of it: axes hang on one grid.
    fn begun_to_sway(&self, model: &Model) -> Result<Vec<f64>, Error> {
        let term = &model.terms[0];
        let parameters = term.effect.info().parameters;
        let index = |name: &str| parameters.iter().position(|p| p.name == name);
        let mut start = model.fit.values.clone();
        let Some((at_hz, at_s)) = index("frequency_hz").zip(index(WANDER_S)) else {
            return Ok(start);
        };
        let raw = self.scene.raw(self.nominal, self.include)?;
        let loudest = |a: &usize, b: &usize| {
            let left = |p: usize| {
                self.left_on(&self.base, axes_seen(self.nominal, term.effect, term.places[p]))
            };
            left(*a).total_cmp(&left(*b))
        };
        let Some(first) = (0..term.places.len()).max_by(loudest) else { return Ok(start) };
        let hz = start[first * parameters.len() + at_hz];
        let ahead = ahead_turns(&self.phase(&raw, term.places[first].on(), hz), self.ranges.ends_s);
        for here in start.chunks_mut(parameters.len()) {
            here[at_hz] = hz + ahead.mean_hz;
            here[at_s] = self.ranges.ends_s;
            for (name, turns) in AHEAD.iter().zip(&ahead.turns) {
                if let Some(k) = index(name) {
                    here[k] = *turns;
                }
            }
            // In phase with the clock, and a quarter period behind.
            let size = here[0].hypot(here[1]).max(parameters[0].typical);
            (here[0], here[1]) = (size * ahead.phase.cos(), -size * ahead.phase.sin());
        }
        Ok(start)
    }

    /// Envelope of an axis' position about a frequency, a sample, in order of time.
    fn phase(&self, raw: &Stack, axis: usize, hz: f64) -> Vec<Envelope> {
        let channels = self.scene.channels.iter().zip(raw);
        let here = channels.filter(|(c, _)| c.axis == axis && c.kind == Kind::Position);
        let block_s = (PERIODS / hz).max(SHORTEST_S);
        let window = |along: f64| (PI * along).sin().powi(2);
        let of_channel = |(c, row): (&Channel, &Option<Vec<f32>>)| {
            let blocks = row
                .as_ref()
                .map_or_else(Vec::new, |row| envelope(self.scene, c, row, hz, (block_s, window)));
            // Recordings differ in their rate.
            let samples = self.scene.tracks[c.track].rate_hz * block_s;
            let mean = move |b: Envelope| Envelope { re: b.re / samples, im: b.im / samples, ..b };
            blocks.into_iter().map(mean).collect::<Vec<_>>()
        };
        let mut blocks: Vec<Envelope> = here.flat_map(of_channel).collect();
        blocks.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        blocks
    }
}

/// How a phase goes.
struct Ahead {
    /// Terms of its walk, turns.
    turns: [f64; AHEAD.len()],
    /// Where it begins, rad.
    phase: f64,
    /// Its mean speed, which the walk goes beside.
    mean_hz: f64,
}

/// The walk that the phase of blocks goes, over a session that ends at `ends_s`: unwrapped from block to block, as it would go on, and fitted by a walk that
/// is no wilder than it has to be.
fn ahead_turns(blocks: &[Envelope], ends_s: f64) -> Ahead {
    let size = |block: &Envelope| block.re.hypot(block.im);
    let mut sizes: Vec<f64> = blocks.iter().map(size).collect();
    sizes.sort_by(f64::total_cmp);
    let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    let is_typical = |block: &&Envelope| LIKE.contains(&(size(block) / typical));
    let mut told: Vec<(f64, f64)> = Vec::new();
    // Turns a second, as they were last told.
    let mut speed = 0.0;
    for block in blocks.iter().filter(is_typical) {
        let phase = block.im.atan2(block.re) / TAU;
        let expected =
            told.last().map_or(phase, |&(last_s, last)| last + speed * (block.time_s - last_s));
        let (time_s, turns) = (block.time_s, phase + (expected - phase).round());
        told.push((time_s, turns));
        let recent = told.iter().rev().take_while(|(s, _)| time_s - s < GOES_ON_S);
        if let Some((from_s, from)) = recent.last().filter(|(s, _)| time_s - s > TELLS_SPEED_S) {
            speed = (turns - from) / (time_s - from_s);
        }
    }
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| {
        told.iter().map(of).sum::<f64>() / told.len().max(1) as f64
    };
    let (mid_s, mid) = (mean(&|p| p.0), mean(&|p| p.1));
    let spread = mean(&|p| (p.0 - mid_s).powi(2)).max(f64::MIN_POSITIVE);
    let mean_hz = mean(&|p| (p.0 - mid_s) * (p.1 - mid)) / spread;
    // The constant comes last.
    let count = AHEAD.len() + 1;
    let mut normal = DMatrix::<f64>::zeros(count, count);
    let mut right = DVector::<f64>::zeros(count);
    let weight = TOLD_TURNS.powi(-2);
    for &(time_s, turns) in &told {
        let term = |k: usize| match k {
            k if k < AHEAD.len() => ((k as f64 + 0.5) * PI * (time_s / ends_s).min(1.0)).sin(),
            _ => 1.0,
        };
        let row = DVector::from_fn(count, |k, _| term(k));
        normal.ger(weight, &row, &row, 1.0);
        right.axpy(weight * (turns - mean_hz * time_s), &row, 1.0);
    }
    for k in 0..AHEAD.len() {
        normal[(k, k)] += (k as f64 + 0.5).powi(2);
    }
    normal[(count - 1, count - 1)] += 1.0e-9;
    let solved = normal.cholesky().map(|factor| factor.solve(&right));
    let at = |k: usize| solved.as_ref().map_or(0.0, |solved| solved[k]);
    Ahead { turns: std::array::from_fn(at), phase: TAU * at(count - 1), mean_hz }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five recordings of 3 s with pauses of 10 s, of a grid that sways by 0.04 Hz in 60 s and is 0.08 Hz off: a turn and more between two of them.
    #[test]
    fn a_phase_is_followed_over_pauses() {
        let turns = |s: f64| {
            let sway = 0.04 * 60.0 / TAU * (1.0 - (TAU * s / 60.0).cos());
            0.3 - 0.08 * s + sway
        };
        let times = (0..5)
            .flat_map(|file| (0..15).map(move |k| f64::from(file) * 13.0 + 0.2 * f64::from(k)));
        let block = |time_s: f64| {
            let (im, re) = (TAU * turns(time_s)).sin_cos();
            Envelope { time_s, re, im }
        };
        let mut blocks: Vec<Envelope> = times.map(block).collect();
        // One in which the stage moves, and one that is cut short.
        (blocks[20].re, blocks[20].im) = (30.0, -8.0);
        (blocks[40].re, blocks[40].im) = (-0.1, 0.1);
        let ends_s = 55.0;
        let ahead = ahead_turns(&blocks, ends_s);
        let mut walk = Walk::new(&ahead.turns, ends_s);
        for s in [0.0, 14.0, 27.5, 41.0, 54.0] {
            let off = ahead.mean_hz * s + walk.at(s) + ahead.phase / TAU - turns(s);
            assert!(off.abs() < 0.02, "at {s} s: {off} turns");
        }
    }
}
