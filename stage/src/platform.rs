//! `diagnose`, `identify` and `replay` for rigs of `kind = "platform"` (second paper).

use std::path::Path;

use anyhow::{Context, bail};
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

/// `flexstage diagnose` for a platform.
pub fn diagnose(rig: &PlatformRig, session: &Session, out: &Path) -> anyhow::Result<()> {
    let outcome = gap::platform::diagnose(rig, session)?;
    let mut json = serde_json::to_string_pretty(&outcome.diagnosis)?;
    json.push('\n');
    write_all(
        out,
        &[
            ("diagnosis.json", json),
            ("rig.toml", outcome.rig.to_toml()),
            ("report.html", outcome.report.to_html()),
        ],
    )?;
    say!("{}", gap::sentence(&outcome.diagnosis))?;
    say!("{}", out.join("report.html").display())?;
    Ok(())
}

/// `flexstage identify` for a platform.
pub fn identify(
    rig: &PlatformRig,
    session: &Path,
    sample_rate_hz: Option<f64>,
    out: &Path,
) -> anyhow::Result<()> {
    let session = Session::read(session, sample_rate_hz)?;
    let Some(name) = out.file_name().and_then(|name| name.to_str()) else {
        bail!("{}: expected a file name for the calibrated rig", out.display());
    };
    let found = gap::platform::identify(rig, &session)?;
    let folder = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    write_all(folder, &[(name, found.rig.to_toml())])?;
    for line in &found.lines {
        say!("{line}")?;
    }
    Ok(())
}

/// `flexstage replay` for a platform.
pub fn replay(
    rig: &PlatformRig,
    recording: &Recording,
    file: &Path,
    out: &Path,
) -> anyhow::Result<()> {
    let predicted = gap::platform::replay(rig, recording, file)?;
    predicted.write(out).with_context(|| "the simulated recording was not written")
}
