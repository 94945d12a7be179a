//! Why a command changed nothing, and why a frame was no message: each says what to do.

use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::SCHEMA_HASH;
use crate::SettingsError;

/// Why a command changed nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// The frame is whole but no command of this schema.
    Malformed,
    /// A setting cannot be used.
    Settings(BadSetting),
    /// The controller refuses in its present state.
    Control(crate::Refusal),
    /// No such axis, field or table index.
    Range,
    /// Only while the outputs are parked.
    NotParked,
    /// Only while the loop is open.
    Armed,
    /// The board is still busy with an earlier command, or a [`Command::Disarm`](super::Command::Disarm) that came after this one has acted already.
    Busy,
    /// Flash could not be written; the old settings are still whole.
    Flash,
    /// The converter self-test failed at the restart, or the ticks do not run.
    NotReady,
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Malformed => "the board does not understand the command",
            Self::Settings(bad) => return core::fmt::Display::fmt(bad, f),
            Self::Control(refusal) => refusal.describe(),
            Self::Range => "there is no such axis, field or table index",
            Self::NotParked => {
                "only while the outputs are parked: disarm and wait until the drives have returned"
            }
            Self::Armed => "only while the loop is open: disarm first",
            Self::Busy => "the board is busy with an earlier command: try again",
            Self::Flash => "flash could not be written; the settings saved before are still whole",
            Self::NotReady => {
                "the converters failed their self-test or do not run: see the self-test bits of the identity"
            }
        })
    }
}
impl core::error::Error for Refusal {}

/// A [`SettingsError`] that can travel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BadSetting {
    /// Part of the settings.
    pub group: String<32>,
    /// Name of the setting.
    pub field: String<32>,
    /// Axis, from 1.
    pub axis: Option<u8>,
    /// Unit or meaning of the range.
    pub unit: String<40>,
    /// Smallest value allowed.
    pub min: f32,
    /// Largest value allowed.
    pub max: f32,
    /// What was found.
    pub found: f32,
}

/// As much of the text as fits.
fn cut<const N: usize>(text: &str) -> String<N> {
    let mut out = String::new();
    for c in text.chars() {
        if out.push(c).is_err() {
            break;
        }
    }
    out
}

impl From<SettingsError> for BadSetting {
    fn from(error: SettingsError) -> Self {
        Self {
            group: cut(error.group),
            field: cut(error.field),
            axis: error.axis,
            unit: cut(error.unit),
            min: error.min,
            max: error.max,
            found: error.found,
        }
    }
}

impl core::fmt::Display for BadSetting {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if let Some(axis) = self.axis {
            write!(f, "axis {axis}: ")?;
        }
        let Self { group, field, unit, min, max, found, .. } = self;
        write!(f, "{group}.{field} must be {min} to {max} {unit}, found {found}")
    }
}

/// Why a good frame is not the message that was expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageError {
    /// The sender was built from other definitions; only identities can be exchanged with it.
    Schema {
        /// Its schema hash.
        found: u32,
    },
    /// The frame carries something else.
    Kind,
    /// The payload does not decode, or has bytes left over.
    Payload,
}

impl core::fmt::Display for MessageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Schema { found } => write!(
                f,
                "the other side speaks message schema {found:08x}, this one {SCHEMA_HASH:08x}: build both from the same source"
            ),
            Self::Kind => f.write_str("the frame carries another kind of message"),
            Self::Payload => f.write_str("the payload of the frame does not decode"),
        }
    }
}
impl core::error::Error for MessageError {}
