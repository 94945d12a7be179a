//! What else it could be: rivals that explain the session nearly as well, and the experiment that would tell them apart.

use host_sim::effects::Place;
use host_sim::rig::Rig;
use host_sim::{Axes, Input, Output, simulate};
use rayon::prelude::*;

use crate::diagnosis::NextExperiment;
use crate::fitting::model::Model;
use crate::judge::accept;
use crate::search::select::Search;
use crate::session::scene::Scene;

/// Cost difference below which noise alone could have decided: three standard deviations and the freedom of the rival.
pub(crate) const NOISE_MARGIN: f64 = 25.0;
/// A rival that leaves no more than this multiple of what the chosen model leaves is not told apart: a misfit of that size is a
/// matter of form, not of kind. Where it saves less than it leaves, of what it saves.
const LEFTOVER_MARGIN: f64 = 0.5;
/// Share of what the chosen model leaves by which rivals do not differ in rank.
const LEVEL: f64 = 0.01;
/// Most rivals that are worth naming.
const MOST_RIVALS: usize = 2;

/// How the causes of a model stand.
#[derive(Clone)]
pub struct Standings {
    /// One a term.
    pub causes: Vec<CauseStanding>,
    /// What would tell the first ambiguous one from its rivals.
    pub next: Option<NextExperiment>,
}

/// Confidence in a cause and the names of those that cannot be told from it.
#[derive(Clone)]
pub struct CauseStanding {
    /// Probability among all that were tried.
    pub confidence: f64,
    /// Names, nearest first; those that noise alone ranks by what the cause is known to be confused with.
    pub rivals: Vec<String>,
}

/// Standing of every term of a model.
pub fn standings(search: &Search, model: &Model) -> Standings {
    let mut next = None;
    let causes = (0..model.terms.len())
        .map(|term| {
            let Standing { confidence, rivals } = standing(search, model, term);
            if next.is_none() && !rivals.is_empty() {
                let own = (model.terms[term].name(), model);
                next = next_experiment(search.scene, own, &rivals);
            }
            let rivals = rivals.iter().map(|(name, _)| name.to_string()).collect();
            CauseStanding { confidence, rivals }
        })
        .collect();
    Standings { causes, next }
}

/// How a cause stands against the others that were tried in its place.
struct Standing {
    /// Probability among all that were tried.
    confidence: f64,
    /// Models with another effect in its place that cannot be told apart, nearest first.
    rivals: Vec<(&'static str, Model)>,
}

/// Compare the chosen model with every fitted one that differs in one effect only.
fn standing(search: &Search, model: &Model, term: usize) -> Standing {
    let name = model.terms[term].name();
    let mut others = model.key();
    others.retain(|n| *n != name);
    let left = (model.fit.cost - search.noise).max(0.0);
    let saved = (search.gap - left).max(0.0);
    let mut weight = 1.0;
    let mut rivals: Vec<(f64, &'static str, Model)> = Vec::new();
    let mut seen: Vec<&str> = Vec::new();
    for rival in &search.tried {
        let key = rival.key();
        if rival.terms.len() != model.terms.len() || !others.iter().all(|n| key.contains(n)) {
            continue;
        }
        let Some(instead) = rival.terms.iter().find(|t| !others.contains(&t.name())) else {
            continue;
        };
        if instead.name() == name || seen.contains(&instead.name()) {
            continue;
        }
        seen.push(instead.name());
        let behind = rival.fit.cost - model.fit.cost;
        weight += (-behind.max(0.0) / (2.0 * (1.0 + left / 12.0))).exp();
        // What integrators differ by is no ground to tell two effects apart either.
        let counts = || accept::counts(search.scene, &rival.fit.stack, &model.fit.stack, u32::MAX);
        if behind < NOISE_MARGIN + LEFTOVER_MARGIN * left.min(saved) || !counts() {
            rivals.push((behind, instead.name(), rival.clone()));
        }
    }
    // Among those that noise alone ranks, or a hundredth of what all of them leave, what the cause is known to be confused with comes first, in
    // that order: a drift that is over before anything counts is an offset, but the last that one thinks of.
    let level = NOISE_MARGIN + LEVEL * left;
    let alike = model.terms[term].effect.info().confused_with;
    let rank = |(behind, name, _): &(f64, &str, Model)| match *behind {
        behind if behind < -level => (0, 0),
        behind if behind < level => {
            alike.iter().position(|known| known == name).map_or((2, 0), |nth| (1, nth))
        }
        _ => (3, 0),
    };
    rivals.sort_by(|a, b| rank(a).cmp(&rank(b)).then(a.0.total_cmp(&b.0)));
    rivals.truncate(MOST_RIVALS);
    Standing {
        confidence: 1.0 / weight,
        rivals: rivals.into_iter().map(|(_, n, m)| (n, m)).collect(),
    }
}

/// One probe of the menu: what to tell a person, and the drive of the axes.
struct Probe {
    words: String,
    rate_hz: f64,
    drive_v: Vec<Vec<f64>>,
}

fn menu(rig: &Rig, axes_of_interest: &[usize]) -> Vec<Probe> {
    let axes = rig.axes.len();
    let rate_hz = rig.sample_rate_hz;
    let top = rig.axes.iter().map(|a| a.amplifier.max_v).fold(f64::INFINITY, f64::min);
    let count = |seconds: f64| (seconds * rate_hz) as usize;
    // Every probe first wipes the memory with one large excursion.
    let wiped = |body: Vec<f64>| -> Vec<f64> {
        let n = count(0.5);
        let mut drive: Vec<f64> = (0..n)
            .map(|i| 0.6 * top * (std::f64::consts::PI * i as f64 / n as f64).sin())
            .collect();
        drive.extend(body);
        drive
    };
    let all = |body: &[f64]| vec![wiped(body.to_vec()); axes];
    let alone = |axis: usize, body: &[f64]| -> Vec<Vec<f64>> {
        (0..axes)
            .map(|a| if a == axis { wiped(body.to_vec()) } else { wiped(vec![0.0; body.len()]) })
            .collect()
    };
    let triangle = |hz: f64, volts: f64, cycles: f64| -> Vec<f64> {
        (0..count(cycles / hz))
            .map(|i| {
                let phase = (i as f64 * hz / rate_hz).fract();
                volts * (1.0 - (2.0 * phase - 1.0).abs())
            })
            .collect()
    };
    let sweep = |bias: f64, volts: f64| -> Vec<f64> {
        let (seconds, low, high) = (3.0, 1.0, 0.4 * rate_hz);
        let ratio: f64 = f64::ln(high / low);
        (0..count(seconds))
            .map(|i| {
                let t = i as f64 / rate_hz;
                let phase = std::f64::consts::TAU * low * seconds / ratio
                    * ((ratio * t / seconds).exp() - 1.0);
                bias + volts * phase.sin()
            })
            .collect()
    };
    let hold = |volts: f64| -> Vec<f64> {
        (0..count(22.0)).map(|i| if (i as f64) < 12.0 * rate_hz { volts } else { 0.0 }).collect()
    };
    let square: Vec<f64> = (0..count(0.6))
        .map(|i| if (i as f64 * 10.0 / rate_hz).fract() < 0.5 { 0.65 * top } else { 0.0 })
        .collect();
    let volts = |share: f64| format!("{:.3} V", share * top);
    let mut menu = vec![
        Probe {
            words: format!("1 Hz triangles of {} on all axes together", volts(0.6)),
            rate_hz,
            drive_v: all(&triangle(1.0, 0.6 * top, 3.0)),
        },
        Probe {
            words: format!("triangles of {} at 0.2 Hz and at 40 Hz on all axes", volts(0.4)),
            rate_hz,
            drive_v: all(&[triangle(0.2, 0.4 * top, 1.0), triangle(40.0, 0.4 * top, 20.0)].concat()),
        },
        Probe {
            words: format!("a step to {}, held for 12 s, and back for 10 s", volts(0.5)),
            rate_hz,
            drive_v: all(&hold(0.5 * top)),
        },
        Probe {
            words: format!("a 10 Hz square wave of {}", volts(0.65)),
            rate_hz,
            drive_v: all(&square),
        },
        Probe {
            words: format!(
                "sweeps from 1 Hz to {:.0} Hz, {} about {} and about {}",
                0.4 * rate_hz,
                volts(0.03),
                volts(0.15),
                volts(0.5)
            ),
            rate_hz,
            drive_v: all(&[sweep(0.15 * top, 0.03 * top), sweep(0.5 * top, 0.03 * top)].concat()),
        },
        Probe {
            words: "all drives at zero for 20 s".into(),
            rate_hz,
            drive_v: all(&vec![0.0; count(20.0)]),
        },
    ];
    for &axis in axes_of_interest {
        menu.push(Probe {
            words: format!(
                "1 Hz triangles of {} on axis {} alone, the others at 0 V",
                volts(0.6),
                axis + 1
            ),
            rate_hz,
            drive_v: alone(axis, &triangle(1.0, 0.6 * top, 2.0)),
        });
        menu.push(Probe {
            words: format!(
                "a sweep from 1 Hz to {:.0} Hz on axis {} alone",
                0.4 * rate_hz,
                axis + 1
            ),
            rate_hz,
            drive_v: alone(axis, &sweep(0.3 * top, 0.05 * top)),
        });
    }
    menu
}

/// Difference from which a probe tells two models apart, in standard deviations of the noise.
const TELLS_APART: f64 = 3.0;

/// The probe of the menu that tells a fitted model from most of its rivals, and of several such the one on which it differs most against the
/// noise from the nearest of them.
fn next_experiment(
    scene: &Scene,
    own: (&str, &Model),
    rivals: &[(&str, Model)],
) -> Option<NextExperiment> {
    let axes: Vec<usize> =
        own.1.terms.iter().flat_map(|t| t.axes()).fold(Vec::new(), |mut seen, axis| {
            if !seen.contains(&axis) {
                seen.push(axis);
            }
            seen
        });
    let scored: Vec<(Vec<f64>, String)> = menu(&own.1.fit.rig, &axes)
        .into_par_iter()
        .filter_map(|probe| {
            let drive: Vec<&[f64]> = probe.drive_v.iter().map(Vec::as_slice).collect();
            let run = |rig: &Rig| {
                let input = Input {
                    sample_rate_hz: probe.rate_hz,
                    start_s: 0.0,
                    ticks: None,
                    drive_v: &drive,
                    initial: &[],
                    monitor_v: None,
                };
                simulate(rig, &input, Axes::All).ok()
            };
            let x = run(&own.1.fit.rig)?;
            let skip = (0.5 * probe.rate_hz) as usize;
            let score = |y: &Output| -> f64 {
                let of_axis = |axis: usize| -> Option<f64> {
                    let sigma = scene.position_noise[axis].as_ref()?.sigma;
                    let both = x.position_m[axis].iter().zip(&y.position_m[axis]).skip(skip);
                    Some(both.map(|(p, q)| ((p - q) * 1.0e6 / sigma).powi(2)).sum())
                };
                (0..drive.len()).filter_map(of_axis).sum::<f64>().sqrt()
            };
            let scores: Option<Vec<f64>> =
                rivals.iter().map(|(_, rival)| Some(score(&run(&rival.fit.rig)?))).collect();
            Some((scores?, probe.words))
        })
        .collect();
    let names: Vec<&str> = rivals.iter().map(|(name, _)| *name).collect();
    in_words(own.0, &names, &scored)
}

/// How many rivals a probe tells apart, and by how much the nearest of those; by how much the nearest if it tells none.
fn worth(scores: &[f64]) -> f64 {
    let told = scores.iter().copied().filter(|&score| score >= TELLS_APART);
    let (many, nearest) =
        told.fold((0, f64::INFINITY), |(n, least), score| (n + 1, least.min(score)));
    if many == 0 {
        return scores.iter().copied().fold(0.0, f64::max) / TELLS_APART;
    }
    // The second part grows with the difference and stays below one.
    f64::from(many) + nearest / (nearest + 1.0e6)
}

/// What to do by how much each probe differs from each rival (standard deviations): one experiment if one tells them all, or what else the
/// others take.
fn in_words(own: &str, rivals: &[&str], scored: &[(Vec<f64>, String)]) -> Option<NextExperiment> {
    let (scores, words) = scored.iter().max_by(|p, q| worth(&p.0).total_cmp(&worth(&q.0)))?;
    let told = scores.iter().copied().filter(|&score| score >= TELLS_APART);
    let nearest = told.fold(f64::INFINITY, f64::min);
    if nearest.is_infinite() {
        let best = scores.iter().copied().fold(0.0, f64::max);
        let who = if rivals.len() > 1 { "any of them" } else { "them" };
        return Some(NextExperiment {
            excitation: format!(
                "none of the usual probes tells {who} apart (best: {words}; expected {best:.1} standard deviations)"
            ),
            separates: std::iter::once(&own).chain(rivals).map(ToString::to_string).collect(),
        });
    }
    let mut excitation =
        format!("{words} (expected to differ by {nearest:.0} standard deviations)");
    let mut separates = vec![own.to_string()];
    for (k, rival) in rivals.iter().enumerate() {
        let best = scored.iter().max_by(|p, q| p.0[k].total_cmp(&q.0[k]))?;
        if scores[k] >= TELLS_APART {
            separates.push(rival.to_string());
        } else if best.0[k] >= TELLS_APART {
            separates.push(rival.to_string());
            excitation +=
                &format!("; for {rival}: {} ({:.0} standard deviations)", best.1, best.0[k]);
        } else {
            excitation += &format!(
                "; none of the usual probes tells {own} from {rival} (at best {:.1} standard deviations)",
                best.0[k]
            );
        }
    }
    Some(NextExperiment { excitation, separates })
}

/// Place as people write it: `axis 2` or `axis 2 from axis 1`.
pub fn place_words(place: Place) -> String {
    match place {
        Place::Axis(axis) => format!("axis {}", axis + 1),
        Place::Pair { on, from } => format!("axis {} from axis {}", on + 1, from + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_probe_that_tells_all_rivals_is_worth_more() {
        let order = [[0.0, 2.0], [2.9, 0.0], [3.0, 0.0], [1.0e9, 2.9], [4.0, 4.0], [5.0, 5.0e6]];
        for pair in order.windows(2) {
            assert!(worth(&pair[0]) < worth(&pair[1]), "{pair:?}");
        }
        assert!(worth(&[40.0]) < worth(&[50.0]));
    }

    #[test]
    fn all_rivals_are_separated_or_said_not_to_be() {
        let say = |rivals: &[&str], scores: &[&[f64]]| {
            let name = |n: usize| ["a step", "a sweep"][n].to_string();
            let scored: Vec<_> =
                scores.iter().enumerate().map(|(n, of)| (of.to_vec(), name(n))).collect();
            let next = in_words("creep", rivals, &scored).expect("a probe");
            (next.separates.join(" "), next.excitation)
        };
        let both = ["stiffness", "friction"];
        let (separates, words) = say(&both, &[&[50.0, 7.0], &[90.0, 2.0]]);
        assert_eq!(separates, "creep stiffness friction");
        assert_eq!(words, "a step (expected to differ by 7 standard deviations)");
        let (separates, words) = say(&both, &[&[50.0, 1.0], &[2.0, 9.0]]);
        assert_eq!(separates, "creep stiffness friction");
        assert!(words.ends_with("; for friction: a sweep (9 standard deviations)"), "{words}");
        let (separates, words) = say(&both, &[&[1.0, 7.0], &[2.0, 6.0]]);
        assert_eq!(separates, "creep friction");
        assert!(words.contains("tells creep from stiffness (at best 2.0"), "{words}");
        let (separates, words) = say(&["stiffness"], &[&[7.0], &[8.0]]);
        assert_eq!(separates, "creep stiffness");
        assert_eq!(words, "a sweep (expected to differ by 8 standard deviations)");
        let (separates, words) = say(&["stiffness"], &[&[1.0], &[0.5]]);
        assert_eq!(separates, "creep stiffness");
        assert!(words.starts_with("none of the usual probes tells them apart"), "{words}");
    }
}
