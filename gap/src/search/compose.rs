//! One axis, its own causes: what suits each axis best, put together.
//!
//! A model that is fitted to all axes has the same effects on all of them, and of two rigs that lack different things on different
//! axes it tells half the truth twice. As long as nothing ties axes together, what a fitted model leaves on an axis does not depend on its
//! places elsewhere, so that the best composition can be read off the models that were fitted. Models with effects between axes are left
//! out; where the rig itself ties axes, the price is only a promise, and the fit decides.

use host_sim::effects::Place;

use crate::Error;
use crate::fitting::fit::Effort;
use crate::fitting::model::{Model, Term, join_terms};
use crate::judge::ambiguity::NOISE_MARGIN;
use crate::search::loops::LOOP;
use crate::search::select::Search;
use crate::search::swap::AS_LITTLE;

/// What one model does on one axis.
struct Part {
    /// Number of the model among those that were tried; none for the rig as it is.
    of: Option<usize>,
    /// Its effects there, sorted.
    names: Vec<&'static str>,
    /// Cost that it leaves there, and what each of its effects has to be worth, more if one of them is a loop, which bends to much.
    price: f64,
}

impl Search<'_> {
    /// Fit the composition of exactly `size` effects that promises to leave least, if that is less than the best model of as many or fewer
    /// leaves, and the best one of those with every effect on axes of its own, if that is less than fewer leave: two effects together on an
    /// axis may leave less and yet not be worth it.
    pub(crate) fn compose(&mut self, size: usize) -> Result<(), Error> {
        self.compose_of(size, size, |_| true)?;
        self.compose_of(size, size - 1, |part| part.names.len() < 2)
    }

    /// Fit the composition of exactly `size` effects from those parts that are `wanted`, if it promises less than models of at most `most`
    /// effects leave.
    fn compose_of(
        &mut self,
        size: usize,
        most: usize,
        wanted: impl Fn(&Part) -> bool,
    ) -> Result<(), Error> {
        let of_axis = |axis| self.parts(axis, size).into_iter().filter(&wanted).collect();
        let parts: Vec<Vec<Part>> = (0..self.nominal.axes.len()).map(of_axis).collect();
        let Some((price, picked)) = cheapest(&parts, size) else { return Ok(()) };
        let price_of = |best: Model| {
            let terms: usize = best.terms.iter().map(|t| t.places.len()).sum();
            best.fit.cost + NOISE_MARGIN * terms as f64 + self.form_of(&best)
        };
        let known = (1..=most).filter_map(|n| self.best_of(n)).map(price_of);
        let known = known.fold(f64::INFINITY, f64::min);
        if price >= known - NOISE_MARGIN {
            return Ok(());
        }
        let mut terms: Vec<(Term, Vec<f64>)> = Vec::new();
        for (axis, part) in picked.iter().enumerate() {
            let Some(model) = part.of.map(|m| &self.tried[m]) else { continue };
            join_terms(&mut terms, model.part(|_, here| here.places[0] == Place::Axis(axis)));
        }
        let (terms, start): (Vec<Term>, Vec<Vec<f64>>) = terms.into_iter().unzip();
        // One at the same places that leaves more was begun elsewhere, or given up.
        let is_it = |known: &Model| known.fit.cost <= price && has_same_places(known, &terms);
        if self.tried.iter().any(is_it) {
            return Ok(());
        }
        let effort = Effort { iterations: 4, tolerance: 2.0e-2, ..self.effort() };
        let model = self.fit_model(terms, start.concat(), effort)?;
        self.remember(model);
        Ok(())
    }

    /// What models of fewer numbers may leave more than this one, for the form that a loop among its effects takes on.
    pub(crate) fn form_of(&self, model: &Model) -> f64 {
        let bends = model.terms.iter().any(|term| term.name() == LOOP);
        if bends { AS_LITTLE * (model.fit.cost - self.noise).max(0.0) } else { 0.0 }
    }

    /// Whether a model of these effects was fitted that has all of them on one axis at least: a composition of what suits different axes
    /// says nothing of how they do beside each other.
    pub(crate) fn is_tried(&self, key: &[&str]) -> bool {
        let together = |m: &Model| {
            let on = |axis: usize| m.terms.iter().all(|term| term.axes().contains(&axis));
            (0..self.nominal.axes.len()).any(on)
        };
        self.tried.iter().any(|m| m.key() == key && together(m))
    }

    /// What models of at most `size` effects do on an axis, the best one of each set of effects.
    fn parts(&self, axis: usize, size: usize) -> Vec<Part> {
        let bare = self.scene.cost_on(&self.base, 1 << axis);
        let mut parts = vec![Part { of: None, names: Vec::new(), price: bare }];
        let is_on_axes = |model: &Model| {
            let mut places = model.terms.iter().flat_map(|t| &t.places);
            model.terms.len() <= size && places.all(|p| matches!(p, Place::Axis(_)))
        };
        for (of, model) in self.tried.iter().enumerate().filter(|(_, m)| is_on_axes(m)) {
            let here = |t: &&Term| t.places.contains(&Place::Axis(axis));
            let mut names: Vec<_> = model.terms.iter().filter(here).map(Term::name).collect();
            names.sort_unstable();
            let left = self.scene.cost_on(&model.fit.stack, 1 << axis);
            // What another effect does about as well on one axis, a loop is not needed for.
            let bends = names.contains(&LOOP);
            let form =
                if bends { AS_LITTLE * self.left_on(&model.fit.stack, 1 << axis) } else { 0.0 };
            let price = left + NOISE_MARGIN * names.len() as f64 + form.max(0.0);
            match parts.iter_mut().find(|part| part.names == names) {
                Some(known) if known.price <= price => {}
                Some(known) => *known = Part { of: Some(of), names, price },
                None => parts.push(Part { of: Some(of), names, price }),
            }
        }
        parts.sort_by(|a, b| a.price.total_cmp(&b.price));
        parts
    }
}

/// Whether a model has these terms, at the same places.
fn has_same_places(model: &Model, terms: &[Term]) -> bool {
    let has = |wanted: &Term| {
        let is_it = |term: &Term| {
            term.name() == wanted.name()
                && term.places.len() == wanted.places.len()
                && wanted.places.iter().all(|place| term.places.contains(place))
        };
        model.terms.iter().any(is_it)
    };
    model.terms.len() == terms.len() && terms.iter().all(has)
}

/// Of all choices of one part an axis, with `size` effects in all, the one with the lowest sum of prices.
fn cheapest(parts: &[Vec<Part>], size: usize) -> Option<(f64, Vec<&Part>)> {
    let mut best: Option<(f64, Vec<&Part>)> = None;
    // Price, parts of the first axes, and their effects.
    let mut open: Vec<(f64, Vec<&Part>, Vec<&str>)> = vec![(0.0, Vec::new(), Vec::new())];
    while let Some((price, picked, names)) = open.pop() {
        if best.as_ref().is_some_and(|(least, _)| price >= *least) {
            continue;
        }
        if picked.len() == parts.len() {
            if names.len() == size {
                best = Some((price, picked));
            }
            continue;
        }
        // The cheapest one is looked at first.
        for part in parts[picked.len()].iter().rev() {
            let mut all = names.clone();
            all.extend(part.names.iter().filter(|n| !names.contains(n)));
            if all.len() <= size {
                let longer = picked.iter().copied().chain([part]).collect();
                open.push((price + part.price, longer, all));
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(names: &[&'static str], price: f64) -> Part {
        Part { of: None, names: names.to_vec(), price }
    }

    #[test]
    fn different_effects_on_different_axes_are_put_together() {
        let parts = [
            vec![part(&["a"], 10.0), part(&["b"], 50.0), part(&[], 90.0)],
            vec![part(&["b"], 20.0), part(&["a"], 70.0)],
            vec![part(&["a", "b"], 5.0), part(&["a"], 6.0), part(&["c"], 1.0)],
        ];
        let (price, picked) = cheapest(&parts, 2).unwrap();
        assert_eq!(price, 35.0);
        assert_eq!(picked[1].names, ["b"]);
        assert_eq!(cheapest(&parts, 3).unwrap().0, 31.0);
        assert_eq!(cheapest(&parts, 1).unwrap().0, 86.0);
        assert!(cheapest(&parts, 4).is_none());
    }
}
