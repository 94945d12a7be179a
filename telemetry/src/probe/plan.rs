//! What the probe suite drives, in volts at the amplifier output.
//!
//! Every recording starts with the same conditioning: all axes up to the highest level and back, which wipes the stack's
//! memory (a Preisach or Maxwell memory forgets what lies inside the largest excursion). That part is the recording's
//! `settle_s`. One axis moves at a time unless the experiment is about several.

use flexstage::{AXES, TICK_HZ};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

use super::waveform::{Waveform, nested_triangles, odd_multisine};

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
    /// Highest voltage that is ever driven: the conditioning. Triangles, steps and multisines end a tenth of theirs below it.
    pub max_v: f64,
    /// How long.
    pub length: Length,
    /// Seed of phases and of the typical motion.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        // The papers' 90 V, conditioned to a tenth more.
        Self { axes: (0..AXES).collect(), max_v: 99.0, length: Length::Standard, seed: 1 }
    }
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

/// Lowest [`Options::max_v`]: what moves a stage of some 0.1 um/V by a hundred times the noise of its gauges. Less than that tells
/// nothing of an effect.
pub const LOWEST_MAX_V: f64 = 5.0;
/// Time of the conditioning: up in 0.2 s, down in 0.2 s, 0.1 s rest.
pub const CONDITION_S: f64 = 0.5;
/// Periods of a table that are exact in ticks: 1024 and 8192.
const FAST_HZ: f64 = TICK_HZ as f64 / 1024.0;
const SLOW_HZ: f64 = TICK_HZ as f64 / 8192.0;

impl Experiment {
    /// Without a period and a table.
    pub(crate) fn new(
        name: impl Into<String>,
        condition_v: f64,
        duration_s: f64,
        phases: Vec<Phase>,
    ) -> Self {
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

/// The suite.
pub fn plan(options: &Options) -> Vec<Experiment> {
    let Options { axes, max_v, length, seed } = options;
    // The conditioning goes a tenth beyond everything else, and nothing beyond what was asked for.
    let condition = *max_v;
    let (max, seed) = (condition * 10.0 / 11.0, *seed);
    let all = |waveform: &dyn Fn(usize) -> Waveform| -> Vec<(usize, Waveform)> {
        axes.iter().map(|&axis| (axis, waveform(axis))).collect()
    };
    let at = |at_s: f64, moves: Vec<(usize, Waveform)>| Phase { at_s, moves };
    let pick = |quick: f64, standard: f64, long: f64| match length {
        Length::Quick => quick,
        Length::Standard => standard,
        Length::Long => long,
    };
    let mut out = vec![Experiment::new("rest", 0.0, pick(2.0, 5.0, 10.0), vec![])];

    for &axis in axes {
        let levels: &[f64] = if *length == Length::Quick && axis != axes[0] {
            &[1.0]
        } else {
            &[1.0 / 3.0, 2.0 / 3.0, 1.0]
        };
        let periods = pick(2.0, 3.0, 4.0);
        for level in levels {
            // Whole volts, where that is not beyond what was asked for.
            let high_v = (max * level).round().min(max);
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
        let amplitude_v = max * 0.12;
        let center_v = (max * bias).round().clamp(amplitude_v, max - amplitude_v);
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
            // Up again, from rest: a sweep that begins at its high end starts with that velocity, which overshoots by tens of volts.
            at(2.7, vec![(axis, sweep(5.0, 1500.0))]),
        ];
        out.push(Experiment::new(format!("sweep-axis{}", axis + 1), condition, 4.9, phases));
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

#[cfg(test)]
mod tests {
    use super::super::limits::{check, scale_um_per_v};
    use super::*;
    use flexstage::Settings;

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
                    let generator = waveform.generator(scale, origin, 1.0);
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
    fn nothing_is_driven_beyond_the_highest_level() {
        for length in [Length::Quick, Length::Standard, Length::Long] {
            for max_v in [LOWEST_MAX_V, 5.5, 7.3, 12.0, 33.3, 60.0, 90.0, 99.0, 100.0, 120.0, 150.0]
            {
                let options = Options { length, max_v, ..Options::default() };
                let ranges: Vec<_> = plan(&options).iter().map(Experiment::range_v).collect();
                let beyond = ranges.iter().filter(|(low, high)| *low < 0.0 || *high > max_v);
                assert_eq!(beyond.count(), 0, "{length:?}, {max_v} V: {ranges:?}");
                assert!(ranges.iter().any(|(_, high)| *high == max_v), "{length:?}, {max_v} V");
            }
        }
    }
}
