//! A recording as the rig would have made it.

use std::path::Path;

use host_sim::platform::{PlatformRig, free_return};
use recording::Recording;

use super::data::{PlatformDataError, free_return_of};

/// The recording with `position_um_1` as the rig returns from the recording's `initial_position_um`; ticks and metadata are
/// those recorded. No noise is added. `file` is what an error calls the recording.
pub fn replay(
    rig: &PlatformRig,
    recording: &Recording,
    file: &Path,
) -> Result<Recording, PlatformDataError> {
    let (initial_m, time_s) = free_return_of(recording, file)?;
    if recording.axes() > 1 {
        return Err(PlatformDataError {
            file: file.display().to_string(),
            message: format!("a platform has one axis, found columns of {} axes", recording.axes()),
        });
    }
    let position =
        free_return(rig, initial_m, &time_s, recording.meta.start_s).map_err(|error| {
            PlatformDataError { file: file.display().to_string(), message: error.to_string() }
        })?;
    let mut predicted = recording.clone();
    predicted.position_um = vec![Some(position.iter().map(|m| (m * 1e6) as f32).collect())];
    Ok(predicted)
}
