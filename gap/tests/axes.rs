//! Effects on axes of their own, of the truth generator, beside others whose form leaves something there or takes them in.

mod common;

use common::{assert_explained, causes, drawn};

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_small_gain_beside_lags_is_no_relaxation() {
    // Relaxation on all axes takes in the gain on one of them but for next to nothing of the gap, with twice as many numbers.
    let diagnosis = drawn(24242, 44, &["sensor-bandwidth", "piezo-gain"]);
    assert_explained(&diagnosis, &[("sensor-bandwidth", &[1, 2, 3][..]), ("piezo-gain", &[1])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn what_trims_a_loop_of_another_rate_is_no_gain() {
    // A gain of two thousandths, the other way than on axis 2, takes a third of what the form of the loop leaves on axis 3.
    let diagnosis = drawn(24242, 114, &["piezo-gain", "hysteresis-rate"]);
    assert_explained(&diagnosis, &[("hysteresis-rate", &[3][..]), ("piezo-gain", &[2])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn friction_makes_up_for_the_law_of_a_loop_on_the_axis_of_the_loop_only() {
    let diagnosis = drawn(21212, 32, &["friction", "hysteresis-shape"]);
    assert_explained(&diagnosis, &[("friction", &[1][..]), ("hysteresis-shape", &[3])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_bent_gauge_is_told_from_a_loop_of_any_law_on_the_axis_beside_it() {
    // The loop closes as much of the axis of the gauge, with nine numbers for three.
    let diagnosis = drawn(21212, 39, &["sensor-nonlinearity", "hysteresis-shape"]);
    let mut named = causes(&diagnosis);
    named.sort_unstable();
    assert_eq!(named, [("hysteresis-shape", &[2][..]), ("sensor-nonlinearity", &[1])]);
}

#[test]
fn a_limit_of_two_amplifiers_is_named_on_the_third_that_hardly_reaches_it() {
    let diagnosis = drawn(24242, 100, &["amplifier-current-limit"]);
    assert_explained(&diagnosis, &[("amplifier-current-limit", &[1, 2, 3][..])]);
    let is_told = |note: &String| note.contains("Axis 1: amplifier-current-limit is named there");
    assert!(diagnosis.notes.iter().any(is_told), "{:?}", diagnosis.notes);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_swinging_part_of_all_axes_is_named_where_it_hardly_rings() {
    // On axis 3 it is a third of the noise beyond it, in recordings that are held out.
    let diagnosis = drawn(25252, 80, &["second-mass", "drive-offset"]);
    assert_explained(&diagnosis, &[("drive-offset", &[1][..]), ("second-mass", &[1, 2, 3])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn an_offset_of_all_gauges_is_named_beside_a_large_loop_as_well() {
    // The form of the loop leaves about as much on axis 1 as the offset takes off there, which is that of the other axes.
    let diagnosis = drawn(25252, 41, &["sensor-offset", "hysteresis-shape"]);
    let named = [("hysteresis-shape", &[1][..]), ("sensor-offset", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn what_integrators_differ_by_beside_creep_is_no_mass() {
    // A third of a gram takes 0.3 of the noise off the edges of squares, a thousandth of what the creep is.
    let diagnosis = drawn(25252, 39, &["creep"]);
    assert_explained(&diagnosis, &[("creep", &[1, 2, 3][..])]);
}

#[test]
fn springs_that_take_back_what_crosstalk_does_are_found_beside_it() {
    // Neither promises anything beside the other, and the springs close next to nothing alone.
    let diagnosis = drawn(26262, 92, &["drive-crosstalk", "stiffness-coupling"]);
    let named = [("drive-crosstalk", &[1, 2, 3][..]), ("stiffness-coupling", &[1, 2])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_drift_is_no_trim_of_a_mass_that_rings() {
    // Nineteen noises of drift are next to nothing of the cost beside a resonance that one sweep shows.
    let diagnosis = drawn(29292, 110, &["second-mass", "sensor-drift"]);
    let named = [("sensor-drift", &[1, 2, 3][..]), ("second-mass", &[1, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn creep_of_all_axes_is_told_beside_a_gain_on_one() {
    // Relaxation bends to both of them on axis 1, where creep alone does nothing.
    let diagnosis = drawn(31313, 9, &["creep", "sensor-gain"]);
    assert_explained(&diagnosis, &[("creep", &[1, 2, 3][..]), ("sensor-gain", &[1])]);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_lag_of_all_gauges_is_told_beside_a_stiff_axis() {
    // Relaxation of axis 1 leaves as little to a twelfth of what is left.
    let diagnosis = drawn(28282, 50, &["sensor-bandwidth", "stiffness"]);
    let named = [("stiffness", &[1][..]), ("sensor-bandwidth", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn springs_beside_preloads_are_not_called_crosstalk() {
    // Beside springs the preloads were first fitted from where they get stuck, and crosstalk was not.
    let diagnosis = drawn(27272, 13, &["stiffness-coupling", "preload-loss"]);
    let named = [("stiffness-coupling", &[2, 3][..]), ("preload-loss", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_lag_of_all_gauges_is_told_beside_a_loop_of_another_rate() {
    // An offset of axis 2 makes up for the lag that the loop takes in there, and no two of the three were tried on that axis.
    let diagnosis = drawn(33333, 114, &["sensor-bandwidth", "hysteresis-rate"]);
    let named = [("hysteresis-rate", &[2][..]), ("sensor-bandwidth", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn the_same_gain_of_two_gauges_is_no_trim_of_creep() {
    // Creep that is fitted again without the gain of axis 1 leaves two and a half times as much, and a loop of any law does as well as that.
    let diagnosis = drawn(33333, 25, &["creep", "sensor-gain"]);
    let named = [("sensor-gain", &[1, 2][..]), ("creep", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn an_offset_of_all_gauges_is_named_beside_a_preload_that_hides_it() {
    // The preload of axis 2 makes up for the whole offset there; with the one that the others have the recordings agree as well.
    let diagnosis = drawn(33333, 46, &["preload-loss", "sensor-offset"]);
    let named = [("sensor-offset", &[1, 2, 3][..]), ("preload-loss", &[2])];
    assert_explained(&diagnosis, &named);
    let is_told = |note: &String| note.contains("Axis 2: sensor-offset is named there");
    assert!(diagnosis.notes.iter().any(is_told), "{:?}", diagnosis.notes);
}

#[test]
fn a_limit_tells_nothing_of_an_axis_that_never_comes_to_it() {
    // Axis 1 agrees as well with the limit of the other two, as with any.
    let diagnosis = drawn(34343, 75, &["piezo-gain", "amplifier-current-limit"]);
    let named = [("amplifier-current-limit", &[2, 3][..]), ("piezo-gain", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn what_a_limit_leaves_on_edges_is_no_spring() {
    // With the capacitance of the way before an edge the limit was off by a quarter of a tick, which a spring of 200 N/m seemed to mend.
    let diagnosis = drawn(34343, 12, &["stiffness-coupling", "amplifier-current-limit"]);
    let named = [("stiffness-coupling", &[1, 2][..]), ("amplifier-current-limit", &[3])];
    assert_explained(&diagnosis, &named);
}

#[test]
#[ignore = "long: cargo xtask test --long"]
fn a_gain_of_all_stacks_is_told_beside_a_mass_that_swings_on_one() {
    // A loop makes up for the gain on the axis of the mass, and is not needed beside the gain that the others have.
    let diagnosis = drawn(34343, 36, &["second-mass", "piezo-gain"]);
    let named = [("second-mass", &[2][..]), ("piezo-gain", &[1, 2, 3])];
    assert_explained(&diagnosis, &named);
}
