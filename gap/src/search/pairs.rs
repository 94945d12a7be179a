//! Effects between axes beside each other.
//!
//! Shared springs and crosstalk move the same gauges: each alone takes in most of the other, and the pairs of axes that it then does not
//! need are those that tell the two apart. So beside each other they are fitted with every pair.

use host_sim::effects::{Place, Role, Scope};

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::knobs::{axes_seen, places};
use crate::fitting::model::{Model, Term, start_terms};
use crate::search::prune::WORTH_OF_PLACE;
use crate::search::select::Search;

impl Search<'_> {
    /// `model` with every pair that reaches an axis with a gap, where several of its effects lie between axes, if that leaves less by as much
    /// as so many more places have to be worth.
    pub(crate) fn every_pair(&self, model: Model, effort: Effort) -> Result<Model, Error> {
        let is_between = |term: &Term| term.effect.info().scope != Scope::Axis;
        if model.terms.iter().filter(|term| is_between(term)).count() < 2
            || model.fit.cost > effort.hopeless
        {
            return Ok(model);
        }
        let mut more = 0;
        let whole = |(mut term, mut values): (Term, Vec<f64>)| {
            if is_between(&term) {
                let info = term.effect.info();
                let none = info.parameters.iter().map(|p| match p.role {
                    Role::Size => p.zero,
                    _ => p.typical,
                });
                let none: Vec<f64> = none.collect();
                let is_loud =
                    |place: &Place| axes_seen(self.nominal, term.effect, *place) & self.loud != 0;
                for place in places(term.effect, self.nominal.axes.len()) {
                    if is_loud(&place) && !term.places.contains(&place) {
                        term.places.push(place);
                        values.extend_from_slice(&none);
                        more += 1;
                    }
                }
            }
            (term, values)
        };
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) =
            start_terms(&model).into_iter().map(whole).unzip();
        if more == 0 || self.is_spent() {
            return Ok(model);
        }
        let hopeless = model.fit.cost;
        let other = self.fit_model(terms, start.concat(), Effort { hopeless, ..effort })?;
        let is_worth = other.fit.cost + WORTH_OF_PLACE * f64::from(more) < model.fit.cost;
        Ok(if is_worth { other } else { model })
    }
}
