//! Stiffness and hysteresis from slow motion: the inverse model itself, fitted.
//!
//! A stack of Goldfarb and Celanovic (IEEE Control Systems 17(3), 1997) that moves slowly against a spring is
//! `v = x / g + sum k_j E_j(x)`, with `E_j` the stop operator of threshold `r_j` in the position, as charge and position then go
//! together. That is a Prandtl-Ishlinskii operator from position to voltage, the form in which the controller needs it: fitted
//! this way round it is linear least squares, and nothing has to be inverted (Krejci and Kuhnen, IEE Proc. Control Theory
//! Appl. 148, 2001, fit the play form and invert it in closed form).
//!
//! What the stack went through before a recording is not known. A stop of threshold `r` has forgotten it once the motion has
//! spanned `2 r`; of one that has not, the unknown part is a constant until the motion reaches new ground. So every
//! recording has a constant of its own, a new one wherever its motion widened, and rows of new ground do not count; no threshold
//! is larger than half the motion. Only if a stack that was never driven predicts the new ground as well as the rest do
//! these rows count, and then thresholds go a little beyond half of the motion: what slips later slips in the first ascent only, and
//! its few rows, with creep and rate in them, do not tell such an element from the spring.

use flexstage::MAX_MAXWELL;
use nalgebra::{DMatrix, DVector};

use super::bounded::non_negative;
use super::creep::Chain;
use super::series::{Series, Step};

/// Largest threshold over the span of the slow motion, for memory that is known from the start and for memory that is not.
///
/// On `bench`'s different plant feedforward alone errs by 0.52 % at 1 Hz with 0.82, 0.34 % with 0.67, 0.27 % with 0.55, 0.18 % with 0.5
/// (at 10 Hz 0.46, 0.32, 0.25, 0.26 %). Where the memory is not known, a stop of half the span or more never slips in what counts: it
/// cannot be told from the spring and takes its stiffness away.
const REACH: [f64; 2] = [0.55, 0.4];
/// Thresholds are crowded towards small ones, where loops have their sharp corners, with this power.
const CROWDING: f64 = 1.6;
/// Widening of a motion that counts, over its span.
const WIDENS: f64 = 0.005;
/// A stack that was never driven is at this share of the drive's span from 0 V at most.
const AT_ZERO: f64 = 0.02;
/// New ground is understood if its misfit is no more than this over that of the rest: a memory that is not there costs tens of
/// times a misfit.
const UNDERSTOOD: f64 = 4.0;
/// Share of the rows of a recording that is fitted before the rest is predicted.
const FITTED: f64 = 2.0 / 3.0;
/// Least slow motion, s ...
const LEAST_S: f64 = 1.0;
/// ... and fewest rows of it.
const FEWEST_ROWS: usize = 100;
/// Slow motion spans at least this share of the drive.
const LEAST_SPAN: f64 = 0.3;
/// Strengths below this are none, V/um.
const NOTHING: f64 = 1.0e-6;

/// One slow row: position, stops, voltage.
struct Row {
    group: usize,
    stretch: usize,
    widening: bool,
    last_third: bool,
    lasts_s: f64,
    /// Position without creep, one stop a threshold, position with creep, um.
    x: Vec<f64>,
    v: f64,
}

/// What slow motion says about an axis.
#[derive(Clone, Debug, Default)]
pub struct Inverse {
    /// Voltage a micrometre of the spring alone, without the stops.
    pub v_per_um: f64,
    /// Threshold (um) and slope (V/um) of each stop.
    pub elements: Vec<(f64, f64)>,
    /// Voltage at position zero of a stack that was never driven, V.
    pub constant_v: f64,
    /// Best straight line, V/um: what a controller without a model would use.
    pub linear_v_per_um: f64,
    /// Its voltage at position zero, V.
    pub linear_v: f64,
    /// Rms about the straight line, V.
    pub linear_misfit_v: f64,
    /// Rms about the model, V.
    pub misfit_v: f64,
    /// The same over the last third of every recording, by fits that never saw it: straight line, V.
    pub held_out_linear_v: f64,
    /// Model, V.
    pub held_out_v: f64,
    /// Slow motion that was used, s.
    pub slow_s: f64,
    /// Whether some recording begins with a stack that was never driven.
    pub from_depoled: bool,
}

/// Fit; the error says what is missing.
pub(super) fn fit(series: &[Series], per_decade: f64, span_v: f64) -> Result<Inverse, String> {
    let motions: Vec<Vec<Moved>> = series.iter().map(|s| elastic(s, per_decade)).collect();
    let spans: Vec<f64> = motions.iter().map(|m| span(m.iter().map(|s| s.um))).collect();
    let slow_um = |m: &Vec<Moved>| span(m.iter().filter(|s| s.step.scored).map(|s| s.um));
    let span_um = motions.iter().map(slow_um).fold(0.0, f64::max);
    let slow_v = span(motions.iter().flatten().filter(|s| s.step.scored).map(|s| s.step.v));
    if slow_v.is_nan() || slow_v < LEAST_SPAN * span_v {
        return Err(format!(
            "no slow motion: expected at least a second in which the drive spans {:.0} V with nothing above 20 Hz in it, \
             found {:.1} V",
            LEAST_SPAN * span_v,
            slow_v.max(0.0)
        ));
    }
    // First as if every recording that shows new ground began with a stack that was never driven; those that it does not suit
    // are told apart.
    let mut known = vec![false; series.len()];
    for row in rows(&motions, &spans, &vec![true; series.len()], &[]) {
        let starts_v = motions[row.stretch].first().map_or(f64::MAX, |s| s.step.v);
        known[row.stretch] |= row.widening && starts_v.abs() <= AT_ZERO * span_v;
    }
    loop {
        let mut limits = thresholds(REACH[0] * span_um);
        let mut rows = rows(&motions, &spans, &known, &limits);
        let new_ground = rows.iter().any(|r| r.widening);
        if !new_ground {
            limits = thresholds(REACH[1] * span_um);
            rows = self::rows(&motions, &spans, &known, &limits);
        }
        let slow_s: f64 = rows.iter().map(|r| r.lasts_s).sum();
        if slow_s < LEAST_S || rows.len() < FEWEST_ROWS {
            return Err(format!(
                "too little slow motion: expected {LEAST_S} s and more in which the drive goes up and down where it was before, \
                 found {slow_s:.2} s"
            ));
        }
        let solution = solve(&rows, |_| true);
        if solution[0] <= NOTHING * slow_v / span_um {
            return Err("the position does not rise with the drive in slow motion: expected a gauge with the sign of its drive and \
                        triangles of several heights, from the whole stroke to a fifth of it"
                .into());
        }
        let left = residuals(&rows, &solution, |_| true);
        let rms = |keep: &dyn Fn(&Row) -> bool| root_mean_square(&rows, &left, keep);
        let rest = rms(&|r| !r.widening);
        let misunderstood: Vec<usize> = (0..known.len())
            .filter(|&s| known[s] && rms(&|r| r.stretch == s && r.widening) > UNDERSTOOD * rest)
            .collect();
        if misunderstood.is_empty() {
            return Ok(inverse(&rows, &limits, new_ground));
        }
        misunderstood.into_iter().for_each(|stretch| known[stretch] = false);
    }
}

/// Of what is left in the rows that `keep` says; 0 without any.
fn root_mean_square(rows: &[Row], left: &[f64], keep: &dyn Fn(&Row) -> bool) -> f64 {
    let kept = rows.iter().zip(left).filter(|(row, _)| keep(row));
    let (n, sum) = kept.fold((0.0, 0.0), |(n, sum), (_, e)| (n + 1.0, sum + e * e));
    if n > 0.0 { f64::sqrt(sum / n) } else { 0.0 }
}

/// A step, and the position without creep.
struct Moved {
    step: Step,
    um: f64,
}

fn elastic(series: &Series, per_decade: f64) -> Vec<Moved> {
    let mut chain = Chain::new(per_decade, &series.strains_um);
    let steps = series.steps().into_iter();
    steps.map(|step| Moved { um: chain.elastic(step.um, step.lasts_s), step }).collect()
}

fn span(x: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = x.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
    high - low
}

/// Thresholds up to `largest_um`, as many as the controller has slip elements.
fn thresholds(largest_um: f64) -> Vec<f64> {
    (1..=MAX_MAXWELL).map(|j| largest_um * (j as f64 / MAX_MAXWELL as f64).powf(CROWDING)).collect()
}

fn rows(motions: &[Vec<Moved>], spans: &[f64], known: &[bool], thresholds: &[f64]) -> Vec<Row> {
    let mut all = Vec::new();
    let mut group = 0;
    for (stretch, motion) in motions.iter().enumerate() {
        let Some(start) = motion.first().map(|s| s.um) else { continue };
        let first = all.len();
        let slack = WIDENS * spans[stretch];
        let (mut low, mut high, mut previous) = (start, start, start);
        // A stack that was never driven is at zero with nothing in its stops.
        let mut stops = vec![0.0; thresholds.len()];
        let mut was_widening = false;
        for &Moved { step, um } in motion {
            for (stop, r) in stops.iter_mut().zip(thresholds) {
                *stop = f64::clamp(*stop + um - previous, -r, *r);
            }
            previous = um;
            let widening = um > high + slack || um < low - slack;
            if widening {
                (low, high) = (low.min(um), high.max(um));
            } else if was_widening && !known[stretch] {
                group += 1;
            }
            was_widening = widening;
            if step.scored && (known[stretch] || !widening) {
                let x: Vec<f64> = std::iter::once(um).chain(stops.iter().copied()).collect();
                let x = x.into_iter().chain([step.um]).collect();
                let (v, lasts_s) = (step.v, step.lasts_s);
                all.push(Row { group, stretch, widening, last_third: false, lasts_s, x, v });
            }
        }
        group += 1;
        let fitted = first + (FITTED * (all.len() - first) as f64) as usize;
        all[fitted..].iter_mut().for_each(|row| row.last_third = true);
    }
    all
}

/// Mean of position, stops and voltage of every group, over the rows that `keep` says; over all rows for groups without such.
fn means(rows: &[Row], keep: impl Fn(&Row) -> bool) -> Vec<(Vec<f64>, f64)> {
    let columns = rows.first().map_or(0, |r| r.x.len());
    let groups = rows.iter().map(|r| r.group + 1).max().unwrap_or(0);
    let kept: Vec<bool> = rows.iter().fold(vec![false; groups], |mut has, r| {
        has[r.group] |= keep(r);
        has
    });
    let mut sums = vec![(vec![0.0; columns], 0.0, 0.0); groups];
    for row in rows.iter().filter(|r| keep(r) || !kept[r.group]) {
        let (x, v, n) = &mut sums[row.group];
        x.iter_mut().zip(&row.x).for_each(|(sum, x)| *sum += x);
        *v += row.v;
        *n += 1.0;
    }
    sums.into_iter()
        .map(|(x, v, n)| {
            let n = f64::max(n, 1.0);
            (x.into_iter().map(|x| x / n).collect(), v / n)
        })
        .collect()
}

/// V/um of the spring and of every stop, each group of rows having a constant of its own.
fn solve(rows: &[Row], keep: impl Fn(&Row) -> bool + Copy) -> DVector<f64> {
    let (normal, right) = normal(rows, keep);
    let unknowns = right.len() - 1;
    let normal = normal.view((0, 0), (unknowns, unknowns)).into_owned();
    let solution = non_negative(&normal, &right.rows(0, unknowns).into_owned(), |i| i == 0);
    solution.push(0.0)
}

fn normal(rows: &[Row], keep: impl Fn(&Row) -> bool + Copy) -> (DMatrix<f64>, DVector<f64>) {
    let means = means(rows, keep);
    let columns = rows.first().map_or(0, |r| r.x.len());
    let (mut normal, mut right) = (DMatrix::zeros(columns, columns), DVector::zeros(columns));
    let mut x = vec![0.0; columns];
    for row in rows.iter().filter(|r| keep(r)) {
        let (mean_x, mean_v) = &means[row.group];
        for ((x, value), mean) in x.iter_mut().zip(&row.x).zip(mean_x) {
            *x = value - mean;
        }
        for i in 0..columns {
            for j in 0..=i {
                normal[(i, j)] += x[i] * x[j];
            }
            right[i] += x[i] * (row.v - mean_v);
        }
    }
    normal.fill_upper_triangle_with_lower_triangle();
    (normal, right)
}

/// Voltage less what the solution says, the constants of the groups being those of the rows that `keep` says.
fn residuals(
    rows: &[Row],
    solution: &DVector<f64>,
    keep: impl Fn(&Row) -> bool + Copy,
) -> Vec<f64> {
    let means = means(rows, keep);
    rows.iter()
        .map(|row| {
            let (mean_x, mean_v) = &means[row.group];
            let model: f64 =
                row.x.iter().zip(mean_x).zip(solution).map(|((x, m), k)| k * (x - m)).sum();
            row.v - mean_v - model
        })
        .collect()
}

fn inverse(rows: &[Row], thresholds: &[f64], from_depoled: bool) -> Inverse {
    let every = |_: &Row| true;
    let before = |r: &Row| !r.last_third;
    let rms = |left: Vec<f64>, keep: &dyn Fn(&Row) -> bool| root_mean_square(rows, &left, keep);
    let line = |keep: &dyn Fn(&Row) -> bool| {
        let (normal, right) = normal(rows, keep);
        let mut solution = DVector::zeros(right.len());
        let with_creep = right.len() - 1;
        solution[with_creep] = right[with_creep] / normal[(with_creep, with_creep)];
        solution
    };
    let (model, straight) = (solve(rows, every), line(&every));
    let (early, early_line) = (solve(rows, before), line(&before));
    // Positions are the gauge's here: the constant is what the drive of a stack that was never driven is at its zero.
    let mean = |f: &dyn Fn(&Row) -> f64| rows.iter().map(f).sum::<f64>() / rows.len() as f64;
    let at_zero = |solution: &DVector<f64>| {
        mean(&|r| r.v - r.x.iter().zip(solution).map(|(x, k)| k * x).sum::<f64>())
    };
    Inverse {
        v_per_um: model[0],
        elements: thresholds
            .iter()
            .zip(model.iter().skip(1))
            .map(|(r, k)| (*r, *k))
            .filter(|(_, k)| *k > NOTHING)
            .collect(),
        constant_v: at_zero(&model),
        linear_v_per_um: straight[straight.len() - 1],
        linear_v: at_zero(&straight),
        linear_misfit_v: rms(residuals(rows, &straight, every), &every),
        misfit_v: rms(residuals(rows, &model, every), &every),
        held_out_linear_v: rms(residuals(rows, &early_line, before), &|r| r.last_third),
        held_out_v: rms(residuals(rows, &early, before), &|r| r.last_third),
        slow_s: rows.iter().map(|r| r.lasts_s).sum(),
        from_depoled,
    }
}
