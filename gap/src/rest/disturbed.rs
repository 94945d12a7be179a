//! Recordings that do not repeat: what comes once is not the model's to explain.

use serde::{Deserialize, Serialize};

use super::waves::drive_rms_v;
use crate::session::floor::{Unrepeated, unrepeated};
use crate::session::scene::Scene;
use crate::session::spectra::spectrum;

/// A recording with much that differs from one period to the next.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Disturbed {
    /// File name inside the session.
    pub file: String,
    /// Root mean square over the axes of what does not repeat, nm.
    pub unrepeatable_nm: f64,
    /// The same in the median recording, nm, those with a smaller drive scaled up to this one's.
    pub usual_nm: f64,
    /// Nine tenths of it lie above this frequency, Hz.
    pub above_hz: f64,
}

/// Fewest periodic recordings that tell what is usual.
const FEWEST: usize = 4;
/// What does not repeat is this many times the usual.
const UNUSUAL: f64 = 2.0;

/// Recordings with an unusual share that does not repeat, in the session's order.
pub(super) fn disturbed(scene: &Scene) -> Vec<Disturbed> {
    let found: Vec<(f64, Disturbed)> = scene
        .tracks
        .iter()
        .filter_map(|track| {
            let rows: Vec<Unrepeated> = track
                .position_um
                .iter()
                .flatten()
                .map(|row| unrepeated(track, row))
                .collect::<Option<_>>()?;
            let samples: usize = rows.iter().map(|row| row.recorded().count()).sum();
            let energy: f64 = rows.iter().flat_map(Unrepeated::recorded).map(|um| um * um).sum();
            let mut power: Vec<f64> = Vec::new();
            let mut step_hz = 0.0;
            for row in &rows {
                let (step, own) = spectrum(&row.difference, track.rate_hz);
                step_hz = step;
                power.resize(own.len(), 0.0);
                power.iter_mut().zip(&own).for_each(|(sum, p)| *sum += p);
            }
            let tenth = 0.1 * power.iter().sum::<f64>();
            let mut below = 0.0;
            let edge = power.iter().position(|p| {
                below += p;
                below > tenth
            })?;
            let drive_v = drive_rms_v(track, &(track.settle..track.len()));
            let found = Disturbed {
                file: track.file.clone(),
                unrepeatable_nm: 1.0e3 * (energy / samples.max(1) as f64).sqrt(),
                usual_nm: 0.0,
                above_hz: edge as f64 * step_hz,
            };
            (drive_v > 0.0).then_some((drive_v, found))
        })
        .collect();
    if found.len() < FEWEST {
        return Vec::new();
    }
    // What does not repeat may grow with the drive, so that a small motion is no excuse, and a large one is.
    let usual_nm = |drive_v: f64| -> f64 {
        let mut sizes: Vec<f64> =
            found.iter().map(|(own_v, d)| d.unrepeatable_nm * (drive_v / own_v).max(1.0)).collect();
        sizes.sort_by(f64::total_cmp);
        sizes[sizes.len() / 2]
    };
    found
        .iter()
        .map(|(drive_v, d)| Disturbed { usual_nm: usual_nm(*drive_v), ..d.clone() })
        .filter(|d| d.unrepeatable_nm > UNUSUAL * d.usual_nm)
        .collect()
}

/// The disturbed recordings in words.
pub(super) fn words(disturbed: &[Disturbed]) -> Option<String> {
    let each: Vec<String> = disturbed
        .iter()
        .map(|d| {
            format!(
                "{} ({:.0} nm do not come again in its next period where {:.0} nm are usual, mostly above {:.0} Hz)",
                d.file, d.unrepeatable_nm, d.usual_nm, d.above_hz
            )
        })
        .collect();
    (!each.is_empty()).then(|| format!("disturbances in {}", each.join(" and ")))
}
