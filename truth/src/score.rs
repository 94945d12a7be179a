//! Compares answers with the key: what the diagnosis named, where, how much of the gap it closed on recordings that it
//! never saw, and whether it kept quiet when it should.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::case::Label;

/// What of `diagnosis.json` is scored.
#[derive(Clone, Debug, Deserialize)]
pub struct Answer {
    /// `no-gap`, `explained`, `partly-explained` or `unexplained`.
    pub verdict: String,
    /// Gap on held-out recordings.
    pub gap: Promise,
    /// Where the gap lies, largest share first.
    #[serde(rename = "where", default)]
    pub place: Vec<Place>,
    /// Causes, largest first.
    pub causes: Vec<Cause>,
}

/// The gap that the diagnosis promises to close.
#[derive(Clone, Debug, Deserialize)]
pub struct Promise {
    /// Share of the gap.
    pub closed: f64,
}

/// A place in the chain.
#[derive(Clone, Debug, Deserialize)]
pub struct Place {
    /// Axis, from 1.
    pub axis: usize,
    /// Stage.
    pub stage: String,
    /// Share of the gap.
    pub share: f64,
}

/// A cause that was named.
#[derive(Clone, Debug, Deserialize)]
pub struct Cause {
    /// Effect.
    pub effect: String,
    /// Stage.
    pub stage: String,
    /// Axes, from 1.
    pub axes: Vec<usize>,
    /// What else it could be.
    #[serde(default)]
    pub indistinguishable_from: Vec<String>,
}

impl Cause {
    /// Whether it names the effect, alone or in a set of at most three.
    fn holds(&self, effect: &str) -> bool {
        let set = 1 + self.indistinguishable_from.len();
        self.effect == effect
            || (set <= 3 && self.indistinguishable_from.iter().any(|name| name == effect))
    }
}

/// Gap on judging recordings (nm rms over axes and samples), before and after.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// With the rig as it was known.
    pub before_nm: f64,
    /// With the rig that the diagnosis wrote.
    pub after_nm: f64,
}

/// Outcome of one case.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Outcome {
    /// The key's entry.
    pub label: Label,
    /// Verdict, or `failed` if there was no answer.
    pub verdict: String,
    /// Effects named, with axes and what they could not be told from.
    pub named: Vec<String>,
    /// Whether the first cause is right, or all is quiet where nothing (known) is wrong.
    pub right: bool,
    /// Whether every truth was named.
    pub all_named: bool,
    /// Whether an effect was named that is not there.
    pub blamed: bool,
    /// Whether the right cause has exactly the right axes; `None` if no right cause was named.
    pub axes_right: Option<bool>,
    /// Whether the stage is right: of the first cause, or of the place for an unknown fault.
    pub stage_right: Option<bool>,
    /// Share of the gap closed, as promised.
    pub promised: f64,
    /// Share of the gap closed on judging recordings.
    pub actual: Option<f64>,
    /// Gap on judging recordings.
    pub judged: Option<Judged>,
    /// Time that the diagnosis took (s).
    pub seconds: f64,
}

impl Outcome {
    /// What the answer leaves on recordings that the diagnosis never saw, beyond the noise, in multiples of it (in quadrature).
    pub fn left_in_noise(&self) -> Option<f64> {
        let floor = self.label.floor_nm;
        self.judged.map(|judged| (judged.after_nm.powi(2) - floor.powi(2)).max(0.0).sqrt() / floor)
    }
}

/// Scores one answer (`None`: the diagnosis failed).
pub fn score(
    label: &Label,
    answer: Option<&Answer>,
    judged: Option<Judged>,
    seconds: f64,
) -> Outcome {
    let floor = label.floor_nm.powi(2);
    let actual = judged.and_then(|judged| {
        let gap = judged.before_nm.powi(2) - floor;
        // Within a few per cent of the floor there is no gap whose share could be closed.
        (gap > 0.1 * floor).then(|| 1.0 - (judged.after_nm.powi(2) - floor) / gap)
    });
    let mut outcome = Outcome {
        label: label.clone(),
        verdict: "failed".into(),
        named: Vec::new(),
        right: false,
        all_named: false,
        blamed: false,
        axes_right: None,
        stage_right: None,
        promised: 0.0,
        actual,
        judged,
        seconds,
    };
    let Some(answer) = answer else { return outcome };
    outcome.verdict = answer.verdict.clone();
    outcome.promised = answer.gap.closed;
    outcome.named = answer
        .causes
        .iter()
        .map(|cause| {
            let mut text = format!("{}{:?}", cause.effect, cause.axes);
            if !cause.indistinguishable_from.is_empty() {
                let _ = write!(text, " or {}", cause.indistinguishable_from.join(" or "));
            }
            text
        })
        .collect();
    let known: Vec<_> = label.truth.iter().filter(|truth| truth.effect != "unknown").collect();
    let is_true = |cause: &Cause| known.iter().any(|truth| cause.holds(&truth.effect));
    outcome.blamed = answer.causes.iter().any(|cause| !is_true(cause));
    outcome.all_named =
        known.iter().all(|truth| answer.causes.iter().any(|cause| cause.holds(&truth.effect)));
    let first = answer.causes.first();
    match label.kind.as_str() {
        "null" => outcome.right = first.is_none() && answer.verdict == "no-gap",
        "unknown" => {
            let quiet = first.is_none();
            outcome.right =
                quiet && matches!(answer.verdict.as_str(), "unexplained" | "partly-explained");
            outcome.stage_right = answer
                .place
                .iter()
                .max_by(|a, b| a.share.total_cmp(&b.share))
                .map(|place| label.truth.iter().any(|truth| truth.stage == place.stage));
        }
        _ => {
            // The larger of a pair is to come first: in nanometres, as the contract measures gaps.
            let dominant = known.iter().max_by(|a, b| a.gap_nm.total_cmp(&b.gap_nm));
            if let (Some(first), Some(dominant)) = (first, dominant) {
                outcome.right = first.holds(&dominant.effect);
                outcome.stage_right = Some(first.stage == dominant.stage || outcome.right);
            } else {
                outcome.stage_right = Some(false);
            }
            let axes = known.iter().filter_map(|truth| {
                let cause = answer.causes.iter().find(|cause| cause.holds(&truth.effect))?;
                let mut named = cause.axes.clone();
                named.sort_unstable();
                named.dedup();
                Some(named == truth.axes)
            });
            outcome.axes_right = axes.reduce(|a, b| a && b);
        }
    }
    outcome
}

/// A share with its 95 % interval (Wilson, JASA 22, 1927).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// How many.
    pub hits: usize,
    /// Of how many.
    pub of: usize,
    /// Interval.
    pub ci95: (f64, f64),
}

impl Share {
    /// A share of counts.
    pub fn of(hits: usize, of: usize) -> Self {
        let (n, z2) = (of as f64, 1.959_964f64.powi(2));
        if of == 0 {
            return Self { hits, of, ci95: (0.0, 1.0) };
        }
        let p = hits as f64 / n;
        let middle = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = (z2 * (p * (1.0 - p) / n + z2 / (4.0 * n * n))).sqrt() / (1.0 + z2 / n);
        Self { hits, of, ci95: ((middle - half).max(0.0), (middle + half).min(1.0)) }
    }

    fn count<'a>(
        outcomes: impl Iterator<Item = &'a Outcome>,
        hit: impl Fn(&Outcome) -> bool,
    ) -> Self {
        let (mut hits, mut of) = (0, 0);
        for outcome in outcomes {
            of += 1;
            hits += usize::from(hit(outcome));
        }
        Self::of(hits, of)
    }

    fn text(&self) -> String {
        if self.of == 0 {
            return "no case".into();
        }
        let percent = 100.0 * self.hits as f64 / self.of as f64;
        let (low, high) = self.ci95;
        format!(
            "{percent:5.1} %  [{:.1}, {:.1}]  ({} of {})",
            100.0 * low,
            100.0 * high,
            self.hits,
            self.of
        )
    }
}

/// Figures over all cases.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Single effects: right cause, or a set of at most three that holds it, first.
    pub single_right: Share,
    /// Single effects: right one first and nothing else blamed.
    pub single_clean: Share,
    /// Axes exactly right, where a right cause was named.
    pub axes: Share,
    /// Stage right.
    pub stage: Share,
    /// Nulls on which anything was found.
    pub false_alarms: Share,
    /// Out-of-catalogue faults without a blamed effect.
    pub abstained: Share,
    /// Out-of-catalogue faults called explained.
    pub wrongly_explained: Share,
    /// Known effects called no gap or unexplained.
    pub known_called_unknown: Share,
    /// Pairs: both named.
    pub pairs_both: Share,
    /// Pairs: the larger one first.
    pub pairs_dominant: Share,
    /// Promised and actual share within 5 points, where an effect was there and a gap to close.
    pub promise_kept: Share,
    /// Share of the gap closed on judging recordings: median and 5th percentile, known effects.
    pub closed: Option<(f64, f64)>,
    /// Longest and median time of a diagnosis (s).
    pub seconds: Option<(f64, f64)>,
    /// Cases without an answer.
    pub failed: usize,
    /// Truth, then what came first instead, with counts.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
}

fn quantile(sorted: &[f64], at: f64) -> f64 {
    let position = at * (sorted.len() - 1) as f64;
    let (low, high) = (position.floor() as usize, position.ceil() as usize);
    sorted[low] + (sorted[high] - sorted[low]) * position.fract()
}

/// Figures over all cases.
pub fn summarise(outcomes: &[Outcome]) -> Summary {
    let of = |kind: &'static str| outcomes.iter().filter(move |outcome| outcome.label.kind == kind);
    let known = || of("single").chain(of("pair"));
    let sorted = |values: Vec<f64>| {
        let mut values = values;
        values.sort_by(f64::total_cmp);
        values
    };
    let closed = sorted(known().filter_map(|outcome| outcome.actual).collect());
    let seconds = sorted(outcomes.iter().map(|outcome| outcome.seconds).collect());
    let mut confusion: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for outcome in of("null").chain(of("single")).chain(of("unknown")) {
        let truth = match outcome.label.truth.first() {
            None => "nothing".to_string(),
            Some(truth) if truth.effect == "unknown" => {
                format!("unknown: {}", truth.note.split(',').next().unwrap_or_default())
            }
            Some(truth) => truth.effect.clone(),
        };
        let named = match outcome.named.first() {
            _ if outcome.right => "right".to_string(),
            Some(first) => first.split('[').next().unwrap_or_default().to_string(),
            None => outcome.verdict.clone(),
        };
        *confusion.entry(truth).or_default().entry(named).or_default() += 1;
    }
    Summary {
        single_right: Share::count(of("single"), |outcome| outcome.right),
        single_clean: Share::count(of("single"), |outcome| outcome.right && !outcome.blamed),
        axes: Share::count(known().filter(|outcome| outcome.axes_right.is_some()), |outcome| {
            outcome.axes_right == Some(true)
        }),
        stage: Share::count(known(), |outcome| outcome.stage_right == Some(true)),
        false_alarms: Share::count(of("null"), |outcome| !outcome.right),
        abstained: Share::count(of("unknown"), |outcome| outcome.right),
        wrongly_explained: Share::count(of("unknown"), |outcome| outcome.verdict == "explained"),
        known_called_unknown: Share::count(known(), |outcome| outcome.named.is_empty()),
        pairs_both: Share::count(of("pair"), |outcome| outcome.all_named),
        pairs_dominant: Share::count(of("pair"), |outcome| outcome.right),
        promise_kept: Share::count(known().filter(|outcome| outcome.actual.is_some()), |outcome| {
            outcome.actual.is_some_and(|actual| (actual - outcome.promised).abs() <= 0.05)
        }),
        closed: (!closed.is_empty()).then(|| (quantile(&closed, 0.5), quantile(&closed, 0.05))),
        seconds: seconds.last().map(|longest| (*longest, quantile(&seconds, 0.5))),
        failed: outcomes.iter().filter(|outcome| outcome.verdict == "failed").count(),
        confusion,
    }
}

impl Summary {
    /// For the terminal.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let rows = [
            ("single effect right (or in a set of 3)", &self.single_right),
            ("  ... and nothing else blamed", &self.single_clean),
            ("axes right, where the cause is", &self.axes),
            ("stage right", &self.stage),
            ("false alarms on nulls", &self.false_alarms),
            ("outside the catalogue: abstained", &self.abstained),
            ("outside the catalogue: called explained", &self.wrongly_explained),
            ("known effect, nothing named", &self.known_called_unknown),
            ("pairs: both named", &self.pairs_both),
            ("pairs: larger one first", &self.pairs_dominant),
            ("promised shrink within 5 points", &self.promise_kept),
        ];
        for (name, share) in rows {
            let _ = writeln!(text, "{name:<42} {}", share.text());
        }
        if let Some((median, low)) = self.closed {
            let _ = writeln!(
                text,
                "{:<42} median {:.1} %, 5th percentile {:.1} %",
                "gap closed on judging recordings",
                100.0 * median,
                100.0 * low
            );
        }
        if let Some((longest, median)) = self.seconds {
            let _ = writeln!(
                text,
                "{:<42} median {median:.1}, longest {longest:.1}",
                "seconds a diagnosis"
            );
        }
        if self.failed > 0 {
            let _ = writeln!(text, "{:<42} {}", "cases without an answer", self.failed);
        }
        for (truth, named) in &self.confusion {
            for (named, count) in named.iter().filter(|(named, _)| *named != "right") {
                let _ = writeln!(text, "  {truth} -> {named}: {count}");
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Truth;

    fn label(kind: &str, effects: &[(&str, f64)]) -> Label {
        let truth = |&(effect, ratio): &(&str, f64)| Truth {
            effect: effect.into(),
            axes: vec![1, 3],
            stage: "piezo".into(),
            note: "telegraph-gauge, size 1".into(),
            ratio,
            gap_nm: 4.0 * ratio,
        };
        Label {
            id: "case".into(),
            kind: kind.into(),
            truth: effects.iter().map(truth).collect(),
            session: "probe".into(),
            monitor: true,
            floor_nm: 4.0,
        }
    }

    fn answer(verdict: &str, causes: &[(&str, &[usize], &[&str])]) -> Answer {
        let cause = |&(effect, axes, set): &(&str, &[usize], &[&str])| Cause {
            effect: effect.into(),
            stage: "piezo".into(),
            axes: axes.to_vec(),
            indistinguishable_from: set.iter().map(|name| name.to_string()).collect(),
        };
        Answer {
            verdict: verdict.into(),
            gap: Promise { closed: 0.9 },
            place: vec![Place { axis: 1, stage: "piezo".into(), share: 1.0 }],
            causes: causes.iter().map(cause).collect(),
        }
    }

    #[test]
    fn sets_count_up_to_three_and_axes_must_match() {
        let creep = label("single", &[("creep", 5.0)]);
        let judged = Some(Judged { before_nm: 20.0, after_nm: 4.0 });
        let outcome = score(
            &creep,
            Some(&answer("explained", &[("viscoelasticity", &[3, 1], &["creep"])])),
            judged,
            1.0,
        );
        assert!(outcome.right && outcome.axes_right == Some(true) && !outcome.blamed);
        assert_eq!(outcome.actual, Some(1.0));
        let four = answer("explained", &[("a", &[1], &["b", "c", "creep"])]);
        assert!(!score(&creep, Some(&four), judged, 1.0).right);
        let late = answer("explained", &[("friction", &[1], &[]), ("creep", &[1], &[])]);
        let outcome = score(&creep, Some(&late), judged, 1.0);
        assert!(
            !outcome.right
                && outcome.all_named
                && outcome.blamed
                && outcome.axes_right == Some(false)
        );
        assert!(!score(&creep, None, None, 1.0).right);
    }

    #[test]
    fn quiet_is_right_only_where_nothing_known_is_wrong() {
        let quiet = answer("no-gap", &[]);
        let abstained = answer("unexplained", &[]);
        let blamed = answer("partly-explained", &[("creep", &[1], &[])]);
        assert!(score(&label("null", &[]), Some(&quiet), None, 1.0).right);
        assert!(!score(&label("null", &[]), Some(&abstained), None, 1.0).right);
        let unknown = label("unknown", &[("unknown", 9.0)]);
        assert!(score(&unknown, Some(&abstained), None, 1.0).right);
        assert!(!score(&unknown, Some(&quiet), None, 1.0).right);
        assert!(!score(&unknown, Some(&blamed), None, 1.0).right);
    }

    #[test]
    fn pairs_want_the_larger_first() {
        let pair = label("pair", &[("creep", 5.0), ("friction", 9.0)]);
        let both = answer("explained", &[("friction", &[1, 3], &[]), ("creep", &[1, 3], &[])]);
        let summary = summarise(&[score(&pair, Some(&both), None, 1.0)]);
        assert_eq!((summary.pairs_both.hits, summary.pairs_dominant.hits), (1, 1));
        let other = answer("explained", &[("creep", &[1, 3], &[])]);
        let outcome = score(&pair, Some(&other), None, 1.0);
        assert!(!outcome.right && !outcome.all_named);
    }

    #[test]
    fn what_is_left_is_counted_beyond_the_noise() {
        let one = label("single", &[("creep", 5.0)]);
        let left = |after_nm| {
            let judged = Judged { before_nm: 50.0, after_nm };
            score(&one, None, Some(judged), 1.0).left_in_noise().unwrap()
        };
        let floor = one.floor_nm;
        assert!((left(floor * 5.0_f64.sqrt()) - 2.0).abs() < 1e-9);
        assert_eq!(left(0.9 * floor), 0.0);
    }

    /// Values of the Wilson interval from its formula worked by hand: 95 of 100 and 0 of 300.
    #[test]
    fn wilson_interval() {
        let share = Share::of(95, 100);
        assert!(
            (share.ci95.0 - 0.8882).abs() < 5e-4 && (share.ci95.1 - 0.9785).abs() < 5e-4,
            "{share:?}"
        );
        assert!((Share::of(0, 300).ci95.1 - 0.0126).abs() < 5e-4);
    }
}
