//! Placeholder
/// hash
pub const SCHEMA_HASH: u32 = 1;
