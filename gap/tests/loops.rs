//! Loops of other laws than the fit's: Bouc and Wen's, and one of many one-sided plays, from the truth generator, which shares no code with
//! the catalogue. And what a loop of eight numbers could pass for.

mod common;

/// Causes that are found in a case of the truth generator, and the share of the gap that they close.
fn found(seed: u64, index: u64, of: &str) -> (Vec<(String, Vec<usize>)>, f64) {
    let diagnosis = common::drawn(seed, index, of);
    let causes = diagnosis.causes.iter().map(|c| (c.effect.clone(), c.axes.clone()));
    (causes.collect(), diagnosis.gap.closed)
}

#[test]
fn a_loop_of_bouc_and_wens_is_a_loop() {
    let (causes, closed) = found(1010, 113, "hysteresis-shape");
    assert_eq!(causes, [("hysteresis-shape".into(), vec![3])]);
    assert!(closed > 0.98, "{closed}");
}

#[test]
fn a_loop_of_one_sided_plays_is_a_loop() {
    let (causes, closed) = found(1010, 101, "hysteresis-shape");
    assert_eq!(causes, [("hysteresis-shape".into(), vec![1])]);
    assert!(closed > 0.98, "{closed}");
}

#[test]
fn half_a_per_cent_of_gain_is_no_loop() {
    let (causes, _) = found(1414, 13, "piezo-gain");
    assert_eq!(causes[0], ("piezo-gain".into(), vec![2, 3]));
    assert!(causes.iter().all(|(effect, _)| effect != "hysteresis-shape"), "{causes:?}");
}
