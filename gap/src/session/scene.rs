//! A session ready to be compared with simulations: channels, their noise, and whitened residuals.
//!
//! A [`Channel`] is one measured quantity of one axis in one recording (or block of it). Its residual is split into bands
//! ([`crate::session::pyramid`]), divided by the noise of the band, and by a tolerance for the form of the model:
//! `variance = noise + (tolerance * nominal gap in this band)^2`. An effect of the right kind but of a slightly other
//! form than the rig's then ranks by how much of the gap it removes in *every* band, level and axis, rather than by
//! the one loud recording. Residuals are measured minus simulated.

use std::sync::Arc;

use host_sim::rig::Rig;
use host_sim::{Axes, Output};
use rayon::prelude::*;

use crate::Error;
pub use crate::session::channel::{Channel, dot};
use crate::session::floor::{self, Kind, Noise};
use crate::session::intake::Track;
use crate::session::motions::Motions;
use crate::session::work::Work;

/// Share of the nominal gap of a band that a correct effect of another form may leave.
pub const TOLERANCE: f64 = 0.05;
pub(super) const METRES_TO_UM: f64 = 1.0e6;
/// Until then an amplifier is where the recording began, s.
const AMPLIFIER_SETTLES_S: f64 = 0.05;

/// Whitened residuals, one entry a channel; `None` where the simulation could not have changed it.
pub type Stack = Vec<Option<Vec<f32>>>;

/// Whitened rows of some channels.
type Rows = Vec<(usize, Vec<f32>)>;

/// A session and how it is compared.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Recordings on their clocks.
    pub tracks: Arc<Vec<Track>>,
    /// What is compared.
    pub channels: Vec<Channel>,
    /// Position noise of each axis.
    pub position_noise: Vec<Option<Noise>>,
    /// Monitor noise of each axis.
    pub monitor_noise: Vec<Option<Noise>>,
    /// Slow strains of one recording are still there in the next.
    pub runs_on: bool,
    /// Stacks come back from strains of before the session in its first recording, which is set aside.
    pub comes_back: bool,
    /// Motions that may be asked for again.
    pub(crate) motions: Arc<Motions>,
    /// What was simulated.
    pub(crate) work: Arc<Work>,
}

/// What a simulation is wanted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wanted {
    /// Bit mask of axes.
    pub axes: u32,
    /// Compare the amplifier monitors too.
    pub monitors: bool,
}

impl Wanted {
    /// Everything.
    pub const ALL: Self = Self { axes: u32::MAX, monitors: true };
}

impl Scene {
    /// Channels and noise of a session; weights are those of the noise alone until [`Channel::weigh`] is called.
    pub fn new(rig: &Rig, tracks: Vec<Track>) -> Self {
        let axes = rig.axes.len();
        let noise =
            |axis: usize, kind: Kind| floor::noise(&tracks, axis, kind, kind.stated(rig, axis));
        let position_noise: Vec<_> = (0..axes).map(|a| noise(a, Kind::Position)).collect();
        let monitor_noise: Vec<_> = (0..axes).map(|a| noise(a, Kind::Monitor)).collect();
        let mut channels = Vec::new();
        for (index, track) in tracks.iter().enumerate() {
            for axis in 0..axes {
                for (kind, column, noise) in [
                    (Kind::Position, &track.position_um[axis], &position_noise[axis]),
                    (Kind::Monitor, &track.monitor_v[axis], &monitor_noise[axis]),
                ] {
                    let (Some(_), Some(noise)) = (column, noise) else { continue };
                    // What an amplifier does while the stack comes to a known memory says as much of it as later.
                    let from = match kind {
                        Kind::Position => track.settle,
                        Kind::Monitor => {
                            track.settle.min((AMPLIFIER_SETTLES_S * track.rate_hz) as usize)
                        }
                    };
                    let range = from..track.len();
                    channels.push(Channel::new(index, track, axis, kind, noise.sigma, range));
                }
            }
        }
        let samples = axes * tracks.iter().map(Track::len).sum::<usize>();
        Self {
            tracks: Arc::new(tracks),
            channels,
            position_noise,
            monitor_noise,
            runs_on: true,
            comes_back: false,
            motions: Arc::new(Motions::new(samples)),
            work: Arc::new(Work::new(samples)),
        }
    }

    /// The same session for a rig, every recording taken by itself, as a replay of a single file does: what runs on from the one before
    /// is known as far as its own lead-in tells.
    pub fn file_by_file(&self, rig: &Rig) -> Result<Self, Error> {
        let pasts: Vec<_> = (0..self.tracks.len())
            .into_par_iter()
            .map(|track| self.past_by_lead_in(rig, track))
            .collect::<Result<_, Error>>()?;
        let mut alone = self.clone();
        alone.runs_on = pasts.iter().any(|past| !past.is_empty());
        if alone.runs_on {
            let tracks = alone.tracks.iter().zip(pasts);
            alone.tracks =
                Arc::new(tracks.map(|(track, past)| Track { past, ..track.clone() }).collect());
            alone.motions = Arc::new(Motions::new(0));
        }
        Ok(alone)
    }

    /// Cost of a stack over the channels of the axes in a mask.
    pub fn cost_on(&self, stack: &Stack, axes: u32) -> f64 {
        let rows = stack.iter().zip(&self.channels).filter(|(_, c)| axes >> c.axis & 1 == 1);
        rows.filter_map(|(row, _)| row.as_ref()).map(|row| dot(row, row)).sum()
    }

    /// Cost that noise alone would leave there.
    pub fn noise_on(&self, stack: &Stack, axes: u32) -> f64 {
        let rows = stack.iter().zip(&self.channels).filter(|(_, c)| axes >> c.axis & 1 == 1);
        rows.filter(|(row, _)| row.is_some()).map(|(_, c)| c.noise_cost()).sum()
    }

    /// Start of the first recording and end of the last, on the session's clock, s.
    pub fn clock_s(&self) -> (f64, f64) {
        let ends = self.tracks.iter().map(|t| (t.start_s, t.ends_s()));
        ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), (start, end)| {
            (first.min(start), last.max(end))
        })
    }

    /// Energy of positions beyond noise in a whitened stack, the weights undone.
    pub fn excess(&self, stack: &Stack) -> f64 {
        self.excess_on(stack, u32::MAX)
    }

    /// The same on the axes in the mask alone.
    pub fn excess_on(&self, stack: &Stack, axes: u32) -> f64 {
        let is_asked = |c: &Channel| c.kind == Kind::Position && axes >> c.axis & 1 == 1;
        let rows = stack.iter().zip(&self.channels).filter(|(_, c)| is_asked(c));
        rows.filter_map(|(row, c)| row.as_ref().map(|row| c.excess(row))).sum()
    }

    /// A stack with the channels of one axis alone.
    pub fn on_axis(&self, stack: &Stack, axis: usize) -> Stack {
        let rows = stack.iter().zip(&self.channels);
        rows.map(|(row, c)| row.as_ref().filter(|_| c.axis == axis).cloned()).collect()
    }

    /// Give the `fastest` bands of every channel no weight.
    pub fn leave_out(&mut self, fastest: usize) {
        if fastest > 0 {
            self.channels.iter_mut().for_each(|channel| channel.leave_out(fastest));
        }
    }

    /// Residual of a channel in units of its noise, not whitened, over its scored samples.
    pub fn residual(&self, channel: &Channel, output: &Output) -> Vec<f32> {
        let track = &self.tracks[channel.track];
        let (measured, simulated, scale) = match channel.kind {
            Kind::Position => {
                (&track.position_um[channel.axis], &output.position_m[channel.axis], METRES_TO_UM)
            }
            Kind::Monitor => (&track.monitor_v[channel.axis], &output.monitor_v[channel.axis], 1.0),
        };
        let Some(measured) = measured else { return vec![0.0; channel.range.len()] };
        let per_sigma = 1.0 / channel.sigma;
        let range = channel.range.clone();
        let left = |(m, s): (&f32, &f64)| ((f64::from(*m) - s * scale) * per_sigma) as f32;
        let (measured, simulated) = (&measured[range.clone()], &simulated[range.clone()]);
        let mut row: Vec<f32> = measured.iter().zip(simulated).map(left).collect();
        for (x, present) in row.iter_mut().zip(&track.present[range]) {
            if !present {
                *x = 0.0;
            }
        }
        row
    }

    /// Whitened residuals of every rig, in parallel over rigs and recordings.
    pub fn residuals(
        &self,
        rigs: &[(&Rig, Wanted)],
        include: impl Fn(&Channel) -> bool + Sync,
    ) -> Result<Vec<Stack>, Error> {
        self.stacks(rigs, include, false)
    }

    /// Whitened residuals of a rig whose neighbours will be asked for: it is kept how its axes move.
    pub fn residuals_at(
        &self,
        rig: &Rig,
        wanted: Wanted,
        include: impl Fn(&Channel) -> bool + Sync,
    ) -> Result<Stack, Error> {
        Ok(self.stacks(&[(rig, wanted)], include, true)?.remove(0))
    }

    fn stacks(
        &self,
        rigs: &[(&Rig, Wanted)],
        include: impl Fn(&Channel) -> bool + Sync,
        keep: bool,
    ) -> Result<Vec<Stack>, Error> {
        // The longest ones first, each by itself, or one core would wait for the other.
        let mut order: Vec<usize> = (0..self.tracks.len()).collect();
        order.sort_by_key(|&track| std::cmp::Reverse(self.tracks[track].len()));
        let jobs: Vec<(usize, usize)> =
            order.iter().flat_map(|&track| (0..rigs.len()).map(move |rig| (rig, track))).collect();
        let done: Vec<(usize, Rows)> = jobs
            .into_par_iter()
            .with_max_len(1)
            .map(|(index, track)| {
                let (rig, wanted) = rigs[index];
                let mine: Vec<usize> = (0..self.channels.len())
                    .filter(|&c| {
                        let channel = &self.channels[c];
                        channel.track == track
                            && wanted.axes >> channel.axis & 1 == 1
                            && (wanted.monitors || channel.kind == Kind::Position)
                            && include(channel)
                    })
                    .collect();
                if mine.is_empty() {
                    return Ok((index, Vec::new()));
                }
                let mask = mine.iter().fold(0_u32, |m, &c| m | 1 << self.channels[c].axis);
                let output = self.recalled(rig, track, Axes::Only(mask), keep)?;
                let rows = mine
                    .into_iter()
                    .map(|c| {
                        (c, self.channels[c].whiten(&self.residual(&self.channels[c], &output)))
                    })
                    .collect();
                Ok((index, rows))
            })
            .collect::<Result<_, Error>>()?;
        let mut stacks: Vec<Stack> = vec![vec![None; self.channels.len()]; rigs.len()];
        for (index, rows) in done {
            for (channel, row) in rows {
                stacks[index][channel] = Some(row);
            }
        }
        Ok(stacks)
    }

    /// Residuals over time in units of the noise, what an unknown memory could have caused taken out.
    pub fn raw(
        &self,
        rig: &Rig,
        include: impl Fn(&Channel) -> bool + Sync,
    ) -> Result<Stack, Error> {
        let rows: Vec<Vec<(usize, Vec<f32>)>> = (0..self.tracks.len())
            .into_par_iter()
            .map(|track| {
                let mine: Vec<usize> = (0..self.channels.len())
                    .filter(|&c| self.channels[c].track == track && include(&self.channels[c]))
                    .collect();
                if mine.is_empty() {
                    return Ok(Vec::new());
                }
                let output = self.recalled(rig, track, Axes::All, false)?;
                Ok(mine
                    .into_iter()
                    .map(|c| {
                        let mut row = self.residual(&self.channels[c], &output);
                        self.channels[c].remove_memory(&mut row);
                        (c, row)
                    })
                    .collect())
            })
            .collect::<Result<_, Error>>()?;
        let mut stack: Stack = vec![None; self.channels.len()];
        for (c, row) in rows.into_iter().flatten() {
            stack[c] = Some(row);
        }
        Ok(stack)
    }
}
