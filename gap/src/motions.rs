//! Simulations of recordings, and motions of axes that will be asked for again.
//!
//! A fit stands at a point and asks what each of its knobs would change there. What a knob of a sensor changes needs no simulation:
//! the axes move as they did. So the motions of the last few points are kept, axis by axis.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use host_sim::motion::{self, AxisMotion, Motion, Upstream, move_axes};
use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Output, SimError, simulate};

use crate::Error;
use crate::scene::Scene;

/// Most samples that are kept, of displacement and amplifier output each: 256 MiB in all.
const MOST_SAMPLES: usize = 1 << 24;

/// Motions, the one used last at the end.
#[derive(Debug, Default)]
pub(crate) struct Motions {
    kept: Mutex<VecDeque<(Key, AxisMotion)>>,
}

/// Whose motion.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Key {
    /// Recording.
    pub track: usize,
    /// Axis, from 0.
    pub axis: usize,
    /// Whether slow strains ran on from the recording before.
    pub runs_on: bool,
    /// The rig, as far as it matters.
    pub upstream: Upstream,
}

impl Motions {
    /// A motion that is kept.
    pub(crate) fn get(&self, key: &Key) -> Option<AxisMotion> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let at = kept.iter().rposition(|(known, _)| known == key)?;
        let entry = kept.remove(at)?;
        let motion = entry.1.clone();
        kept.push_back(entry);
        Some(motion)
    }

    /// Keep a motion, at the expense of those that were not used for longest.
    pub(crate) fn keep(&self, key: Key, motion: AxisMotion) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.iter().any(|(known, _)| *known == key) {
            return;
        }
        kept.push_back((key, motion));
        let mut samples: usize = kept.iter().map(|(_, m)| m.displacement_m.len()).sum();
        while samples > MOST_SAMPLES && kept.len() > 1 {
            let oldest = kept.pop_front();
            samples -= oldest.map_or(0, |(_, m)| m.displacement_m.len());
        }
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
                let upstream = || Upstream::of(rig, axis);
                needed.contains(axis).then(|| Key { track, axis, runs_on, upstream: upstream() })
            })
            .collect();
        let mut known: Motion =
            keys.iter().map(|key| key.as_ref().and_then(|key| self.motions.get(key))).collect();
        let missing = (0..keys.len())
            .filter(|&axis| keys[axis].is_some() && known[axis].is_none())
            .fold(0, |mask, axis| mask | 1 << axis);
        self.with_input(track, &[], |input| {
            if missing != 0 {
                let moved = move_axes(rig, input, Axes::Only(missing))?;
                for ((axis, motion), key) in moved.into_iter().enumerate().zip(keys) {
                    if missing >> axis & 1 == 0 {
                        continue;
                    }
                    if let (true, Some(key), Some(motion)) = (keep, key, &motion) {
                        self.motions.keep(key, motion.clone());
                    }
                    known[axis] = motion;
                }
            }
            motion::read(rig, input, &known, axes)
        })
    }

    fn with_input<T>(
        &self,
        track: usize,
        initial: &[Initial],
        run: impl FnOnce(&Input) -> Result<T, SimError>,
    ) -> Result<T, Error> {
        let track = &self.tracks[track];
        let drive: Vec<&[f64]> = track.drive_v.iter().map(Vec::as_slice).collect();
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
    use std::sync::Arc;

    use host_sim::Place;

    use super::*;

    fn key(rig: &Rig, axis: usize) -> Key {
        Key { track: 0, axis, runs_on: false, upstream: Upstream::of(rig, axis) }
    }

    fn motion(samples: usize) -> AxisMotion {
        let column = Arc::new(vec![0.0; samples]);
        AxisMotion { displacement_m: column.clone(), amplifier_v: column, end: Initial::default() }
    }

    #[test]
    fn an_axis_moves_the_same_whatever_its_sensor_and_other_axes_do() {
        let rig = Rig::named("handley").unwrap();
        let changed = |effect: &str, place: Place, parameter: &str, value: f64| {
            let mut rig = rig.clone();
            rig.set(effect, place, parameter, value).unwrap();
            rig
        };
        let motions = Motions::default();
        motions.keep(key(&rig, 0), motion(10));
        let finds = |rig: &Rig| motions.get(&key(rig, 0)).is_some();
        assert!(finds(&changed("sensor-offset", Place::Axis(0), "offset_m", 1.0e-8)));
        assert!(finds(&changed("drive-gain", Place::Axis(1), "ratio", 0.02)));
        assert!(!finds(&changed("drive-gain", Place::Axis(0), "ratio", 0.02)));
        let pair = Place::Pair { on: 1, from: 2 };
        assert!(!finds(&changed("drive-crosstalk", pair, "share", 0.02)));
        let mut heavy = rig.clone();
        heavy.axes[0].mechanism.mass_kg += 0.1;
        assert!(!finds(&heavy));
        assert!(motions.get(&key(&rig, 1)).is_none());
    }

    #[test]
    fn the_one_not_used_for_longest_goes_first() {
        let rig = Rig::named("handley").unwrap();
        let motions = Motions::default();
        motions.keep(key(&rig, 0), motion(MOST_SAMPLES / 2));
        motions.keep(key(&rig, 1), motion(MOST_SAMPLES / 2));
        assert!(motions.get(&key(&rig, 0)).is_some());
        motions.keep(key(&rig, 2), motion(10));
        assert!(motions.get(&key(&rig, 0)).is_some() && motions.get(&key(&rig, 2)).is_some());
        assert!(motions.get(&key(&rig, 1)).is_none());
    }
}
