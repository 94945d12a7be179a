//! Recordings as the rest of the crate wants them: one [`Track`] a file, on the uniform sample clock of the recording.
//!
//! Lost ticks are filled by holding the last drive and are never scored, nor is the settling part, nor the first
//! milliseconds after a gap (what the drive did meanwhile is not known, and what a stack remembers of a long one is set aside in
//! [`crate::session::memory`]). Units: volts and micrometres as recorded.

use std::ops::Range;
use std::sync::Arc;

use host_sim::rig::Rig;
use host_sim::stages::pace::lively_share;
use host_sim::{RATES_HZ, Stretch};
use recording::{Entry, Recording, Session};

use crate::Error;
use crate::session::period::{self, Told};
use crate::session::wild;
use crate::session::work::Ticks;

/// Time after lost ticks in which nothing is scored, in seconds: five time constants of a slow amplifier.
const RECOVERY_S: f64 = 5.0e-3;
/// Fewest scored samples that make a recording worth reading.
const FEWEST_SAMPLES: usize = 32;

/// One recording on its uniform clock.
#[derive(Debug, Clone)]
pub struct Track {
    /// File name inside the session.
    pub file: String,
    /// Free text of the recording.
    pub experiment: String,
    /// Sample rate in Hz.
    pub rate_hz: f64,
    /// Start on the session's clock in seconds.
    pub start_s: f64,
    /// Period of a periodic excitation in seconds, if the drive repeats with it.
    pub period_s: Option<f64>,
    /// Drive of every axis of the rig, volts, held from its tick to the next.
    pub drive_v: Vec<Vec<f64>>,
    /// Share of the ticks in which that asks an axis for more than a calm one.
    pub lively: Vec<f64>,
    /// Measured amplifier output of the axes that have it, volts.
    pub monitor_v: Vec<Option<Vec<f32>>>,
    /// Measured position of the axes that have it, micrometres.
    pub position_um: Vec<Option<Vec<f32>>>,
    /// Tick of the first sample.
    pub first_tick: u64,
    /// First sample to score.
    pub settle: usize,
    /// Samples before `settle_s`: no position is scored there.
    pub lead_in: usize,
    /// `true` where a sample was recorded, is not wild, and is not too soon after a loss.
    pub present: Vec<bool>,
    /// Samples of which a wild reading was replaced by what its neighbours allow.
    pub(crate) replaced: Vec<usize>,
    /// Where samples were lost.
    pub(crate) holes: Vec<Range<usize>>,
    /// Lost ticks in this file.
    pub lost: u64,
    /// `true` when a setpoint was recorded: the drive may then depend on the measured position.
    pub closed_loop: bool,
    /// What the stack of each axis went through before, the oldest first; empty where the session does not tell.
    pub past: Vec<Arc<[Stretch]>>,
}

impl Track {
    /// Samples on the uniform clock.
    pub fn len(&self) -> usize {
        self.present.len()
    }

    /// `true` for a track without samples.
    pub fn is_empty(&self) -> bool {
        self.present.is_empty()
    }

    /// What a simulation of it goes through.
    pub(crate) fn ticks(&self) -> Ticks<'_> {
        Ticks { many: self.len(), step_s: 1.0 / self.rate_hz, lively: &self.lively }
    }

    /// End on the session's clock, seconds.
    pub fn ends_s(&self) -> f64 {
        self.start_s + self.len() as f64 / self.rate_hz
    }

    /// Time of a sample from the start of the file, seconds.
    pub fn time_s(&self, sample: usize) -> f64 {
        sample as f64 / self.rate_hz
    }
}

/// Check a session against its rig and lay every recording on its clock. Recordings with nothing to score are passed over and
/// named beside the tracks, with the session's own notes, unless there are no others.
pub fn tracks(rig: &Rig, session: &Session) -> Result<(Vec<Track>, Vec<String>), Error> {
    if session.recordings.is_empty() {
        return Err(Error::Session("no recording in the folder".into()));
    }
    let short = |r: &Recording| r.len() < r.settle_rows() + FEWEST_SAMPLES;
    let all_short = session.recordings.iter().all(|entry| short(&entry.recording));
    let mut tracks = Vec::with_capacity(session.recordings.len());
    let mut passed_over = session.notes.clone();
    let mut not_their_periods = Vec::new();
    let mut any_repeats = false;
    let mut unscored = Vec::new();
    for entry in &session.recordings {
        if short(&entry.recording) && !all_short {
            passed_over.push(format!(
                "{}: nothing to score after settle_s = {} s; passed over.",
                entry.file, entry.recording.meta.settle_s
            ));
            // One that cannot be laid on its clock tells nothing of the past either.
            unscored.extend(track(rig, entry).map(|(track, _)| track));
            continue;
        }
        let (track, period) = track(rig, entry)?;
        match period {
            Told::Otherwise(note) => not_their_periods.push((entry.file.as_str(), note)),
            Told::Repeats => any_repeats = true,
            Told::Nothing => {}
        }
        let scored = track.present.iter().skip(track.settle).filter(|&&p| p).count();
        if scored < FEWEST_SAMPLES {
            return Err(Error::Recording {
                file: entry.path.display().to_string(),
                message: format!(
                    "{scored} of {} samples can be scored: expected at least {FEWEST_SAMPLES} after settle_s = {} s (the first {} ms, \
                     and as much after lost ticks, are not scored either)",
                    entry.recording.len(),
                    entry.recording.meta.settle_s,
                    1.0e3 * RECOVERY_S
                ),
            });
        }
        tracks.push(track);
    }
    if !not_their_periods.is_empty() && !any_repeats {
        // Drives that stand still cannot contradict what is wrong of all the others.
        tracks.iter_mut().for_each(|track| track.period_s = None);
    }
    passed_over.extend(period::note(&not_their_periods));
    // The stacks went through those as well.
    let scored = tracks.len();
    tracks.extend(unscored);
    passed_over.extend(wild::leave_out(rig, &mut tracks)?);
    crate::session::past::remember(rig, &mut tracks);
    tracks.truncate(scored);
    Ok((tracks, passed_over))
}

/// A recording on its clock, and what its drive says of its period.
fn track(rig: &Rig, entry: &Entry) -> Result<(Track, Told), Error> {
    let recording = &entry.recording;
    let bad =
        |message: String| Error::Recording { file: entry.path.display().to_string(), message };
    if !RATES_HZ.contains(&recording.meta.sample_rate_hz) {
        return Err(bad(format!(
            "sample_rate_hz: expected {} to {} samples a second, found {}",
            RATES_HZ.start(),
            RATES_HZ.end(),
            recording.meta.sample_rate_hz
        )));
    }
    let axes = rig.axes.len();
    let extra = (axes..recording.axes()).find(|&axis| {
        recording.position_um[axis].is_some() || recording.drive_v[axis].iter().any(|&v| v != 0.0)
    });
    if let Some(axis) = extra {
        return Err(bad(format!(
            "columns of axis {} found, but rig `{}` has {axes} axis(es): use the rig file of these recordings",
            axis + 1,
            rig.name
        )));
    }
    if recording.position_um.iter().all(Option::is_none) {
        return Err(bad("no position_um_K column: expected at least one measured axis".into()));
    }
    let first = *recording.tick.first().ok_or_else(|| bad("no samples".into()))?;
    let span = recording.span_ticks();
    if span > 8 * recording.len() as u64 + 1_000_000 {
        return Err(bad(format!(
            "{} of {span} ticks are lost: too little is left to simulate through",
            span - recording.len() as u64
        )));
    }
    let n = span as usize;
    let at: Vec<usize> = recording.tick.iter().map(|&tick| (tick - first) as usize).collect();
    let recovery = (RECOVERY_S * recording.meta.sample_rate_hz).ceil() as usize;
    let mut present = vec![false; n];
    let mut previous: Option<usize> = None;
    let mut resume = 0;
    let mut holes = Vec::new();
    for &sample in &at {
        if let Some(last) = previous.filter(|last| sample > last + 1) {
            resume = sample + recovery;
            holes.push(last + 1..sample);
        }
        present[sample] = sample >= resume;
        previous = Some(sample);
    }
    // The state of amplifier and stack before the first sample is not known: nothing is scored for a moment.
    let settle =
        (recording.meta.settle_s.max(RECOVERY_S) * recording.meta.sample_rate_hz).ceil() as usize;
    let held = |column: &[f32]| -> Vec<f64> {
        let mut out = vec![0.0; n];
        for (row, &sample) in at.iter().enumerate() {
            let end = at.get(row + 1).copied().unwrap_or(n);
            out[sample..end].fill(f64::from(column[row]));
        }
        out
    };
    let spread = |column: &Option<Vec<f32>>| -> Option<Vec<f32>> {
        column.as_ref().map(|values| {
            let mut out = vec![0.0; n];
            for (row, &sample) in at.iter().enumerate() {
                out[sample] = values[row];
            }
            out
        })
    };
    let pick = |columns: &[Option<Vec<f32>>], axis: usize| columns.get(axis).and_then(spread);
    let closed_loop = recording.reference_um.iter().any(Option::is_some);
    let drive_v: Vec<Vec<f64>> = (0..axes)
        .map(|axis| recording.drive_v.get(axis).map_or_else(|| vec![0.0; n], |c| held(c)))
        .collect();
    let period = period::told(rig, recording, &drive_v, &present, settle);
    let track = Track {
        file: entry.file.clone(),
        experiment: recording.meta.experiment.clone(),
        rate_hz: recording.meta.sample_rate_hz,
        start_s: recording.meta.start_s,
        period_s: recording.meta.period_s.filter(|_| !matches!(period, Told::Otherwise(_))),
        lively: drive_v.iter().map(|volts| lively_share(volts)).collect(),
        drive_v,
        monitor_v: (0..axes).map(|axis| pick(&recording.monitor_v, axis)).collect(),
        position_um: (0..axes).map(|axis| pick(&recording.position_um, axis)).collect(),
        first_tick: first,
        settle,
        lead_in: recording.settle_ticks() as usize,
        present,
        replaced: Vec::new(),
        holes,
        lost: n as u64 - recording.len() as u64,
        closed_loop,
        past: Vec::new(),
    };
    Ok((track, period))
}
