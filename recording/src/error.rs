//! Errors for people: which file, which column or key, what was expected, what was found. One line each.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What was tried, to follow "cannot".
        action: &'static str,
        /// What the system said.
        source: io::Error,
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
        move |source| Self::Io { path, action, source }
    }
}
