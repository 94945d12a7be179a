//! The gap of the second paper's platforms: why the one-mass model and the measured return disagree.
//!
//! Recordings of free returns go in, a [`Diagnosis`](crate::Diagnosis) and the corrected chain come out.
//!
//! | file | what |
//! | --- | --- |
//! | [`data`] | free returns from a session, and what is held out |
//! | [`noise`] | noise floor, its memory and drift, measured from the recording |
//! | [`model`] | a rig with parameters that may be turned |
//! | [`fit`] | least squares on the simulated return, confidence intervals |
//! | [`catalogue`] | effects that a platform can have |
//! | [`tell`] | what the data cannot tell: masses, the common scale of forces, the order of the springs |
//! | [`identify`](mod@identify) | the parameters of the chain as it is |
//! | [`select`] | which effects the data asks for, and what else it could be |
//! | [`causes`] | causes as the answer states them, and the next experiment |
//! | [`diagnose`](mod@diagnose) | all of it in order |
//! | [`picture`] | the report |
//!
//! A free return from rest under no force tells ratios only: with masses too small to matter each spring with its damper
//! returns on its own, x(t) = F Σ exp(-k_i t / c_i) / k_i. So the rates k_i/c_i and the shares of the deflection can be
//! told; the common scale of all forces comes from the static test (the rig's own static stiffness is kept).

pub mod catalogue;
pub mod causes;
pub mod data;
pub mod diagnose;
pub mod fit;
pub mod identify;
pub mod model;
pub mod noise;
pub mod picture;
mod replay;
pub mod select;
pub mod tell;

pub use data::PlatformDataError;
pub use diagnose::{Outcome, diagnose};
pub use identify::{Identified, identify};
pub use replay::replay;
