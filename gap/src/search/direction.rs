//! Directions: what a setting of an effect changes in whitened residuals, beside a model whose knobs move along.

use host_sim::effects::Place;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::fitting::fit::Sensitivities;
use crate::session::scene::{Scene, Stack, dot};

/// One effect at one place with one set of parameter values, and what it changes.
pub struct Direction {
    /// Index into [`crate::search::screen::Screen::effects`].
    pub effect: usize,
    /// Where.
    pub place: Place,
    /// Parameter values that were tried.
    pub values: Vec<f64>,
    /// Channel and change of its whitened residual.
    pub(super) rows: Vec<(usize, Vec<f32>)>,
    /// Squared length of all rows.
    pub(super) energy: f64,
}

/// A direction beside a model that moves along with it.
pub(super) struct Beside {
    /// Product with the residual.
    pub(super) along: f64,
    /// Squared length.
    pub(super) energy: f64,
    /// What the model does; none without one.
    pub(super) room: Option<Room>,
}

/// What the knobs of a model move by, in internal steps.
pub(super) struct Room {
    /// Without the direction.
    pub(super) alone: DVector<f64>,
    /// For a unit of the direction.
    pub(super) a_unit: DVector<f64>,
    /// Products of the knobs with the direction.
    pub(super) cross: DVector<f64>,
}

impl Direction {
    /// This direction at a residual, what is `known` projected out; none where it is all known.
    pub(super) fn beside(&self, stack: &Stack, known: Option<&Known>) -> Option<Beside> {
        let mut along = 0.0;
        for (c, row) in &self.rows {
            along += dot(row, stack[*c].as_ref()?);
        }
        let mut energy = self.energy;
        let mut room = None;
        if let Some(known) = known {
            let n = known.knobs;
            let mut matrix = DMatrix::<f64>::identity(n, n) * 1.0e-9;
            let mut gradient = DVector::zeros(n);
            let mut cross = DVector::zeros(n);
            for (c, row) in &self.rows {
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
                let a_unit = factor.solve(&cross);
                along -= a_unit.dot(&gradient);
                energy -= a_unit.dot(&cross);
                room = Some(Room { alone: factor.solve(&gradient), a_unit, cross });
            }
        }
        let is_new = energy >= 1.0e-6 * self.energy && energy > 0.0;
        is_new.then_some(Beside { along, energy, room })
    }

    /// Product with another direction at the same place.
    pub(super) fn dot(&self, other: &Self) -> f64 {
        let same = |c: usize| other.rows.iter().find(|(d, _)| *d == c);
        self.rows.iter().filter_map(|(c, row)| Some(dot(row, &same(*c)?.1))).sum()
    }
}

/// What is already in a model, channel by channel: it is the same for every direction.
pub(super) struct Known<'a> {
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
    pub(super) fn new(scene: &Scene, stack: &Stack, model: &'a Sensitivities) -> Self {
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
