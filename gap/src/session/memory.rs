//! What the stacks remember at the start of a recording and after it was interrupted for long: unknown, and set aside where it reaches into what
//! is scored. A drive that turned while nothing was recorded leaves a stack elsewhere: on the first paper's rig, tens of nanometres.

use std::ops::Range;

use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Output, Place, Stretch, simulate};
use rayon::prelude::*;

use crate::Error;
use crate::session::channel::Channel;
use crate::session::floor::Kind;
use crate::session::intake::Track;
use crate::session::past::CREEP;
use crate::session::scene::Scene;

/// Shortest interruption in which a drive is taken to have turned, s,
const INTERRUPTED_S: f64 = 0.02;
/// and most of a recording that are looked at, the longest ones: each takes a simulation and a direction for every turn.
const MOST_INTERRUPTIONS: usize = 4;
/// Where it may have turned, as shares of what the session drives: as many as tell how far each slip element was taken.
const TURNS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
/// Share of an interruption that a ramp there takes, and one back.
const RAMP: f64 = 0.4;

/// What a stack is taken to have gone through before the session, where it creeps: held at so much transducer voltage, V, for a time that began
/// and ended so long ago, s.
const HELD_V: f64 = 50.0;
const AGES_S: [f64; 6] = [0.0, 0.3, 3.0, 30.0, 300.0, 3000.0];
/// How much it creeps, a decade: the size of a direction does not matter.
const CREEPS: f64 = 0.015;
/// Multiple of the noise from which another past is seen at all.
const SEEN: f32 = 0.3;

/// Long interruptions of a recording, by samples, the longest first.
pub(crate) fn interruptions(track: &Track) -> Vec<Range<usize>> {
    let least = (INTERRUPTED_S * track.rate_hz).ceil() as usize;
    let mut long: Vec<_> = track.holes.iter().filter(|hole| hole.len() >= least).collect();
    long.sort_by_key(|hole| std::cmp::Reverse(hole.len()));
    long.into_iter().take(MOST_INTERRUPTIONS).cloned().collect()
}

impl Scene {
    /// Find out in which channels the unknown memory of the stacks at the start, or after an interruption, still matters, and set it aside
    /// there. The past of a stack is taken to lie within the voltages that this session drives: a ramp to the top of them wipes it out.
    pub fn set_aside_memory(&mut self, rig: &Rig) -> Result<(), Error> {
        let (low, high) = self
            .tracks
            .iter()
            .flat_map(|t| t.drive_v.iter().flatten())
            .fold((0.0_f64, 0.0_f64), |(low, high), &v| (low.min(v), high.max(v)));
        let rows: Vec<Vec<Vec<Vec<f32>>>> = (0..self.tracks.len())
            .into_par_iter()
            .map(|track| {
                let virgin = self.output(rig, track, Axes::All, &[])?;
                let mut swept: Vec<Output> = [high, 0.5 * high, low]
                    .into_iter()
                    .filter(|turn| *turn != 0.0)
                    .map(|turn| {
                        let past = self.after_turn(rig, track, turn)?;
                        self.output(rig, track, Axes::All, &past)
                    })
                    .collect::<Result<_, Error>>()?;
                for hole in interruptions(&self.tracks[track]) {
                    for share in TURNS {
                        let turn = low + share * (high - low);
                        let drive = turned(&self.tracks[track], &hole, turn);
                        let run = |input: &Input| simulate(rig, input, Axes::All);
                        swept.push(self.with_drive(track, &drive, &[], run)?);
                    }
                }
                Ok(self.directions(track, &virgin, &swept))
            })
            .collect::<Result<_, Error>>()?;
        let mut rows: Vec<_> = rows.into_iter().map(Vec::into_iter).collect();
        for channel in &mut self.channels {
            channel.memory = rows[channel.track].next().unwrap_or_default();
            channel.orthonormalise();
        }
        if self.comes_back { self.set_aside_creep(rig) } else { Ok(()) }
    }

    /// Set aside, beside that, what a stack that creeps may yet come back from in the first recording: nobody knows what was done to it before
    /// the session. `rig` is the nominal one.
    fn set_aside_creep(&mut self, rig: &Rig) -> Result<(), Error> {
        let mut creeping = rig.clone();
        for axis in 0..rig.axes.len() {
            let set = creeping.set(CREEP, Place::Axis(axis), "per_decade", CREEPS);
            set.map_err(|e| Error::Rig(e.to_string()))?;
        }
        for track in 0..self.tracks.len() {
            if !self.tracks[track].past.iter().all(|past| past.is_empty()) {
                continue;
            }
            let rested = self.output(&creeping, track, Axes::All, &[])?;
            let ages = AGES_S.windows(2).map(|age| {
                let held = Stretch { lasted_s: age[1] - age[0], transducer_v: HELD_V };
                let since = Stretch { lasted_s: age[0], transducer_v: 0.0 };
                let past = Some(vec![held, since].into());
                let states = vec![Initial { past, ..Initial::default() }; rig.axes.len()];
                self.output(&creeping, track, Axes::All, &states)
            });
            let held: Vec<Output> = ages.collect::<Result<_, _>>()?;
            let mut rows = self.directions(track, &rested, &held).into_iter();
            for channel in self.channels.iter_mut().filter(|c| c.track == track) {
                channel.memory.extend(rows.next().unwrap_or_default());
                channel.orthonormalise();
            }
        }
        Ok(())
    }

    /// What each channel of a recording would read otherwise if its stacks had another past than that of `base`.
    fn directions(&self, track: usize, base: &Output, others: &[Output]) -> Vec<Vec<Vec<f32>>> {
        let of_channel = |channel: &Channel| {
            if channel.kind == Kind::Monitor {
                return Vec::new();
            }
            let base = self.residual(channel, base);
            let other = |output| {
                let residual = self.residual(channel, output);
                residual.iter().zip(&base).map(|(a, b)| a - b).collect::<Vec<f32>>()
            };
            let is_seen = |d: &Vec<f32>| d.iter().fold(0.0_f32, |m, x| m.max(x.abs())) > SEEN;
            others.iter().map(other).filter(is_seen).collect()
        };
        self.channels.iter().filter(|c| c.track == track).map(of_channel).collect()
    }

    /// What the stacks remember after a slow excursion from 0 V to `turn_v` and on to where a recording starts.
    fn after_turn(&self, rig: &Rig, track: usize, turn_v: f64) -> Result<Vec<Initial>, Error> {
        const SAMPLES: usize = 400;
        let track = &self.tracks[track];
        let drive: Vec<Vec<f64>> = track
            .drive_v
            .iter()
            .map(|column| {
                let start_v = column.first().copied().unwrap_or(0.0);
                let ramp = |from: f64, to: f64| {
                    (0..SAMPLES).map(move |k| from + (to - from) * k as f64 / SAMPLES as f64)
                };
                let rest = std::iter::repeat_n(start_v, SAMPLES / 4);
                ramp(0.0, turn_v).chain(ramp(turn_v, start_v)).chain(rest).collect()
            })
            .collect();
        let drive: Vec<&[f64]> = drive.iter().map(Vec::as_slice).collect();
        let input = Input {
            sample_rate_hz: track.rate_hz,
            start_s: track.start_s,
            ticks: None,
            drive_v: &drive,
            initial: &[],
            monitor_v: None,
        };
        let output = simulate(rig, &input, Axes::All).map_err(|e| Error::Rig(e.to_string()))?;
        Ok(output
            .end
            .into_iter()
            .map(|end| Initial { memory: end.memory, ..Initial::default() })
            .collect())
    }
}

/// Drive of every axis, V, with an excursion to `turn_v` in an interruption, and from there to where the recording goes on.
fn turned(track: &Track, hole: &Range<usize>, turn_v: f64) -> Vec<Vec<f64>> {
    let ramp = ((RAMP * hole.len() as f64) as usize).max(1);
    let mut drive = track.drive_v.clone();
    for column in &mut drive {
        let (from, to) = (column[hole.start], column[hole.end.min(column.len() - 1)]);
        for (k, v) in column[hole.clone()].iter_mut().enumerate() {
            let share = (k % ramp) as f64 / ramp as f64;
            *v = match k / ramp {
                0 => from + (turn_v - from) * share,
                1 => turn_v + (to - turn_v) * share,
                _ => to,
            };
        }
    }
    drive
}
