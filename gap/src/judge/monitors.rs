//! What the amplifier monitors still miss speaks against causes behind the amplifier.
//!
//! A monitor reads what drives the stack. Where it differs from what the rig and the causes say, and by enough to move the stage by a
//! good part of the gap, something before the stack is missing: a gauge with an offset may account for all that the gauge reads, and yet
//! it was the drive that was shifted.

use host_sim::rig::Rig;

use crate::diagnosis::AxisGap;
use crate::judge::accept;
use crate::session::floor::Kind;
use crate::session::scene::{Scene, Stack};

/// Share of the gap energy of an axis that what its monitor misses would make.
const MATTERS: f64 = 0.1;
/// What is missing, as a share of the noise energy of the monitor, from which it is no error in that: the noise is known to a per cent.
const BEYOND_NOISE: f64 = 0.2;

/// What a monitor misses, volts rms beyond its noise: with the rig as given, and with the causes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Missing {
    pub before_v: f64,
    pub after_v: f64,
}

/// For each axis what its monitor has against the causes, if anything: raw residuals `before` and `after` them, and the gaps of the
/// positions. An axis without a gap has nothing to explain, and where gauges read several axes no gap is of one monitor.
pub(crate) fn contradicted(
    rig: &Rig,
    scene: &Scene,
    [before, after]: [&Stack; 2],
    gaps: &[AxisGap],
) -> Vec<Option<Missing>> {
    let of_axis = |axis: usize| {
        let gap = gaps.iter().find(|gap| gap.axis == axis + 1 && gap.energy_nm2() > 0.0)?;
        let missing = Missing {
            before_v: missing_v(scene, before, axis)?,
            after_v: missing_v(scene, after, axis)?,
        };
        let closed = 1.0 - (missing.after_v / missing.before_v).powi(2);
        let moves_nm = missing.after_v * rig.axes[axis].rest_m_per_v() * 1.0e9;
        let matters = moves_nm.powi(2) > MATTERS * gap.energy_nm2();
        (matters && !accept::names(closed)).then_some(missing)
    };
    (0..rig.axes.len()).map(|axis| of_axis(axis).filter(|_| rig.output_map.is_none())).collect()
}

/// Root mean square of what a stack leaves of the monitor of an axis, beyond its noise, V; `None` where it was not recorded, or nothing
/// is left.
fn missing_v(scene: &Scene, stack: &Stack, axis: usize) -> Option<f64> {
    let (mut energy, mut floor, mut samples) = (0.0, 0.0, 0.0);
    for (channel, row) in scene.channels.iter().zip(stack) {
        let Some(row) =
            row.as_ref().filter(|_| (channel.kind, channel.axis) == (Kind::Monitor, axis))
        else {
            continue;
        };
        energy += row.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() * channel.sigma.powi(2);
        floor += channel.raw_floor() * channel.sigma.powi(2);
        samples += channel.samples();
    }
    let missing = energy - floor;
    (missing > BEYOND_NOISE * floor).then(|| (missing / samples).sqrt())
}
