//! Why a simulation and a rig disagree: locate, name, fit and accept.
//!
//! Recordings of a rig go in, a [`Diagnosis`] and the corrected rig come out. The steps are folders: [`session`] makes recordings
//! comparable with simulations, [`locate`] says where the gap lies, [`search`] chooses effects of the catalogue with the models and fits of
//! [`fitting`], [`judge`] decides what may be said, [`rest`] measures what is left, [`picture`] draws it all; [`mod@diagnose`] is the way
//! through them. Method and sources: the field's practice of output-error identification (Ljung, System Identification, chapter 7) with a
//! model-form tolerance after Kennedy and O'Hagan. Beside it, [`mod@identify`] refits nominal parameters alone, [`control`] finds what the
//! controller has to know, and [`platform`] does all of this for compliant platforms.

pub mod control;
pub mod diagnose;
pub mod diagnosis;
mod error;
pub mod fitting;
pub mod identify;
pub mod judge;
pub mod locate;
mod looks;
pub mod picture;
pub mod platform;
pub mod rest;
pub mod search;
pub mod session;

pub use control::{ForControl, for_control};
pub use diagnose::{Outcome, diagnose};
pub use diagnosis::Diagnosis;
pub use error::Error;
pub use identify::{Identified, identify};

/// How to run a diagnosis or a calibration.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Effects taken out of the catalogue (leave-one-out tests).
    pub exclude: Vec<String>,
    /// Show progress on standard error.
    pub progress: bool,
}

/// The verdict in one sentence, for the terminal and the head of the report.
pub fn sentence(diagnosis: &Diagnosis) -> String {
    use diagnosis::Verdict;
    let gap = &diagnosis.gap;
    let list = |names: Vec<String>| -> String {
        match names.as_slice() {
            [] => String::new(),
            [one] => one.clone(),
            [head @ .., last] => format!("{} and {last}", head.join(", ")),
        }
    };
    let axes = |axes: &[usize]| -> String {
        let word = if axes.len() == 1 { "axis" } else { "axes" };
        format!("{word} {}", list(axes.iter().map(usize::to_string).collect()))
    };
    let causes = list(
        diagnosis
            .causes
            .iter()
            .map(|c| {
                let mut name = format!("{} on {}", c.effect, axes(&c.axes));
                if !c.indistinguishable_from.is_empty() {
                    name += &format!(" (or {})", c.indistinguishable_from.join(" or "));
                }
                name
            })
            .collect(),
    );
    let unfitted = unfitted(diagnosis);
    let left = match &diagnosis.rest {
        Some(rest) if !rest.words.is_empty() => {
            format!(" What is left: {}.", rest.words.join("; "))
        }
        _ => String::new(),
    };
    if let Some(band) = &diagnosis.band {
        return format!(
            "{causes}: below {:.0} Hz the gap falls from {:.1} nm to {:.1} nm on {unfitted} (noise {:.1} nm there); \
             above, nothing in the catalogue accounts for it.{left}",
            band.below_hz, band.before_nm, band.after_nm, band.floor_nm
        );
    }
    let closed = 100.0 * gap.closed;
    let looks_like =
        diagnosis.looks_like.as_ref().map_or(String::new(), |words| format!(" {words}"));
    let in_order = diagnosis.in_order_nm.map_or(String::new(), |nm| {
        format!(" Taken in the session's order, not file by file, {nm:.1} nm are left.")
    });
    match diagnosis.verdict {
        Verdict::NoGap => format!(
            "No gap beyond noise: the rig file predicts these recordings to {:.2} nm, and the noise is {:.2} nm.",
            gap.before_nm, gap.floor_nm
        ),
        Verdict::Explained => format!(
            "{causes}: the gap falls from {:.1} nm to {:.1} nm on {unfitted} (noise {:.1} nm; {closed:.1} % closed).{in_order}",
            gap.before_nm, gap.after_nm, gap.floor_nm
        ),
        Verdict::PartlyExplained => format!(
            "{causes} close {closed:.1} % of the gap ({:.1} nm to {:.1} nm, noise {:.1} nm); nothing in the catalogue accounts for the rest.{in_order}{looks_like}{left}",
            gap.before_nm, gap.after_nm, gap.floor_nm
        ),
        Verdict::Unexplained => {
            let place = diagnosis.location.first().map_or(String::new(), |l| {
                format!(" It lies mostly in the {} of axis {}.", l.stage, l.axis)
            });
            format!(
                "There is a gap of {:.1} nm (noise {:.1} nm) that nothing in the catalogue explains.{place}{looks_like}{left}",
                gap.before_nm, gap.floor_nm
            )
        }
    }
}

/// What the causes were checked on: whole recordings, or parts where every one of them was fitted as well.
pub(crate) fn unfitted(diagnosis: &Diagnosis) -> &'static str {
    let is_whole = |r: &diagnosis::RecordingGap| r.role == diagnosis::Role::HeldOut;
    match diagnosis.recordings.as_slice() {
        [_] => "parts of the recording that were not fitted",
        all if all.iter().any(is_whole) => "recordings that were not fitted",
        _ => "parts of the recordings that were not fitted",
    }
}
