//! Files that a command will write, tried before its work: a measurement or applied settings are not to end in a path that cannot be.

use std::path::Path;

use anyhow::{Context, bail};

/// A file in a folder that is there.
pub fn file(path: &Path) -> anyhow::Result<()> {
    recording::check_target(path)?;
    takes_files(parent(path), path)
}

/// A file whose folders are made with it.
pub fn file_in_new_folders(path: &Path) -> anyhow::Result<()> {
    recording::check_target(path)?;
    let mut folder = parent(path);
    while !folder.exists() && folder != parent(folder) {
        if folder.is_symlink() {
            let (path, name) = (path.display(), folder.display());
            bail!("{path}: cannot be written: expected a folder {name}, found a link to nothing");
        }
        folder = parent(folder);
    }
    takes_files(folder, path)
}

/// The folder that a file is in.
pub fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file without a name tells whether there is a folder, and whether it may be written to.
fn takes_files(folder: &Path, path: &Path) -> anyhow::Result<()> {
    let (path, name) = (path.display(), folder.display());
    if folder.exists() && !folder.is_dir() {
        bail!("{path}: cannot be written: expected a folder {name}, found a file");
    }
    if !folder.exists() {
        bail!("{path}: cannot be written: expected a folder {name}, found no such folder");
    }
    let tried = tempfile::tempfile_in(folder).map(drop);
    tried.with_context(|| {
        format!("{path}: cannot be written: expected a folder {name} that takes files")
    })
}
