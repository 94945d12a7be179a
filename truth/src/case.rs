//! Draws cases: a rig, a session, what is wrong, and recordings to judge by.

use std::fs;
use std::io;
use std::ops::Range;
use std::path::Path;

use rand::rngs::StdRng;
use rand::seq::IndexedRandom;
use rand::{Rng, RngExt, SeedableRng};
use recording::Recording;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::effects::{Drawn, EFFECTS, Effect};
use crate::excitation::{Experiment, probe_session, random_session, typical_motion};
use crate::faults::{Fault, Kind};
use crate::rig::Rig;
use crate::simulate::{Options, run};
use crate::world::World;

/// What kinds of cases are drawn.
#[derive(Clone, Debug)]
pub struct Draw {
    /// Smallest and largest gap, in multiples of the gauge's noise (rms over axes and samples).
    pub ratio: (f64, f64),
    /// Sessions.
    pub sessions: Sessions,
    /// Whether the rig's constants are drawn as well, or always the first paper's.
    pub other_rigs: bool,
    /// Weights of cases with nothing wrong, one effect, two effects, and a fault that is in no catalogue.
    pub weights: [f64; 4],
    /// Effects to draw from; empty for all.
    pub only: Vec<String>,
    /// Whether effects take further forms ([`crate::forms`]).
    pub further_forms: bool,
    /// Faults to draw from where one is drawn; not empty.
    pub faults: &'static [Kind],
}

impl Default for Draw {
    fn default() -> Self {
        Self {
            ratio: (3.0, 60.0),
            sessions: Sessions::Mixed,
            other_rigs: false,
            weights: [0.2, 0.45, 0.2, 0.15],
            only: Vec::new(),
            further_forms: false,
            faults: &Kind::BROKEN,
        }
    }
}

/// Kinds of sessions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sessions {
    /// The usual probe session.
    Probe,
    /// Random experiments.
    Random,
    /// Either, with equal chances.
    Mixed,
}

/// One entry of the key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Effect of the contract, or `unknown`.
    pub effect: String,
    /// Axes, from 1.
    pub axes: Vec<usize>,
    /// Stage, in the contract's words.
    pub stage: String,
    /// For people: form, size, kind of fault.
    pub note: String,
    /// Gap that it makes alone, in multiples of the gauge's noise of each axis: what sizes are drawn by.
    pub ratio: f64,
    /// Gap that it makes alone, nm rms over axes and samples: what an answer's `closes` is about, and what orders its causes.
    pub gap_nm: f64,
}

/// How large a gap is, rms over axes and scored samples.
#[derive(Clone, Copy, Debug, Default)]
struct Gap {
    /// In multiples of the noise of each axis' gauge.
    ratio: f64,
    nm: f64,
}

/// What a case is, as the key says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Label {
    /// Name of the folder.
    pub id: String,
    /// `null`, `single`, `pair` or `unknown`.
    pub kind: String,
    /// What is wrong.
    pub truth: Vec<Truth>,
    /// Kind of session.
    pub session: String,
    /// Whether the amplifiers' outputs were recorded.
    pub monitor: bool,
    /// Noise floor of the gauges (nm rms over axes), converter included.
    pub floor_nm: f64,
}

/// A case with its recordings.
#[derive(Clone)]
pub struct Case {
    /// What the key says.
    pub label: Label,
    /// What the diagnosis is given.
    pub rig: Rig,
    /// Its recordings.
    pub session: Vec<Recording>,
    /// What it never sees.
    pub judging: Vec<Recording>,
}

impl Case {
    /// Draws case `index` of a seed: the same numbers give the same case.
    pub fn draw(seed: u64, index: u64, draw: &Draw) -> Self {
        Self::drawn(seed, index, draw, true)
    }

    /// The same without the recordings that a diagnosis never sees.
    pub fn draw_unjudged(seed: u64, index: u64, draw: &Draw) -> Self {
        Self::drawn(seed, index, draw, false)
    }

    fn drawn(seed: u64, index: u64, draw: &Draw, is_judged: bool) -> Self {
        let mut rng = StdRng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ index);
        let rig = if draw.other_rigs && rng.random_bool(0.5) {
            Rig::another(&mut rng)
        } else {
            Rig::handley()
        };
        let axes = rig.axes.len();
        let probe = match draw.sessions {
            Sessions::Probe => true,
            Sessions::Random => false,
            Sessions::Mixed => rng.random_bool(0.5),
        };
        let monitor = probe || rng.random_bool(0.75);
        let experiments = if probe {
            probe_session(&mut rng, axes, rig.sample_rate_hz, true)
        } else {
            let rate = *[10_000.0, 10_000.0, 10_000.0, 5_000.0, 20_000.0]
                .choose(&mut rng)
                .expect("not empty");
            let count = rng.random_range(7..11);
            random_session(&mut rng, axes, count, rate, monitor)
        };
        let end_s = experiments.last().map_or(0.0, |last| last.start_s + last.seconds());
        let judging = typical_motion(&mut rng, axes, rig.sample_rate_hz, end_s + 10.0);

        let kind = pick(&draw.weights, &mut rng);
        let allowed: Vec<&'static Effect> = EFFECTS
            .iter()
            .filter(|effect| {
                draw.only.is_empty() || draw.only.iter().any(|name| name == effect.name)
            })
            .collect();
        let mut truth = Vec::new();
        let mut world = World::nominal(&rig);
        let trial = Trial { rig: &rig, experiments: &experiments };
        match kind {
            1 | 2 => {
                for _ in 0..kind {
                    let mut taken: Vec<&str> =
                        truth.iter().map(|truth: &Truth| truth.effect.as_str()).collect();
                    taken.extend(taken.first().and_then(|name| opposite(name)));
                    let left: Vec<_> =
                        allowed.iter().filter(|effect| !taken.contains(&effect.name)).collect();
                    let Some(effect) = left.choose(&mut rng) else { break };
                    let (drawn, gap) = trial.sized(effect, draw, &mut rng);
                    drawn.apply(&mut world);
                    truth.push(Truth {
                        effect: effect.name.into(),
                        axes: drawn.axes.iter().map(|axis| axis + 1).collect(),
                        stage: effect.stage.into(),
                        note: format!("size {:.4e}, sign {}", drawn.size, drawn.sign),
                        ratio: gap.ratio,
                        gap_nm: gap.nm,
                    });
                }
            }
            3 => {
                let fault =
                    *draw.faults.choose(&mut rng).expect("not empty, as its documentation asks");
                let one = rng.random_range(0..axes);
                let on = if rng.random_bool(0.3) { 0..axes } else { one..one + 1 };
                let (size, gap, sized) = trial.sized_fault(fault, &on, draw.ratio, &mut rng);
                for axis in on.clone() {
                    // What is broken throws other dice than when it was sized; physics and electronics stay what they were.
                    let seed = if fault.is_steady() { sized } else { rng.random() };
                    world.faults.push(Fault::new(axis, fault, size, seed));
                }
                truth.push(Truth {
                    effect: "unknown".into(),
                    axes: on.map(|axis| axis + 1).collect(),
                    stage: fault.stage().into(),
                    note: format!("{}, size {size:.4e}", fault.name()),
                    ratio: gap.ratio,
                    gap_nm: gap.nm,
                });
            }
            _ => {}
        }
        let judging = if is_judged { &judging[..] } else { &[] };
        let mut runs = simulate_all(&mut world, experiments.iter().chain(judging), Options::FINE);
        let judging = runs.split_off(experiments.len());
        let floor =
            rig.axes.iter().map(|axis| axis.noise_m.powi(2) + axis.resolution_m.powi(2) / 12.0);
        let floor_nm = 1e9 * (floor.sum::<f64>() / axes as f64).sqrt();
        let kind = ["null", "single", "pair", "unknown"][kind];
        let label = Label {
            id: format!("case-{index:04}"),
            kind: kind.into(),
            truth,
            session: if probe { "probe" } else { "random" }.into(),
            monitor,
            floor_nm,
        };
        Self { label, rig, session: runs, judging }
    }

    /// The same case as a rig records it whose amplifiers have no monitor outputs.
    pub fn drop_monitor(&mut self) {
        self.label.monitor = false;
        for recording in self.session.iter_mut().chain(&mut self.judging) {
            recording.monitor_v.fill(None);
        }
    }

    /// Writes `ID/session/*.parquet`, `ID/rig.toml` and `ID/judging/*.parquet`. File names say nothing about the truth.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        let folder = folder.join(&self.label.id);
        for (part, recordings) in [("session", &self.session), ("judging", &self.judging)] {
            let part = folder.join(part);
            fs::create_dir_all(&part)?;
            for (index, recording) in recordings.iter().enumerate() {
                let path = part.join(format!("{index:02}-{}.parquet", recording.meta.experiment));
                recording.write(&path).map_err(io::Error::other)?;
            }
        }
        fs::write(folder.join("rig.toml"), self.rig.to_toml())
    }
}

/// The key of all cases, as text.
pub fn key(labels: &[Label]) -> String {
    serde_json::to_string_pretty(labels).expect("labels are plain data")
}

/// Hash of the key (SHA-256, hex): published before the answers are known.
pub fn seal(key: &str) -> String {
    Sha256::digest(key.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// An effect that would be the same thing twice in a pair: the sum of the two has no unique answer.
fn opposite(name: &str) -> Option<&'static str> {
    const SAME: [(&str, &str); 1] = [("amplifier-hum", "sensor-hum")];
    SAME.iter().find_map(|&(a, b)| match name {
        _ if name == a => Some(b),
        _ if name == b => Some(a),
        _ => None,
    })
}

fn pick(weights: &[f64], rng: &mut impl Rng) -> usize {
    let total: f64 = weights.iter().sum();
    let mut left = rng.random_range(0.0..total.max(f64::MIN_POSITIVE));
    for (index, weight) in weights.iter().enumerate() {
        if left < *weight {
            return index;
        }
        left -= weight;
    }
    0
}

fn simulate_all<'a>(
    world: &mut World,
    experiments: impl Iterator<Item = &'a Experiment>,
    options: Options,
) -> Vec<Recording> {
    let mut clock = 0.0;
    let mut recordings = Vec::new();
    for experiment in experiments {
        recordings.push(run(world, experiment, (experiment.start_s - clock).max(0.0), options));
        clock = experiment.start_s + experiment.seconds();
    }
    recordings
}

/// Measures how large a gap something makes in a session, without noise and in coarse steps.
struct Trial<'a> {
    rig: &'a Rig,
    experiments: &'a [Experiment],
}

impl Trial<'_> {
    fn positions(&self, change: impl Fn(&mut World)) -> Vec<Recording> {
        let mut world = World::nominal(self.rig);
        change(&mut world);
        simulate_all(&mut world, self.experiments.iter(), Options::ROUGH)
    }

    /// Gap over all axes and scored samples of recordings that settle first.
    fn gap(&self, nominal: &[Recording], changed: &[Recording]) -> Gap {
        let (mut sum, mut sum_um2, mut count) = (0.0, 0.0, 0usize);
        for (nominal, changed) in nominal.iter().zip(changed) {
            if nominal.meta.settle_s == 0.0 {
                continue;
            }
            let from = nominal.settle_rows();
            for (axis, (a, b)) in nominal.position_um.iter().zip(&changed.position_um).enumerate() {
                let (Some(a), Some(b)) = (a, b) else { continue };
                let noise_um = self.rig.axes[axis].noise_m * 1e6;
                for (a, b) in a[from..].iter().zip(&b[from..]) {
                    sum += (f64::from(a - b) / noise_um).powi(2);
                    sum_um2 += f64::from(a - b).powi(2);
                }
                count += a.len() - from;
            }
        }
        let rms = |sum: f64| (sum / count.max(1) as f64).sqrt();
        Gap { ratio: rms(sum), nm: 1e3 * rms(sum_um2) }
    }

    /// An effect whose gap is within the wanted range: drawn from physical sizes, then brought to a size drawn
    /// log-uniformly inside the range if it fell outside.
    fn sized(&self, effect: &'static Effect, draw: &Draw, rng: &mut impl Rng) -> (Drawn, Gap) {
        let range = draw.ratio;
        let nominal = self.positions(|_| {});
        let mut best: Option<(Drawn, Gap)> = None;
        for _ in 0..4 {
            let mut drawn = Drawn::new(effect, self.rig.axes.len(), rng);
            drawn.is_further = draw.further_forms;
            let wanted = rng.random_range(range.0.ln()..range.1.ln()).exp();
            for _ in 0..4 {
                let gap = self.gap(&nominal, &self.positions(|world| drawn.apply(world)));
                let ratio = gap.ratio;
                if (range.0..=range.1).contains(&ratio) {
                    return (drawn, gap);
                }
                let off = |ratio: f64| (ratio.max(1e-3) / wanted).ln().abs();
                if best.as_ref().is_none_or(|best| off(ratio) < off(best.1.ratio)) {
                    best = Some((drawn.clone(), gap));
                }
                // Never beyond twice what is physical: some effects cannot make the gap that was wanted.
                let factor = (wanted / ratio.max(1e-3)).clamp(0.1, 10.0);
                let (low, high) = effect.size;
                drawn.size = (drawn.size * factor).clamp(0.3 * low, 2.0 * high);
            }
        }
        best.expect("at least one try was made")
    }

    fn sized_fault(
        &self,
        kind: Kind,
        on: &Range<usize>,
        range: (f64, f64),
        rng: &mut impl Rng,
    ) -> (f64, Gap, u64) {
        let nominal = self.positions(|_| {});
        let seed = rng.random();
        let mut size = kind.draw(rng);
        let wanted = rng.random_range(range.0.ln()..range.1.ln()).exp();
        let mut gap = Gap::default();
        for _ in 0..4 {
            let faults = || on.clone().map(|axis| Fault::new(axis, kind, size, seed));
            gap = self.gap(&nominal, &self.positions(|world| world.faults.extend(faults())));
            if (range.0..=range.1).contains(&gap.ratio) {
                break;
            }
            size *= (wanted / gap.ratio.max(1e-3)).clamp(0.2, 5.0);
            if matches!(
                kind,
                Kind::Freeze | Kind::Dropout | Kind::Brownout | Kind::HighPass | Kind::SupplySag
            ) {
                size = size.min(0.9);
            }
        }
        (size, gap, seed)
    }
}
