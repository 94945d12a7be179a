//! What is promised has to be measured where there is something to close.

use gap::diagnosis::Role;

mod common;

use common::{assert_explained, drawn};

/// A limit of the current that squares reach, a step hardly, and nothing else.
#[test]
fn a_gap_of_one_recording_is_checked_on_a_part_of_it() {
    let diagnosis = drawn(1616, 75, &["amplifier-current-limit"]);
    assert_explained(&diagnosis, &[("amplifier-current-limit", &[1, 2, 3][..])]);
    assert!(diagnosis.gap.closed > 0.95, "{:?}", diagnosis.gap);
    assert!(diagnosis.gap.before_nm > 10.0 * diagnosis.gap.floor_nm, "{:?}", diagnosis.gap);
    assert!(diagnosis.recordings.iter().all(|r| r.role == Role::Fit));
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn an_axis_whose_gap_is_in_one_recording_held_out_is_looked_at_again() {
    // Another axis has the same limit, and shows it in a recording that is fitted.
    let diagnosis = drawn(12121, 69, &["amplifier-current-limit"]);
    assert_explained(&diagnosis, &[("amplifier-current-limit", &[1, 2][..])]);
}
