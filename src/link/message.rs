//! Commands and replies, postcard-encoded.

use super::stream::{Fields, Profile};
use postcard_schema::key::Key;

/// What the messages and the layout of the samples are made of, in 32 bits. Any change of either changes it.
pub const SCHEMA_HASH: u32 = {
    let [a, b, c, d, ..] = Key::for_path::<(Fields, Profile)>("flexstage samples 1").to_bytes();
    u32::from_le_bytes([a, b, c, d])
};
