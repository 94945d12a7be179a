//! Compares answers with the key.
