//! A model of the gap: effects at their places, with fitted values.

use host_sim::effects::Place;
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::fit::Fit;
use crate::fitting::guess::Ranges;
use crate::fitting::knobs::{EffectRef, Knob, is_plain, keep_laws, knobs_at};

/// One effect and the places where it acts.
#[derive(Clone)]
pub struct Term {
    /// Effect.
    pub effect: EffectRef,
    /// Axes or pairs.
    pub places: Vec<Place>,
}

impl Term {
    /// Name in the catalogue.
    pub fn name(&self) -> &'static str {
        self.effect.info().name
    }

    /// The same effect at one place alone.
    pub fn at(&self, place: Place) -> Self {
        Self { effect: self.effect, places: vec![place] }
    }

    /// Axes (from 0) whose motion this term explains.
    pub fn axes(&self) -> Vec<usize> {
        let mut axes: Vec<usize> = Vec::new();
        for place in &self.places {
            match *place {
                Place::Axis(axis) => axes.push(axis),
                Place::Pair { on, from } => {
                    axes.push(on);
                    if self.effect.info().scope == host_sim::effects::Scope::ReciprocalPair {
                        axes.push(from);
                    }
                }
            }
        }
        axes.sort_unstable();
        axes.dedup();
        axes
    }
}

/// A fitted set of effects.
#[derive(Clone)]
pub struct Model {
    /// Effects.
    pub terms: Vec<Term>,
    /// Their fit.
    pub fit: Fit,
    /// What the session offers, for the scales of knobs.
    pub ranges: Ranges,
}

impl Model {
    /// Names of the effects, sorted: the identity of the model in a search.
    pub fn key(&self) -> Vec<&'static str> {
        let mut names: Vec<_> = self.terms.iter().map(Term::name).collect();
        names.sort_unstable();
        names
    }

    /// How many numbers it has that a fit is free in and that are not merely a variety of its law.
    pub(crate) fn numbers(&self) -> usize {
        let counts = |knob: &&Knob| !knob.is_frozen() && !knob.is_variety();
        self.fit.knobs.iter().filter(counts).count()
    }

    /// Whether every effect of it keeps to axes of its own, and it has what `wider` has on fewer of these axes: a gauge of another gain where the
    /// wider one has a stiffness that grows, of four numbers, and is none of them but the gain.
    pub(crate) fn splits(&self, wider: &Model) -> bool {
        let axes = |model: &Model| model.terms.iter().flat_map(Term::axes).collect::<Vec<_>>();
        let (mut own, mut all) = (axes(self), axes(wider));
        own.sort_unstable();
        all.sort_unstable();
        let is_kept = |term: &Term| {
            let has = |own: &&Term| {
                own.name() == term.name() && own.places.iter().all(|p| term.places.contains(p))
            };
            self.terms.iter().any(|own| has(&own))
        };
        own == all && own.windows(2).all(|two| two[0] != two[1]) && wider.terms.iter().all(is_kept)
    }

    /// Whether every effect is one number at each place, or one beside which others only tell varieties apart.
    pub(crate) fn is_plain(&self) -> bool {
        self.terms.iter().all(|term| is_plain(term.effect))
    }

    /// Number of knobs that a term has.
    pub(crate) fn knob_range(&self, term: usize) -> std::ops::Range<usize> {
        let size = |t: &Term| t.places.len() * t.effect.info().parameters.len();
        let start: usize = self.terms[..term].iter().map(size).sum();
        start..start + size(&self.terms[term])
    }

    /// Values of one term at one place.
    pub fn values(&self, term: usize, place: usize) -> &[f64] {
        let width = self.terms[term].effect.info().parameters.len();
        let start = self.knob_range(term).start + place * width;
        &self.fit.values[start..start + width]
    }

    /// The rig with this model's effects except those of `term` at the places that `drop` picks.
    pub fn without(
        &self,
        nominal: &Rig,
        term: usize,
        drop: impl Fn(Place) -> bool,
    ) -> Result<Rig, Error> {
        self.keeping(nominal, |t, place| t != term || !drop(place))
    }

    /// The rig with those effects of this model that `keep` picks by their number.
    pub fn with(&self, nominal: &Rig, keep: impl Fn(usize) -> bool) -> Result<Rig, Error> {
        self.keeping(nominal, |t, _| keep(t))
    }

    fn keeping(&self, nominal: &Rig, keep: impl Fn(usize, Place) -> bool) -> Result<Rig, Error> {
        let mut rig = nominal.clone();
        for (t, this) in self.terms.iter().enumerate() {
            for (p, &place) in this.places.iter().enumerate() {
                if !keep(t, place) {
                    continue;
                }
                for (knob, &value) in
                    knobs_at(this.effect, place, &self.ranges).iter().zip(self.values(t, p))
                {
                    knob.write(&mut rig, value)?;
                }
            }
        }
        Ok(rig)
    }

    /// The terms with those of their places that `keep` lets through (given the term, and itself at that place alone), and the values.
    pub fn part(&self, keep: impl Fn(&Term, &Term) -> bool) -> Vec<(Term, Vec<f64>)> {
        let part = |(t, term): (usize, &Term)| {
            let kept: Vec<usize> =
                (0..term.places.len()).filter(|&p| keep(term, &term.at(term.places[p]))).collect();
            let places: Vec<Place> = kept.iter().map(|&p| term.places[p]).collect();
            let values = kept.iter().flat_map(|&p| self.values(t, p).to_vec()).collect();
            (!places.is_empty()).then_some((Term { effect: term.effect, places }, values))
        };
        self.terms.iter().enumerate().filter_map(part).collect()
    }
}

/// Terms of a model with the values that a wider fit starts from.
pub fn start_terms(model: &Model) -> Vec<(Term, Vec<f64>)> {
    model.part(|_, _| true)
}

/// Add terms and their values to `terms`: an effect that is there already acts at further places.
pub(crate) fn join_terms(terms: &mut Vec<(Term, Vec<f64>)>, more: Vec<(Term, Vec<f64>)>) {
    for (term, values) in more {
        match terms.iter_mut().find(|(known, _)| known.name() == term.name()) {
            Some((known, all)) => {
                known.places.extend(term.places);
                all.extend(values);
            }
            None => terms.push((term, values)),
        }
    }
}

/// Knobs of terms, in the order of their values.
pub fn knobs_of(terms: &[Term], ranges: &Ranges) -> Vec<Knob> {
    let of_term = |t: &Term| -> Vec<Knob> {
        t.places.iter().flat_map(|&p| knobs_at(t.effect, p, ranges)).collect()
    };
    terms.iter().flat_map(of_term).collect()
}

/// The same where their values are known: laws and parts that do nothing there are frozen, as in a fit that starts from them.
pub(crate) fn knobs_from(terms: &[Term], values: &[f64], ranges: &Ranges) -> Vec<Knob> {
    let mut knobs = knobs_of(terms, ranges);
    keep_laws(&mut knobs, values);
    knobs
}
