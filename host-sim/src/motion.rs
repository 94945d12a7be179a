//! How the axes move, apart from what their sensors make of it.
//!
//! A sensor changes nothing before it. Fits ask for the readings of many sensors of the same motion, and the motion is nearly all of
//! the work: [`move_axes`] gives it, to be kept as long as [`Upstream`] says that it is the same, and [`read`] reads it.

use std::sync::Arc;

use crate::effects::{Place, Stage};
use crate::rig::{Axis, Rig, Setting};
use crate::simulate::{Axes, Input, Output, SimError, check};
use crate::stages::group::Group;
use crate::stages::model::Model;
use crate::stages::sensor::SensorSim;
use crate::start::Initial;

/// One axis' motion at each sample; clones share it.
#[derive(Debug, Clone)]
pub struct AxisMotion {
    /// Displacement, m.
    pub displacement_m: Arc<Vec<f64>>,
    /// Amplifier output, V.
    pub amplifier_v: Arc<Vec<f64>>,
    /// State after the last sample.
    pub end: Initial,
}

/// Motion of the axes of a rig, `None` for those that were not simulated.
pub type Motion = Vec<Option<AxisMotion>>;

/// All that the motion of one axis depends on but the drive and the initial state: two rigs in which it is equal move alike.
#[derive(Debug, Clone, PartialEq)]
pub struct Upstream {
    axes: Vec<Axis>,
    settings: Vec<Setting>,
}

impl Upstream {
    /// Of an axis (counted from 0).
    pub fn of(rig: &Rig, axis: usize) -> Self {
        let acts = |s: &&Setting| s.effect.info().stage != Stage::Sensor && s.is_active();
        let is_tied =
            rig.effects.iter().filter(acts).any(|s| matches!(s.place, Place::Pair { .. }));
        let concerns = |s: &&Setting| is_tied || s.place == Place::Axis(axis);
        Self {
            axes: if is_tied { rig.axes.clone() } else { vec![rig.axes[axis].clone()] },
            settings: rig.effects.iter().filter(acts).filter(concerns).cloned().collect(),
        }
    }
}

/// Axes that have to move for the readings of the wanted ones.
pub fn needed(rig: &Rig, wanted: Axes) -> Axes {
    Axes::Only(mask_needed(rig, wanted))
}

/// The same as a mask.
fn mask_needed(rig: &Rig, wanted: Axes) -> u32 {
    let n = rig.axes.len();
    let mut model = Model::new(rig, 1.0 / rig.sample_rate_hz);
    let sensors = SensorSim::new(&mut model.axes, model.output_map.take());
    let seen = (0..n).filter(|&sensor| wanted.contains(sensor)).flat_map(|sensor| {
        // The monitor of an axis is its own, whatever its sensor sees.
        sensors.axes_of(sensor).into_iter().chain([sensor])
    });
    seen.fold(0, |mask, axis| mask | 1 << axis)
}

/// Move axes under a drive without lost ticks: those asked for, and those that springs tie to them.
pub fn move_axes(rig: &Rig, input: &Input, axes: Axes) -> Result<Motion, SimError> {
    check(rig, input)?;
    let step_s = 1.0 / input.sample_rate_hz;
    let mut model = Model::new(rig, step_s);
    // What a sensor block holds is not needed here.
    SensorSim::new(&mut model.axes, None);
    let mut motion: Motion = vec![None; rig.axes.len()];
    for mut group in Group::split(model.axes, &model.springs, step_s, true) {
        if group.members.iter().any(|&axis| axes.contains(axis)) {
            move_group(&mut group, input, &mut motion);
        }
    }
    Ok(motion)
}

fn move_group(group: &mut Group, input: &Input, motion: &mut Motion) {
    let step_s = 1.0 / input.sample_rate_hz;
    let samples = input.drive_v[0].len();
    let rested = Initial::default();
    let monitor = |axis: usize, sample: usize| input.monitor_v.map(|all| all[axis][sample]);
    group.start(
        |axis| input.drive_v[axis][0],
        |axis| input.initial.get(axis).unwrap_or(&rested),
        |axis| monitor(axis, 0),
        input.start_s,
    );
    let members = group.members.clone();
    let mut x: Vec<Vec<f64>> = members.iter().map(|_| Vec::with_capacity(samples)).collect();
    let mut v: Vec<Vec<f64>> = members.iter().map(|_| Vec::with_capacity(samples)).collect();
    let time_s = |sample: usize| input.start_s + (sample + 1) as f64 * step_s;
    if group.is_alone() {
        let (x, v) = (&mut x[0], &mut v[0]);
        x.push(group.axes()[0].position_m());
        v.push(group.axes()[0].output_v());
        group.follow(
            samples - 1,
            |sample, axis| input.drive_v[axis][sample],
            |sample, axis| monitor(axis, sample + 1),
            time_s,
            |_, position_m, output_v| {
                x.push(position_m);
                v.push(output_v);
            },
        );
    } else {
        let mut reached = |slot: usize, position_m, output_v| {
            x[slot].push(position_m);
            v[slot].push(output_v);
        };
        for (slot, axis) in group.axes().iter().enumerate() {
            reached(slot, axis.position_m(), axis.output_v());
        }
        group.follow_tied(
            samples - 1,
            |sample, axis| input.drive_v[axis][sample],
            |sample, axis| monitor(axis, sample + 1),
            time_s,
            reached,
        );
    }
    for ((slot, &member), (x, v)) in members.iter().enumerate().zip(x.into_iter().zip(v)) {
        motion[member] = Some(AxisMotion {
            displacement_m: Arc::new(x),
            amplifier_v: Arc::new(v),
            end: group.axes()[slot].state(),
        });
    }
}

/// What the wanted sensors read of a motion; every axis that [`needed`] names has to be in it.
pub fn read(rig: &Rig, input: &Input, motion: Motion, wanted: Axes) -> Result<Output, SimError> {
    let n = rig.axes.len();
    let samples = input.drive_v[0].len();
    let step_s = 1.0 / input.sample_rate_hz;
    let mask = mask_needed(rig, wanted);
    if let Some(axis) = (0..n).find(|&axis| mask >> axis & 1 == 1 && motion[axis].is_none()) {
        return Err(SimError(format!("expected the motion of axis {}, found none", axis + 1)));
    }
    let mut model = Model::new(rig, step_s);
    let mut sensors = SensorSim::new(&mut model.axes, model.output_map.take());
    let mut output = Output {
        position_m: vec![Vec::new(); n],
        monitor_v: vec![Vec::new(); n],
        end: vec![Initial::default(); n],
    };
    let displacement_m: Vec<&[f64]> = motion
        .iter()
        .map(|m| m.as_ref().map_or(&[][..], |m| m.displacement_m.as_slice()))
        .collect();
    let (bare, others): (Vec<usize>, Vec<usize>) =
        (0..n).filter(|&sensor| wanted.contains(sensor)).partition(|&s| sensors.is_bare(s));
    for sensor in bare {
        output.position_m[sensor] = sensors.bare_readings(sensor, &displacement_m, samples);
    }
    if !others.is_empty() {
        let mut readings = vec![0.0; n];
        for &sensor in &others {
            output.position_m[sensor].reserve_exact(samples);
        }
        for sample in 0..samples {
            let time_s = input.start_s + sample as f64 * step_s;
            let displacement =
                |axis: usize| displacement_m[axis].get(sample).copied().unwrap_or(0.0);
            sensors.read(displacement, time_s, |sensor| others.contains(&sensor), &mut readings);
            for &sensor in &others {
                output.position_m[sensor].push(readings[sensor]);
            }
        }
    }
    for (axis, moved) in motion.into_iter().enumerate() {
        let Some(AxisMotion { amplifier_v, end, .. }) = moved else { continue };
        output.end[axis] = end;
        if wanted.contains(axis) {
            output.monitor_v[axis] = Arc::unwrap_or_clone(amplifier_v);
        }
    }
    Ok(output)
}
