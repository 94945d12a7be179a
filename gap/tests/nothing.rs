//! Where nothing is missing nothing is named, whatever integrator made the recordings. From the truth generator.

use gap::diagnosis::Verdict;

mod common;

use common::{causes, drawn};

/// A random binary drive: its edges are as large a part of a tick apart as the steps of the integrators.
#[test]
fn edges_are_no_mass() {
    let diagnosis = drawn(1818, 69, &[]);
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::NoGap, vec![]));
}

/// Interference that wanders on one axis; beside it a tenth of a nanometre on another.
#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_crumb_is_no_answer_to_a_gap_of_another_axis() {
    let diagnosis = drawn(1818, 27, &["unknown"]);
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Unexplained, vec![]));
}
