//! Files that appear together or not at all.

use std::fs::{self, File, Metadata};
use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::{Error, Result};

/// Files that are written beside their names first and get them all at once, and folders for them. Dropped without
/// [`Together::publish`] it leaves nothing behind, not even the folders.
#[derive(Default)]
pub struct Together {
    files: Vec<(NamedTempFile, PathBuf)>,
    /// Those that were not there before, the outermost first.
    folders: Vec<PathBuf>,
}

impl Together {
    /// Makes a folder and what is missing above it.
    pub fn folder(&mut self, folder: &Path) -> Result<()> {
        let missing: Vec<&Path> = folder
            .ancestors()
            .take_while(|above| !above.as_os_str().is_empty() && !above.exists())
            .collect();
        for folder in missing.into_iter().rev() {
            fs::create_dir(folder).map_err(Error::io(folder, "make the folder"))?;
            self.folders.push(folder.into());
        }
        if folder.is_dir() || folder.as_os_str().is_empty() {
            return Ok(());
        }
        Err(Error::invalid(folder, "expected a folder, found a file"))
    }

    /// Adds a file that `write` fills; its folder must be there.
    pub fn add(&mut self, path: &Path, write: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
        check_target(path)?;
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        let mut builder = tempfile::Builder::new();
        builder.prefix(".flexstage-").suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // tempfile makes private files; these are for everybody whom the folder admits.
            builder.permissions(fs::Permissions::from_mode(0o644));
        }
        let mut file = builder.tempfile_in(folder).map_err(Error::io(path, "write beside it"))?;
        write(file.as_file_mut())?;
        self.files.push((file, path.into()));
        Ok(())
    }

    /// Adds a file of text.
    pub fn add_text(&mut self, path: &Path, text: &str) -> Result<()> {
        self.add(path, |file| {
            file.write_all(text.as_bytes())
                .and_then(|()| file.sync_all())
                .map_err(Error::io(path, "write"))
        })
    }

    /// Gives all files their names.
    pub fn publish(mut self) -> Result<()> {
        let mut new = Vec::new();
        for (file, path) in self.files.drain(..) {
            let was_there = path.exists();
            // The targets were checked, so this fails only where the folder changed meanwhile or the disk is at fault.
            if let Err(error) = check_target(&path).and_then(|()| {
                file.persist(&path).map_err(|error| Error::io(&path, "write")(error.error))
            }) {
                for path in new {
                    let _ = fs::remove_file(path);
                }
                return Err(error);
            }
            if !was_there {
                new.push(path);
            }
        }
        self.folders.clear();
        Ok(())
    }
}

impl Drop for Together {
    fn drop(&mut self) {
        self.files.clear();
        for folder in self.folders.iter().rev() {
            // Fails, as it should, where somebody else put something into it.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Whether a file can be written under this name: nothing is there yet, or a file that may be replaced. A device must not be: as
/// root its node would be gone.
pub fn check_target(path: &Path) -> Result<()> {
    let what = |found: &Metadata| {
        if found.is_dir() {
            "expected a file, found a folder"
        } else {
            "expected a file, found a device or pipe"
        }
    };
    match fs::metadata(path) {
        Ok(found) if !found.is_file() => {
            Err(Error::invalid(path, format!("cannot write: {}", what(&found))))
        }
        _ if path.file_name().is_none() => Err(Error::invalid(path, "expected the name of a file")),
        _ => Ok(()),
    }
}
