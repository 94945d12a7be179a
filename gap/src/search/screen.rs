//! Screening: what each effect of the catalogue would do to the residuals, at sizes worth finding.
//!
//! Every effect is put into the rig at its typical size (threshold effects and time constants at several sizes, shaped ones at several shapes), the
//! session is simulated once a setting, and the change of the whitened residuals is kept as a direction. A residual is
//! then tested against all directions by inner products alone, with what is already in the model projected out.

use host_sim::effects::{Place, Role};
use host_sim::rig::Rig;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::Error;
use crate::fitting::fit::Sensitivities;
use crate::fitting::guess::{Ranges, settings};
use crate::fitting::knobs::{EffectRef, axes_seen, places, sees_monitor};
use crate::session::scene::{Channel, Scene, Stack, Wanted, dot};

/// One effect at one place with one set of parameter values, and what it changes.
pub struct Direction {
    /// Index into [`Screen::effects`].
    pub effect: usize,
    /// Where.
    pub place: Place,
    /// Parameter values that were tried.
    pub values: Vec<f64>,
    /// Channel and change of its whitened residual.
    rows: Vec<(usize, Vec<f32>)>,
    /// Squared length of all rows.
    energy: f64,
}

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

/// What is already in a model, channel by channel: it is the same for every direction.
struct Known<'a> {
    /// Number of knobs.
    knobs: usize,
    /// `None` where the residual is not known.
    channels: Vec<Option<KnownChannel<'a>>>,
}

/// Knobs that reach a channel, with their inner products.
struct KnownChannel<'a> {
    rows: Vec<(usize, &'a Vec<f32>)>,
    /// With the residual.
    gradient: Vec<f64>,
    /// With each other.
    matrix: DMatrix<f64>,
}

impl<'a> Known<'a> {
    fn new(scene: &Scene, stack: &Stack, model: &'a Sensitivities) -> Self {
        let of_channel = |c: usize| -> Option<KnownChannel<'a>> {
            let here = stack[c].as_ref()?;
            let axis = scene.channels[c].axis;
            let rows: Vec<(usize, &Vec<f32>)> =
                (0..model.len()).filter_map(|k| model.row(k, c, axis).map(|r| (k, r))).collect();
            let gradient = rows.iter().map(|(_, row)| dot(row, here)).collect();
            let mut matrix = DMatrix::zeros(rows.len(), rows.len());
            for i in 0..rows.len() {
                for j in 0..=i {
                    matrix[(i, j)] = dot(rows[i].1, rows[j].1);
                    matrix[(j, i)] = matrix[(i, j)];
                }
            }
            Some(KnownChannel { rows, gradient, matrix })
        };
        let channels = (0..scene.channels.len()).into_par_iter().map(of_channel).collect();
        Self { knobs: model.len(), channels }
    }
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
        let mut best: Vec<Vec<Gain>> = vec![Vec::new(); self.effects.len()];
        for (effect, gain) in tested.into_iter().flatten() {
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
        gains.max_by(|a, b| a.gain.total_cmp(&b.gain)).map(|gain| gain.start)
    }

    fn gain(&self, direction: &Direction, stack: &Stack, known: Option<&Known>) -> Option<Gain> {
        let mut along = 0.0;
        for (c, row) in &direction.rows {
            along += dot(row, stack[*c].as_ref()?);
        }
        let mut energy = direction.energy;
        // What the model moves by alone, and for each unit of the direction.
        let mut room: Option<(DVector<f64>, DVector<f64>)> = None;
        if let Some(known) = known {
            let n = known.knobs;
            let mut matrix = DMatrix::<f64>::identity(n, n) * 1.0e-9;
            let mut gradient = DVector::zeros(n);
            let mut cross = DVector::zeros(n);
            for (c, row) in &direction.rows {
                let here = known.channels[*c].as_ref()?;
                for (i, &(a, of_knob)) in here.rows.iter().enumerate() {
                    gradient[a] += here.gradient[i];
                    cross[a] += dot(of_knob, row);
                    for (j, &(b, _)) in here.rows.iter().enumerate() {
                        matrix[(a, b)] += here.matrix[(i, j)];
                    }
                }
            }
            if let Some(factor) = matrix.cholesky() {
                let solved = factor.solve(&cross);
                along -= solved.dot(&gradient);
                energy -= solved.dot(&cross);
                room = Some((factor.solve(&gradient), solved));
            }
        }
        if energy < 1.0e-6 * direction.energy || energy <= 0.0 {
            return None;
        }
        let shift = |amount: f64| -> Vec<f64> {
            room.as_ref()
                .map(|(alone, a_unit)| (-(alone + amount * a_unit)).as_slice().to_vec())
                .unwrap_or_default()
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
