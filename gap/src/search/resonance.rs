//! Where a resonance lies, and how many poles a lag has, before a fit: a lightly damped mode is narrower than the step that a fit takes
//! towards it.
//!
//! A mode with a quality of a hundred spans one per cent of its frequency. From three per cent beside it, a fit sees a hill that it can
//! only lower by damping the model's own mode away. So frequencies around the one that the screen liked are tried first.

use host_sim::effects::Place;
use host_sim::rig::{Axis, Rig};

use crate::Error;
use crate::fitting::fit::rig_with;
use crate::fitting::knobs::{EffectRef, FASTEST_MODE, axes_seen};
use crate::fitting::model::{Term, knobs_of};
use crate::search::select::Search;
use crate::session::scene::{Channel, Stack, Wanted, dot};
use crate::session::work;

/// Frequencies that are tried around a start, as steps beside it and their size: first the coarse ones, then between them.
const SCANS: [(i32, f64); 2] = [(4, 0.02), (4, 0.0025)];

/// Share of what is left that the recordings hold in which frequencies are tried.
const TELLING: f64 = 0.8;

/// So many offers of a start are many: most of them are told from the best ones by one recording.
const MANY_OFFERS: usize = 24;

/// Of many offers one in so many is tried in all recordings that tell.
const KEPT_OF_MANY: usize = 5;

/// Coarse steps below and above a frequency that was seen. It is read off to three per cent, and stack and mechanism are softer alone than
/// with a stack whose charge is held, so a mass that is told from them is too small.
const AROUND_SEEN: std::ops::RangeInclusive<i32> = -4..=6;

/// Damping ratio of a mode that is tried beside one that rings freely.
const DAMPED: f64 = 0.02;

/// What sets the frequency of an effect that resonates.
#[derive(Clone, Copy)]
pub(super) enum Mode {
    /// The mass of the mechanism, beside the nominal one (kg), on the spring that there is (N/m).
    Mass { nominal_kg: f64, stiffness_n_per_m: f64 },
    /// A spring of its own, on an axis that is held by this stiffness (N/m).
    Own { stiffness_n_per_m: f64 },
}

/// Stiffness of a swinging part's spring, beside that of the axis in series with it, that is tried: the more of the axis' motion it takes
/// with it, the farther the resonance that is seen lies below the frequency with the axis held.
const SHARES: [f64; 4] = [0.05, 0.2, 0.45, 0.75];

impl Mode {
    pub(super) fn of(effect: &str, axis: &Axis) -> Option<Self> {
        let stiffness_n_per_m = axis.piezo.stiffness_n_per_m + axis.mechanism.stiffness_n_per_m;
        match effect {
            "inertia" => Some(Self::Mass {
                nominal_kg: axis.piezo.mass_kg + axis.mechanism.mass_kg,
                stiffness_n_per_m,
            }),
            "second-mass" => Some(Self::Own { stiffness_n_per_m }),
            _ => None,
        }
    }

    /// Values of the effect with its frequency times `ratio`.
    pub(super) fn moved(self, values: &[f64], ratio: f64) -> Vec<f64> {
        let mut values = values.to_vec();
        match self {
            // The frequency goes with the root of the mass.
            Self::Mass { nominal_kg, .. } => {
                values[0] = (nominal_kg + values[0]) / (ratio * ratio) - nominal_kg;
            }
            Self::Own { .. } => values[1] *= ratio,
        }
        values
    }

    /// Values of the effect with its frequency at `hz`, ringing freely and damped; none where the nominal mass alone is slower. What a
    /// screen made of a resonance that it missed is no size to start from.
    fn placed(self, effect: EffectRef, values: &[f64], hz: f64) -> Vec<Vec<f64>> {
        match self {
            Self::Mass { nominal_kg, stiffness_n_per_m } => {
                let omega = std::f64::consts::TAU * hz;
                let added_kg = stiffness_n_per_m / (omega * omega) - nominal_kg;
                if added_kg <= 0.0 {
                    return Vec::new();
                }
                let damped = 2.0 * DAMPED * stiffness_n_per_m / omega;
                vec![vec![added_kg, 0.0], vec![added_kg, damped]]
            }
            Self::Own { stiffness_n_per_m } => {
                let typical = &effect.info().parameters[0].typical;
                let damping = values[2].min(0.05);
                let omega = std::f64::consts::TAU * hz;
                // Two springs in series carry the mass at the frequency that is seen: share = k2 / (k + k2).
                let heavy = SHARES.map(|share| {
                    let mass_kg = share * stiffness_n_per_m / (omega * omega);
                    [mass_kg, hz / (1.0 - share).sqrt(), damping]
                });
                let light = [values[0].max(0.1 * typical), hz, damping];
                let parts = std::iter::once(light).chain(heavy);
                parts.map(|part| [&part, &values[part.len()..]].concat()).collect()
            }
        }
    }

    /// Whether a fit may put the resonance at `hz`: a part that swings is held below a third of the sample rate.
    fn holds(self, hz: f64, rate_hz: f64) -> bool {
        matches!(self, Self::Mass { .. }) || hz < FASTEST_MODE * rate_hz
    }

    /// Whether values are a resonance at all: a screen that missed it takes away what mass there is.
    fn is_sound(self, values: &[f64]) -> bool {
        match self {
            Self::Mass { nominal_kg, .. } => values[0] > -0.5 * nominal_kg,
            Self::Own { .. } => true,
        }
    }

    /// Values of the effect with as little damping as it may have: what rings long is told from what rings a little too low only if the
    /// model rings as long.
    fn rung(self, values: &[f64]) -> Vec<f64> {
        let mut values = values.to_vec();
        match self {
            Self::Mass { .. } => values[1] = 0.0,
            Self::Own { .. } => values[2] *= 0.3,
        }
        values
    }
}

/// Delays about one that a screen found: a fit does not get over the next edge of a square, or half a period of what is fast.
fn delays(start: &[f64]) -> Vec<Vec<f64>> {
    [1.0, 0.25, 0.5, 0.7, 1.4, 2.0, 4.0].map(|ratio| vec![ratio * start[0]]).to_vec()
}

/// Lags about one that a screen found, with one pole and with two: what two take away they give back later, and from one a fit does not
/// get there.
fn lags(start: &[f64], second: [f64; 3]) -> Vec<Vec<f64>> {
    let mut lags = vec![start.to_vec()];
    for ratio in [0.5, 0.7, 1.0, 1.4, 2.0] {
        lags.extend(second.map(|second| vec![ratio * start[0], second]));
    }
    lags
}

/// Recordings in which start values are tried.
pub(super) struct Telling {
    /// Those that hold most of what is left.
    all: Vec<usize>,
    /// Of each axis the one that holds most.
    first: Vec<usize>,
}

impl Search<'_> {
    /// Start values of `effect` at `places`, one set a place, moved to the frequencies that suit the session best beside the
    /// `known` terms, which leave `left`, or to the poles that do, or within the reach of a threshold. Others stay as they are.
    pub(crate) fn tuned(
        &self,
        (known, left): (&[(Term, Vec<f64>)], &Stack),
        effect: EffectRef,
        places: &[Place],
        mut starts: Vec<Vec<f64>>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let name = effect.info().name;
        let modes: Vec<Mode> = places
            .iter()
            .filter_map(|place| Mode::of(name, &self.nominal.axes[place.on()]))
            .collect();
        let late = |start: &Vec<f64>| match name {
            "sensor-bandwidth" => Some(lags(start, [0.0, 0.25, 0.5])),
            "amplifier-bandwidth" => Some(lags(start, [0.0, 0.3, 0.8])),
            "drive-delay" => Some(delays(start)),
            _ => None,
        };
        if let Some(offers) = starts.iter().map(late).collect::<Option<Vec<_>>>() {
            return self.best_of_offers(known, (effect, places), &offers, &self.telling(left));
        }
        if modes.is_empty() {
            return if effect.info().threshold {
                self.within_threshold(known, effect, places, starts)
            } else {
                Ok(starts)
            };
        }
        let telling = self.telling(left);
        let ranges = &self.ranges;
        for (round, (reach, step)) in SCANS.into_iter().enumerate() {
            let offers: Vec<Vec<Vec<f64>>> = (0..places.len())
                .map(|p| {
                    let (mode, start) = (modes[p], &starts[p]);
                    let around = |values: &[f64], steps: std::ops::RangeInclusive<i32>| {
                        let values = values.to_vec();
                        steps.map(move |k| mode.moved(&values, 1.0 + f64::from(k) * step))
                    };
                    let own = around(start, -reach..=reach);
                    if round > 0 {
                        return own.chain(around(&mode.rung(start), -reach..=reach)).collect();
                    }
                    let is_within = |hz: &&f64| mode.holds(**hz, ranges.rate_hz);
                    let seen = ranges.resonances_hz[places[p].on()].iter().filter(is_within);
                    let seen = seen.flat_map(|&hz| mode.placed(effect, start, hz));
                    let seen: Vec<Vec<f64>> =
                        seen.flat_map(|there| around(&there, AROUND_SEEN)).collect();
                    if mode.is_sound(start) || seen.is_empty() {
                        own.chain(seen).collect()
                    } else {
                        seen
                    }
                })
                .collect();
            if !self.affords(known, (effect, places), &offers, &telling)? {
                break;
            }
            starts = self.best_of_offers(known, (effect, places), &offers, &telling)?;
        }
        Ok(starts)
    }

    /// Whether a search may still simulate all of these offers: beside a loop that takes every tick in parts they could cost more than all else.
    pub(super) fn affords(
        &self,
        known: &[(Term, Vec<f64>)],
        (effect, places): (EffectRef, &[Place]),
        offers: &[Vec<Vec<f64>>],
        telling: &Telling,
    ) -> Result<bool, Error> {
        let many = offers.iter().map(Vec::len).max().unwrap_or(0);
        let rig = self.offered(known, (effect, places), offers, 0)?;
        let axes = places.iter().fold(0, |m, &p| m | axes_seen(self.nominal, effect, p));
        let price = |tracks: &[usize], times: usize| -> u64 {
            let tracks = tracks.iter().map(|&track| self.scene.tracks[track].ticks());
            tracks.map(|ticks| work::price(&rig, axes, &ticks)).sum::<u64>() * times as u64
        };
        let is_ranked = many >= MANY_OFFERS && telling.first.len() < telling.all.len();
        let price = if is_ranked {
            price(&telling.first, many) + price(&telling.all, many.div_ceil(KEPT_OF_MANY))
        } else {
            price(&telling.all, many)
        };
        Ok(self.scene.work.affords(price))
    }

    /// For every place the one of its offers that leaves least of some recordings, beside the `known` terms. Many offers go through the
    /// most telling recording first.
    pub(super) fn best_of_offers(
        &self,
        known: &[(Term, Vec<f64>)],
        (effect, places): (EffectRef, &[Place]),
        offers: &[Vec<Vec<f64>>],
        telling: &Telling,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let many = offers.iter().map(Vec::len).max().unwrap_or(0);
        let mut ranked = offers.to_vec();
        if many >= MANY_OFFERS && telling.first.len() < telling.all.len() {
            ranked = self.rank_offers(known, (effect, places), offers, &telling.first)?;
            ranked.iter_mut().for_each(|offers| offers.truncate(many.div_ceil(KEPT_OF_MANY)));
        }
        let ranked = self.rank_offers(known, (effect, places), &ranked, &telling.all)?;
        Ok(ranked.into_iter().map(|mut offers| offers.swap_remove(0)).collect())
    }

    /// The rig with the `known` terms and the offer of that number, or the last one, at every place.
    fn offered(
        &self,
        known: &[(Term, Vec<f64>)],
        (effect, places): (EffectRef, &[Place]),
        offers: &[Vec<Vec<f64>>],
        number: usize,
    ) -> Result<Rig, Error> {
        let mut terms: Vec<Term> = known.iter().map(|(term, _)| term.clone()).collect();
        terms.push(Term { effect, places: places.to_vec() });
        let mut values: Vec<f64> = known.iter().flat_map(|(_, v)| v.iter().copied()).collect();
        values.extend(offers.iter().flat_map(|o| o[number.min(o.len() - 1)].iter().copied()));
        rig_with(self.nominal, &knobs_of(&terms, &self.ranges), &values)
    }

    /// The offers of every place, those that leave least of some recordings first.
    fn rank_offers(
        &self,
        known: &[(Term, Vec<f64>)],
        (effect, places): (EffectRef, &[Place]),
        offers: &[Vec<Vec<f64>>],
        telling: &[usize],
    ) -> Result<Vec<Vec<Vec<f64>>>, Error> {
        let include = |c: &Channel| (self.include)(c) && telling.contains(&c.track);
        let most = offers.iter().map(Vec::len).max().unwrap_or(0);
        let rigs = (0..most)
            .map(|k| self.offered(known, (effect, places), offers, k))
            .collect::<Result<Vec<_>, _>>()?;
        let axes = places.iter().fold(0, |m, &p| m | axes_seen(self.nominal, effect, p));
        let jobs: Vec<_> = rigs.iter().map(|rig| (rig, Wanted { axes, monitors: false })).collect();
        let stacks = self.scene.residuals(&jobs, include)?;
        let rank = |(offers, &place): (&Vec<Vec<f64>>, &Place)| {
            let mask = axes_seen(self.nominal, effect, place);
            let left: Vec<f64> =
                stacks.iter().map(|stack| self.scene.cost_on(stack, mask)).collect();
            let mut order: Vec<usize> = (0..offers.len()).collect();
            // An offer that cannot be simulated is the last one.
            let key = |k: usize| if left[k].is_finite() { left[k] } else { f64::INFINITY };
            order.sort_by(|&a, &b| key(a).total_cmp(&key(b)));
            order.into_iter().map(|k| offers[k].clone()).collect()
        };
        Ok(offers.iter().zip(places).map(rank).collect())
    }

    /// The recordings that hold most of what is left, and of each axis the one that holds most. A frequency that is off shows where the
    /// resonance rings, and costs a simulation of everything else.
    pub(super) fn telling(&self, left: &Stack) -> Telling {
        let mut gaps = vec![0.0; self.scene.tracks.len()];
        let mut first = vec![(0.0, None); self.nominal.axes.len()];
        for (row, channel) in left.iter().zip(&self.scene.channels) {
            if let Some(row) = row {
                let gap = dot(row, row) - channel.noise_cost();
                gaps[channel.track] += gap;
                if gap > first[channel.axis].0 {
                    first[channel.axis] = (gap, Some(channel.track));
                }
            }
        }
        let mut order: Vec<usize> = (0..gaps.len()).filter(|&track| gaps[track] > 0.0).collect();
        order.sort_by(|&a, &b| gaps[b].total_cmp(&gaps[a]));
        let wanted = TELLING * gaps.iter().map(|gap| gap.max(0.0)).sum::<f64>();
        let mut held = 0.0;
        order.retain(|&track| {
            let is_needed = held < wanted;
            held += gaps[track];
            is_needed
        });
        let mut first: Vec<usize> = first.into_iter().filter_map(|(_, track)| track).collect();
        first.sort_unstable();
        first.dedup();
        Telling { all: order, first }
    }
}
