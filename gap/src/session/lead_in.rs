//! What the lead-in of a single recording tells of the stacks' past.
//!
//! A stack goes on creeping in one recording from what was done to it in the ones before. A replay of a single file knows none of them; what
//! it has is the part before `settle_s`, in which nothing is scored and which is there to bring the stack to a known state. Past its
//! largest drive the slip elements remember nothing older, and what is left between measured and simulated there is the creep that is still
//! coming back. The past is looked for as mean transducer voltages over stretches that lengthen with their age. A few tenths of a second
//! do not tell them apart, so each is taken for zero as far as the lead-in does not object. An unknown initial state that is found from
//! samples which are then not scored is nothing unusual: the cascaded tanks of Schoukens and Noel (Three benchmarks addressing open
//! challenges in nonlinear system identification, 2017) ask for it.

use std::ops::Range;
use std::sync::Arc;

use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Output, Place, Stretch, simulate};
use nalgebra::{DMatrix, DVector};

use crate::Error;

/// How long ago each stretch ended and began, s: what a lead-in of half a second can tell apart and more.
const AGES_S: [f64; 6] = [0.0, 0.3, 3.0, 30.0, 300.0, 3000.0];
/// Mean transducer voltage of a stretch that surprises nobody, V.
const USUAL_V: f64 = 30.0;
/// Voltage of which the consequences are simulated, V.
const TRIED_V: f64 = 30.0;
/// Means over this long are compared, s.
const BLOCK_S: f64 = 0.01;
/// Fewest of them.
const FEWEST_BLOCKS: usize = 5;
/// What a good model leaves in all of them alike, m, and as a share of the displacement.
const LEAVES_M: f64 = 2.0e-9;
const LEAVES_SHARE: f64 = 1.0e-3;
/// Share of the motion in them that is missing where the lead-in is not one of this rig, or was not measured: no past makes that.
const NOT_OF_THIS_RIG: f64 = 0.2;
/// Sweeps of a coordinate descent over the stretches.
const SWEEPS: usize = 500;

/// Initial states of all axes that suit the lead-in of a recording best: `settle` is its number of samples, `measured_m(axis, sample)` what
/// the gauges read there. Rested stacks where the rig has no creep, or where the lead-in is too short.
pub fn initial(
    rig: &Rig,
    input: &Input,
    settle: usize,
    measured_m: impl Fn(usize, usize) -> Option<f64>,
) -> Result<Vec<Initial>, Error> {
    let axes = rig.axes.len();
    let rested = vec![Initial::default(); axes];
    let creeps = |axis: &usize| {
        rig.get("creep", Place::Axis(*axis), "per_decade").is_some_and(|share| share != 0.0)
    };
    let creeping: Vec<usize> = (0..axes).filter(creeps).collect();
    let settle = settle.min(input.drive_v[0].len());
    let blocks = blocks(input, settle);
    if creeping.is_empty() || blocks.len() < FEWEST_BLOCKS {
        return Ok(rested);
    }
    let drive: Vec<&[f64]> = input.drive_v.iter().map(|v| &v[..settle]).collect();
    let run = |past: &[Initial]| -> Result<Output, Error> {
        let lead_in = Input {
            ticks: input.ticks.map(|ticks| &ticks[..settle]),
            drive_v: &drive,
            monitor_v: None,
            initial: past,
            ..*input
        };
        simulate(rig, &lead_in, Axes::All).map_err(|e| Error::Rig(e.to_string()))
    };
    let stretches = AGES_S.len() - 1;
    let state = |voltages_v: &DVector<f64>| {
        let mut state = rested.clone();
        for (&axis, own) in creeping.iter().zip(voltages_v.as_slice().chunks(stretches)) {
            state[axis].past = Some(past(own));
        }
        state
    };
    let mean = |axis: usize, block: &Range<usize>, of: &dyn Fn(usize, f64) -> f64| {
        let read = block.clone().filter_map(|i| measured_m(axis, i).map(|m| of(i, m)));
        let (sum, count) = read.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    };
    // Blocks of a gauge, and what a good model leaves in the mean of one.
    let mut rows = Vec::new();
    for (axis, block) in (0..axes).flat_map(|axis| blocks.iter().map(move |block| (axis, block))) {
        if let Some(level_m) = mean(axis, block, &|_, m| m.abs()) {
            let leaves_m = LEAVES_M.hypot(LEAVES_SHARE * level_m);
            rows.push((axis, block, leaves_m * (blocks.len() as f64).sqrt()));
        }
    }
    let base = run(&rested)?;
    let [missing_m, motion_m] = [1.0, 0.0].map(|measured| {
        let of = rows.iter().map(|(axis, block, _)| {
            let left = |i: usize, m: f64| m * measured - base.position_m[*axis][i];
            mean(*axis, block, &left).unwrap_or(0.0).powi(2)
        });
        of.sum::<f64>().sqrt()
    });
    if missing_m > NOT_OF_THIS_RIG * motion_m {
        return Ok(rested);
    }
    let missing = rows.iter().map(|(axis, block, leaves_m)| {
        let mean = mean(*axis, block, &|i, m| m - base.position_m[*axis][i]);
        mean.unwrap_or(0.0) / leaves_m
    });
    let missing = DVector::from_iterator(rows.len(), missing);
    let mut slopes = DMatrix::zeros(rows.len(), creeping.len() * stretches);
    for k in 0..slopes.ncols() {
        let mut tried_v = DVector::zeros(slopes.ncols());
        tried_v[k] = TRIED_V;
        let tried = run(&state(&tried_v))?;
        for (row, (axis, block, leaves_m)) in rows.iter().enumerate() {
            let adds = |i: usize, _| tried.position_m[*axis][i] - base.position_m[*axis][i];
            let per_v = mean(*axis, block, &adds).unwrap_or(0.0) / TRIED_V;
            slopes[(row, k)] = per_v / leaves_m;
        }
    }
    let within = |k: usize| {
        let amplifier = &rig.axes[creeping[k / stretches]].amplifier;
        (amplifier.min_v, amplifier.max_v)
    };
    Ok(state(&bounded(&slopes, &missing, within)))
}

/// Stretches of these mean voltages, the youngest first.
fn past(voltages_v: &[f64]) -> Arc<[Stretch]> {
    let ages = AGES_S.windows(2).zip(voltages_v);
    ages.map(|(age, &transducer_v)| Stretch { lasted_s: age[1] - age[0], transducer_v })
        .rev()
        .collect()
}

/// Blocks of samples past the largest drive of any axis.
fn blocks(input: &Input, settle: usize) -> Vec<Range<usize>> {
    let turn = |drive: &&[f64]| {
        let swing = |i: usize| (drive[i] - drive[0]).abs();
        (0..settle).fold(0, |most, i| if swing(i) > swing(most) { i } else { most })
    };
    let from = input.drive_v.iter().map(turn).max().unwrap_or(0);
    let length = ((BLOCK_S * input.sample_rate_hz).round() as usize).max(1);
    (from..settle.saturating_sub(length - 1))
        .step_by(length)
        .map(|start| start..start + length)
        .collect()
}

/// Voltages `within` their limits that suit the equations best, and are no larger than they have to be (a ridge).
fn bounded(
    equations: &DMatrix<f64>,
    right: &DVector<f64>,
    within: impl Fn(usize) -> (f64, f64),
) -> DVector<f64> {
    let unknowns = equations.ncols();
    let usual = DMatrix::identity(unknowns, unknowns) / (USUAL_V * USUAL_V);
    let normal = equations.tr_mul(equations) + usual;
    let asked = equations.tr_mul(right);
    let mut voltages_v = DVector::zeros(unknowns);
    // Coordinate descent comes to the one minimum that a strictly convex sum of squares has in a box.
    for _ in 0..SWEEPS {
        for k in 0..unknowns {
            let open = asked[k] - (normal.row(k) * &voltages_v)[0];
            let (least_v, most_v) = within(k);
            voltages_v[k] = (voltages_v[k] + open / normal[(k, k)]).max(least_v).min(most_v);
        }
    }
    voltages_v
}
