//! What is done to a rig: the usual probe session, and sessions of anything.

use std::f64::consts::TAU;

use rand::{Rng, RngExt};

/// One experiment, to be recorded in one file.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// Name.
    pub name: String,
    /// Sample rate (Hz).
    pub sample_rate_hz: f64,
    /// Length of the first part, which only writes the stack's memory (s).
    pub settle_s: f64,
    /// Start on the session's clock (s).
    pub start_s: f64,
    /// Period, if the excitation has one (s).
    pub period_s: Option<f64>,
    /// Whether the amplifiers' outputs are recorded.
    pub monitor: bool,
    /// Commands.
    pub drive: Drive,
    /// For noise and for the memory that the stacks have at the start.
    pub seed: u64,
}

/// Where the commands come from.
#[derive(Clone, Debug)]
pub enum Drive {
    /// A table an axis (V).
    Open(Vec<Vec<f32>>),
    /// A loop on the measured position, after the settling part (V).
    Closed {
        /// Commands of the settling part, for all axes.
        settle: Vec<f32>,
        /// Setpoint an axis (um), from the first tick on.
        reference_um: Vec<Vec<f32>>,
        /// Proportional gain (V/um).
        proportional: f64,
        /// Integral gain (V/um/s).
        integral: f64,
    },
}

impl Experiment {
    /// Length in ticks.
    pub fn ticks(&self) -> usize {
        let table = match &self.drive {
            Drive::Open(tables) => tables.first(),
            Drive::Closed { reference_um, .. } => reference_um.first(),
        };
        table.map_or(0, Vec::len)
    }

    /// Length (s).
    pub fn seconds(&self) -> f64 {
        self.ticks() as f64 / self.sample_rate_hz
    }
}

/// Ramp to 100 V and back in 0.4 s and a rest of 0.1 s: wipes out whatever the stack remembers.
fn settle(rate: f64, top: f64) -> Vec<f32> {
    (0..(0.5 * rate).round() as usize)
        .map(|tick| {
            let t = tick as f64 / rate;
            (top * (1.0 - (t / 0.2 - 1.0).abs()).max(0.0)) as f32
        })
        .collect()
}

/// Samples a function of time (s).
fn sampled(rate: f64, seconds: f64, f: impl Fn(f64) -> f64) -> Vec<f32> {
    (0..(seconds * rate).round() as usize).map(|tick| f(tick as f64 / rate) as f32).collect()
}

fn triangle(t: f64, frequency: f64) -> f64 {
    let phase = (t * frequency).fract();
    1.0 - (2.0 * phase - 1.0).abs()
}

/// Straight lines between (time, value).
fn lines(points: &[(f64, f64)]) -> impl Fn(f64) -> f64 + '_ {
    move |t| {
        let next = points.partition_point(|point| point.0 <= t);
        match (next.checked_sub(1).map(|i| points[i]), points.get(next)) {
            (Some((t0, v0)), Some(&(t1, v1))) => v0 + (v1 - v0) * (t - t0) / (t1 - t0),
            (Some((_, v)), None) | (None, Some(&(_, v))) => v,
            (None, None) => 0.0,
        }
    }
}

/// Random-phase sum of sines around a middle, scaled to a peak.
fn multisine(
    rng: &mut impl Rng,
    lines_hz: &[f64],
    weight: impl Fn(f64) -> f64,
    peak: f64,
    period: f64,
    rate: f64,
) -> Vec<f64> {
    let count = (period * rate).round() as usize;
    let mut sum = vec![0.0; count];
    for &line in lines_hz {
        let phase = rng.random_range(0.0..TAU);
        let amplitude = weight(line);
        // A recurrence instead of a sine each: rotation by one sample.
        let step = TAU * line / rate;
        let (mut c, mut s) = (phase.cos() * amplitude, phase.sin() * amplitude);
        let (dc, ds) = (step.cos(), step.sin());
        for value in &mut sum {
            *value += s;
            (c, s) = (c * dc - s * ds, s * dc + c * ds);
        }
    }
    let largest = sum.iter().fold(0.0f64, |max, value| max.max(value.abs()));
    sum.into_iter().map(|value| value * peak / largest).collect()
}

/// Puts experiments on the session's clock, some seconds apart.
struct Builder<'a, R> {
    rng: &'a mut R,
    axes: usize,
    clock_s: f64,
    pause_s: f64,
    monitor: bool,
    experiments: Vec<Experiment>,
}

impl<R: Rng> Builder<'_, R> {
    fn push(&mut self, name: &str, rate: f64, settle_s: f64, period_s: Option<f64>, drive: Drive) {
        let experiment = Experiment {
            name: name.into(),
            sample_rate_hz: rate,
            settle_s,
            start_s: (self.clock_s * 1e3).round() / 1e3,
            period_s,
            monitor: self.monitor,
            drive,
            seed: self.rng.random(),
        };
        self.clock_s += experiment.seconds() + self.pause_s;
        self.experiments.push(experiment);
    }

    /// Settling ramp on all axes, then each axis' own table; shorter tables hold 0 V.
    fn open(&mut self, name: &str, rate: f64, tables: Vec<Vec<f32>>) {
        let length = tables.iter().map(Vec::len).max().unwrap_or(0);
        let ramp = settle(rate, 100.0);
        let tables = (0..self.axes)
            .map(|axis| {
                let mut table = ramp.clone();
                table.extend(tables.get(axis).into_iter().flatten());
                table.resize(ramp.len() + length, 0.0);
                table
            })
            .collect();
        self.push(name, rate, 0.5, None, Drive::Open(tables));
    }

    fn alone(&self, axis: usize, table: Vec<f32>) -> Vec<Vec<f32>> {
        (0..self.axes).map(|index| if index == axis { table.clone() } else { Vec::new() }).collect()
    }
}

/// The usual session: rest, triangles of one axis at three levels, nested triangles, fast triangle, multisine, squares, steps.
pub fn probe_session(rng: &mut impl Rng, axes: usize, rate: f64, monitor: bool) -> Vec<Experiment> {
    let mut builder =
        Builder { rng, axes, clock_s: 0.0, pause_s: 3.0, monitor, experiments: Vec::new() };
    let rest = vec![vec![0.0; (2.0 * rate) as usize]; axes];
    builder.push("rest", rate, 0.0, None, Drive::Open(rest));
    for level in [30.0, 60.0, 90.0] {
        let table = sampled(rate, 2.0, |t| level * triangle(t, 1.0));
        let tables = builder.alone(0, table);
        builder.open(&format!("triangle-1hz-{level}v-axis1"), rate, tables);
    }
    for axis in 1..axes {
        let tables = builder.alone(axis, sampled(rate, 2.0, |t| 90.0 * triangle(t, 1.0)));
        builder.open(&format!("triangle-1hz-90v-axis{}", axis + 1), rate, tables);
    }
    let mut corners = vec![(0.0, 5.0)];
    for (index, top) in [95.0, 80.0, 65.0, 53.0, 41.0, 31.0, 21.0, 13.0].into_iter().enumerate() {
        corners.push((0.5 * index as f64 + 0.25, top));
        corners.push((0.5 * index as f64 + 0.5, 5.0));
    }
    let nested = sampled(rate, 4.0, lines(&corners));
    builder.open("nested-triangles", rate, vec![nested; axes]);
    let fast = sampled(rate, 1.0, |t| 60.0 * triangle(t, 20.0));
    builder.open("triangle-20hz-60v", rate, vec![fast; axes]);
    let line_hz: Vec<f64> =
        (0..2500).map(|n| 0.5 + f64::from(n)).filter(|f| *f < 0.25 * rate).collect();
    let noise = (0..axes)
        .map(|_| {
            let sum =
                multisine(builder.rng, &line_hz, |f| 1.0 / (1.0 + f / 150.0), 20.0, 2.0, rate);
            let mut table = sampled(rate, 0.4, |t| 40.0 * (t / 0.2).min(1.0));
            table.extend(sum.iter().map(|value| (40.0 + value) as f32));
            table
        })
        .collect();
    builder.open("multisine", rate, noise);
    let squares = (0..axes)
        .map(|axis| {
            sampled(rate, 1.2, |t| {
                let since = t - 0.02 * axis as f64 - 1e-9;
                if since >= 0.0 && (since / 0.25).fract() < 0.5 { 100.0 } else { 0.0 }
            })
        })
        .collect();
    builder.open("square-100v", rate, squares);
    let slow = rate / 10.0;
    let steps = (0..axes)
        .map(|axis| {
            let level = [60.0, 80.0, 40.0][axis % 3];
            sampled(slow, 30.0, |t| if (0.5..20.5).contains(&t) { level } else { 0.0 })
        })
        .collect();
    builder.open("step-hold", slow, steps);
    builder.experiments
}

/// A session of anything: kinds, levels, axes, rates and order drawn at random; `count` experiments of some seconds each.
pub fn random_session(
    rng: &mut impl Rng,
    axes: usize,
    count: usize,
    rate: f64,
    monitor: bool,
) -> Vec<Experiment> {
    let pause_s = rng.random_range(1.0..20.0);
    let clock_s = rng.random_range(0.0..5.0);
    let mut builder = Builder { rng, axes, clock_s, pause_s, monitor, experiments: Vec::new() };
    if builder.rng.random_bool(0.7) {
        let rest = vec![vec![0.0; (2.0 * rate) as usize]; axes];
        builder.push("rest", rate, 0.0, None, Drive::Open(rest));
    }
    for _ in 0..count {
        random_experiment(&mut builder, rate);
    }
    builder.experiments
}

/// Motion of everyday use, for judging: scans, moves and slow wandering that no probe has, later on the session's clock.
pub fn typical_motion(rng: &mut impl Rng, axes: usize, rate: f64, start_s: f64) -> Vec<Experiment> {
    let mut builder = Builder {
        rng,
        axes,
        clock_s: start_s,
        pause_s: 2.0,
        monitor: true,
        experiments: Vec::new(),
    };
    let seconds = 3.0;
    let scans = (0..axes)
        .map(|axis| match axis % 3 {
            0 => {
                let frequency = builder.rng.random_range(4.0..9.0);
                let span = builder.rng.random_range(30.0..70.0);
                sampled(rate, seconds, |t| 10.0 + span * (0.5 - 0.5 * (TAU * frequency * t).cos()))
            }
            1 => {
                let steps = builder.rng.random_range(6.0..14.0f64).round();
                sampled(rate, seconds, |t| 10.0 + 60.0 * ((t / seconds * steps).floor() / steps))
            }
            _ => wander(builder.rng, rate, seconds, 5.0, 85.0, 8.0),
        })
        .collect();
    builder.open("typical-scan", rate, scans);
    let moves = (0..axes).map(|_| moves(builder.rng, rate, seconds)).collect();
    builder.open("typical-moves", rate, moves);
    builder.experiments
}

/// Random smooth wandering between two levels with frequencies up to `top_hz`.
fn wander(
    rng: &mut impl Rng,
    rate: f64,
    seconds: f64,
    low: f64,
    high: f64,
    top_hz: f64,
) -> Vec<f32> {
    let lines_hz: Vec<f64> = (0..12).map(|_| rng.random_range(0.1..top_hz)).collect();
    let sum = multisine(rng, &lines_hz, |f| 1.0 / (1.0 + f / 2.0), 1.0, seconds, rate);
    let middle = 0.5 * (low + high);
    sum.iter().map(|value| (middle + 0.5 * (high - low) * value) as f32).collect()
}

/// Moves to random places with limited speed, and stays.
fn moves(rng: &mut impl Rng, rate: f64, seconds: f64) -> Vec<f32> {
    let mut points = vec![(0.0, 0.0)];
    let (mut t, mut v) = (0.0, 0.0f64);
    while t < seconds {
        let next = rng.random_range(0.0..95.0f64);
        let speed = 10f64.powf(rng.random_range(2.0..4.3));
        t += (next - v).abs() / speed + 1e-4;
        points.push((t, next));
        t += rng.random_range(0.02..0.4);
        points.push((t, next));
        v = next;
    }
    sampled(rate, seconds, lines(&points))
}

fn random_experiment<R: Rng>(builder: &mut Builder<'_, R>, rate: f64) {
    let axes = builder.axes;
    let active: Vec<bool> = match builder.rng.random_range(0..3) {
        0 => {
            let one = builder.rng.random_range(0..axes);
            (0..axes).map(|axis| axis == one).collect()
        }
        1 => vec![true; axes],
        _ => (0..axes).map(|_| builder.rng.random_bool(0.6)).collect(),
    };
    let seconds = builder.rng.random_range(1.0..4.0);
    let top = builder.rng.random_range(20.0..100.0);
    let kind = builder.rng.random_range(0..9);
    let mut rate = rate;
    let names = [
        "triangle",
        "decaying",
        "multisine",
        "squares",
        "staircase",
        "prbs",
        "sweep",
        "wander",
        "moves",
    ];
    if kind == 4 {
        // Staircases are slow: recorded slowly, for longer.
        rate /= 10.0;
    }
    let mut tables = Vec::new();
    for &active in &active {
        if !active {
            tables.push(Vec::new());
            continue;
        }
        let rng = &mut *builder.rng;
        let frequency = 10f64.powf(rng.random_range(-0.3..1.5));
        tables.push(match kind {
            0 => sampled(rate, seconds, |t| top * triangle(t, frequency)),
            1 => {
                let frequency = frequency.min(6.0);
                sampled(rate, seconds, |t| {
                    let level =
                        top * (1.0 - (t * frequency).floor() / (seconds * frequency).ceil());
                    level * triangle(t, frequency)
                })
            }
            2 => {
                let band = 10f64.powf(rng.random_range(1.5..(0.4 * rate).log10()));
                let step = (band / 800.0).max(0.5);
                let lines_hz: Vec<f64> =
                    (1..).map(|n| step * f64::from(n)).take_while(|f| *f < band).collect();
                let corner = rng.random_range(30.0..1000.0);
                let peak = rng.random_range(5.0..0.45 * top);
                let sum =
                    multisine(rng, &lines_hz, |f| 1.0 / (1.0 + f / corner), peak, seconds, rate);
                let rise = |n: usize| (n as f64 / (0.1 * rate)).min(1.0);
                sum.iter()
                    .enumerate()
                    .map(|(n, value)| (rise(n) * (0.5 * top + value)) as f32)
                    .collect()
            }
            3 => {
                let half = rng.random_range(0.02..0.3);
                let lag = rng.random_range(0.0..half);
                sampled(rate, seconds, |t| {
                    if ((t - lag) / half).floor() % 2.0 == 0.0 && t > lag { top } else { 0.0 }
                })
            }
            4 => {
                let steps = rng.random_range(3.0..9.0f64).round();
                let order: Vec<f64> =
                    (0..steps as usize).map(|_| rng.random_range(0.0..top)).collect();
                sampled(rate, 5.0 * seconds, |t| {
                    order[((t / (5.0 * seconds) * steps) as usize).min(order.len() - 1)]
                })
            }
            5 => {
                let clock = rng.random_range(2e-3..5e-2);
                let low = rng.random_range(0.0..0.5 * top);
                let bits: Vec<bool> =
                    (0..(seconds / clock) as usize + 1).map(|_| rng.random_bool(0.5)).collect();
                sampled(rate, seconds, |t| if bits[(t / clock) as usize] { top } else { low })
            }
            6 => {
                let (from, to): (f64, f64) =
                    (rng.random_range(0.5..3.0), rng.random_range(50.0..0.2 * rate));
                let growth = (to / from).ln() / seconds;
                let peak = rng.random_range(3.0..0.4 * top);
                sampled(rate, seconds, |t| {
                    let angle = TAU * from * ((growth * t).exp() - 1.0) / growth;
                    0.5 * top * (t / 0.1).min(1.0) + peak * angle.sin() * (t / 0.1).min(1.0)
                })
            }
            7 => wander(rng, rate, seconds, 0.02 * top, top, 30.0),
            _ => moves(rng, rate, seconds),
        });
    }
    if builder.rng.random_bool(0.12) && rate > 4000.0 {
        // A closed loop instead: reference from the table, in micrometres.
        let ramp = settle(rate, 100.0);
        let length = tables.iter().map(Vec::len).max().unwrap_or(0);
        let reference_um = tables
            .iter()
            .map(|table| {
                let mut reference = vec![0.0f32; ramp.len()];
                reference.extend(table.iter().map(|volts| volts * 0.09));
                reference.resize(ramp.len() + length, 0.0);
                reference
            })
            .collect();
        let proportional = builder.rng.random_range(0.0..2.0);
        let integral = builder.rng.random_range(50.0..400.0);
        let drive = Drive::Closed { settle: ramp, reference_um, proportional, integral };
        builder.push("closed-loop", rate, 0.5, None, drive);
    } else {
        builder.open(names[kind], rate, tables);
    }
}
