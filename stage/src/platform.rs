//! `identify` for rigs of `kind = "platform"` (second paper).

use std::path::Path;

use anyhow::bail;
use host_sim::platform::PlatformRig;
use recording::{Recording, Session};

use crate::diagnose::write_all;
use crate::say::say;

/// A free return of a platform says nothing about a stage, whatever its columns: refuse it.
pub fn refuse_free_return(recording: &Recording, file: &Path) -> anyhow::Result<()> {
    if recording.meta.initial_position_um.is_some() {
        bail!(
            "{}: a free return of a platform (its metadata has initial_position_um), but the rig is a stage: expected a \
             rig of kind = \"platform\"",
            file.display()
        );
    }
    Ok(())
}

/// `flexstage identify` for a platform, into a file of a folder.
pub fn identify(
    rig: &PlatformRig,
    session: &Session,
    folder: &Path,
    name: &str,
) -> anyhow::Result<()> {
    let found = gap::platform::identify(rig, session)?;
    write_all(folder, &[(name, found.rig.to_toml())])?;
    for line in &found.lines {
        say!("{line}")?;
    }
    Ok(())
}
