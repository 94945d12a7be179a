//! Varieties of an effect that a fit does not get to by itself.
//!
//! A current limit has a corner, or a knee that bends ever sooner. What a small knee changes goes with more than its square, so that a fit
//! which starts from a corner stays there, and the screen, which tries both, may like the corner at one size better than the knee at a wrong
//! one. So where the plain variety leaves something the other one is fitted as well.
//!
//! Creep goes with the logarithm of time and with the voltage, or a little otherwise in either: two numbers more, which most stacks do not need.
//! What rubs yields ever more before it slips, or holds as a spring does until it slips; it may take more to break loose than to slide,
//! and many contacts may slip one after the other.
//!
//! A spring from axis to axis holds each of them as well, a base that both stand on gives way under each: that is not the spring of a matrix, and
//! all three have one number.
//!
//! Loops widen with the rate by one law or another, and each of them comes near to the others: a fit that begins with one stays with it. So
//! do gauges that drift to an end and those that drift to and fro.

use host_sim::effects::{Parameter, Place};

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::knobs::EffectRef;
use crate::fitting::model::Model;
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::select::{CLOSED, Search, WORTH_OF_FIRST};

/// A variety that a fit of the plain one does not get to.
struct Variety {
    effect: &'static str,
    /// Zero in the plain variety.
    parameter: &'static str,
    /// Where the parameter starts,
    start: f64,
    /// and where another one starts that the variety needs.
    with: Option<(&'static str, f64)>,
    /// By how much the effect's first size grows there.
    growth: f64,
    /// Share of what the plain variety leaves that this one may leave.
    leaves: f64,
    /// Share of the gap that the plain one may leave for this one to be granted beyond the search's allowance; none: it is a part of that.
    granted_below: Option<f64>,
}

/// What most of them have.
const USUAL: Variety = Variety {
    effect: "",
    parameter: "",
    start: 0.0,
    with: None,
    growth: 1.0,
    leaves: 1.0,
    granted_below: None,
};

const VARIETIES: [Variety; 7] = [
    Variety {
        effect: "amplifier-current-limit",
        parameter: "knee",
        start: 0.35,
        growth: 1.25,
        ..USUAL
    },
    Variety { effect: "creep", parameter: "level", start: 0.1, ..USUAL },
    Variety {
        effect: "friction",
        parameter: "corner",
        start: 0.7,
        leaves: 0.8,
        granted_below: Some(0.25),
        ..USUAL
    },
    Variety {
        effect: "friction",
        parameter: "spread_decades",
        start: 1.5,
        with: Some(("corner", 0.9)),
        leaves: 0.5,
        ..USUAL
    },
    Variety {
        effect: "friction",
        parameter: "stribeck",
        start: 0.4,
        growth: 0.85,
        leaves: 0.4,
        ..USUAL
    },
    // From axis to axis, and under both of them.
    Variety { effect: "stiffness-coupling", parameter: "own", start: -1.0, leaves: 0.5, ..USUAL },
    Variety { effect: "stiffness-coupling", parameter: "own", start: 1.0, leaves: 0.5, ..USUAL },
];

/// A law of an effect that has several: parameters that are not at their zero, or the default of a shape, where a fit of it begins, and those that are.
struct Law {
    on: &'static [&'static str],
    off: &'static [&'static str],
}

/// Limits that grow from a current of the recordings on, and from one far below it.
const GROWS: Law = Law { on: &["per_decade"], off: &["stiffening"] };
const GROWS_FROM_FAR_BELOW: Law = Law { on: &["per_decade", "stiffening"], off: &[] };
const LOSES_IN_SERIES: Law = Law { on: &["resistance_ohm", "loss_exponent"], off: &[] };
const COMES_LATE: Law = Law { on: &["strain_loss_v"], off: &[] };
const SETTLES: Law = Law { on: &["settling_m"], off: &[] };
const SWINGS: Law = Law { on: &["cycle_s"], off: &[] };

/// Effects with laws of several kinds.
const LAWS: [(&str, &[Law]); 2] = [
    ("hysteresis-rate", &[GROWS, GROWS_FROM_FAR_BELOW, LOSES_IN_SERIES, COMES_LATE]),
    ("sensor-drift", &[SETTLES, SWINGS]),
];
/// Share of the gap that a law may leave at most for others to be tried.
const WORTH_OTHERS: f64 = 0.4;

/// Whether an effect has laws that a fit of one of them does not get to.
pub(crate) fn has_other_laws(effect: EffectRef) -> bool {
    LAWS.iter().any(|(name, _)| *name == effect.info().name)
}

impl Search<'_> {
    /// `model` of one effect, whose fit began at `begun`, or the same begun with another law of it, whichever leaves least.
    pub(crate) fn other_law(
        &self,
        model: Model,
        begun: &[f64],
        effort: Effort,
    ) -> Result<Model, Error> {
        let [term] = model.terms.as_slice() else { return Ok(model) };
        let info = term.effect.info();
        let Some((_, laws)) = LAWS.iter().find(|(name, _)| *name == info.name) else {
            return Ok(model);
        };
        let left = model.fit.cost - self.noise;
        if left < CLOSED * self.gap
            || left > WORTH_OTHERS * self.gap
            || model.fit.cost > effort.hopeless
        {
            return Ok(model);
        }
        let follows = |law: &Law, values: &[f64]| {
            let is_at_odds = |(p, v): (&Parameter, &f64)| {
                if *v == p.zero { law.on.contains(&p.name) } else { law.off.contains(&p.name) }
            };
            !info.parameters.iter().zip(values).any(is_at_odds)
        };
        let mut best: Option<Model> = None;
        let width = info.parameters.len();
        for law in *laws {
            if begun.chunks(width).all(|values| follows(law, values)) {
                continue;
            }
            // Where the law does nothing by itself, what was found stays.
            let start = |(nth, &place): (usize, &Place)| {
                self.screen
                    .start_by(&self.base, info.name, place, |values| follows(law, values))
                    .unwrap_or_else(|| model.values(0, nth).to_vec())
            };
            let start: Vec<Vec<f64>> = term.places.iter().enumerate().map(start).collect();
            // One that stays behind the best of them is not fitted to the end.
            let hopeless = best.as_ref().unwrap_or(&model).fit.cost;
            let effort = Effort { hopeless, ..effort };
            let other = self.fit_model(model.terms.clone(), start.concat(), effort)?;
            if other.fit.cost < best.as_ref().unwrap_or(&model).fit.cost {
                best = Some(other);
            }
        }
        Ok(best.unwrap_or(model))
    }

    /// `model`, or the same with another variety of its last effect, whichever leaves less.
    pub(crate) fn other_variety(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let name = model.terms[model.terms.len() - 1].name();
        let mut model = model;
        for variety in VARIETIES.iter().filter(|variety| variety.effect == name) {
            model = self.of_variety(model, variety, effort)?;
        }
        Ok(model)
    }

    /// `model`, or the same with this variety of its last effect.
    fn of_variety(&self, model: Model, variety: &Variety, effort: Effort) -> Result<Model, Error> {
        let last = model.terms.len() - 1;
        let info = model.terms[last].effect.info();
        let left = model.fit.cost - self.noise;
        // Where the plain one does nothing at all, there is nothing that a knee could round off.
        let does_nothing = model.terms.len() == 1 && left > (1.0 - WORTH_OF_FIRST) * self.gap;
        if left < CLOSED * self.gap || model.fit.cost > effort.hopeless || does_nothing {
            return Ok(model);
        }
        let position = |name: &str| info.parameters.iter().position(|p| p.name == name);
        let Some(index) = position(variety.parameter) else { return Ok(model) };
        let with = variety.with.and_then(|(name, start)| Some((position(name)?, start)));
        let width = info.parameters.len();
        let range = model.knob_range(last);
        let mut values = model.fit.values.clone();
        for place in range.step_by(width) {
            if values[place + index] == info.parameters[index].zero {
                values[place + index] = variety.start;
                values[place] *= variety.growth;
                if let Some((other, start)) = with {
                    values[place + other] = start;
                }
            }
        }
        if values == model.fit.values {
            return Ok(model);
        }
        // A number more that noise could have asked for is none.
        let line = (self.noise + variety.leaves * left).min(model.fit.cost - NOISE_MARGIN);
        let effort = Effort { hopeless: model.fit.cost, ..effort };
        let fit = || self.fit_model(model.terms.clone(), values, effort);
        let other = match variety.granted_below {
            None => fit()?,
            Some(most) if left <= most * self.gap && self.scene.work.grants() => {
                self.scene.work.grant(fit)?
            }
            Some(_) => return Ok(model),
        };
        Ok(if other.fit.cost < line { other } else { model })
    }
}
