//! Loops that widen with the rate, of the truth generator, in sessions that had been answered with other effects beside them.

mod common;

use common::{assert_explained, drawn};

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_loop_that_widens_with_the_rate_needs_nothing_beside_it() {
    // The charge goes farthest where the current turns, which takes less than a tick.
    for (seed, case, axes) in [(10101, 19, &[2][..]), (11111, 0, &[2]), (10101, 110, &[1])] {
        let diagnosis = drawn(seed, case, &["hysteresis-rate"]);
        assert_explained(&diagnosis, &[("hysteresis-rate", axes)]);
    }
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_loss_that_goes_with_a_root_of_the_current_is_found_on_every_axis() {
    // The screen likes a loss of strain better, from which no fit gets there.
    let diagnosis = drawn(11111, 106, &["hysteresis-rate"]);
    assert_explained(&diagnosis, &[("hysteresis-rate", &[1, 2, 3][..])]);
    assert!(diagnosis.gap.closed > 0.985, "{}", diagnosis.gap.closed);
}

#[test]
fn a_loss_that_goes_with_a_root_of_the_current_is_found_from_afar() {
    // A loss of strain leaves a quarter of this gap, relaxation with friction a hundredth.
    let diagnosis = drawn(14141, 85, &["hysteresis-rate"]);
    assert_explained(&diagnosis, &[("hysteresis-rate", &[2][..])]);
    assert!(diagnosis.gap.closed > 0.99, "{}", diagnosis.gap.closed);
}
