//! Measured recordings (data/real): what the diagnosis says of the fine steering mirror.

use gap::Options;
use gap::diagnosis::Verdict;
use host_sim::rig::Rig;
use recording::Session;

/// Somebody who believes in three independent axes must be told that they are not: below 200 Hz cross terms take the error
/// from 86 % to 15 % of the motion (notes/gap.md, section 5), that is the gap to less than a fifth; above, resonances that
/// nobody modelled hide it.
#[test]
fn the_mirror_is_mixed_across_axes() {
    let Some(data) = shared_data::find("data/real/fsm") else { return };
    let Some(rig) = shared_data::find("rigs/fsm-independent.toml") else { return };
    let rig = Rig::load(&rig).expect("rig file");
    let session = Session::read(&data, None).expect("session");
    let outcome = gap::diagnose(&rig, &session, &Options::default()).expect("diagnosis");
    let d = &outcome.diagnosis;
    let line = gap::sentence(d);
    println!("{line}");
    assert_eq!(d.verdict, Verdict::PartlyExplained, "{line}");
    let first = d.causes.first().expect("a cause");
    assert!(first.effect.ends_with("-crosstalk") || first.effect.ends_with("-coupling"), "{line}");
    assert_eq!(first.axes, [1, 2, 3]);
    let band = d.band.as_ref().expect("a band");
    assert!(band.below_hz <= 200.0 && band.after_nm < band.before_nm / 5.0, "{line}");
}
