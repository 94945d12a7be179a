//! One step of stack and mechanism: implicit in the mechanics (average acceleration) and in the charge together.

use super::{Moving, settled};
use crate::world::{AxisWorld, Rate};

/// What acts on a stage from outside: a force (N), and stiffness (N/m) and damping (N s/m) that hold for a step.
#[derive(Default)]
pub(super) struct Outside {
    pub(super) force_n: f64,
    pub(super) stiffness: f64,
    pub(super) damping: f64,
}

/// One step of stack and mechanism under the amplifier's output.
pub(super) fn mechanics(axis: &mut AxisWorld, state: &mut Moving, outside: &Outside, dt: f64) {
    let constants = &axis.constants;
    let transformer = constants.transformer_n_per_v;
    let mut stiffness =
        constants.stiffness_n_per_m + constants.mechanism_n_per_m + outside.stiffness;
    let mut damping = constants.damping_n_s_per_m + outside.damping;
    if let Some((level, soft)) = axis.viscous_at_rest {
        damping += level / state.speed.hypot(soft);
    }
    let mut force = outside.force_n + transformer * state.creep_v;
    if let Rate::Late(volts, rate) = axis.rate {
        // That of the drive, as for the loop that grows below: with that of the charge, a tenth of a millisecond late, a stack of a large loss
        // chatters where it stands.
        force -= transformer * volts * (state.drive_rate / rate).asinh();
    }
    // Each of these is linear in the new position: value and slope at the old one.
    let here = state.position_m;
    if let Some((hard, scale, exponent)) = axis.hardening {
        let along = here.abs() / scale;
        let slope = hard * exponent * along.powf(exponent - 1.0);
        force -= hard * scale * along.powf(exponent) * here.signum() - slope * here;
        stiffness += slope;
    }
    if let Some((lost, point, width, from_rest)) = axis.contact {
        // Smooth minimum of zero and the distance above the contact point, and its slope.
        let below = |x: f64| {
            let z = ((point - x) / width).clamp(-700.0, 700.0);
            (if z > 40.0 { x - point } else { -width * z.exp().ln_1p() }, 1.0 / (1.0 + (-z).exp()))
        };
        let zero = if from_rest { below(0.0).0 } else { 0.0 };
        let (value, slope) = below(here);
        force += lost * (value - zero - slope * here);
        stiffness -= lost * slope;
    }
    for (deflection, (branch, _)) in state.branches.iter().zip(&axis.branches) {
        stiffness += branch;
        force += branch * deflection;
    }
    for ((y, speed), mode) in state.modes.iter().zip(&axis.modes) {
        let (spring, damper) =
            (mode.mass_kg * mode.omega * mode.omega, 2.0 * mode.zeta * mode.omega * mode.mass_kg);
        stiffness += spring;
        damping += damper;
        force += spring * y + damper * speed;
    }
    let grip = axis.friction.map(|friction| {
        let stribeck = (-(state.speed / friction.stribeck_m_per_s).powi(2)).exp();
        let level = friction.coulomb_n * (1.0 + (friction.breakaway - 1.0) * stribeck);
        (level, friction.coulomb_n / friction.presliding_m)
    });
    let gripped = |travel: f64| {
        grip.map_or((0.0, 0.0), |(level, bristle)| {
            bristles(state.friction_n, level, bristle, travel)
        })
    };
    let slipped = |held_n: f64, (limit_n, stiffness): (f64, f64), travel: f64| {
        (held_n + stiffness * travel).clamp(-limit_n, limit_n)
    };
    let rubbed = |travel: f64| {
        let contacts = state.contacts_n.iter().zip(&axis.contacts);
        contacts.fold(gripped(travel), |(sum, slope), (&held_n, &contact)| {
            let n = slipped(held_n, contact, travel);
            (sum + n, slope + if n.abs() < contact.0 { contact.1 } else { 0.0 })
        })
    };
    let rubs = axis.friction.is_some() || !axis.contacts.is_empty();

    // The speed that the loop grows with is that of the drive, as a current into the whole capacitance: with that of the charge, a
    // faster fall from above would lift the loop and fall faster still, and the stack would chatter where it stands.
    let current = (state.output_v - state.driven_v) / dt
        * (constants.capacitance_f + transformer * transformer / stiffness);
    state.driven_v = state.output_v;
    state.drive_rate =
        settled(state.drive_rate + (current - state.drive_rate) * (dt / 1e-4).min(1.0));
    let factor = match axis.rate {
        Rate::PerDecade(growth) => 1.0 + growth * (1.0 + state.drive_rate.abs() / 1e-4).log10(),
        Rate::Saturating(growth, rate) => 1.0 + growth * (state.drive_rate.abs() / rate).tanh(),
        _ => 1.0,
    };
    // Voltage and slope of a loss that goes with a power of the rate, smooth through zero, at charge q.
    let follow = (dt / 1e-4).min(1.0);
    let extra = |q: f64, last: f64| match axis.rate {
        Rate::Power(volts, power) => {
            let rate = state.charge_rate + ((q - last) / dt - state.charge_rate) * follow;
            let (r, soft) = (rate / 1e-3, 1e-2);
            let size = (r * r + soft * soft).powf(0.5 * (power - 1.0));
            let slope = size * (1.0 + (power - 1.0) * r * r / (r * r + soft * soft));
            (volts * size * r, volts * slope * follow / dt / 1e-3)
        }
        Rate::Relaxing(volts, time) => {
            let (slope, left) = (volts / (1e-3 * time), (-dt / time).exp());
            (left * (state.relaxing_v + slope * (q - last)), left * slope)
        }
        _ => (0.0, 0.0),
    };
    // Average acceleration: x1 = xp + h a1, v1 = vp + dt/2 a1; the charge couples in linearly.
    let h = 0.25 * dt * dt;
    let xp = state.position_m + dt * state.speed + h * state.acceleration;
    let vp = state.speed + 0.5 * dt * state.acceleration;
    let wanted = state.output_v;
    let last = axis.hysteresis.charge_c();
    let mut travel = dt * state.speed;
    let mut q = last + state.charge_rate * dt;
    let (mut base, mut taken, mut acceleration);
    // Friction is taken by its tangent at the travel of the round before; without friction the first round is the answer.
    let mut rounds = 0;
    loop {
        let (rub, slope) = rubbed(travel);
        let stiffness = stiffness + slope;
        let inertia = constants.mass_kg + 0.5 * dt * damping + h * stiffness;
        let rest = force - rub + slope * (here + travel) - stiffness * xp - damping * vp;
        base = transformer * (xp + h * rest / inertia);
        taken = constants.capacitance_f + transformer * h * transformer / inertia;
        // One scalar equation for the charge, monotone: Newton on the branch that the last step suggests.
        for _ in 0..12 {
            let (voltage, slope) = axis.hysteresis.at(q);
            let (loss, steep) = extra(q, last);
            let residual = factor * voltage + loss + (q - base) / taken - wanted;
            let change = residual / (factor * slope + steep + 1.0 / taken);
            q -= change;
            if change.abs() < 1e-13 {
                break;
            }
        }
        acceleration = (transformer * (q - base) / taken + rest) / inertia;
        let gone = xp + h * acceleration - here;
        let moved = (gone - travel).abs();
        // A kink that throws the tangent from side to side is halved.
        travel = if rounds < 6 { gone } else { 0.5 * (gone + travel) };
        rounds += 1;
        if !rubs || moved < 1e-15 || rounds == 40 {
            break;
        }
    }
    let friction_n = gripped(travel).0;
    for (held_n, &contact) in state.contacts_n.iter_mut().zip(&axis.contacts) {
        *held_n = slipped(*held_n, contact, travel);
    }
    state.friction_n = friction_n;
    if let Rate::Relaxing(..) = axis.rate {
        state.relaxing_v = settled(extra(q, last).0);
    }
    let q = settled(q);
    axis.hysteresis.commit(q);
    // A rate over a tenth of a millisecond: dissipation does not follow the 32 kHz ringing.
    state.charge_rate =
        settled(state.charge_rate + ((q - last) / dt - state.charge_rate) * (dt / 1e-4).min(1.0));
    state.voltage_z = settled((q - base) / taken);
    state.position_m = settled(xp + h * acceleration);
    state.speed = settled(vp + 0.5 * dt * acceleration);
    state.acceleration = settled(acceleration);
    for (deflection, share) in state.branches.iter_mut().zip(&state.branch_shares) {
        *deflection = settled(*deflection + (state.position_m - *deflection) * share);
    }
    for ((y, speed), mode) in state.modes.iter_mut().zip(&axis.modes) {
        let pull = mode.omega * mode.omega * (state.position_m - *y)
            + 2.0 * mode.zeta * mode.omega * (state.speed - *speed);
        *speed = settled(*speed + dt * pull);
        *y = settled(*y + dt * *speed);
    }
}

/// Force (N) of bristles that give way at `level_n`, and its slope (N/m), `travel_m` after they held with `before_n`.
/// Dahl's law, implicit in the force, so that whatever rubs takes energy and never gives any, at any step.
fn bristles(before_n: f64, level_n: f64, stiffness_n_per_m: f64, travel_m: f64) -> (f64, f64) {
    let share = stiffness_n_per_m / level_n;
    let less = 1.0 + share * travel_m.abs();
    let force = (before_n + stiffness_n_per_m * travel_m) / less;
    let slope = (stiffness_n_per_m - share * before_n * travel_m.signum()) / (less * less);
    (force, slope.max(0.0))
}
