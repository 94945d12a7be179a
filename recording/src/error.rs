//! Errors for people: which file, which column or key, what was expected, what was found. One line each.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    // The system's error is in the line itself, not behind it as a source: it would be printed twice.
    #[error("{}: cannot {action}: {}", path.display(), in_words(cause))]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What was tried, to follow "cannot".
        action: &'static str,
        /// What the system said.
        cause: io::Error,
    },
    /// The file is there, but what it holds cannot be used.
    #[error("{}: {what}", path.display())]
    Invalid {
        /// File or folder.
        path: PathBuf,
        /// Column or key, what was expected and what was found.
        what: String,
    },
}

/// `Result` with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub(crate) fn invalid(path: &Path, what: impl Display) -> Self {
        // Messages of libraries may span lines; ours are one line.
        let what = what.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        Self::Invalid { path: path.into(), what }
    }

    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |cause| Self::Io { path, action, cause }
    }
}

/// What the system says, for people; its own words where it is none of the usual ones.
fn in_words(error: &io::Error) -> String {
    let words = match error.kind() {
        io::ErrorKind::NotFound => "there is no such file or folder",
        io::ErrorKind::IsADirectory => "expected a file, found a folder",
        io::ErrorKind::NotADirectory => "this is a file, expected a folder of recordings",
        io::ErrorKind::PermissionDenied => "not allowed",
        io::ErrorKind::StorageFull => "the disk is full",
        _ => return error.to_string(),
    };
    words.to_owned()
}
