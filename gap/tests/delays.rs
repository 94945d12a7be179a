//! Dead times and lags, from the truth generator, which shares no code with the catalogue.

use gap::diagnosis::Verdict;

mod common;

use common::{assert_explained, causes, drawn};

#[test]
fn a_dead_time_that_wanders_is_not_called_one() {
    let diagnosis = drawn(1414, 31, &["unknown"]);
    assert_eq!((diagnosis.verdict, causes(&diagnosis)), (Verdict::Unexplained, vec![]));
    assert!(diagnosis.looks_like.as_ref().is_some_and(|words| words.contains("drive-delay")));
    assert!(diagnosis.location.iter().all(|l| l.stage == "drive" && l.axis == 2));
}

#[test]
fn a_dead_time_is_one() {
    let diagnosis = drawn(1616, 91, &["drive-delay"]);
    assert_explained(&diagnosis, &[("drive-delay", &[3][..])]);
}

#[test]
fn a_dead_time_of_many_ticks_is_found_beside_friction() {
    let diagnosis = drawn(1616, 62, &["drive-delay", "friction"]);
    let mut named = causes(&diagnosis);
    named.sort_unstable();
    assert_eq!(named, [("drive-delay", &[2][..]), ("friction", &[2])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_lag_of_second_order_is_a_lag() {
    let diagnosis = drawn(1414, 50, &["sensor-bandwidth"]);
    assert_eq!(diagnosis.verdict, Verdict::Explained);
    assert_eq!(diagnosis.causes[0].effect, "sensor-bandwidth");
}
