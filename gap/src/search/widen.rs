//! One more effect beside the best models: those that a linear prediction promises something of, and those that it says nothing about.

use crate::Error;
use crate::fitting::fit::Sensitivities;
use crate::fitting::knobs::{EffectRef, Knob, is_plain};
use crate::fitting::model::{Model, Term, start_terms};
use crate::judge::accept::has_many_laws;
use crate::search::screen::Gain;
use crate::search::select::Search;

/// Share of the gain that is needed which a partner must promise by linear prediction to be fitted.
pub(crate) const PROMISE: f64 = 0.3;
/// ... a third one: beside two that were fitted, little is left that is not a straight line.
const PROMISE_OF_THIRD: f64 = 0.5;
/// Models that a third effect is tried beside.
const BEAM_OF_THIRD: usize = 2;
/// Share of the gap that a single effect leaves where the likeliest partners are fitted although none promises enough.
const LEFT_OPEN: f64 = 0.02;
/// How many of them.
const LIKELIEST: usize = 2;
/// Share of the gap that such a partner leaves by itself at most, unless it ties axes together as the first one does.
const OF_USE: f64 = 0.8;

impl Search<'_> {
    /// Fit the best models of `size` effects together with their most promising partners.
    pub(crate) fn widen(&mut self, size: usize) -> Result<(), Error> {
        let mut starts: Vec<Model> =
            self.tried.iter().filter(|m| m.terms.len() == size).cloned().collect();
        starts.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
        // What is one number cannot bend to what it is not, and seldom comes first where two are missing.
        let plain = starts.iter().skip(self.breadth.beam).find(|m| m.is_plain()).cloned();
        // Two that leave about the same are mostly two names of one thing: a third effect beside the second of them tells little more.
        starts.truncate(if size > 1 {
            self.breadth.beam.min(BEAM_OF_THIRD)
        } else {
            self.breadth.beam
        });
        starts.extend(plain.filter(|_| size == 1));
        let reach = starts.first().map_or(0.0, |b| b.fit.cost + 0.3 * self.gap);
        starts.retain(|m| m.fit.cost <= reach);
        let best = starts.first().map_or(0.0, |b| b.fit.cost);
        let wanted = best - self.worth_of_further(best - self.noise);
        for start in starts {
            let f = &start.fit;
            let sensitivities = Sensitivities::at(
                self.scene,
                self.nominal,
                &f.knobs,
                &f.values,
                &f.stack,
                self.include,
            )?;
            let gains = self.screen.test(self.scene, &f.stack, Some(&sensitivities));
            let names: Vec<&str> = start.terms.iter().map(Term::name).collect();
            let share = if size > 1 { PROMISE_OF_THIRD } else { PROMISE };
            let needed = share * (start.fit.cost - wanted);
            let mut partners = self.shortlist(&gains, &names, usize::MAX);
            let rest = partners.split_off(partners.len().min(self.breadth.partners));
            // Beside an effect that took on what is missing, one of many forms promises more than the plain one that is.
            let plain = rest.into_iter().filter(|(effect, _)| is_plain(*effect));
            partners.extend(plain.take(self.breadth.plain));
            // They take next to nothing, and a mass beside a loop of another rate a third of what a search may spend.
            partners.sort_by_key(|(effect, _)| !is_plain(*effect));
            partners.retain(|(_, gains)| gains.iter().map(|g| g.gain).sum::<f64>() >= needed);
            if partners.is_empty() && start.fit.cost == best {
                partners = self.likeliest(&start);
            }
            for (effect, gains) in partners {
                if self.is_spent() {
                    return Ok(());
                }
                let mut key = start.key();
                key.push(effect.info().name);
                key.sort_unstable();
                if self.is_tried(&key) {
                    continue;
                }
                let known = (&start_terms(&start)[..], &start.fit.stack);
                let model = self.fit_terms(known, effect, &gains)?;
                self.remember(model);
            }
        }
        Ok(())
    }

    /// Partners for a single effect that leaves much and beside which none promises enough: a lag beside a lag is no straight line. Those
    /// that did best alone, with what they came to.
    fn likeliest(&self, single: &Model) -> Vec<(EffectRef, Vec<Gain>)> {
        // What an effect of many laws leaves is its own, and what it does beside another says little.
        let is_of_one_law = |m: &Model| m.terms.len() == 1 && !has_many_laws(m.terms[0].name());
        let is_open = single.fit.cost - self.noise > LEFT_OPEN * self.gap;
        if !is_of_one_law(single) || !is_open {
            return Vec::new();
        }
        // The best ones come first.
        let is_other = |m: &&Model| is_of_one_law(m) && m.key() != single.key();
        // Of two that tie axes together one may take back what the other one does, and be of no use alone.
        let ties_axes = |m: &Model| m.fit.knobs.iter().any(Knob::couples);
        let is_of_use = |m: &&Model| {
            m.fit.cost - self.noise < OF_USE * self.gap || (ties_axes(single) && ties_axes(m))
        };
        let of_model = |model: &Model| {
            let term = &model.terms[0];
            let gain = |(p, &place)| Gain {
                place,
                gain: 0.0,
                start: model.values(0, p).to_vec(),
                shift: Vec::new(),
            };
            (term.effect, term.places.iter().enumerate().map(gain).collect())
        };
        let others = self.tried.iter().filter(is_other).filter(is_of_use);
        others.take(LIKELIEST).map(of_model).collect()
    }
}
