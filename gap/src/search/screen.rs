//! Screening: what each effect of the catalogue would do to the residuals, at sizes worth finding.
//!
//! Every effect is put into the rig at its typical size (threshold effects and time constants at several sizes, shaped ones at several shapes), the
//! session is simulated once a setting, and the change of the whitened residuals is kept as a direction. A residual is
//! then tested against all directions by inner products alone, with what is already in the model projected out.

use host_sim::effects::{Place, Role};
use host_sim::rig::Rig;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use crate::Error;
use crate::fitting::fit::Sensitivities;
use crate::fitting::guess::{Ranges, settings};
use crate::fitting::knobs::{EffectRef, axes_seen, places, sees_monitor};
use crate::search::direction::{Beside, Direction, Known, Room};
use crate::session::scene::{Channel, Scene, Stack, Wanted, dot};

/// Sizes of the two phases of a drift that comes and goes; the last parameter of the effect is its period.
const CYCLE_PHASES: [&str; 2] = ["swing_sin_m", "swing_cos_m"];

/// All directions of the catalogue.
pub struct Screen {
    /// Effects that were tried.
    pub effects: Vec<EffectRef>,
    /// What they change.
    pub directions: Vec<Direction>,
}

/// How much an effect at a place would take off the cost, by linear prediction.
#[derive(Debug, Clone)]
pub struct Gain {
    /// Place.
    pub place: Place,
    /// Predicted fall of the cost.
    pub gain: f64,
    /// Parameter values to start a fit from.
    pub start: Vec<f64>,
    /// What each knob of the model beside it moves by then, in internal steps; empty without a model.
    pub shift: Vec<f64>,
}

/// Simulate every effect of `effects` in `rig`, whose residuals are `base`. Places that only reach axes outside the mask beside
/// it are left out: nothing is missing there.
pub fn screen(
    scene: &Scene,
    rig: &Rig,
    (base, loud): (&Stack, u32),
    effects: &[EffectRef],
    ranges: &Ranges,
    include: &(dyn Fn(&Channel) -> bool + Sync),
    tick: &(dyn Fn() + Sync),
) -> Result<Screen, Error> {
    // (effect, settings, places that share the simulation, channels)
    let mut jobs: Vec<(usize, Vec<f64>, Vec<Place>, Wanted)> = Vec::new();
    for (index, &effect) in effects.iter().enumerate() {
        let mut groups: Vec<(Vec<Place>, Wanted)> = Vec::new();
        for place in places(effect, rig.axes.len()) {
            let axes = axes_seen(rig, effect, place);
            if axes & loud == 0 {
                continue;
            }
            match groups.iter_mut().find(|(_, w)| w.axes & axes == 0) {
                Some((members, w)) => {
                    members.push(place);
                    w.axes |= axes;
                }
                None => groups.push((vec![place], Wanted { axes, monitors: sees_monitor(effect) })),
            }
        }
        for values in settings(effect, ranges) {
            for (members, wanted) in &groups {
                jobs.push((index, values.clone(), members.clone(), *wanted));
            }
        }
    }
    let directions: Vec<Vec<Direction>> = jobs
        .into_par_iter()
        .map(|(index, values, members, wanted)| {
            let effect = effects[index];
            let info = effect.info();
            let mut changed = rig.clone();
            for &place in &members {
                for (parameter, &value) in info.parameters.iter().zip(&values) {
                    changed
                        .set(info.name, place, parameter.name, value)
                        .map_err(|e| Error::Rig(e.to_string()))?;
                }
            }
            tick();
            // A setting that cannot be simulated is no direction.
            let Ok(mut stacks) = scene.residuals(&[(&changed, wanted)], include) else {
                return Ok(Vec::new());
            };
            let mut rows = stacks.remove(0);
            let mut found = Vec::new();
            for &place in &members {
                let axes = axes_seen(rig, effect, place);
                let mut mine = Vec::new();
                let mut energy = 0.0;
                for (c, row) in rows.iter_mut().enumerate() {
                    if axes >> scene.channels[c].axis & 1 == 0 {
                        continue;
                    }
                    let (Some(mut row), Some(here)) = (row.take(), base[c].as_ref()) else {
                        continue;
                    };
                    for (x, &h) in row.iter_mut().zip(here) {
                        *x -= h;
                    }
                    let own = dot(&row, &row);
                    // What moves a channel by less than a thousandth of its noise is not worth its memory.
                    if own > 1.0e-6 * row.len() as f64 {
                        energy += own;
                        mine.push((c, row));
                    }
                }
                if energy > 0.0 {
                    found.push(Direction {
                        effect: index,
                        place,
                        values: values.clone(),
                        rows: mine,
                        energy,
                    });
                }
            }
            Ok(found)
        })
        .collect::<Result<_, Error>>()?;
    Ok(Screen { effects: effects.to_vec(), directions: directions.into_iter().flatten().collect() })
}

impl Screen {
    /// Test a residual against every direction. `model` holds the sensitivities of what is already in the model.
    pub fn test(
        &self,
        scene: &Scene,
        stack: &Stack,
        model: Option<&Sensitivities>,
    ) -> Vec<Vec<Gain>> {
        let known = model.map(|model| Known::new(scene, stack, model));
        let tested: Vec<Option<(usize, Gain)>> = self
            .directions
            .par_iter()
            .map(|d| self.gain(d, stack, known.as_ref()).map(|gain| (d.effect, gain)))
            .collect();
        let in_phase = |phases: [&Direction; 2]| {
            let gain = self.cycle_gain(phases, stack, known.as_ref())?;
            Some((phases[0].effect, gain))
        };
        let cycles: Vec<Option<(usize, Gain)>> =
            self.cycles().into_par_iter().map(in_phase).collect();
        let mut best: Vec<Vec<Gain>> = vec![Vec::new(); self.effects.len()];
        for (effect, gain) in tested.into_iter().chain(cycles).flatten() {
            // The two phases of a hum are independent: together they gain what each gains alone.
            if self.effects[effect].info().name.ends_with("-hum") {
                let frequency = gain.start.last().copied();
                if let Some(known) = best[effect]
                    .iter_mut()
                    .find(|g| g.place == gain.place && g.start.last().copied() == frequency)
                {
                    known.gain += gain.gain;
                    known.start[0] += gain.start[0];
                    known.start[1] += gain.start[1];
                    known.shift.iter_mut().zip(&gain.shift).for_each(|(k, s)| *k += s);
                } else {
                    best[effect].push(gain);
                }
                continue;
            }
            match best[effect].iter_mut().find(|g| g.place == gain.place) {
                Some(known) if known.gain >= gain.gain => {}
                Some(known) => *known = gain,
                None => best[effect].push(gain),
            }
        }
        for (gains, effect) in best.iter_mut().zip(&self.effects) {
            if effect.info().name.ends_with("-hum") {
                gains.sort_by(|a, b| b.gain.total_cmp(&a.gain));
                let mut seen: Vec<Place> = Vec::new();
                gains.retain(|g| {
                    !seen.contains(&g.place) && {
                        seen.push(g.place);
                        true
                    }
                });
            }
        }
        best
    }

    /// Where a fit of an effect at a place starts by those of its settings that are `wanted`: the one that gains most.
    pub(crate) fn start_by(
        &self,
        stack: &Stack,
        effect: &str,
        place: Place,
        wanted: impl Fn(&[f64]) -> bool,
    ) -> Option<Vec<f64>> {
        let is_of_it = |d: &&Direction| {
            d.place == place && self.effects[d.effect].info().name == effect && wanted(&d.values)
        };
        let gains =
            self.directions.iter().filter(is_of_it).filter_map(|d| self.gain(d, stack, None));
        let cycles = self.cycles().into_iter().filter(|phases| phases.iter().all(is_of_it));
        let gains = gains.chain(cycles.filter_map(|phases| self.cycle_gain(phases, stack, None)));
        gains.max_by(|a, b| a.gain.total_cmp(&b.gain)).map(|gain| gain.start)
    }

    /// Pairs of directions that are the two phases of one cycle of a drift at one place. Unlike those of a hum they are not independent: a
    /// session may see half a cycle.
    fn cycles(&self) -> Vec<[&Direction; 2]> {
        let swings = |direction: &Direction, phase: &str| {
            let info = self.effects[direction.effect].info();
            let index = info.parameters.iter().position(|p| p.name == phase);
            index.is_some_and(|k| direction.values[k] != info.parameters[k].zero)
        };
        let sines = self.directions.iter().filter(|d| swings(d, CYCLE_PHASES[0]));
        let of_sine = |sin| {
            let Direction { effect, place, values, .. }: &Direction = sin;
            let is_other = |cos: &&Direction| {
                (cos.effect, cos.place, cos.values.last()) == (*effect, *place, values.last())
                    && swings(cos, CYCLE_PHASES[1])
            };
            Some([sin, self.directions.iter().find(is_other)?])
        };
        sines.filter_map(of_sine).collect()
    }

    /// What the two phases of a cycle gain together.
    fn cycle_gain(
        &self,
        phases: [&Direction; 2],
        stack: &Stack,
        known: Option<&Known>,
    ) -> Option<Gain> {
        let [sin, cos] = [phases[0].beside(stack, known)?, phases[1].beside(stack, known)?];
        let mut product = phases[0].dot(phases[1]);
        if let (Some(sin), Some(cos)) = (&sin.room, &cos.room) {
            product -= sin.a_unit.dot(&cos.cross);
        }
        let energy = Matrix2::new(sin.energy, product, product, cos.energy);
        let along = Vector2::new(sin.along, cos.along);
        let amounts = -(energy.cholesky()?.solve(&along));
        let gain = -amounts.dot(&along);
        let parameters = self.effects[phases[0].effect].info().parameters;
        let mut start = phases[0].values.clone();
        for (k, p) in parameters.iter().enumerate().filter(|(_, p)| p.role == Role::Size) {
            let size = amounts[0] * phases[0].values[k] + amounts[1] * phases[1].values[k];
            start[k] = size.clamp(p.min, p.max);
        }
        let shift = match (&sin.room, &cos.room) {
            (Some(sin), Some(cos)) => {
                let moved = &sin.alone + amounts[0] * &sin.a_unit + amounts[1] * &cos.a_unit;
                (-moved).as_slice().to_vec()
            }
            _ => Vec::new(),
        };
        (gain > 0.0).then_some(Gain { place: phases[0].place, gain, start, shift })
    }

    fn gain(&self, direction: &Direction, stack: &Stack, known: Option<&Known>) -> Option<Gain> {
        let Beside { along, energy, room } = direction.beside(stack, known)?;
        let shift = |amount: f64| -> Vec<f64> {
            let moved = |room: &Room| -(&room.alone + amount * &room.a_unit);
            room.as_ref().map(|room| moved(room).as_slice().to_vec()).unwrap_or_default()
        };
        let effect = self.effects[direction.effect];
        let parameters = effect.info().parameters;
        let mut amount = -along / energy;
        let mut start = direction.values.clone();
        if effect.info().threshold
            || parameters.iter().any(|p| p.role == Role::Size && p.log && p.zero > 50.0 * p.typical)
        {
            // What acts beyond a threshold does not scale: it is taken as it was simulated, or a part of it at most.
            amount = amount.clamp(0.0, 1.0);
            let gain = -amount * along * 2.0 - amount * amount * energy;
            return (gain > 0.0).then(|| Gain {
                place: direction.place,
                gain,
                start,
                shift: shift(1.0),
            });
        }
        for (value, p) in start.iter_mut().zip(parameters) {
            if p.role == Role::Size && *value != p.zero {
                if p.log {
                    let whole = (*value / p.zero).ln();
                    let reached = (p.zero * (amount * whole).exp()).clamp(p.min, p.max);
                    amount = (reached / p.zero).ln() / whole;
                    *value = reached;
                } else {
                    let reached = (p.zero + amount * (*value - p.zero)).clamp(p.min, p.max);
                    amount = (reached - p.zero) / (*value - p.zero);
                    *value = reached;
                }
            }
        }
        // Resonances move rather than grow: such a direction is taken as it was simulated or not at all.
        if matches!(effect.info().name, "inertia" | "second-mass") {
            let whole = -2.0 * along - energy;
            if whole > 0.3 * (-amount * along * 2.0 - amount * amount * energy) {
                return Some(Gain {
                    place: direction.place,
                    gain: whole,
                    start: direction.values.clone(),
                    shift: shift(1.0),
                });
            }
        }
        let gain = -amount * along * 2.0 - amount * amount * energy;
        (gain > 0.0).then(|| Gain { place: direction.place, gain, start, shift: shift(amount) })
    }
}
