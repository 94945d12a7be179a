//! What the probe suite drives, in volts at the amplifier output, checked against the board's limits before anything moves.
//!
//! Every recording starts with the same conditioning: all axes up to the highest level and back, which wipes the stack's
//! memory (a Preisach or Maxwell memory forgets what lies inside the largest excursion). That part is the recording's
//! `settle_s`. One axis moves at a time unless the experiment is about several.

use flexstage::generator::{Multisine, Wave};
use flexstage::{AXES, GeneratorSettings, Settings, TICK_HZ};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

use crate::{Error, Result};

/// How much time the suite may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Length {
    /// About half a minute of motion an axis less: one level of each kind, for a first verdict.
    Quick,
    /// The suite of the notes with short holds: about three minutes.
    #[default]
    Standard,
    /// Long holds and more repetitions: about thirteen minutes.
    Long,
}

/// What is chosen by the person at the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Axes, from 0.
    pub axes: Vec<usize>,
    /// Highest voltage of triangles, steps and multisines.
    pub max_v: f64,
    /// How long.
    pub length: Length,
    /// Seed of phases and of the typical motion.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { axes: (0..AXES).collect(), max_v: 90.0, length: Length::Standard, seed: 1 }
    }
}

/// A waveform in volts.
#[derive(Clone, Debug, PartialEq)]
pub enum Waveform {
    /// To a voltage within a time, and stay.
    Ramp {
        /// Where, V.
        to_v: f64,
        /// Time, s.
        duration_s: f64,
    },
    /// Triangle from `low_v` up to `high_v` and back.
    Triangle {
        /// Bottom, V.
        low_v: f64,
        /// Top, V.
        high_v: f64,
        /// Periods per second.
        frequency_hz: f64,
    },
    /// Square wave with edges of finite slope.
    Square {
        /// Bottom, V.
        low_v: f64,
        /// Top, V.
        high_v: f64,
        /// Periods per second.
        frequency_hz: f64,
        /// Slope of the edges.
        slope_v_per_ms: f64,
    },
    /// Exponential sweep.
    Sweep {
        /// Centre, V.
        center_v: f64,
        /// Amplitude, V.
        amplitude_v: f64,
        /// First frequency.
        from_hz: f64,
        /// Last frequency.
        to_hz: f64,
        /// Time between them.
        duration_s: f64,
    },
    /// The experiment's table.
    Table {
        /// Centre, V.
        center_v: f64,
        /// Amplitude, V.
        amplitude_v: f64,
        /// Periods per second.
        frequency_hz: f64,
        /// Phase, turns.
        phase_turns: f64,
    },
    /// Sixteen tones of the generator's own multisine.
    Tones {
        /// Centre, V.
        center_v: f64,
        /// Peak, V.
        amplitude_v: f64,
        /// Base frequency.
        base_hz: f64,
        /// Lowest multiple of it.
        first: u16,
        /// Distance of multiples.
        stride: u16,
        /// Seed of the phases.
        seed: u32,
    },
}

/// Something that begins at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// Begin, seconds after the conditioning.
    pub at_s: f64,
    /// Axis (from 0) and what it does.
    pub moves: Vec<(usize, Waveform)>,
}

/// One recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// Name, also of the file.
    pub name: String,
    /// Conditioning up to this level, V; 0 for a recording at rest.
    pub condition_v: f64,
    /// What happens, in order of time.
    pub phases: Vec<Phase>,
    /// Length after the conditioning, s.
    pub duration_s: f64,
    /// Exact period of the excitation, s.
    pub period_s: Option<f64>,
    /// One period of an arbitrary waveform, -1 to 1.
    pub table: Option<Vec<f32>>,
}

/// Time of the conditioning: up in 0.2 s, down in 0.2 s, 0.1 s rest.
pub const CONDITION_S: f64 = 0.5;
/// Periods of a table that are exact in ticks: 1024 and 8192.
const FAST_HZ: f64 = TICK_HZ as f64 / 1024.0;
const SLOW_HZ: f64 = TICK_HZ as f64 / 8192.0;

impl Experiment {
    fn new(name: impl Into<String>, condition_v: f64, duration_s: f64, phases: Vec<Phase>) -> Self {
        let (period_s, table) = (None, None);
        Self { name: name.into(), condition_v, phases, duration_s, period_s, table }
    }

    /// Length with conditioning, s.
    pub fn total_s(&self) -> f64 {
        self.duration_s + if self.condition_v > 0.0 { CONDITION_S } else { 0.0 }
    }

    /// Lowest and highest voltage.
    pub fn range_v(&self) -> (f64, f64) {
        let mut range = (0.0f64, self.condition_v.max(0.0));
        for (_, waveform) in self.phases.iter().flat_map(|phase| &phase.moves) {
            let (low, high) = waveform.range_v();
            range = (range.0.min(low), range.1.max(high));
        }
        range
    }
}

impl Waveform {
    fn range_v(&self) -> (f64, f64) {
        match *self {
            Self::Ramp { to_v, .. } => (to_v, to_v),
            Self::Triangle { low_v, high_v, .. } | Self::Square { low_v, high_v, .. } => {
                (low_v, high_v)
            }
            Self::Sweep { center_v, amplitude_v, .. }
            | Self::Table { center_v, amplitude_v, .. }
            | Self::Tones { center_v, amplitude_v, .. } => {
                (center_v - amplitude_v, center_v + amplitude_v)
            }
        }
    }

    /// The generator that makes these volts on an axis that turns micrometres into volts by `scale` (um per volt).
    pub fn generator(&self, scale: f64, origin_um: f64) -> GeneratorSettings {
        let um = |v: f64| (v * scale + origin_um) as f32;
        let size = |v: f64| (v * scale) as f32;
        let wave = |center_v: f64, amplitude_v: f64, frequency_hz: f64, phase_turns: f64| Wave {
            center_um: um(center_v),
            amplitude_um: size(amplitude_v),
            frequency_hz: frequency_hz as f32,
            phase_turns: phase_turns as f32,
            blend_s: 0.02,
            duration_s: 0.0,
        };
        let between =
            |low: f64, high: f64, hz: f64| wave((low + high) / 2.0, (high - low) / 2.0, hz, 0.75);
        match *self {
            Self::Ramp { to_v, duration_s } => {
                GeneratorSettings::Ramp { target_um: um(to_v), duration_s: duration_s as f32 }
            }
            Self::Triangle { low_v, high_v, frequency_hz } => {
                GeneratorSettings::Triangle(between(low_v, high_v, frequency_hz))
            }
            Self::Square { low_v, high_v, frequency_hz, slope_v_per_ms } => {
                GeneratorSettings::Square {
                    wave: between(low_v, high_v, frequency_hz),
                    slope_um_per_ms: size(slope_v_per_ms),
                }
            }
            Self::Sweep { center_v, amplitude_v, from_hz, to_hz, duration_s } => {
                GeneratorSettings::Sweep {
                    center_um: um(center_v),
                    amplitude_um: size(amplitude_v),
                    from_hz: from_hz as f32,
                    to_hz: to_hz as f32,
                    duration_s: duration_s as f32,
                    blend_s: 0.1,
                }
            }
            Self::Table { center_v, amplitude_v, frequency_hz, phase_turns } => {
                GeneratorSettings::Table(wave(center_v, amplitude_v, frequency_hz, phase_turns))
            }
            Self::Tones { center_v, amplitude_v, base_hz, first, stride, seed } => {
                GeneratorSettings::Multisine(Multisine {
                    center_um: um(center_v),
                    peak_um: size(amplitude_v),
                    base_hz: base_hz as f32,
                    first,
                    stride,
                    tones: 16,
                    seed,
                    blend_s: 0.1,
                    duration_s: 0.0,
                })
            }
        }
    }
}

/// Random-phase multisine of odd lines up to `highest`, every fourth odd line left out (where only a nonlinearity answers),
/// amplitude falling with the square root of frequency; 1024 points, peak 1.
pub fn odd_multisine(highest: usize, seed: u64) -> Vec<f32> {
    let mut rng = SmallRng::seed_from_u64(seed);
    let lines: Vec<(f64, f64, f64)> = (1..=highest)
        .step_by(2)
        .enumerate()
        .filter(|(i, _)| i % 4 != 3)
        .map(|(_, k)| {
            let phase = rng.random_range(0.0..std::f64::consts::TAU);
            (k as f64, 1.0 / (k as f64).sqrt(), phase)
        })
        .collect();
    let points: Vec<f64> = (0..flexstage::TABLE_POINTS)
        .map(|n| {
            let turn = std::f64::consts::TAU * n as f64 / flexstage::TABLE_POINTS as f64;
            lines.iter().map(|&(k, a, phase)| a * (k * turn + phase).sin()).sum()
        })
        .collect();
    let peak = points.iter().fold(1e-9f64, |m, x| m.max(x.abs()));
    points.iter().map(|x| (x / peak) as f32).collect()
}

/// Triangles of falling amplitude about a common bottom: outer loop first, then minor loops inside it; ends where it starts.
fn nested_triangles() -> Vec<f32> {
    const LEVELS: [f32; 5] = [1.0, 0.75, 0.5, 0.3, 0.15];
    let n = flexstage::TABLE_POINTS;
    let total: f32 = LEVELS.iter().sum();
    let mut points = Vec::with_capacity(n);
    for (i, level) in LEVELS.iter().enumerate() {
        // Equal slopes: time in proportion to the level.
        let end = LEVELS[..=i].iter().sum::<f32>() / total * n as f32;
        let start = points.len();
        let length = (end as usize).min(n).saturating_sub(start).max(1);
        for j in 0..length {
            let turn = j as f32 / length as f32;
            let tri = 1.0 - (2.0 * turn - 1.0).abs();
            points.push(-1.0 + 2.0 * level * tri);
        }
    }
    points.resize(n, -1.0);
    points
}

/// The suite.
pub fn plan(options: &Options) -> Vec<Experiment> {
    let Options { axes, max_v, length, seed } = options;
    let (max, seed) = (*max_v, *seed);
    let all = |waveform: &dyn Fn(usize) -> Waveform| -> Vec<(usize, Waveform)> {
        axes.iter().map(|&axis| (axis, waveform(axis))).collect()
    };
    let at = |at_s: f64, moves: Vec<(usize, Waveform)>| Phase { at_s, moves };
    let pick = |quick: f64, standard: f64, long: f64| match length {
        Length::Quick => quick,
        Length::Standard => standard,
        Length::Long => long,
    };
    let condition = max * 1.1;
    let mut out = vec![Experiment::new("rest", 0.0, pick(2.0, 5.0, 10.0), vec![])];

    for &axis in axes {
        let levels: &[f64] = if *length == Length::Quick && axis != axes[0] {
            &[1.0]
        } else {
            &[1.0 / 3.0, 2.0 / 3.0, 1.0]
        };
        let periods = pick(2.0, 3.0, 4.0);
        for level in levels {
            let high_v = (max * level).round();
            let triangle = Waveform::Triangle { low_v: 0.0, high_v, frequency_hz: 1.0 };
            let name = format!("triangle-1hz-{high_v:.0}v-axis{}", axis + 1);
            let phases = vec![at(0.0, vec![(axis, triangle)])];
            out.push(Experiment {
                period_s: Some(1.0),
                ..Experiment::new(name, condition, periods, phases)
            });
        }
    }
    for (hz, seconds) in [(0.1, pick(0.0, 10.0, 20.0)), (20.0, 1.0)] {
        if seconds > 0.0 {
            let high_v = (max * 2.0 / 3.0).round();
            let phases = vec![at(
                0.0,
                all(&|_| Waveform::Triangle { low_v: 0.0, high_v, frequency_hz: hz }),
            )];
            let name = format!("triangle-{hz}hz-{high_v:.0}v");
            out.push(Experiment {
                period_s: Some(1.0 / hz),
                ..Experiment::new(name, condition, seconds, phases)
            });
        }
    }
    {
        let period = 4.0;
        let moves = all(&|_| Waveform::Table {
            center_v: max / 2.0,
            amplitude_v: max / 2.0,
            frequency_hz: 1.0 / period,
            phase_turns: 0.0,
        });
        let duration = period * pick(1.0, 1.0, 2.0);
        let base = Experiment::new("nested-triangles", condition, duration, vec![at(0.0, moves)]);
        out.push(Experiment { period_s: Some(period), table: Some(nested_triangles()), ..base });
    }
    {
        // Each axis to another level, so that a slow effect shows how it scales with the step.
        let up = |axis: usize| max * [2.0 / 3.0, 0.9, 0.45][axis % 3];
        let hold = pick(3.0, 15.0, 60.0);
        let back = pick(1.0, 5.0, 30.0);
        let phases = vec![
            at(0.0, all(&|axis| Waveform::Ramp { to_v: up(axis), duration_s: 0.002 })),
            at(hold, all(&|axis| Waveform::Ramp { to_v: up(axis) / 3.0, duration_s: 0.002 })),
        ];
        out.push(Experiment::new("step-hold", condition, hold + back, phases));
    }
    let biases: &[f64] = if *length == Length::Quick { &[0.5] } else { &[0.22, 0.5, 0.85] };
    for (i, &bias) in biases.iter().enumerate() {
        let center_v = (max * bias).round();
        let amplitude_v = (max * 0.12).min(center_v);
        let ramp = || at(0.0, all(&|_| Waveform::Ramp { to_v: center_v, duration_s: 0.2 }));
        for (kind, hz, highest, seconds) in [
            ("wide", FAST_HZ, 255, pick(2.0, 3.0, 6.0)),
            ("low", SLOW_HZ, 121, pick(0.0, 4.2, 8.4)),
        ] {
            if seconds == 0.0 || (kind == "low" && i != 1) {
                continue;
            }
            for (n, &axis) in axes.iter().enumerate() {
                // Off the middle bias all axes share the time: the same lines, shifted in time against each other.
                let together = i != 1 && biases.len() > 1;
                if together && n > 0 {
                    continue;
                }
                let wave = |k: usize| Waveform::Table {
                    center_v,
                    amplitude_v,
                    frequency_hz: hz,
                    phase_turns: [0.0, 0.37, 0.71][k % 3],
                };
                let moves = if together { all(&wave) } else { vec![(axis, wave(0))] };
                let place = if together { String::new() } else { format!("-axis{}", axis + 1) };
                let name = format!("multisine-{kind}-{center_v:.0}v{place}");
                let phases = vec![ramp(), at(0.25, moves)];
                let base = Experiment::new(name, condition, 0.5 + seconds, phases);
                out.push(Experiment {
                    period_s: Some(1.0 / hz),
                    table: Some(odd_multisine(highest, seed ^ (i as u64 * 31 + n as u64))),
                    ..base
                });
            }
        }
    }
    for &axis in axes.iter().take(if *length == Length::Quick { 1 } else { AXES }) {
        let sweep = |from_hz: f64, to_hz: f64| Waveform::Sweep {
            center_v: max / 2.0,
            amplitude_v: max * 0.06,
            from_hz,
            to_hz,
            duration_s: 2.0,
        };
        let ramp = Waveform::Ramp { to_v: max / 2.0, duration_s: 0.2 };
        let phases = vec![
            at(0.0, vec![(axis, ramp)]),
            at(0.25, vec![(axis, sweep(5.0, 1500.0))]),
            at(2.3, vec![(axis, sweep(1500.0, 5.0))]),
        ];
        out.push(Experiment::new(format!("sweep-axis{}", axis + 1), condition, 4.4, phases));
    }
    for slope in
        [0.5, 2.0, 10.0, 100.0].into_iter().skip(if *length == Length::Quick { 3 } else { 0 })
    {
        let square = Waveform::Square {
            low_v: 0.0,
            high_v: max,
            // Room for the slow edges: one edge takes max / slope.
            frequency_hz: if slope < 1.0 { 2.0 } else { 5.0 },
            slope_v_per_ms: slope,
        };
        let phases = vec![at(0.0, all(&|_| square.clone()))];
        out.push(Experiment::new(format!("square-{slope}v-per-ms"), condition, 1.2, phases));
    }
    {
        let center_v = max / 2.0;
        let moves = all(&|axis| Waveform::Tones {
            center_v,
            amplitude_v: max * 0.25,
            base_hz: 2.0,
            first: 2 + axis as u16,
            stride: 9,
            seed: seed as u32 ^ (axis as u32 + 17),
        });
        let ramp = at(0.0, all(&|_| Waveform::Ramp { to_v: center_v, duration_s: 0.2 }));
        let seconds = pick(2.0, 4.0, 10.0);
        let phases = vec![ramp, at(0.25, moves)];
        let base = Experiment::new("multisine-all", condition, 0.5 + seconds, phases);
        out.push(Experiment { period_s: Some(0.5), ..base });
    }
    {
        // Typical motion: moves to random places in random times, all axes.
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x7ab5);
        let seconds = pick(4.0, 12.0, 30.0);
        let mut phases = Vec::new();
        let mut t = 0.0;
        while t < seconds - 0.4 {
            let moves = axes
                .iter()
                .map(|&axis| {
                    let to_v = rng.random_range(0.05..0.95) * max;
                    (axis, Waveform::Ramp { to_v, duration_s: rng.random_range(0.03..0.3) })
                })
                .collect();
            phases.push(at(t, moves));
            t += rng.random_range(0.32..0.6);
        }
        out.push(Experiment::new("typical-motion", condition, seconds, phases));
    }
    out.push(Experiment::new("rest-end", 0.0, pick(1.0, 5.0, 10.0), vec![]));
    out
}

/// Refuse a plan that the board's limits would cut: what is not driven as planned probes nothing.
pub fn check(plan: &[Experiment], settings: &Settings, axes: &[usize]) -> Result<()> {
    for &axis in axes {
        let Some(axis_settings) = settings.axes.get(axis) else {
            return Err(Error::Invalid(format!(
                "there is no axis {}: expected 1 to {AXES}",
                axis + 1
            )));
        };
        let limits = &axis_settings.limits;
        let (scale, origin) = scale_um_per_v(settings, axis);
        for experiment in plan {
            let (low, high) = experiment.range_v();
            for (what, unit, found_low, found_high, min, max) in [
                ("drive", "V", low, high, limits.min_v, limits.max_v),
                (
                    "travel",
                    "um",
                    low * scale + origin,
                    high * scale + origin,
                    limits.min_um,
                    limits.max_um,
                ),
            ] {
                if found_low < f64::from(min) - 1e-6 || found_high > f64::from(max) + 1e-6 {
                    return Err(Error::Invalid(format!(
                        "probe `{}` needs {found_low:.1} to {found_high:.1} {unit} on axis {}, its {what} limits are \
                         {min} to {max} {unit}: choose a lower level (--max-v) or widen the limits",
                        experiment.name,
                        axis + 1
                    )));
                }
            }
        }
    }
    Ok(())
}

/// Micrometres of reference per volt of drive with [`open_loop`] settings, and the reference at 0 V.
pub fn scale_um_per_v(settings: &Settings, axis: usize) -> (f64, f64) {
    let a = &settings.axes[axis];
    let stiffness = f64::from(a.stack.stiffness_n_per_m) + f64::from(a.mechanism.stiffness_n_per_m);
    (f64::from(a.stack.transformer_n_per_v) / stiffness * 1e6, f64::from(a.origin_um))
}

/// The same settings with the loop open: the drive is the reference times a constant, limits and guard stay.
///
/// Position limits still watch the measured position; the following error is not watched, because the stack's
/// hysteresis is what is being measured. A host that goes away parks the drives after two seconds.
pub fn open_loop(settings: &Settings) -> Settings {
    let mut out = settings.clone();
    for axis in &mut out.axes {
        axis.feedforward.gain = 1.0;
        axis.feedforward.hysteresis = false;
        axis.feedforward.dynamics = false;
        axis.feedforward.amplifier_lead = false;
        axis.feedforward.creep.clear();
        axis.feedforward.advance_s = 0.0;
        axis.feedback.proportional_v_per_um = 0.0;
        axis.feedback.integral_v_per_um_s = 0.0;
        axis.feedback.derivative_v_ms_per_um = 0.0;
        axis.feedback.notches.clear();
        axis.limits.following_error_um = 0.0;
    }
    out.cross_stiffness_n_per_m = Default::default();
    out.guard.command_timeout_s = 2.0;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_length_fits_the_default_board() {
        for (length, seconds) in [
            (Length::Quick, 20.0..70.0),
            (Length::Standard, 100.0..240.0),
            (Length::Long, 300.0..800.0),
        ] {
            let options = Options { length, ..Options::default() };
            let plan = plan(&options);
            check(&plan, &Settings::default(), &options.axes).unwrap();
            let total: f64 = plan.iter().map(Experiment::total_s).sum();
            assert!(seconds.contains(&total), "{length:?}: {total} s");
            for experiment in &plan {
                for (axis, waveform) in experiment.phases.iter().flat_map(|p| &p.moves) {
                    let (scale, origin) = scale_um_per_v(&Settings::default(), *axis);
                    let generator = waveform.generator(scale, origin);
                    flexstage::Generator::build(&generator)
                        .unwrap_or_else(|e| panic!("{}: {e}", experiment.name));
                }
            }
            let mut names: Vec<&str> = plan.iter().map(|e| e.name.as_str()).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), plan.len(), "file names are unique");
        }
    }

    #[test]
    fn limits_are_respected_by_name() {
        let options = Options { max_v: 140.0, ..Options::default() };
        let error = check(&plan(&options), &Settings::default(), &options.axes).unwrap_err();
        assert!(
            error.to_string().contains("150 V") && error.to_string().contains("axis 1"),
            "{error}"
        );
        assert!(check(&[], &Settings::default(), &[5]).is_err());
    }

    #[test]
    fn the_multisine_leaves_even_and_every_fourth_odd_line_out() {
        let points = odd_multisine(99, 3);
        let frf = crate::measure::frf::periodic(&points, &points, 1024.0, 1024);
        let lines: Vec<usize> =
            frf.points.iter().map(|p| p.frequency_hz.round() as usize).collect();
        assert!(lines.iter().all(|k| k % 2 == 1 && (k / 2) % 4 != 3), "{lines:?}");
        assert_eq!(lines.len(), 38);
        assert!(points.iter().all(|p| p.abs() <= 1.0));
    }

    #[test]
    fn nested_loops_shrink_and_close() {
        let points = nested_triangles();
        assert_eq!(points.len(), flexstage::TABLE_POINTS);
        // The last point is one step above the bottom, where the next period begins.
        assert!(points[0] == -1.0 && points[1023] < -0.97, "{}", points[1023]);
        assert!(points.iter().all(|p| (-1.0..=1.0).contains(p)));
    }
}
