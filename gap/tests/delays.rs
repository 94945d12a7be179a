//! A dead time that wanders is no dead time. From the truth generator, which shares no code with the catalogue.

use gap::diagnosis::Verdict;

mod common;

#[test]
fn a_dead_time_that_wanders_is_not_called_one() {
    let diagnosis = common::drawn(1414, 31, "unknown");
    assert_eq!(diagnosis.verdict, Verdict::Unexplained);
    assert!(diagnosis.causes.is_empty());
    assert!(diagnosis.looks_like.as_ref().is_some_and(|words| words.contains("drive-delay")));
    assert!(diagnosis.location.iter().all(|l| l.stage == "drive" && l.axis == 2));
}

#[test]
fn a_dead_time_is_one() {
    let diagnosis = common::drawn(1616, 91, "drive-delay");
    let causes: Vec<_> =
        diagnosis.causes.iter().map(|c| (c.effect.as_str(), &c.axes[..])).collect();
    assert_eq!(
        (diagnosis.verdict, &causes[..]),
        (Verdict::Explained, &[("drive-delay", &[3][..])][..])
    );
}

#[test]
fn a_lag_of_second_order_is_a_lag() {
    let diagnosis = common::drawn(1414, 50, "sensor-bandwidth");
    assert_eq!(diagnosis.verdict, Verdict::Explained);
    assert_eq!(diagnosis.causes[0].effect, "sensor-bandwidth");
}
