//! A gauge or a monitor over a session: which of its readings are wild, and what is said of them.

use host_sim::rig::Rig;
use rayon::prelude::*;

use super::{ACCIDENTS, AFTER_A_STEP, AFTER_A_STEP_S, Nominal, Run, readings};
use crate::session::floor::{Kind, column};
use crate::session::intake::Track;

/// Most wild readings in a row: more of them may be motion.
const MOST_IN_A_ROW: usize = 3;
/// Least that they are off, in steps of a gauge that is read coarsely.
const LEAST_STEPS: f64 = 8.0;
/// Most by which the samples on both sides may differ, as a share of what the ones between them are off: an edge goes further.
const SIDES_DIFFER: f64 = 0.25;
/// Samples on each side that tell how much the difference to the rig changes there anyway,
const AROUND: usize = 50;
/// how far off a wild reading is in units of that,
const STANDS_OUT: f64 = 5.0;
/// and how many changes are passed over: those into and out of two further wild readings.
const PASSED_OVER: usize = 4;
/// Share of what it is off in the recording that it has to be off in the difference to the rig.
const NOT_OF_THE_MODEL: f64 = 0.5;
/// Excursion of the rig as it is known that explains a reading, and jump of the gauge at another time that makes it nothing unusual, as shares of
/// what it is off.
const KNOWN_MOTION: f64 = 0.25;
const JUMPS_ELSEWHERE: f64 = 0.5;

/// How far the readings of a run are off both neighbours, if those agree about it.
fn excursion(x: impl Fn(usize) -> f64, at: usize, long: usize) -> Option<f64> {
    let (before, after) = (x(at - 1), x(at + long));
    let mut off = f64::INFINITY;
    for k in at..at + long {
        let (up, down) = (x(k) - before, x(k) - after);
        if up * down <= 0.0 {
            return None;
        }
        off = off.min(up.abs()).min(down.abs());
    }
    ((before - after).abs() <= SIDES_DIFFER * off).then_some(off)
}

fn is_whole(present: &[bool], at: usize, long: usize) -> bool {
    at > 0 && at + long < present.len() && present[at - 1..=at + long].iter().all(|&p| p)
}

/// Whether any reading is that far off both neighbours.
pub(super) fn stands_out_anywhere(x: &[f32], present: &[bool], least: f64) -> bool {
    let of = |k: usize| f64::from(x[k]);
    (1..x.len().saturating_sub(1))
        .filter(|&at| (of(at) - of(at - 1)).abs() >= least)
        .any(|at| run_at(&of, present, at, least).is_some())
}

/// The shortest run from a sample on that is that far off.
fn run_at(x: &impl Fn(usize) -> f64, present: &[bool], at: usize, least: f64) -> Option<Run> {
    (1..=MOST_IN_A_ROW).find_map(|long| {
        let off = is_whole(present, at, long).then(|| excursion(x, at, long))??;
        (off >= least).then_some(Run { at, long, off })
    })
}

/// A column of the session.
pub(super) struct Gauge<'a> {
    pub(super) rig: &'a Rig,
    pub(super) axis: usize,
    pub(super) kind: Kind,
    /// What a wild reading is off at least, um or V.
    pub(super) least: f64,
}

impl Gauge<'_> {
    /// What the rig as it is known reads, um or V.
    fn of_model(&self, nominal: &Nominal, k: usize) -> f64 {
        match self.kind {
            Kind::Position => 1.0e6 * nominal.output.position_m[self.axis][k],
            Kind::Monitor => nominal.output.monitor_v[self.axis][k],
        }
    }

    /// What a volt of a drive makes of a reading at most.
    fn per_volt(&self) -> f64 {
        match self.kind {
            Kind::Position => {
                let um_per_v = self.rig.axes.iter().map(|axis| 1.0e6 * axis.rest_m_per_v().abs());
                um_per_v.fold(0.0, f64::max)
            }
            Kind::Monitor => 1.0,
        }
    }

    /// Readings of a track that look wild by what is around them.
    pub(super) fn runs(&self, track: &Track, nominal: &Nominal) -> Vec<Run> {
        let Some(x) = column(track, self.axis, self.kind) else { return Vec::new() };
        let measured = |k: usize| f64::from(x[k]);
        let left = |k: usize| measured(k) - self.of_model(nominal, k);
        let least = self.least.max(LEAST_STEPS * resolution(x));
        let mut runs: Vec<Run> = Vec::new();
        let mut at = 1;
        while at + 1 < x.len() {
            let run = (measured(at) - measured(at - 1)).abs() >= least;
            let run = run.then(|| run_at(&measured, &track.present, at, least)).flatten();
            let run = run.filter(|run| self.is_wild(track, nominal, &left, run));
            if let Some(run) = run {
                runs.push(run);
                at += run.long;
            }
            at += 1;
        }
        runs
    }

    /// Whether a run stands out of the difference to the rig, and no drive accounts for it.
    fn is_wild(
        &self,
        track: &Track,
        nominal: &Nominal,
        left: &impl Fn(usize) -> f64,
        run: &Run,
    ) -> bool {
        let Run { at, long, off } = *run;
        let Some(beyond) = excursion(left, at, long) else { return false };
        if beyond < NOT_OF_THE_MODEL * off || self.per_volt() * nominal.step_v[at] >= off {
            return false;
        }
        let around = at.saturating_sub(AROUND).max(1)..(at + long + AROUND).min(track.len());
        let is_there = |k: usize| track.present[k] && track.present[k - 1];
        let mut changes: Vec<f64> = around
            .filter(|&k| !run.touches(k) && is_there(k))
            .map(|k| (left(k) - left(k - 1)).abs())
            .collect();
        // Where next to nothing is left between losses nobody can say what is usual.
        if changes.len() < AROUND {
            return false;
        }
        changes.sort_by(|a, b| b.total_cmp(a));
        if beyond < STANDS_OUT * changes[PASSED_OVER] {
            return false;
        }
        let model = |k: usize| self.of_model(nominal, k);
        let window = AFTER_A_STEP.max((AFTER_A_STEP_S * track.rate_hz) as usize);
        let near = at.saturating_sub(window).max(1)..(at + window).min(track.len());
        let moves = |k: usize, long: usize| {
            let of_model = (k + long < track.len()).then(|| excursion(model, k, long)).flatten();
            of_model.is_some_and(|um| um >= KNOWN_MOTION * off)
        };
        !near.into_iter().any(|k| (1..=MOST_IN_A_ROW).any(|long| moves(k, long)))
    }

    /// Keep those that are larger than anything else that the gauge does without a drive, in any recording.
    pub(super) fn keep_unusual(
        &self,
        tracks: &[Track],
        nominal: &[Option<Nominal>],
        found: &mut [(usize, Vec<Run>)],
    ) {
        let all: Vec<(usize, Run)> =
            found.iter().flat_map(|(t, runs)| runs.iter().map(move |run| (*t, *run))).collect();
        let jumps_as_much = |off: f64| {
            tracks.par_iter().zip(nominal).enumerate().any(|(t, (track, nominal))| {
                let (Some(x), Some(nominal)) = (column(track, self.axis, self.kind), nominal)
                else {
                    return false;
                };
                let left = |k: usize| f64::from(x[k]) - self.of_model(nominal, k);
                (1..track.len()).any(|k| {
                    (left(k) - left(k - 1)).abs() >= JUMPS_ELSEWHERE * off
                        && track.present[k]
                        && track.present[k - 1]
                        && self.per_volt() * nominal.step_v[k] < KNOWN_MOTION * off
                        && !all.iter().any(|(of, run)| *of == t && run.touches(k))
                })
            })
        };
        // What is smaller than one that is nothing unusual is none either.
        let mut sizes: Vec<f64> = all.iter().map(|(_, run)| run.off).collect();
        sizes.sort_by(f64::total_cmp);
        let usual = sizes.partition_point(|&off| jumps_as_much(off));
        let least = sizes.get(usual).copied().unwrap_or(f64::INFINITY);
        found.iter_mut().for_each(|(_, runs)| runs.retain(|run| run.off >= least));
    }
}

impl Gauge<'_> {
    /// What a reader should know about wild readings of a recording.
    pub(super) fn note(&self, track: &Track, runs: &[Run]) -> String {
        let Track { file, first_tick, .. } = track;
        let (name, off) = (self.name(), self.off(runs));
        let tick = first_tick + runs.first().map_or(0, |run| run.at) as u64;
        match readings(runs) {
            1 => format!(
                "{file}: {name} reads {off} off at tick {tick}, which its neighbours on both sides and the drives do not allow. That sample was taken for lost."
            ),
            n => format!(
                "{file}: {n} readings of {name} are up to {off} off, the first at tick {tick}, which their neighbours on both sides and the drives do not \
                 allow. Those samples were taken for lost."
            ),
        }
    }

    /// What a reader should know about one that has more of them than accidents are.
    pub(super) fn sick(&self, tracks: &[Track], found: &[(usize, Vec<Run>)]) -> Option<String> {
        let (t, runs) = found.iter().max_by_key(|(_, runs)| readings(runs))?;
        let (name, off) = (self.name(), self.off(runs));
        let Track { file, first_tick, .. } = &tracks[*t];
        Some(format!(
            "{file}: {} readings of {name} are up to {off} off what their neighbours on both sides allow, the first at tick {}{}. More than one in {:.0} is no \
             accident, and nothing was left out: look for a loose contact, a converter that is disturbed, or a bit that sticks.",
            readings(runs),
            first_tick + runs.first().map_or(0, |run| run.at) as u64,
            match found.len() - 1 {
                0 => String::new(),
                more => format!(" (and fewer in {more} more recordings)"),
            },
            1.0 / ACCIDENTS
        ))
    }

    fn name(&self) -> String {
        let name = match self.kind {
            Kind::Position => "gauge",
            Kind::Monitor => "monitor",
        };
        format!("the {name} of axis {}", self.axis + 1)
    }

    /// How far off the worst of them is.
    fn off(&self, runs: &[Run]) -> String {
        let most = runs.iter().map(|run| run.off).fold(0.0, f64::max);
        match self.kind {
            Kind::Position if most >= 1.0 => format!("{most:.1} um"),
            Kind::Position => format!("{:.0} nm", 1.0e3 * most),
            Kind::Monitor => format!("{most:.2} V"),
        }
    }
}

/// Least difference between two values of a column that are not the same: the step of its converter, or next to nothing.
fn resolution(x: &[f32]) -> f64 {
    let mut values = x.to_vec();
    values.sort_by(f32::total_cmp);
    let steps = values.windows(2).map(|pair| f64::from(pair[1]) - f64::from(pair[0]));
    let least = steps.filter(|&step| step > 0.0).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}
