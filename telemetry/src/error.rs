//! What can go wrong between host and board, in words that say what to do.

use std::time::Duration;

/// Error of the link, the session or a tool on top of it. Displays as one line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No board answers to the selection.
    #[error("no board found{}: plug one in, check its cable and (on Linux) the udev rule in contrib/, or use --virtual", selected(.serial))]
    NoBoard {
        /// Serial number that was asked for.
        serial: Option<String>,
    },
    /// More than one board and no selection.
    #[error("{} boards are connected ({}): choose one with --serial", .serials.len(), .serials.join(", "))]
    ManyBoards {
        /// Their serial numbers.
        serials: Vec<String>,
    },
    /// The operating system does not let us open it.
    #[error(
        "the board {serial} cannot be opened ({reason}): on Linux install contrib/60-flexstage.rules (see docs/viewer.md) and plug the board in again"
    )]
    NotAllowed {
        /// Serial number.
        serial: String,
        /// What the system said.
        reason: String,
    },
    /// Another program holds it.
    #[error(
        "{board} is in use by another program: close the other flexstage window or command first"
    )]
    Busy {
        /// Which board.
        board: String,
    },
    /// The connection broke.
    #[error("the connection to {board} was lost: {reason}")]
    Lost {
        /// Which board.
        board: String,
        /// Why.
        reason: String,
    },
    /// The address cannot be reached.
    #[error(
        "cannot connect to {address}: {reason}; expected a board there, emulated with `cargo xtask emulate --listen {address}` or offered with `flexstage serve --listen {address}`"
    )]
    Connect {
        /// Address.
        address: String,
        /// What the system said.
        reason: String,
    },
    /// What answers is no flexstage board, or says nothing.
    #[error("{board} does not identify itself as a flexstage controller ({reason})")]
    NotFlexstage {
        /// Which board.
        board: String,
        /// What was found.
        reason: String,
    },
    /// Firmware of another version.
    #[error(
        "{board} runs firmware {firmware} with message schema {found:08x}, this program speaks {expected:08x}: \
         flash the firmware of this version (`flexstage flash`) or use the flexstage of that firmware"
    )]
    Version {
        /// Which board.
        board: String,
        /// Firmware version on it.
        firmware: String,
        /// Schema on the board.
        found: u32,
        /// Schema of this program.
        expected: u32,
    },
    /// No answer to a command.
    #[error("no answer to `{command}` within {} ms: the board is busy, stuck or gone", .after.as_millis())]
    Timeout {
        /// The command.
        command: String,
        /// How long it was waited for.
        after: Duration,
    },
    /// The board refused a command.
    #[error("the board refused `{command}`: {reason}")]
    Refused {
        /// The command.
        command: String,
        /// Why.
        reason: String,
    },
    /// A value that was checked before sending.
    #[error("{0}")]
    Invalid(String),
    /// What was to be driven lies beyond the limits of the board.
    #[error("{0}")]
    Beyond(String),
    /// A fault of the controller during an experiment.
    #[error("the controller stopped with a fault: {0}")]
    Fault(String),
    /// A person stopped it.
    #[error("stopped: {0}")]
    Stopped(String),
    /// Reading or writing a recording.
    #[error(transparent)]
    Recording(#[from] recording::Error),
    /// Anything of the file system.
    #[error("{path}: {source}")]
    File {
        /// File or folder.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The simulated rig cannot be used.
    #[error("{0}")]
    Rig(String),
}

fn selected(serial: &Option<String>) -> String {
    serial.as_ref().map(|s| format!(" with serial number {s}")).unwrap_or_default()
}

/// Result of the telemetry crate.
pub type Result<T> = std::result::Result<T, Error>;
