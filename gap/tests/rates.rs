//! Loops that widen with the rate, of the truth generator, in sessions that had been answered with other effects beside them.

use gap::diagnosis::Verdict;

mod common;

use common::{causes, drawn};

#[test]
fn a_loop_that_widens_with_the_rate_needs_nothing_beside_it() {
    // The charge goes farthest where the current turns, which takes less than a tick.
    for (seed, case, axes) in [(10101, 19, &[2][..]), (11111, 0, &[2]), (10101, 110, &[1])] {
        let diagnosis = drawn(seed, case, &["hysteresis-rate"]);
        let named = vec![("hysteresis-rate", axes)];
        assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Explained, named));
    }
}

#[test]
fn a_loss_that_goes_with_a_root_of_the_current_is_found_on_every_axis() {
    // The screen likes a loss of strain better, from which no fit gets there.
    let diagnosis = drawn(11111, 106, &["hysteresis-rate"]);
    let named = vec![("hysteresis-rate", &[1, 2, 3][..])];
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Explained, named));
    assert!(diagnosis.gap.closed > 0.985, "{}", diagnosis.gap.closed);
}

#[test]
fn a_loss_that_goes_with_a_root_of_the_current_is_found_from_afar() {
    // A loss of strain leaves a quarter of this gap, relaxation with friction a hundredth.
    let diagnosis = drawn(14141, 85, &["hysteresis-rate"]);
    let named = vec![("hysteresis-rate", &[2][..])];
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Explained, named));
    assert!(diagnosis.gap.closed > 0.99, "{}", diagnosis.gap.closed);
}
