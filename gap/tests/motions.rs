//! A session compared with motions recalled from before gives to the bit what a fresh one gives.

mod common;

use gap::session::intake;
use gap::session::scene::{Channel, Scene, Wanted};
use host_sim::Place;
use host_sim::rig::Rig;

#[test]
fn recalled_motions_change_no_bit() {
    let rig = Rig::named("handley").expect("embedded rig");
    let session = common::session(&rig, |_, _, um| um);
    let scene = || Scene::new(&rig, intake::tracks(&rig, &session).expect("tracks").0);
    let every = |_: &Channel| true;
    let recalling = scene();
    let nominal = recalling.residuals_at(&rig, Wanted::ALL, every).expect("simulation");
    let (first, pair) = (Place::Axis(0), Place::Pair { on: 1, from: 2 });
    let changes = [
        ("sensor-gain", first, "ratio", 1.01),
        ("sensor-offset", Place::Axis(2), "offset_m", 2.0e-8),
        ("sensor-crosstalk", pair, "share", 0.01),
        ("drive-gain", first, "ratio", 0.99),
        ("stiffness-coupling", pair, "stiffness_n_per_m", 3.0e5),
        ("drive-crosstalk", pair, "share", 0.01),
        ("friction", first, "coulomb_n", 2.0),
    ];
    // Each change by itself, then on top of those before it: what is kept must not outlive what it depends on.
    let mut piled = rig.clone();
    for (effect, place, parameter, value) in changes {
        let mut alone = rig.clone();
        for changed in [&mut alone, &mut piled] {
            changed.set(effect, place, parameter, value).expect("a parameter of the catalogue");
            let fresh = scene().residuals(&[(changed, Wanted::ALL)], every).expect("simulation");
            let recalled = recalling.residuals_at(changed, Wanted::ALL, every).expect("simulation");
            assert!(recalled == fresh[0], "{effect}");
            assert!(recalled != nominal, "{effect} does something");
        }
    }
}
