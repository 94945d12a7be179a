//! What is left once the catalogue has said its part: is it linear in the drives, does it run across axes, does it grow with the level,
//! does it repeat at all?
//!
//! Nothing here is named as a cause: these are properties of the remainder, measured without a model of the rig, for the person who has to
//! extend it. Frequency responses from every drive to every reading are fitted to what is left of the fitted recordings
//! and judged on the held-out ones (`response`); a lag that is there at all speeds and grows with the level is a loop (`lag`); what
//! does not come again in the next period is a disturbance (`disturbed`). Method: best linear approximation (Pintelon and Schoukens,
//! System Identification: A Frequency Domain Approach, 2nd ed., chapters 2 to 4).

mod disturbed;
mod lag;
mod picture;
mod response;
mod waves;

use serde::{Deserialize, Serialize};

pub use disturbed::Disturbed;
pub use lag::LagAtLevel;
pub(crate) use picture::draw;
pub use response::{BandLeft, OwnOrAll};

use crate::session::scene::{Scene, Stack};

/// Share of the spectrum, from 0 Hz, that counts as slow motion: resonances are faster, loops and static gains rule.
const SLOW_SHARE: f64 = 1.0 / 16.0;

/// Properties of what the causes leave.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Rest {
    /// What linear models of the drives would leave of held-out recordings, octave by octave and level by level.
    pub linear: Vec<BandLeft>,
    /// Lag towards zero frequency at every level.
    pub lag: Vec<LagAtLevel>,
    /// Recordings with much that does not repeat.
    pub disturbed: Vec<Disturbed>,
    /// What follows from these, in words.
    pub words: Vec<String>,
}

/// Measure what is left. `before` and `after` are raw residuals of the rig as given and of the rig with its causes, in units of the noise.
pub(crate) fn rest(scene: &Scene, before: &Stack, after: &Stack) -> Rest {
    let waves = waves::waves(scene, before, after);
    let linear = response::bands(&waves);
    let lag = lag::lags(&waves);
    let disturbed = disturbed::disturbed(scene);
    let mut words: Vec<String> = response::words(&linear).into_iter().collect();
    words.extend(lag::words(&lag));
    words.extend(disturbed::words(&disturbed));
    Rest { linear, lag, disturbed, words }
}
