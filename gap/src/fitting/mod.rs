//! Models of a gap, and their parameters from a session: output-error fits.
//!
//! | file | what it does |
//! | --- | --- |
//! | [`knobs`] | what a fit turns, in which units and bounds |
//! | [`model`] | effects at their places, with values |
//! | [`guess`] | settings to look at first, taken from what the session contains |
//! | [`fit`], `descent` | Levenberg-Marquardt on simulations, axes that nothing ties together each with a step of its own |

pub(crate) mod descent;
pub mod fit;
pub mod guess;
pub mod knobs;
pub mod model;
