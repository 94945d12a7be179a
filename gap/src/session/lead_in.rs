//! What the lead-in of a single recording tells of the stacks' past.
//!
//! A stack goes on creeping in one recording from what was done to it in the ones before. A replay of a single file knows none of them; what
//! it has is the part before `settle_s`, in which no position is scored and which is there to bring the stack to a known state. Past its
//! largest drive, if that is the largest of the file, the slip elements remember nothing older, and what is left between measured and
//! simulated there is the creep that is still coming back. The past is looked for as mean transducer voltages over stretches that lengthen
//! with their age. A few tenths of a second do not tell them apart, so each is taken for zero as far as the lead-in does not object. An
//! unknown initial state that is found from samples which are then not scored is nothing unusual: the cascaded tanks of Schoukens and
//! Noel (Three benchmarks addressing open challenges in nonlinear system identification, 2017) ask for it.
//!
//! An offset of the gauge that the rig file lacks cannot be told from slow creep in so short a time: a rig with creep takes it for that.

use std::ops::Range;
use std::sync::Arc;

use host_sim::rig::Rig;
use host_sim::{Axes, Initial, Input, Place, SimError, Stretch, simulate};
use nalgebra::{SMatrix, SVector};

/// How long ago each stretch ended and began, s: what a lead-in of half a second can tell apart and more.
const AGES_S: [f64; STRETCHES + 1] = [0.0, 0.3, 3.0, 30.0, 300.0, 3000.0];
/// Number of stretches.
const STRETCHES: usize = 5;
/// Mean transducer voltage of a stretch that surprises nobody, V.
const USUAL_V: f64 = 30.0;
/// Voltage of which the consequences are simulated, V.
const TRIED_V: f64 = 30.0;
/// Means over this long are compared, or single samples of slower recordings, s.
const BLOCK_S: f64 = 0.01;
/// Fewest of them.
const FEWEST_BLOCKS: usize = 5;
/// What a good model leaves in all of them alike, m, and as a share of the displacement.
const LEAVES_M: f64 = 2.0e-9;
const LEAVES_SHARE: f64 = 1.0e-3;
/// Share of the largest drive of the file that an axis has to reach in its lead-in to forget what was before.
const FORGETS: f64 = 0.9;
/// Share of what is missing in the lead-in (rms) that a past may leave: else it is something other than creep.
const ACCOUNTS: f64 = 0.5;
/// Change of every voltage at which they count as found, V, and most sweeps until then.
const SETTLED_V: f64 = 1.0e-6;
const MOST_SWEEPS: usize = 1_000_000;

/// Mean voltages of the stretches, the youngest first, V.
type Voltages = SVector<f64, STRETCHES>;

/// Initial states of all axes that suit the lead-in of a recording best: `settle` is its number of samples, `measured_m(axis, sample)` what
/// the gauges read there. Rested stacks where the rig has no creep, where gauges read several axes, where a sample was not measured,
/// or where the lead-in is too short or too small to tell.
pub fn initial(
    rig: &Rig,
    input: &Input,
    settle: usize,
    measured_m: impl Fn(usize, usize) -> Option<f64>,
) -> Result<Vec<Initial>, SimError> {
    let mut initial = vec![Initial::default(); rig.axes.len()];
    let lead_in = 0..settle;
    // What does not fit together is for the simulation to complain of.
    if rig.output_map.is_some() || input.drive_v.iter().any(|drive| drive.len() < settle) {
        return Ok(initial);
    }
    let swing_v = |axis: usize, sample: usize| {
        let drive_v = input.drive_v[axis];
        (drive_v[sample] - drive_v[0]).abs()
    };
    let largest_v = (0..input.drive_v.len())
        .flat_map(|axis| (0..input.drive_v[axis].len()).map(move |sample| swing_v(axis, sample)))
        .fold(0.0, f64::max);
    for axis in 0..rig.axes.len() {
        let creeps = rig.get("creep", Place::Axis(axis), "per_decade").unwrap_or(0.0) != 0.0;
        let further = |a: usize, b: usize| if swing_v(axis, b) > swing_v(axis, a) { b } else { a };
        let Some(turn) = lead_in.clone().reduce(further).filter(|_| creeps) else { continue };
        let blocks = blocks(turn..settle, input.sample_rate_hz);
        if swing_v(axis, turn) < FORGETS * largest_v || blocks.len() < FEWEST_BLOCKS {
            continue;
        }
        let read: Option<Vec<f64>> = (turn..settle).map(|i| measured_m(axis, i)).collect();
        let Some(read) = read else { continue };
        let mean_m = |block: &Range<usize>, of: &dyn Fn(usize) -> f64| {
            block.clone().map(of).sum::<f64>() / block.len() as f64
        };
        let simulated_m = |past: Option<Arc<[Stretch]>>| -> Result<Vec<f64>, SimError> {
            let drive_v: Vec<&[f64]> = input.drive_v.iter().map(|v| &v[lead_in.clone()]).collect();
            let mut states = vec![Initial::default(); rig.axes.len()];
            states[axis].past = past;
            let input = Input {
                ticks: input.ticks.map(|ticks| &ticks[lead_in.clone()]),
                drive_v: &drive_v,
                monitor_v: None,
                initial: &states,
                ..*input
            };
            let output = simulate(rig, &input, Axes::Only(1 << axis))?;
            Ok(blocks.iter().map(|block| mean_m(block, &|i| output.position_m[axis][i])).collect())
        };
        let noise_m = rig.axes[axis].sensor.noise_rms_m / (blocks[0].len() as f64).sqrt();
        let measured: Vec<f64> =
            blocks.iter().map(|block| mean_m(block, &|i| read[i - turn])).collect();
        // What a good model leaves is alike in all blocks, so that many of them tell no more than few.
        let leaves_m = |level_m: f64| {
            let form_m = LEAVES_M.hypot(LEAVES_SHARE * level_m) * (blocks.len() as f64).sqrt();
            form_m.hypot(noise_m)
        };
        let base = simulated_m(None)?;
        let mut slopes = Vec::with_capacity(STRETCHES);
        for stretch in 0..STRETCHES {
            let mut tried_v = Voltages::zeros();
            tried_v[stretch] = TRIED_V;
            let tried = simulated_m(Some(past(&tried_v)))?;
            slopes
                .push(tried.iter().zip(&base).map(|(a, b)| (a - b) / TRIED_V).collect::<Vec<_>>());
        }
        let mut normal =
            SMatrix::<f64, STRETCHES, STRETCHES>::from_diagonal_element(USUAL_V.powi(-2));
        let mut asked = Voltages::zeros();
        for (row, &measured_m) in measured.iter().enumerate() {
            let weight = leaves_m(measured_m).powi(-2);
            let slope = Voltages::from_fn(|k, _| slopes[k][row]);
            normal += slope * slope.transpose() * weight;
            asked += slope * (weight * (measured_m - base[row]));
        }
        let amplifier = &rig.axes[axis].amplifier;
        let limits_v = (amplifier.min_v.min(0.0), amplifier.max_v.max(0.0));
        let past = past(&bounded(&normal, &asked, limits_v));
        let left = |simulated: &[f64]| -> f64 {
            measured.iter().zip(simulated).map(|(a, b)| (a - b).powi(2)).sum()
        };
        if left(&simulated_m(Some(past.clone()))?) < ACCOUNTS.powi(2) * left(&base) {
            initial[axis].past = Some(past);
        }
    }
    Ok(initial)
}

/// Stretches of these mean voltages.
fn past(voltages_v: &Voltages) -> Arc<[Stretch]> {
    let ages = AGES_S.windows(2).zip(voltages_v.iter());
    ages.map(|(age, &transducer_v)| Stretch { lasted_s: age[1] - age[0], transducer_v })
        .rev()
        .collect()
}

/// Whole blocks of a stretch of samples.
fn blocks(samples: Range<usize>, rate_hz: f64) -> Vec<Range<usize>> {
    let length = ((BLOCK_S * rate_hz).round() as usize).max(1);
    let starts = samples.clone().step_by(length).filter(|start| start + length <= samples.end);
    starts.map(|start| start..start + length).collect()
}

/// Voltages within limits that solve `normal * v = asked` best.
fn bounded(
    normal: &SMatrix<f64, STRETCHES, STRETCHES>,
    asked: &Voltages,
    (least_v, most_v): (f64, f64),
) -> Voltages {
    let mut voltages_v = Voltages::zeros();
    // Coordinate descent comes to the one minimum that a strictly convex sum of squares has in a box.
    for _ in 0..MOST_SWEEPS {
        let before_v = voltages_v;
        for k in 0..STRETCHES {
            let open = asked[k] - (normal.row(k) * voltages_v)[0];
            voltages_v[k] = (voltages_v[k] + open / normal[(k, k)]).max(least_v).min(most_v);
        }
        if (voltages_v - before_v).amax() < SETTLED_V {
            break;
        }
    }
    voltages_v
}
