//! `flexstage identify`: refit the nominal parameters of a rig, and nothing else.
//!
//! Turned are, axis by axis: transformer ratio (gain), amplifier time constant, gauge offset, and the strengths of the Maxwell
//! elements at fixed slip charges; with a sensor geometry its entries in place of the gains. A rig without elements gets eight, their slip charges
//! spread over the charge that the session reaches (Goldfarb and Celanovic 1997: a sum of elasto-slide elements in charge). Each knob carries a weak prior around its nominal value, so that
//! what the recordings do not determine stays where it was.

use host_sim::Output;
use host_sim::rig::Rig;
use recording::Session;

use crate::diagnosis::Band;
use crate::fitting::fit::{Effort, Fit, fit};
use crate::fitting::knobs::{Knob, Prior, Target};
use crate::judge::slow;
use crate::session::energy::Energies;
use crate::session::floor::Kind;
use crate::session::intake;
use crate::session::pyramid::{MOST_LEFT_OUT, low_pass, share_kept};
use crate::session::scene::{Channel, Scene};
use crate::session::split::hold_out_last_third;
use crate::{Error, Options};

/// Fits with weights at most.
const ROUNDS: usize = 6;
/// Change of what is left in any band (its power) below which weights are not drawn again.
const SETTLED: f64 = 0.05;
/// A model that leaves more of a band's power than this does not follow it.
const UNEXPLAINED: f64 = 0.1;
/// Of the first fit.
const EFFORT: Effort = Effort { iterations: 12, tolerance: 1.0e-4, ..Effort::DEFAULT };
/// Elements that a rig without any is given.
const ELEMENTS: usize = 8;

/// A calibrated rig.
pub struct Identified {
    /// The rig with the fitted values.
    pub rig: Rig,
    /// Root mean square gap before and after, nm, over everything.
    pub before_nm: f64,
    /// After, nm.
    pub after_nm: f64,
    /// The same over the last third of every recording, by a fit that never saw it: before, nm.
    pub held_out_before_nm: f64,
    /// After, nm.
    pub held_out_after_nm: f64,
    /// What gains, offsets and lags alone leave of the held-out third, nm; `None` where the rig has a hysteresis model of
    /// its own, so that nothing was added to it.
    pub held_out_linear_nm: Option<f64>,
    /// Noise floor, nm.
    pub floor_nm: f64,
    /// Where the model follows only slow motion: the band that was fitted, with the gap of the held-out third in it.
    pub band: Option<Band>,
    /// What changed, one line a value.
    pub lines: Vec<String>,
}

/// Refit the nominal parameters of `rig` to a session.
pub fn identify(rig: &Rig, session: &Session, options: &Options) -> Result<Identified, Error> {
    let bar = crate::diagnose::bar(options);
    bar.set_message("reading the recordings");
    let mut scene = Scene::new(rig, intake::tracks(rig, session)?.0);
    hold_out_last_third(&mut scene);
    scene.set_aside_memory(rig)?;
    let everything = |_: &Channel| true;
    let prepared = with_elements(&scene, rig);
    let (knobs, start) = knobs(&scene, &prepared);
    let train = |c: &Channel| !c.held_out;
    bar.set_message("fitting two thirds of every recording");
    let left_out = bands_to_leave_out(&scene, &prepared, &knobs, &start, &train)?;
    let honest = settle(&scene, left_out, &prepared, knobs.clone(), start, &train)?;
    let held_out = |c: &Channel| c.held_out;
    let linear = if prepared == *rig {
        None
    } else {
        bar.set_message("fitting a linear model beside it");
        let (knobs, start) = self::knobs(&scene, rig);
        let line = settle(&scene, left_out, rig, knobs, start, &train)?;
        Some(scene.raw(&line.rig, everything)?)
    };
    bar.set_message("fitting everything");
    let start = honest.values.clone();
    let whole = settle(&scene, left_out, &prepared, knobs, start, &everything)?;
    let before = scene.raw(rig, everything)?;
    let after_honest = scene.raw(&honest.rig, everything)?;
    let after = scene.raw(&whole.rig, everything)?;
    let axes = rig.axes.len();
    let all = Energies::new(&scene, &before, &after, &everything).gap(axes);
    let held = Energies::new(&scene, &before, &after_honest, &held_out).gap(axes);
    let held_out_linear_nm =
        linear.map(|linear| Energies::new(&scene, &before, &linear, &held_out).gap(axes).after_nm);
    bar.finish_and_clear();
    let band = (left_out > 0).then(|| slow::band(&scene, &before, &after_honest, left_out));
    Ok(Identified {
        band,
        lines: lines(&whole),
        rig: whole.rig,
        before_nm: all.before_nm,
        after_nm: all.after_nm,
        held_out_before_nm: held.before_nm,
        held_out_after_nm: held.after_nm,
        held_out_linear_nm,
        floor_nm: all.floor_nm,
    })
}

/// Bands to leave out for the model to follow the rest, from rest upwards: a model without the resonances of the rig would else
/// spend its gains and lags on them. None, where it follows nothing.
fn bands_to_leave_out(
    scene: &Scene,
    rig: &Rig,
    knobs: &[Knob],
    start: &[f64],
    include: &(dyn Fn(&Channel) -> bool + Sync),
) -> Result<usize, Error> {
    for left_out in 0..=MOST_LEFT_OUT {
        let mut slow = scene.clone();
        slow.leave_out(left_out);
        let fit = fit(&slow, rig, knobs.to_vec(), start.to_vec(), EFFORT, None, include)?;
        if unexplained(scene, &fit.rig, left_out, include)? < UNEXPLAINED {
            return Ok(left_out);
        }
    }
    Ok(0)
}

/// Share of the measured motion that a rig leaves in the fastest band that is kept, by power.
fn unexplained(
    scene: &Scene,
    rig: &Rig,
    left_out: usize,
    include: &(dyn Fn(&Channel) -> bool + Sync),
) -> Result<f64, Error> {
    let still = Output { position_m: vec![Vec::new(); rig.axes.len()], ..Output::default() };
    let after = scene.raw(rig, include)?;
    let (mut left, mut moved, mut noise) = (0.0, 0.0, 0.0);
    for (channel, after) in scene.channels.iter().zip(&after) {
        let (Some(after), Kind::Position) = (after, channel.kind) else { continue };
        let mut at_rest = still.clone();
        at_rest.position_m[channel.axis] = vec![0.0; scene.tracks[channel.track].len()];
        let band = |row: &[f32]| -> f64 {
            let upper = low_pass(row, share_kept(left_out));
            let lower = low_pass(row, share_kept(left_out + 1));
            upper.iter().zip(&lower).map(|(u, l)| f64::from(u - l).powi(2)).sum()
        };
        left += band(after);
        moved += band(&scene.residual(channel, &at_rest));
        noise += after.len() as f64 * (share_kept(left_out) - share_kept(left_out + 1));
    }
    // A band with little but noise in it is followed.
    Ok(f64::max(left - 2.0 * noise, 0.0) / f64::max(moved, f64::MIN_POSITIVE))
}

/// Fits again and again, each weighed by what the one before could not follow: a coarse model must not spend everything on
/// its loudest recording, nor on a resonance that it does not have, and what it cannot follow shows only once it follows
/// the rest.
fn settle(
    scene: &Scene,
    left_out: usize,
    rig: &Rig,
    knobs: Vec<Knob>,
    start: Vec<f64>,
    include: &(dyn Fn(&Channel) -> bool + Sync),
) -> Result<Fit, Error> {
    let mut weighed = scene.clone();
    weighed.leave_out(left_out);
    let mut found = fit(&weighed, rig, knobs.clone(), start, EFFORT, None, include)?;
    let mut before: Option<Vec<f64>> = None;
    for _ in 0..ROUNDS {
        let mut powers = Vec::new();
        for (c, channel) in weighed.channels.iter_mut().enumerate() {
            if let Some(row) = &found.stack[c] {
                let power = channel.band_power(row);
                // What this model cannot follow counts as noise, so that the rest is fitted as well as it can be.
                channel.weigh(&power, 1.0);
                powers.extend(power);
            }
        }
        let settled = before.is_some_and(|before| {
            before.iter().zip(&powers).all(|(a, b)| (b / a - 1.0).abs() < SETTLED)
        });
        if settled {
            break;
        }
        before = Some(powers);
        weighed.leave_out(left_out);
        let effort = Effort { iterations: 6, ..EFFORT };
        found = fit(&weighed, rig, knobs.clone(), found.values, effort, None, include)?;
    }
    Ok(found)
}

/// Charge per metre of travel: q = T x + C v with v = K x / T.
fn charge_per_metre(rig: &Rig, axis: usize) -> f64 {
    let a = &rig.axes[axis];
    let stiffness = a.piezo.stiffness_n_per_m + a.mechanism.stiffness_n_per_m;
    a.piezo.transformer_n_per_v + a.piezo.capacitance_f * stiffness / a.piezo.transformer_n_per_v
}

/// Give axes without Maxwell elements eight weak ones, spread over the charge that the drive reaches.
fn with_elements(scene: &Scene, rig: &Rig) -> Rig {
    let mut rig = rig.clone();
    for axis in 0..rig.axes.len() {
        if !rig.axes[axis].piezo.hysteresis.capacitance_f.is_empty() {
            continue;
        }
        let (low, high) = scene
            .tracks
            .iter()
            .flat_map(|t| t.drive_v[axis].iter())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let span_v = high - low;
        if span_v.is_nan() || span_v <= 0.0 {
            continue;
        }
        let a = &rig.axes[axis];
        let stiffness = a.piezo.stiffness_n_per_m + a.mechanism.stiffness_n_per_m;
        let travel = a.piezo.transformer_n_per_v * span_v / stiffness;
        let charge = charge_per_metre(&rig, axis) * travel;
        let hysteresis = &mut rig.axes[axis].piezo.hysteresis;
        for i in 1..=ELEMENTS {
            // Elements slip when the charge has moved twice their slip charge after a reversal.
            let slip = 0.5 * charge * i as f64 / ELEMENTS as f64;
            // One per cent of the drive each: small enough to start from, large enough to feel.
            let limit = 1.0e-3 * span_v * i as f64 / ELEMENTS as f64;
            hysteresis.capacitance_f.push(slip / limit);
            hysteresis.limit_v.push(limit);
        }
    }
    rig
}

fn nominal(
    axis: usize,
    element: usize,
    write: fn(&mut Rig, usize, usize, f64),
    monitors: bool,
    own_gauge: bool,
    name: &'static str,
    unit: &'static str,
) -> Target {
    Target::Nominal { axis, write, element, monitors, own_gauge, name, unit }
}

/// The knobs of a rig and where they stand.
fn knobs(scene: &Scene, rig: &Rig) -> (Vec<Knob>, Vec<f64>) {
    let mut knobs = Vec::new();
    let mut start = Vec::new();
    let mut add =
        |target: Target, value: f64, min: f64, max: f64, scale: f64, log: bool, sd: f64| {
            knobs.push(Knob {
                target,
                min,
                max,
                origin: if log { 0.0 } else { value },
                scale,
                log,
                fixed_step: if log { None } else { Some(0.3 * scale) },
                prior: Some(Prior { centre: value, sd }),
            });
            start.push(value);
        };
    for axis in 0..rig.axes.len() {
        let a = &rig.axes[axis];
        let measured = scene.channels.iter().any(|c| c.axis == axis && c.kind == Kind::Position);
        if !measured {
            continue;
        }
        match &rig.output_map {
            Some(map) => {
                let largest = map.iter().flatten().fold(0.0_f64, |m, g| m.max(g.abs())).max(1.0e-6);
                for (column, &gain) in map[axis].iter().enumerate() {
                    let write = |rig: &mut Rig, row: usize, column: usize, v: f64| {
                        if let Some(map) = &mut rig.output_map {
                            map[row][column] = v;
                        }
                    };
                    let target = nominal(axis, column, write, false, true, "output_map", "m/m");
                    add(
                        target,
                        gain,
                        -100.0 * largest,
                        100.0 * largest,
                        0.02 * largest,
                        false,
                        100.0,
                    );
                }
            }
            None => {
                let write = |rig: &mut Rig, axis: usize, _: usize, v: f64| {
                    rig.axes[axis].piezo.transformer_n_per_v = v
                };
                let t = a.piezo.transformer_n_per_v;
                add(
                    nominal(axis, 0, write, false, false, "piezo.transformer_n_per_v", "N/V"),
                    t,
                    0.2 * t,
                    5.0 * t,
                    t,
                    true,
                    0.3,
                );
            }
        }
        let tau = a.amplifier.time_constant_s;
        let write = |rig: &mut Rig, axis: usize, _: usize, v: f64| {
            rig.axes[axis].amplifier.time_constant_s = v
        };
        add(
            nominal(axis, 0, write, true, false, "amplifier.time_constant_s", "s"),
            tau,
            0.05 * tau,
            50.0 * tau,
            tau,
            true,
            1.0,
        );
        let write =
            |rig: &mut Rig, axis: usize, _: usize, v: f64| rig.axes[axis].sensor.offset_m = v;
        let offset = a.sensor.offset_m;
        add(
            nominal(axis, 0, write, false, true, "sensor.offset_m", "m"),
            offset,
            offset - 1.0e-3,
            offset + 1.0e-3,
            1.0e-7,
            false,
            1.0e3,
        );
        let slips: Vec<f64> = a
            .piezo
            .hysteresis
            .capacitance_f
            .iter()
            .zip(&a.piezo.hysteresis.limit_v)
            .map(|(c, v)| c * v)
            .collect();
        for element in 0..slips.len() {
            // The limit at a fixed slip charge: the slope follows.
            let write = |rig: &mut Rig, axis: usize, element: usize, v: f64| {
                let h = &mut rig.axes[axis].piezo.hysteresis;
                let slip = h.capacitance_f[element] * h.limit_v[element];
                h.limit_v[element] = v;
                h.capacitance_f[element] = slip / v;
            };
            let limit = a.piezo.hysteresis.limit_v[element];
            add(
                nominal(axis, element, write, false, false, "piezo.hysteresis.limit_v", "V"),
                limit,
                1.0e-3 * limit,
                1.0e3 * limit,
                limit,
                true,
                3.0,
            );
        }
    }
    (knobs, start)
}

fn lines(fit: &Fit) -> Vec<String> {
    fit.knobs
        .iter()
        .zip(&fit.values)
        .filter_map(|(knob, value)| match &knob.target {
            Target::Nominal { axis, element, name, unit, .. } => {
                let place = match *name {
                    "output_map" | "piezo.hysteresis.limit_v" => format!("{name}[{element}]"),
                    _ => (*name).to_string(),
                };
                let before = knob.prior.map_or(f64::NAN, |p| p.centre);
                Some(format!("axis {} {place}: {before:.5e} -> {value:.5e} {unit}", axis + 1))
            }
            Target::Effect { .. } => None,
        })
        .collect()
}
