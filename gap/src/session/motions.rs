//! Simulations of recordings, and motions of axes that will be asked for again.
//!
//! A fit stands at a point and asks what each of its knobs would change there. What a knob of a sensor changes needs no simulation:
//! the axes move as they did. So the motions of the last few points are kept, axis by axis.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

use host_sim::motion::{self, AxisMotion, Motion, Upstream, move_axes};
use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Output, SimError, Stretch, simulate};
use rayon::prelude::*;

use crate::Error;
use crate::session::intake::Track;
use crate::session::lead_in;
use crate::session::scene::Scene;
use crate::session::work;

/// Most samples that are kept, of displacement and amplifier output each: 256 MiB in all, or one point of a longer session.
const MOST_SAMPLES: usize = 1 << 24;
/// Most points that are kept: a fit goes back to none before the last few.
const MOST_POINTS: usize = 12;

/// Motions of one axis in one recording, the one used last at the end.
type Points = VecDeque<(Key, AxisMotion)>;

/// Motions of the last points.
#[derive(Debug)]
pub(crate) struct Motions {
    /// By recording and axis (from 0).
    kept: Mutex<BTreeMap<(usize, usize), Points>>,
    /// Points of each.
    most: usize,
}

/// Whose motion an axis made in a recording.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Key {
    /// Whether slow strains ran on from the recording before.
    pub runs_on: bool,
    /// The rig, as far as it matters.
    pub upstream: Upstream,
}

impl Motions {
    /// For a session of so many samples of all axes together.
    pub(crate) fn new(samples: usize) -> Self {
        let most = (MOST_SAMPLES / samples.max(1)).clamp(1, MOST_POINTS);
        Self { kept: Mutex::default(), most }
    }

    /// The motion of an axis (from 0) in a recording, if it is kept. `again`: it is about to be kept for the next time; jobs that run beside
    /// each other leave the order alone, or what is kept would depend on which of them came first.
    pub(crate) fn get(
        &self,
        (track, axis): (usize, usize),
        key: &Key,
        again: bool,
    ) -> Option<AxisMotion> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let here = kept.get_mut(&(track, axis))?;
        let at = here.iter().rposition(|(known, _)| known == key)?;
        let motion = here.get(at)?.1.clone();
        if again && let Some(entry) = here.remove(at) {
            here.push_back(entry);
        }
        Some(motion)
    }

    /// Keep a motion, at the expense of that which was not used for longest.
    pub(crate) fn keep(&self, (track, axis): (usize, usize), key: Key, motion: AxisMotion) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let here = kept.entry((track, axis)).or_default();
        if here.iter().any(|(known, _)| *known == key) {
            return;
        }
        while here.len() >= self.most {
            here.pop_front();
        }
        here.push_back((key, motion));
    }
}

impl Scene {
    /// Simulate one recording, from these states of its axes (none: depoled) and with what went before.
    pub fn output(
        &self,
        rig: &Rig,
        track: usize,
        axes: Axes,
        initial: &[Initial],
    ) -> Result<Output, Error> {
        self.with_input(track, initial, |input| simulate(rig, input, axes))
    }

    /// The same from depoled stacks, with the motion of axes that are known from before; `keep` it for the next time.
    pub(crate) fn recalled(
        &self,
        rig: &Rig,
        track: usize,
        axes: Axes,
        keep: bool,
    ) -> Result<Output, Error> {
        let needed = motion::needed(rig, axes);
        let runs_on = self.runs_on && !self.tracks[track].past.is_empty();
        let keys: Vec<Option<Key>> = (0..rig.axes.len())
            .map(|axis| {
                needed.contains(axis).then(|| Key { runs_on, upstream: Upstream::of(rig, axis) })
            })
            .collect();
        let recall = |(axis, key): (usize, &Option<Key>)| {
            self.motions.get((track, axis), key.as_ref()?, keep)
        };
        let mut known: Motion = keys.iter().enumerate().map(recall).collect();
        let missing = (0..keys.len())
            .filter(|&axis| keys[axis].is_some() && known[axis].is_none())
            .fold(0, |mask, axis| mask | 1 << axis);
        self.work.count(rig, missing, &self.tracks[track].ticks());
        self.with_input(track, &[], |input| {
            let mut moved: Vec<Motion> = work::tied(rig, missing)
                .into_par_iter()
                .map(|axes| move_axes(rig, input, Axes::Only(axes)))
                .collect::<Result<_, _>>()?;
            for (axis, key) in keys.into_iter().enumerate().filter(|(a, _)| missing >> a & 1 == 1) {
                let motion = moved.iter_mut().find_map(|moved| moved[axis].take());
                if let (true, Some(key), Some(motion)) = (keep, key, &motion) {
                    self.motions.keep((track, axis), key, motion.clone());
                }
                known[axis] = motion;
            }
            motion::read(rig, input, known, axes)
        })
    }

    /// Past of every stack before a recording, as far as its lead-in tells; empty where it tells nothing.
    pub(crate) fn past_by_lead_in(
        &self,
        rig: &Rig,
        track: usize,
    ) -> Result<Vec<Arc<[Stretch]>>, Error> {
        let Track { position_um, present, replaced, lead_in, .. } = &self.tracks[track];
        let mut lacking = (0..*lead_in).filter(|sample| !present[*sample]);
        let is_whole = lacking.all(|sample| replaced.contains(&sample));
        let measured_m = |axis: usize, sample: usize| {
            Some(f64::from(position_um[axis].as_ref()?[sample]) * 1.0e-6)
        };
        let settle = if is_whole { *lead_in } else { 0 };
        let initial =
            self.with_input(track, &[], |input| lead_in::initial(rig, input, settle, measured_m))?;
        let known = initial.iter().any(|state| state.past.is_some());
        let pasts = initial.into_iter().filter(|_| known);
        Ok(pasts.map(|state| state.past.unwrap_or_default()).collect())
    }

    fn with_input<T>(
        &self,
        track: usize,
        initial: &[Initial],
        run: impl FnOnce(&Input) -> Result<T, SimError>,
    ) -> Result<T, Error> {
        self.with_drive(track, &self.tracks[track].drive_v, initial, run)
    }

    /// The same as if the drive of every axis had been another one, V.
    pub(super) fn with_drive<T>(
        &self,
        track: usize,
        drive_v: &[Vec<f64>],
        initial: &[Initial],
        run: impl FnOnce(&Input) -> Result<T, SimError>,
    ) -> Result<T, Error> {
        let track = &self.tracks[track];
        let drive: Vec<&[f64]> = drive_v.iter().map(Vec::as_slice).collect();
        let mut initial = initial.to_vec();
        if self.runs_on && !track.past.is_empty() {
            initial.resize(track.past.len(), Initial::default());
            for (state, past) in initial.iter_mut().zip(&track.past) {
                state.past = Some(past.clone());
            }
        }
        let input = Input {
            sample_rate_hz: track.rate_hz,
            start_s: track.start_s,
            ticks: None,
            drive_v: &drive,
            initial: &initial,
            monitor_v: None,
        };
        run(&input).map_err(|e| Error::Rig(e.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use host_sim::Place;

    use super::*;

    fn key(rig: &Rig, axis: usize) -> Key {
        Key { runs_on: false, upstream: Upstream::of(rig, axis) }
    }

    fn motion() -> AxisMotion {
        let column = Arc::new(vec![0.0; 10]);
        AxisMotion { displacement_m: column.clone(), amplifier_v: column, end: Initial::default() }
    }

    fn changed(effect: &str, place: Place, parameter: &str, value: f64) -> Rig {
        let mut rig = Rig::named("handley").unwrap();
        rig.set(effect, place, parameter, value).unwrap();
        rig
    }

    #[test]
    fn an_axis_moves_the_same_whatever_its_sensor_and_other_axes_do() {
        let rig = Rig::named("handley").unwrap();
        let motions = Motions::new(10);
        motions.keep((0, 0), key(&rig, 0), motion());
        let finds = |rig: &Rig| motions.get((0, 0), &key(rig, 0), true).is_some();
        assert!(finds(&changed("sensor-offset", Place::Axis(0), "offset_m", 1.0e-8)));
        assert!(finds(&changed("drive-gain", Place::Axis(1), "ratio", 0.98)));
        assert!(!finds(&changed("drive-gain", Place::Axis(0), "ratio", 0.98)));
        let pair = Place::Pair { on: 1, from: 2 };
        assert!(!finds(&changed("drive-crosstalk", pair, "share", 0.02)));
        let mut heavy = rig.clone();
        heavy.axes[0].mechanism.mass_kg += 0.1;
        assert!(!finds(&heavy));
        assert!(motions.get((0, 1), &key(&rig, 0), true).is_none());
        assert!(motions.get((1, 0), &key(&rig, 0), true).is_none());
    }

    #[test]
    fn the_one_not_used_for_longest_goes_first() {
        let motions = Motions::new(MOST_SAMPLES / 2);
        let rigs = [0.97, 0.98, 0.99].map(|r| changed("drive-gain", Place::Axis(0), "ratio", r));
        let [first, second, third] = rigs.map(|rig| key(&rig, 0));
        motions.keep((0, 0), first.clone(), motion());
        motions.keep((0, 0), second.clone(), motion());
        assert!(motions.get((0, 0), &first, true).is_some());
        motions.keep((0, 0), third.clone(), motion());
        assert!(
            motions.get((0, 0), &first, true).is_some()
                && motions.get((0, 0), &third, true).is_some()
        );
        assert!(motions.get((0, 0), &second, true).is_none());
        assert_eq!(Motions::new(10 * MOST_SAMPLES).most, 1);
    }
}
