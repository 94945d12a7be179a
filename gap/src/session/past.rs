//! What each stack went through before a recording, as far as the session tells: slow strains may run on from file to file.
//!
//! A hold of a minute goes on creeping back through the next ten files. The session's clock (`start_s`) says when each file
//! began; between files the drives are at 0 V.

use std::sync::Arc;

use host_sim::Stretch;
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::guess::Ranges;
use crate::fitting::knobs::EffectRef;
use crate::search::select::Search;
use crate::session::intake::Track;
use crate::session::pyramid::MOST_LEFT_OUT;
use crate::session::scene::{Channel, Scene};

/// Growth of the stretches with their age: what is long gone acts through its mean.
const GROWTH: f64 = 1.06;
/// Shortest stretch, s.
const SHORTEST_S: f64 = 2.0e-3;

/// The effect that this is about.
pub(crate) const CREEP: &str = "creep";
/// Share of what is missing in slow motion that creep has to account for, for the past of the first recording to be set aside.
const CREEPS: f64 = 0.3;

/// Give every track the past of its axes.
pub(crate) fn remember(rig: &Rig, tracks: &mut [Track]) {
    let axes = rig.axes.len();
    let sums: Vec<Vec<Vec<f64>>> =
        tracks.iter().map(|track| (0..axes).map(|axis| sums(rig, track, axis)).collect()).collect();
    for index in 0..tracks.len() {
        let start_s = tracks[index].start_s;
        // Files whose clocks overlap tell nothing of their order.
        let before: Vec<usize> = (0..tracks.len())
            .filter(|&t| t != index && tracks[t].ends_s() <= start_s + SHORTEST_S)
            .collect();
        let Some(first_s) = before.iter().map(|&t| tracks[t].start_s).reduce(f64::min) else {
            continue;
        };
        let past = (0..axes)
            .map(|axis| {
                let volt_seconds = |from_s: f64, to_s: f64| -> f64 {
                    let within = |&t: &usize| {
                        let at = |time_s: f64| {
                            let sums = &sums[t][axis];
                            let sample = (time_s - tracks[t].start_s) * tracks[t].rate_hz;
                            sums[(sample.max(0.0) as usize).min(sums.len() - 1)]
                        };
                        at(to_s) - at(from_s)
                    };
                    before.iter().map(within).sum()
                };
                let mut stretches = Vec::new();
                let (mut age_s, mut length_s) = (0.0, SHORTEST_S);
                while age_s < start_s - first_s {
                    stretches.push(Stretch {
                        lasted_s: length_s,
                        transducer_v: volt_seconds(start_s - age_s - length_s, start_s - age_s)
                            / length_s,
                    });
                    age_s += length_s;
                    length_s = (age_s * (GROWTH - 1.0)).max(SHORTEST_S);
                }
                stretches.reverse();
                stretches.into()
            })
            .collect::<Vec<Arc<[Stretch]>>>();
        tracks[index].past = past;
    }
}

/// Whether creep runs on from file to file here, or every file begins with a stack that was given time to rest: what suits the
/// recordings better. Without creep it does not matter. Where it does, and there is some, nobody knows what the first recording is yet to
/// come back from, which is set aside: a drift of the gauges beside relaxation accounts for that, and for less elsewhere than creep does.
pub(crate) fn tell(
    scene: &mut Scene,
    rig: &Rig,
    effects: &[EffectRef],
    ranges: &Ranges,
) -> Result<(), Error> {
    let creep: Vec<EffectRef> =
        effects.iter().copied().filter(|e| e.info().name == CREEP).collect();
    if creep.is_empty() || scene.tracks.iter().all(|track| track.past.is_empty()) {
        return Ok(());
    }
    // What rings or lags would decide instead where it is louder: creep is slow.
    let left = |runs_on: bool| -> Result<(f64, bool), Error> {
        let mut slow = Scene { runs_on, ..scene.clone() };
        slow.leave_out(MOST_LEFT_OUT);
        let fitted = |c: &Channel| !c.held_out;
        let tick = || {};
        let mut search = Search::new(&slow, rig, &creep, ranges, &fitted, &tick)?;
        let Some(model) = search.run()? else { return Ok((f64::INFINITY, false)) };
        let left = model.fit.cost - search.noise;
        Ok((model.fit.cost, left < (1.0 - CREEPS) * search.gap))
    };
    let ((in_order, creeps), (file_by_file, _)) = (left(true)?, left(false)?);
    scene.runs_on = in_order <= file_by_file;
    scene.comes_back = scene.runs_on && creeps;
    if scene.comes_back { scene.set_aside_memory(rig) } else { Ok(()) }
}

/// Volt-seconds of the transducer from the start of a track to each of its samples.
///
/// At rest `T v = K x`: the measured displacement knows the voltage behind the hysteresis. Where it is not measured, or not of
/// this axis alone, the drive has to do.
fn sums(rig: &Rig, track: &Track, axis: usize) -> Vec<f64> {
    let volts_per_um = 1.0e-6 / rig.axes[axis].rest_m_per_v();
    let own_gauge = rig.output_map.is_none();
    let position = track.position_um[axis].as_ref().filter(|_| own_gauge);
    let mut sum = 0.0;
    std::iter::once(0.0)
        .chain((0..track.len()).map(|i| {
            let volts = match position {
                Some(x) if track.present[i] => f64::from(x[i]) * volts_per_um,
                _ => track.drive_v[axis][i],
            };
            sum += volts / track.rate_hz;
            sum
        }))
        .collect()
}
