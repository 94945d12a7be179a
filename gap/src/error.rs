//! What makes a session unusable. Every message is one line: which file or field, what was expected, what to do.

/// A session or rig that cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The recordings do not fit the rig.
    #[error("{file}: {message}")]
    Recording {
        /// Recording at fault.
        file: String,
        /// What is wrong with it.
        message: String,
    },
    /// The session as a whole cannot be used.
    #[error("session: {0}")]
    Session(String),
    /// The rig cannot be simulated.
    #[error("{0}")]
    Rig(String),
}
