//! Loops of other laws than the fit's: Bouc and Wen's, and one of many one-sided plays, from the truth generator, which shares no code with
//! the catalogue. And what a loop of eight numbers could pass for.

mod common;

use common::{assert_explained, causes, drawn};

#[test]
fn a_loop_of_bouc_and_wens_is_a_loop() {
    let diagnosis = drawn(1010, 113, &["hysteresis-shape"]);
    assert_eq!(causes(&diagnosis), [("hysteresis-shape", &[3][..])]);
    assert!(diagnosis.gap.closed > 0.98, "{}", diagnosis.gap.closed);
}

#[test]
fn a_loop_of_one_sided_plays_is_a_loop() {
    let diagnosis = drawn(1010, 101, &["hysteresis-shape"]);
    assert_eq!(causes(&diagnosis), [("hysteresis-shape", &[1][..])]);
    assert!(diagnosis.gap.closed > 0.98, "{}", diagnosis.gap.closed);
}

#[test]
fn half_a_per_cent_of_gain_is_no_loop() {
    let diagnosis = drawn(1414, 13, &["piezo-gain"]);
    let causes = causes(&diagnosis);
    assert_eq!(causes[0], ("piezo-gain", &[2, 3][..]));
    assert!(causes.iter().all(|(effect, _)| *effect != "hysteresis-shape"), "{causes:?}");
}

#[test]
fn a_loop_is_one_beside_what_other_axes_have() {
    let diagnosis = drawn(1616, 9, &["hysteresis-shape", "sensor-crosstalk"]);
    let named = [("hysteresis-shape", &[1][..]), ("sensor-crosstalk", &[2, 3])];
    assert_eq!(causes(&diagnosis), named);
}

#[test]
fn a_loop_of_another_law_is_one_beside_a_slow_gauge() {
    // Two effects with a plain loop leave what a third one would make up for, and friction does about as well as the gauge.
    let diagnosis = drawn(18181, 1, &["sensor-bandwidth", "hysteresis-shape"]);
    let named = [("sensor-bandwidth", &[1][..]), ("hysteresis-shape", &[1, 2, 3])];
    assert_eq!(causes(&diagnosis), named);
}

#[test]
fn a_memory_that_small_cycles_wear_off_is_a_loop() {
    // Bouc and Wen's law slides back with every small cycle: a plain loop accounts for an eighth of that, and nothing else for more than a third.
    let diagnosis = drawn(28282, 27, &["hysteresis-shape"]);
    assert_explained(&diagnosis, &[("hysteresis-shape", &[2][..])]);
    assert!(diagnosis.gap.closed > 0.98, "{}", diagnosis.gap.closed);
}
