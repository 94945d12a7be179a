//! Wild samples: readings far off what their neighbours on both sides allow, up to three in a row, as a converter gives that was disturbed.
//!
//! A single one 20 um off holds more energy than the noise of a minute, and no model of a stage can say it. Few of them are accidents: they are
//! taken for lost. Many are a disease of the gauge, which has to stay visible, and so has everything that could be motion. A reading is called
//! wild only if it stands out of the recording *and* out of the difference to the rig as it is known, there by far more than anything
//! around it changes from sample to sample; if no drive moved by as much just before; and if the gauge jumps by half of that nowhere else, as
//! one does that falls from state to state or has a bit that sticks.

mod gauge;

use gauge::{Gauge, stands_out_anywhere};
use host_sim::rig::Rig;
use host_sim::{Axes, Input, Output, simulate};
use rayon::prelude::*;

use crate::Error;
use crate::session::floor::{self, Kind, column};
use crate::session::intake::Track;

/// Least that they are off, in units of the noise: less than that does not spoil a diagnosis.
const LEAST_NOISES: f64 = 20.0;
/// Time after a step of a drive in which no smaller reading is called wild, s, and samples: a pulse, an amplifier that is late, a wire beside
/// another.
const AFTER_A_STEP_S: f64 = 5.0e-3;
const AFTER_A_STEP: usize = 20;
/// Most wild readings of a recording that are accidents, as a share of its samples,
const ACCIDENTS: f64 = 1.0e-3;
/// and how many are none in a short one either.
const FEW: usize = 2;

/// One to three readings in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Run {
    /// First of them.
    at: usize,
    /// How many.
    long: usize,
    /// How far off the nearest of them is, in the unit of the column.
    off: f64,
}

impl Run {
    /// Whether the change into a sample is one into, within or out of the run.
    fn touches(&self, change: usize) -> bool {
        (self.at..=self.at + self.long).contains(&change)
    }
}

/// What a track is compared with.
struct Nominal {
    /// The rig as it is known, under the recorded drive.
    output: Output,
    /// Largest step of any drive just before each sample, V.
    step_v: Vec<f64>,
}

/// Take wild samples out of all tracks; what is said of them.
pub(super) fn leave_out(rig: &Rig, tracks: &mut [Track]) -> Result<Vec<String>, Error> {
    let (mut notes, mut wild) = (Vec::new(), Vec::new());
    let mut nominal: Vec<Option<Nominal>> = tracks.iter().map(|_| None).collect();
    for axis in 0..rig.axes.len() {
        for kind in [Kind::Position, Kind::Monitor] {
            let stated = kind.stated(rig, axis);
            let Some(noise) = floor::noise(tracks, axis, kind, stated) else { continue };
            let least = LEAST_NOISES * noise.sigma.max(stated);
            let suspects: Vec<usize> = (0..tracks.len())
                .into_par_iter()
                .filter(|&t| {
                    let track = &tracks[t];
                    let column = column(track, axis, kind);
                    column.is_some_and(|x| stands_out_anywhere(x, &track.present, least))
                })
                .collect();
            if suspects.is_empty() {
                continue;
            }
            known(rig, tracks, &suspects, &mut nominal)?;
            let gauge = Gauge { rig, axis, kind, least };
            let of_track = |t: &usize| Some((*t, gauge.runs(&tracks[*t], nominal[*t].as_ref()?)));
            let mut found: Vec<(usize, Vec<Run>)> =
                suspects.par_iter().filter_map(of_track).collect();
            found.retain(|(_, runs)| !runs.is_empty());
            if found.is_empty() {
                continue;
            }
            let is_sick = found.iter().any(|(t, runs)| {
                readings(runs) > FEW.max((ACCIDENTS * tracks[*t].len() as f64) as usize)
            });
            if is_sick {
                notes.extend(gauge.sick(tracks, &found));
                continue;
            }
            let all: Vec<usize> = (0..tracks.len()).collect();
            known(rig, tracks, &all, &mut nominal)?;
            gauge.keep_unusual(tracks, &nominal, &mut found);
            for (t, runs) in found.into_iter().filter(|(_, runs)| !runs.is_empty()) {
                notes.push(gauge.note(&tracks[t], &runs));
                wild.push((t, axis, kind, runs));
            }
        }
    }
    // Not before all were looked at: what disturbs one converter may disturb others at the same tick.
    for (t, axis, kind, runs) in wild {
        replace(&mut tracks[t], axis, kind, &runs);
    }
    Ok(notes)
}

fn readings(runs: &[Run]) -> usize {
    runs.iter().map(|run| run.long).sum()
}

/// Simulate those tracks that were not yet.
fn known(
    rig: &Rig,
    tracks: &[Track],
    wanted: &[usize],
    nominal: &mut [Option<Nominal>],
) -> Result<(), Error> {
    let missing: Vec<usize> = wanted.iter().copied().filter(|&t| nominal[t].is_none()).collect();
    let new: Vec<(usize, Nominal)> = missing
        .into_par_iter()
        .map(|t| {
            let track = &tracks[t];
            let drive_v: Vec<&[f64]> = track.drive_v.iter().map(Vec::as_slice).collect();
            let input = Input {
                sample_rate_hz: track.rate_hz,
                start_s: track.start_s,
                ticks: None,
                drive_v: &drive_v,
                initial: &[],
                monitor_v: None,
            };
            let output = simulate(rig, &input, Axes::All).map_err(|e| Error::Rig(e.to_string()))?;
            Ok((t, Nominal { output, step_v: steps_before(track) }))
        })
        .collect::<Result<_, Error>>()?;
    for (t, known) in new {
        nominal[t] = Some(known);
    }
    Ok(())
}

/// Largest step of any drive just before each sample, V. What is asked for at a sample itself comes after its reading: a closed loop
/// answers to a wild one there. What was before the first sample is not known: any step may have been.
fn steps_before(track: &Track) -> Vec<f64> {
    let step_v: Vec<f64> = (0..track.len())
        .map(|k| {
            let of_axis = |v: &Vec<f64>| (v[k] - v[k.saturating_sub(1)]).abs();
            track.drive_v.iter().map(of_axis).fold(0.0, f64::max)
        })
        .collect();
    let window = AFTER_A_STEP.max((AFTER_A_STEP_S * track.rate_hz) as usize);
    // The largest of a sliding window: what is smaller than a later one will never be the largest.
    let mut falling = std::collections::VecDeque::new();
    let mut before = vec![f64::INFINITY; track.len()];
    for k in 1..track.len() {
        while falling.back().is_some_and(|&last: &usize| step_v[last] <= step_v[k - 1]) {
            falling.pop_back();
        }
        falling.push_back(k - 1);
        if falling.front().is_some_and(|&first| first + window < k) {
            falling.pop_front();
        }
        if k > window {
            before[k] = falling.front().map_or(0.0, |&first| step_v[first]);
        }
    }
    before
}

/// Put in place of wild readings what the neighbours allow, and score nothing there.
fn replace(track: &mut Track, axis: usize, kind: Kind, runs: &[Run]) {
    let column = match kind {
        Kind::Position => &mut track.position_um[axis],
        Kind::Monitor => &mut track.monitor_v[axis],
    };
    let Some(x) = column else { return };
    for &Run { at, long, .. } in runs {
        let (before, after) = (x[at - 1], x[at + long]);
        for k in 0..long {
            x[at + k] = before + (after - before) * (k + 1) as f32 / (long + 1) as f32;
            track.present[at + k] = false;
            track.replaced.push(at + k);
        }
    }
}
