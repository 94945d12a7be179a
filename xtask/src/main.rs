//! What a person or CI runs: firmware, emulate, test, bench.
fn main() {}
