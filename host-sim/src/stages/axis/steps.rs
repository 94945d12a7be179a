//! What of an axis depends on the length of a step: an axis that is calm goes on in longer ones (see [`crate::stages::pace`]).

use super::alone;
use crate::stages::creep::CreepSim;
use crate::stages::mechanism::LinearMechanism;
use crate::stages::model::AxisModel;

/// What depends on the length of a step.
pub(super) struct Steps {
    pub(super) mechanism: LinearMechanism,
    pub(super) creep: CreepSim,
    pub(super) ticks: Vec<alone::Tick>,
    pub(super) step_s: f64,
}

impl Steps {
    /// Of `step_s`, in which the force goes as with a time constant of `shape_s`; `added`: levels of [`stiffening`].
    pub(super) fn new(model: &AxisModel, step_s: f64, shape_s: f64, added: &[f64]) -> Self {
        let mechanism = LinearMechanism::new(model, step_s, shape_s, added);
        let piezo = &model.piezo;
        let creep = CreepSim::new(&piezo.creep, piezo.creep_level_per_v, step_s);
        let ticks = alone::ticks(
            &mechanism,
            piezo.transformer_n_per_v,
            piezo.capacitance_f,
            1.0 + creep.per_volt(),
        );
        Self { mechanism, creep, ticks, step_s }
    }
}

/// Levels of the stiffening by the hysteresis branch, from all elements slipping to none.
const LEVELS: usize = 9;

/// Stiffness that the charge branch adds to the mechanism when elements of slope `j/(LEVELS-1)` of all hold, N/m:
/// with `v_z = v - S q`, `q = T x + C v_z`, the force `T v_z` falls by `T^2 S/(1 + C S)` a metre.
pub(super) fn stiffening(model: &AxisModel) -> Vec<f64> {
    let piezo = &model.piezo;
    let all = piezo.steepest_v_per_c();
    if all == 0.0 {
        return vec![0.0];
    }
    let transformer = piezo.transformer_n_per_v;
    (0..LEVELS)
        .map(|j| {
            let slope = all * j as f64 / (LEVELS - 1) as f64;
            transformer * transformer * slope / (1.0 + piezo.capacitance_f * slope)
        })
        .collect()
}
