//! Where tests find the recordings that are not in the repository.
//!
//! Measured and simulated recordings lie beside a checkout, in `../shared`, or where the environment variable
//! `FLEXSTAGE_SHARED` says. Most people do not have them: a test that needs them then says in one line that it was
//! skipped. Continuous integration (`CI=true`) has them, and there a skipped test is a failed one.

use std::path::{Path, PathBuf};

/// The folder of the shared data, if there is one.
pub fn root() -> Option<PathBuf> {
    let folder = match std::env::var_os("FLEXSTAGE_SHARED") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
    };
    folder.is_dir().then_some(folder)
}

/// The file or folder `path` below the shared data, e.g. `data/open/o1`; `None` when a test has to be skipped.
///
/// # Panics
/// Where `CI=true` and the data is missing, so that nothing is skipped unseen.
pub fn find(path: &str) -> Option<PathBuf> {
    if let Some(found) = root().map(|root| root.join(path)).filter(|found| found.exists()) {
        return Some(found);
    }
    skip(&format!("{path} is not in ../shared nor in the folder that FLEXSTAGE_SHARED names"));
    None
}

/// Say that a test is skipped and why.
///
/// # Panics
/// Where `CI=true`.
pub fn skip(why: &str) {
    let in_ci = std::env::var("CI").is_ok_and(|value| value == "true");
    assert!(!in_ci, "not to be skipped in CI: {why}");
    // Past the test harness's capture, so that the line is seen without --nocapture.
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {why}");
}
