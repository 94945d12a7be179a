//! The answer of `flexstage diagnose` as it is written to `diagnosis.json` (format: `contract.md`).
//!
//! Lengths are in nanometres, shares and probabilities between 0 and 1, axes numbered from 1.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::rest::Rest;

/// What the diagnosis concludes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Model and rig agree to the noise.
    NoGap,
    /// The named causes account for the gap.
    Explained,
    /// The named causes are real, but a gap remains that nothing in the catalogue accounts for.
    PartlyExplained,
    /// Nothing in the catalogue accounts for the gap.
    Unexplained,
}

/// Everything that `diagnosis.json` holds.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Diagnosis {
    /// The conclusion.
    pub verdict: Verdict,
    /// Size of the gap on recordings that were not fitted.
    pub gap: Gap,
    /// Where the gap lies before any effect is added, largest share first.
    #[serde(rename = "where")]
    pub location: Vec<Location>,
    /// Accepted causes, largest first.
    pub causes: Vec<Cause>,
    /// The experiment that would separate what these recordings cannot; `None` when nothing is ambiguous.
    pub next_experiment: Option<NextExperiment>,
    /// Every recording of the session and what it was used for.
    pub recordings: Vec<RecordingGap>,
    /// Where the causes account for slow motion only: how far the gap shrinks there. The figures of `gap` are over all frequencies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band: Option<Band>,
    /// Gap with the causes added where the recordings are taken in the session's order, each beginning as the one before has left the
    /// stage, nm; only where that makes a difference. A replay of single files, which `gap` stands for, knows of it what the part
    /// before `settle_s` tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub in_order_nm: Option<f64>,
    /// What is outside the catalogue and accounts for the gap, or a part of it, better than the causes that would be named; in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub looks_like: Option<String>,
    /// What is left where the causes do not account for the whole gap.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<Rest>,
    /// Statements that fit no field: what cannot be told from this session, what was disturbed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// Gap below a frequency, root mean square over axes and samples of held-out recordings.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Band {
    /// Upper edge, Hz.
    pub below_hz: f64,
    /// With the rig as it was given, nm.
    pub before_nm: f64,
    /// With the causes added, nm.
    pub after_nm: f64,
    /// Measurement noise in the band, nm.
    pub floor_nm: f64,
}

impl Band {
    /// `1 - (after^2 - floor^2) / (before^2 - floor^2)`.
    pub fn closed(&self) -> f64 {
        let floor = self.floor_nm.powi(2);
        1.0 - (self.after_nm.powi(2) - floor) / (self.before_nm.powi(2) - floor)
    }
}

/// Root-mean-square gap over axes and samples after settling, held-out recordings only.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Gap {
    /// With the rig as it was given, nm.
    pub before_nm: f64,
    /// With the causes added, nm.
    pub after_nm: f64,
    /// Measurement noise, nm.
    pub floor_nm: f64,
    /// `1 - (after^2 - floor^2) / (before^2 - floor^2)`.
    pub closed: f64,
    /// 95 % interval of `closed` from a block bootstrap.
    pub closed_ci95: [f64; 2],
    /// The same, axis by axis.
    pub per_axis: Vec<AxisGap>,
}

/// Gap of one axis.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct AxisGap {
    /// Axis, from 1.
    pub axis: usize,
    /// With the rig as it was given, nm.
    pub before_nm: f64,
    /// With the causes added, nm.
    pub after_nm: f64,
    /// Measurement noise, nm.
    pub floor_nm: f64,
    /// As [`Gap::closed`].
    pub closed: f64,
}

impl AxisGap {
    /// Energy of the gap beyond the noise, with the rig as it was given, nm^2.
    pub(crate) fn energy_nm2(&self) -> f64 {
        self.before_nm.powi(2) - self.floor_nm.powi(2)
    }
}

/// A share of the explainable gap energy.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Location {
    /// Axis, from 1.
    pub axis: usize,
    /// `drive`, `amplifier`, `piezo`, `mechanism`, `sensor` or `environment`.
    pub stage: String,
    /// Share of the explainable gap energy before any effect is added.
    pub share: f64,
}

/// One accepted cause.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Cause {
    /// Name in the catalogue.
    pub effect: String,
    /// Wrong value or missing physics.
    pub kind: CauseKind,
    /// Stage of the chain where the effect sits.
    pub stage: String,
    /// Axes that need it, from 1.
    pub axes: Vec<usize>,
    /// Share of the explainable gap energy that this cause closes.
    pub closes: f64,
    /// Fitted parameters. Where axes differ the name ends in the axis or pair (`_1`, `_1_2`).
    pub parameters: BTreeMap<String, Parameter>,
    /// Probability of this cause among the rivals that were tried.
    pub confidence: f64,
    /// Effects that these recordings cannot tell from this one.
    pub indistinguishable_from: Vec<String>,
}

/// Wrong value or missing physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CauseKind {
    /// A parameter of the nominal model has another value.
    Parametric,
    /// The nominal model lacks the physics.
    Structural,
}

/// A fitted value.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Parameter {
    /// Best value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Unit of both.
    pub unit: String,
}

/// An experiment that separates what the session cannot.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NextExperiment {
    /// What to drive, in words.
    pub excitation: String,
    /// The effects that it tells apart.
    pub separates: Vec<String>,
}

/// What one recording was used for and how it fared.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RecordingGap {
    /// File name inside the session folder.
    pub file: String,
    /// Fitted or held out.
    pub role: Role,
    /// Gap with the rig as it was given, nm.
    pub before_nm: f64,
    /// Gap with the causes added, nm.
    pub after_nm: f64,
}

/// Use of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// Parameters were fitted to it.
    Fit,
    /// Only scored.
    HeldOut,
}
