//! Runs a world through an experiment.
//!
//! Fixed steps of 6.25 us (16 to a tick at 10 kHz); implicit (average acceleration) in the mechanics and in the
//! stack's charge together, so that the 32 kHz mode of stack and mechanism is followed without a limit on the step. Only the
//! neighbours' forces, small against the stack's stiffness, enter explicitly.

mod mechanics;

use std::f64::consts::TAU;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use recording::{Meta, Recording};

use crate::excitation::{Drive, Experiment};
use crate::world::{AxisWorld, World};
use mechanics::{Outside, mechanics};

/// How finely, and whether converters and noise are there.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Longest step (s).
    pub step_s: f64,
    /// Whether gauge and monitor have noise and steps.
    pub noise: bool,
}

impl Options {
    /// For recordings.
    pub const FINE: Self = Self { step_s: 6.25e-6, noise: true };
    /// For finding out how large an effect is.
    pub const ROUGH: Self = Self { step_s: 20e-6, noise: false };
}

/// What moves fast, per axis; starts anew with each file.
struct Moving {
    command: Vec<f32>,
    pole_v: f64,
    slope_v_per_s: f64,
    output_v: f64,
    hum_v: f64,
    position_m: f64,
    speed: f64,
    acceleration: f64,
    voltage_z: f64,
    charge_rate: f64,
    drive_rate: f64,
    relaxing_v: f64,
    driven_v: f64,
    creep_v: f64,
    creep_table: Vec<(f64, f64)>,
    branches: Vec<f64>,
    modes: Vec<(f64, f64)>,
    friction_n: f64,
    contacts_n: Vec<f64>,
    filter: (f64, f64),
    outside_n: f64,
    /// Delay of the command (steps), and shares by which the poles approach their targets in a step.
    delay_steps: f64,
    amplifier_share: f64,
    second_share: f64,
    branch_shares: Vec<f64>,
    gauge_share: f64,
}

/// Charge (C) that no past of a stack exceeded: below what the settling ramp to 100 V draws, since that is what a ramp is for.
fn past_c(axis: &AxisWorld) -> f64 {
    let constants = &axis.constants;
    let stiffness = constants.stiffness_n_per_m + constants.mechanism_n_per_m;
    let free = constants.capacitance_f + constants.transformer_n_per_v.powi(2) / stiffness;
    let slip_v: f64 = constants.slip.iter().map(|slip| slip.1).sum();
    let top_v = axis.clip.1.min(100.0) * axis.drive.0.min(1.0) + axis.drive.1.min(0.0);
    free * (0.85 * top_v - 1.2 * slip_v).max(0.1 * top_v)
}

/// Runs one experiment; slow states and faults of `world` run on, the rest starts anew with a random memory of the stacks.
///
/// `idle_s` is the time since the last experiment ended, with the drives at 0 V.
pub fn run(world: &mut World, experiment: &Experiment, idle_s: f64, options: Options) -> Recording {
    let axes = world.axes.len();
    let rate = experiment.sample_rate_hz;
    // Added masses bring modes of some kilohertz, which want fine steps; where samples are slow, nothing fast is seen.
    let fast =
        world.axes.iter().any(|axis| !axis.modes.is_empty() || axis.constants.mass_kg > 5e-3);
    let longest = options.step_s * if fast { 1.0 } else { (rate / 2500.0).recip().clamp(1.0, 4.0) };
    let steps = (1.0 / (rate * longest)).ceil().max(1.0) as usize;
    let dt = 1.0 / (rate * steps as f64);
    // Neighbours' forces at the new time by extrapolation; coarse steps would amplify the 32 kHz ringing through it.
    let ahead = if dt < 15e-6 { dt } else { 0.0 };
    let mut rng = StdRng::seed_from_u64(experiment.seed);
    let mut moving: Vec<Moving> = Vec::new();
    for (index, axis) in world.axes.iter_mut().enumerate() {
        let mut memory = StdRng::seed_from_u64(experiment.seed ^ (0x5eed << 20) ^ index as u64);
        axis.hysteresis.scramble(past_c(axis), &mut memory);
        if let Some(creep) = &mut axis.creep {
            let table = creep.table(idle_s);
            creep.step(&table, 0.0);
        }
        moving.push(Moving {
            command: Vec::with_capacity(experiment.ticks()),
            pole_v: 0.0,
            slope_v_per_s: 0.0,
            output_v: 0.0,
            hum_v: 0.0,
            position_m: 0.0,
            speed: 0.0,
            acceleration: 0.0,
            voltage_z: 0.0,
            charge_rate: 0.0,
            drive_rate: 0.0,
            relaxing_v: 0.0,
            driven_v: 0.0,
            creep_v: 0.0,
            creep_table: axis.creep.as_ref().map_or_else(Vec::new, |creep| creep.table(1.0 / rate)),
            branches: vec![0.0; axis.branches.len()],
            modes: vec![(0.0, 0.0); axis.modes.len()],
            friction_n: 0.0,
            contacts_n: vec![0.0; axis.contacts.len()],
            filter: (0.0, 0.0),
            outside_n: 0.0,
            delay_steps: 0.0,
            amplifier_share: share(dt, axis.constants.amplifier_s),
            second_share: share(dt, axis.second_pole_s.max(1e-12)),
            branch_shares: axis.branches.iter().map(|&(_, time)| share(dt, time)).collect(),
            gauge_share: axis
                .lowpass
                .map_or(1.0, |lowpass| share(dt, 1.0 / (TAU * lowpass.corner_hz))),
        });
    }

    come_to_rest(world, &mut moving, dt);

    let meta = Meta {
        experiment: experiment.name.clone(),
        sample_rate_hz: rate,
        settle_s: experiment.settle_s,
        start_s: experiment.start_s,
        rig: world.name.clone(),
        period_s: experiment.period_s,
        initial_position_um: None,
    };
    let mut recording = Recording::empty(meta, axes);
    let ticks = experiment.ticks();
    recording.tick = (0..ticks as u64).collect();
    let mut positions = vec![Vec::with_capacity(ticks); axes];
    let mut monitors = vec![Vec::with_capacity(ticks); axes];
    let mut integral = vec![0.0; axes];
    let closed = matches!(experiment.drive, Drive::Closed { .. });
    let mut references = vec![Vec::new(); axes];

    let (mut commands, mut displacements) = (vec![0.0; axes], vec![0.0; axes]);

    for tick in 0..ticks {
        let time = experiment.start_s + tick as f64 / rate;
        // Sampled first: this tick's drive has not acted yet.
        let seen: Vec<f64> = (0..axes).map(|axis| seen_m(world, &moving, axis)).collect();
        for (index, (axis, state)) in world.axes.iter_mut().zip(&mut moving).enumerate() {
            let mut reading = gauge(axis, state, seen[index], time);
            for fault in world.faults.iter_mut().filter(|fault| fault.axis == index) {
                reading = fault.reading(tick, time, reading, &seen);
            }
            let mut monitor = state.output_v;
            let constants = &axis.constants;
            if options.noise {
                reading += constants.noise_m * rng.sample::<f64, _>(StandardNormal);
                monitor += constants.monitor_v.0 * rng.sample::<f64, _>(StandardNormal);
                if constants.resolution_m > 0.0 {
                    reading = (reading / constants.resolution_m).round() * constants.resolution_m;
                }
                if constants.monitor_v.1 > 0.0 {
                    monitor = (monitor / constants.monitor_v.1).round() * constants.monitor_v.1;
                }
            }
            let measured_um = reading * 1e6;
            positions[index].push(measured_um as f32);
            monitors[index].push(monitor as f32);
            let command = match &experiment.drive {
                Drive::Open(tables) => tables[index][tick],
                Drive::Closed { settle, reference_um, proportional, integral: gain } => {
                    let wanted = reference_um[index][tick];
                    references[index].push(wanted);
                    match settle.get(tick) {
                        Some(&volts) => volts,
                        None => {
                            let error = f64::from(wanted) - measured_um;
                            integral[index] += gain * error / rate;
                            let volts =
                                f64::from(wanted) * 8.8 + proportional * error + integral[index];
                            volts.clamp(0.0, 120.0) as f32
                        }
                    }
                }
            };
            state.command.push(command);
            state.outside_n = 0.0;
            for fault in world.faults.iter_mut().filter(|fault| fault.axis == index) {
                state.outside_n += fault.force(tick, time);
            }
            if let Some(creep) = &mut axis.creep {
                state.creep_v = creep.step(&state.creep_table, state.voltage_z);
            }
        }
        // Dead times in steps; a wandering one is looked up each tick.
        for (index, state) in moving.iter_mut().enumerate() {
            let faults = world.faults.iter_mut().filter(|fault| fault.axis == index);
            let wander: f64 = faults.map(|fault| fault.dead_time(tick, time, 1.0 / rate)).sum();
            state.delay_steps = ((world.axes[index].delay_s + wander) / dt).max(0.0);
        }
        for step in 0..steps {
            let now = tick * steps + step;
            let time = time + step as f64 * dt;
            for ((command, displacement), state) in
                commands.iter_mut().zip(&mut displacements).zip(&moving)
            {
                let then = if state.delay_steps > 0.0 {
                    ((now as f64 + 0.5 - state.delay_steps).max(0.0) as usize / steps).min(tick)
                } else {
                    tick
                };
                *command = f64::from(state.command[then]);
                *displacement = state.position_m + ahead * state.speed;
            }
            for index in 0..axes {
                let axis = &mut world.axes[index];
                let mut asked = axis.drive.0 * commands[index] + axis.drive.1;
                for (share, command) in world.drive_cross[index].iter().zip(&commands) {
                    asked += share * command;
                }
                for fault in world.faults.iter_mut().filter(|fault| fault.axis == index) {
                    asked = fault.drive(tick, time, asked, moving[index].drive_rate);
                }
                let mut outside =
                    Outside { force_n: moving[index].outside_n, ..Outside::default() };
                for fault in world.faults.iter().filter(|fault| fault.axis == index) {
                    outside.force_n += fault.shaking(time);
                    outside.damping += fault.drag(moving[index].speed);
                    let (stiffness, from_m) = fault.stop(moving[index].position_m);
                    outside.stiffness += stiffness;
                    outside.force_n += stiffness * from_m;
                }
                for (stiffness, displacement) in
                    world.stiffness_cross[index].iter().zip(&displacements)
                {
                    outside.force_n -= stiffness * displacement;
                }
                amplifier(axis, &mut moving[index], asked, time, dt);
                mechanics(axis, &mut moving[index], &outside, dt);
            }
            for index in 0..axes {
                let seen = seen_m(world, &moving, index);
                conditioner(&world.axes[index], &mut moving[index], seen, dt);
            }
        }
    }
    recording.drive_v = moving.into_iter().map(|state| state.command).collect();
    recording.position_um = positions.into_iter().map(Some).collect();
    if experiment.monitor {
        recording.monitor_v = monitors.into_iter().map(Some).collect();
    }
    if closed {
        recording.reference_um = references.into_iter().map(Some).collect();
    }
    recording
}

/// Time in which the stages come to rest before a recording begins (s).
const REST_S: f64 = 0.02;

/// Lets the stages come to rest under what their stacks remember, damped as much as they can be without creeping: a recording that began with
/// a jump would ring for seconds where nothing was driven.
fn come_to_rest(world: &mut World, moving: &mut [Moving], dt: f64) {
    for _ in 0..(REST_S / dt) as usize {
        let displacements: Vec<f64> = moving.iter().map(|state| state.position_m).collect();
        for (index, (axis, state)) in world.axes.iter_mut().zip(moving.iter_mut()).enumerate() {
            let constants = &axis.constants;
            let stiffness = constants.stiffness_n_per_m + constants.mechanism_n_per_m;
            let neighbours = world.stiffness_cross[index].iter().zip(&displacements);
            let outside = Outside {
                force_n: -neighbours.map(|(stiffness, x)| stiffness * x).sum::<f64>(),
                damping: 2.0 * (stiffness * constants.mass_kg).sqrt(),
                ..Outside::default()
            };
            mechanics(axis, state, &outside, dt);
        }
    }
    for state in moving {
        (state.speed, state.acceleration, state.charge_rate) = (0.0, 0.0, 0.0);
        state.modes.fill((state.position_m, 0.0));
        state.branches.fill(state.position_m);
        state.filter = (state.position_m, 0.0);
    }
}

/// Share of the way that a first-order lag covers in a step.
fn share(dt: f64, time_s: f64) -> f64 {
    -(-dt / time_s).exp_m1()
}

/// What has died away is zero: it would end among the subnormal numbers and stay there, and a processor takes a hundred times as long over
/// those.
fn settled(value: f64) -> f64 {
    if value.abs() < 1e-100 { 0.0 } else { value }
}

/// What the gauge's conditioner says, before noise and converter.
fn gauge(axis: &AxisWorld, state: &Moving, seen: f64, time: f64) -> f64 {
    let x = if axis.lowpass.is_some() { state.filter.0 } else { seen };
    let bend = axis.bend.map_or(0.0, |bend| bend.at(x));
    let drift = axis.drift.map_or(0.0, |drift| drift.at(time));
    axis.sensor.0 * x + axis.sensor.1 + bend + drift + axis.sensor_hum.at(time)
}

/// One step of the amplifier: pole or poles, current, rails, mains.
fn amplifier(axis: &AxisWorld, state: &mut Moving, asked: f64, time: f64, dt: f64) {
    let (low, high, knee) = axis.clip;
    let asked = if knee > 0.0 {
        // A soft knee of this width at either rail.
        let over = |x: f64| knee * (x / knee).exp().ln_1p();
        if asked > high - 20.0 * knee {
            asked - over(asked - high)
        } else if asked < low + 20.0 * knee {
            asked + over(low - asked)
        } else {
            asked
        }
    } else {
        asked.clamp(low, high)
    };
    let target = if axis.second_pole_s > 0.0 {
        state.pole_v = settled(state.pole_v + (asked - state.pole_v) * state.second_share);
        state.pole_v
    } else {
        asked
    };
    let gap = target - state.output_v + state.hum_v;
    let mut rise = match axis.ringing {
        Some((omega, zeta)) => {
            let pull = omega * omega * gap - 2.0 * zeta * omega * state.slope_v_per_s;
            dt * settled(state.slope_v_per_s + dt * pull)
        }
        None => gap * state.amplifier_share,
    };
    let (limit_a, soft) = axis.current;
    if limit_a.is_finite() {
        // Charge by charge: what the stack takes a volt depends on its memory and on the load.
        let constants = &axis.constants;
        let stiffness = constants.stiffness_n_per_m + constants.mechanism_n_per_m;
        let linear = constants.capacitance_f + constants.transformer_n_per_v.powi(2) / stiffness;
        let (_, slope) = axis.hysteresis.at(axis.hysteresis.charge_c() + rise.signum() * 1e-9);
        let most = limit_a * dt * (slope + 1.0 / linear);
        rise = if soft { most * (rise / most).tanh() } else { rise.clamp(-most, most) };
    }
    if axis.slew_v_per_s > 0.0 {
        rise = rise.clamp(-axis.slew_v_per_s * dt, axis.slew_v_per_s * dt);
    }
    if axis.ringing.is_some() {
        // What rings over goes no farther than the supply.
        let from = state.output_v - state.hum_v;
        rise = (from + rise).clamp(low, high) - from;
    }
    state.slope_v_per_s = rise / dt;
    let free = state.output_v - state.hum_v + rise;
    state.hum_v = axis.amplifier_hum.at(time + dt);
    state.output_v = settled(free + state.hum_v);
}

/// One step of a gauge's conditioner, if it has a low-pass: of what the gauge sees, of its own axis and of others.
fn conditioner(axis: &AxisWorld, state: &mut Moving, seen_m: f64, dt: f64) {
    let Some(lowpass) = axis.lowpass else { return };
    let omega = TAU * lowpass.corner_hz;
    let (y, slope) = &mut state.filter;
    if lowpass.second_order {
        let pull = omega * omega * (seen_m - *y) - std::f64::consts::SQRT_2 * omega * *slope;
        *slope = settled(*slope + dt * pull);
        *y = settled(*y + dt * *slope);
    } else {
        *y = settled(*y + (seen_m - *y) * state.gauge_share);
    }
}

/// Displacement (m) that the gauge of an axis sees, with what it gets of the others.
fn seen_m(world: &World, moving: &[Moving], axis: usize) -> f64 {
    let others = world.sensor_cross[axis].iter().zip(moving);
    moving[axis].position_m + others.map(|(share, other)| share * other.position_m).sum::<f64>()
}
