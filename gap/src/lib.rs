//! Why a simulation and a rig disagree: locate, name, fit and accept.
//!
//! Recordings of a rig go in, a [`Diagnosis`] and the corrected rig come out. The steps are files: [`intake`] lays recordings on
//! their clocks, [`floor`] measures the noise, [`scene`] whitens residuals, [`locate`] says where the gap lies, [`split`] holds
//! recordings out, [`screen`] tests the catalogue, [`fit`] turns parameters, [`select`] chooses effects, [`accept`] decides what may
//! be said, [`ambiguity`] what else it could be, [`picture`] draws it. Method and sources: the field's practice of output-error
//! identification (Ljung, System Identification, chapter 7) with a model-form tolerance after Kennedy and O'Hagan.

pub mod accept;
pub mod ambiguity;
pub mod diagnose;
pub mod diagnosis;
pub mod energy;
mod error;
pub mod fit;
pub mod floor;
pub mod intake;
pub mod knobs;
pub mod locate;
pub mod picture;
pub mod pyramid;
pub mod scene;
pub mod screen;
pub mod select;
pub mod split;

pub use diagnose::{Outcome, diagnose};
pub use diagnosis::Diagnosis;
pub use error::Error;

/// How to run a diagnosis or a calibration.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Effects taken out of the catalogue (leave-one-out tests).
    pub exclude: Vec<String>,
    /// Show progress on standard error.
    pub progress: bool,
}
