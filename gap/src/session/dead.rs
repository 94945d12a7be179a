//! Axes that do not move at all where they are driven: a gauge or a stack that is not connected.
//!
//! Many effects can be made so large that nothing moves (friction of 22 kN, a stiffness two thousand times the stage's), and each of them
//! fits such recordings to the noise. None is believed.

use crate::session::floor::Kind;
use crate::session::scene::{Scene, Stack};

/// Share of the simulated motion below which an axis does not move.
const MOVES: f64 = 0.03;
/// Simulated motion from which that can be told, in units of the noise, rms.
const DRIVEN: f64 = 30.0;

/// An axis that does not move.
pub(crate) struct Dead {
    /// From 0.
    pub(crate) axis: usize,
    /// Motion of the simulation, nm rms.
    simulated_nm: f64,
    /// Motion of the gauge, nm rms.
    measured_nm: f64,
}

impl Dead {
    /// For the report.
    pub(crate) fn note(&self) -> String {
        let Self { axis, simulated_nm, measured_nm } = self;
        format!(
            "Axis {} does not move: its gauge shows {measured_nm:.1} nm rms where the drive would move it by {simulated_nm:.0} nm. A gauge or a stack \
             that is not connected does that; nothing was looked for. Leave out its column position_um_{} to diagnose the other axes.",
            axis + 1,
            axis + 1
        )
    }
}

/// Axes that do not move, from residuals of the rig as it is known, as [`Scene::raw`] gives them.
pub(crate) fn axes(scene: &Scene, raw: &Stack) -> Vec<Dead> {
    let of_axis = |axis: usize| {
        let (mut measured, mut simulated, mut samples, mut sigma_um) = (0.0, 0.0, 0.0, 0.0);
        for (channel, row) in scene.channels.iter().zip(raw) {
            let track = &scene.tracks[channel.track];
            let (Kind::Position, Some(row), Some(position)) =
                (channel.kind, row, &track.position_um[channel.axis])
            else {
                continue;
            };
            if channel.axis != axis {
                continue;
            }
            let present = channel.range.clone().zip(row).filter(|&(i, _)| track.present[i]);
            let pairs: Vec<(f64, f64)> = present
                .map(|(i, &left)| {
                    let um = f64::from(position[i]);
                    (um, um - f64::from(left) * channel.sigma)
                })
                .collect();
            let n = pairs.len() as f64;
            let mean = pairs.iter().fold((0.0, 0.0), |a, p| (a.0 + p.0 / n, a.1 + p.1 / n));
            for (um, of_model) in pairs {
                measured += (um - mean.0).powi(2);
                simulated += (of_model - mean.1).powi(2);
            }
            samples += n;
            sigma_um = channel.sigma;
        }
        let rms = |energy: f64| (energy / f64::max(samples, 1.0)).sqrt();
        let noise = samples * sigma_um * sigma_um;
        let is_dead = simulated > DRIVEN * DRIVEN * noise.max(f64::MIN_POSITIVE)
            && measured - noise < MOVES * MOVES * simulated;
        is_dead.then(|| Dead {
            axis,
            simulated_nm: 1.0e3 * rms(simulated),
            measured_nm: 1.0e3 * rms(measured),
        })
    };
    (0..scene.position_noise.len()).filter_map(of_axis).collect()
}
