//! What the stacks remember at the start of a recording: unknown, and set aside where it reaches into what is scored.

use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Output, simulate};
use rayon::prelude::*;

use crate::Error;
use crate::session::floor::Kind;
use crate::session::scene::Scene;

impl Scene {
    /// Find out in which channels the unknown memory of the stacks at the start still matters, and set it aside there. The past
    /// of a stack is taken to lie within the voltages that this session drives: a ramp to the top of them wipes it out.
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
                let swept: Vec<Output> = [high, 0.5 * high, low]
                    .into_iter()
                    .filter(|turn| *turn != 0.0)
                    .map(|turn| {
                        let past = self.after_turn(rig, track, turn)?;
                        self.output(rig, track, Axes::All, &past)
                    })
                    .collect::<Result<_, Error>>()?;
                Ok(self
                    .channels
                    .iter()
                    .filter(|c| c.track == track)
                    .map(|channel| {
                        if channel.kind == Kind::Monitor {
                            return Vec::new();
                        }
                        let base = self.residual(channel, &virgin);
                        swept
                            .iter()
                            .map(|output| {
                                self.residual(channel, output)
                                    .iter()
                                    .zip(&base)
                                    .map(|(a, b)| a - b)
                                    .collect::<Vec<f32>>()
                            })
                            .filter(|d: &Vec<f32>| {
                                d.iter().fold(0.0_f32, |m, x| m.max(x.abs())) > 0.3
                            })
                            .collect()
                    })
                    .collect())
            })
            .collect::<Result<_, Error>>()?;
        let mut rows: Vec<_> = rows.into_iter().map(Vec::into_iter).collect();
        for channel in &mut self.channels {
            let directions = rows[channel.track].next().unwrap_or_default();
            channel.memory = directions;
            channel.orthonormalise();
        }
        Ok(())
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
