//! Where an unknown fault lies: a reading that jumps faster than the stage can travel is the gauge's, anything else is not.

mod common;

use common::session;
use gap::Options;
use gap::diagnosis::Verdict;
use host_sim::rig::Rig;
use recording::Session;

fn located(rig: &Rig, session: &Session, exclude: Vec<String>) -> (Verdict, usize, String) {
    let options = Options { exclude, ..Options::default() };
    let d = gap::diagnose(rig, session, &options).expect("diagnosis").diagnosis;
    let place = d.location.first().expect("a place");
    (d.verdict, place.axis, place.stage.clone())
}

#[test]
fn a_reading_that_drops_out_is_the_gauge() {
    let rig = Rig::named("handley").expect("built in");
    // A loose contact: three samples at seven tenths of the reading, some nine times a second.
    let loose = |axis: usize, row: usize, um: f64| {
        if axis == 1 && row % 1_130 < 3 { 0.7 * um } else { um }
    };
    let (verdict, axis, stage) = located(&rig, &session(&rig, loose), Vec::new());
    assert_eq!((verdict, axis, stage.as_str()), (Verdict::Unexplained, 2, "sensor"));
}

#[test]
fn a_stage_that_moves_otherwise_is_not() {
    let rig = Rig::named("handley").expect("built in");
    let mut other = rig.clone();
    other.axes[1].mechanism.stiffness_n_per_m *= 1.5;
    let everything: Vec<String> =
        host_sim::effects::catalogue().iter().map(|e| e.info().name.to_string()).collect();
    let session = session(&other, |_, _, um| um);
    let (verdict, axis, stage) = located(&rig, &session, everything);
    assert_eq!((verdict, axis), (Verdict::Unexplained, 2));
    assert_ne!(stage, "sensor");
}
