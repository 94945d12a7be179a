//! Recordings that lie far apart on the session's clock: as quick as others, and the same answer.

use std::sync::mpsc;
use std::time::Duration;

use gap::{Options, diagnose};
use host_sim::rig::Rig;
use recording::Session;

mod common;

use common::{causes, session_of, squares};

/// A gauge that reads too much under squares, whose edges leave lines in the spectrum.
fn squares_on_a_wrong_gauge() -> Session {
    let rig = Rig::named("handley").expect("rig");
    session_of(&rig, squares, |axis, _, um| if axis == 0 { 1.04 * um } else { um })
}

#[test]
fn a_month_later() {
    let rig = Rig::named("handley").expect("rig");
    let answer = |session: &Session| {
        let outcome = diagnose(&rig, session, &Options::default()).expect("answer");
        format!("{:?}", causes(&outcome.diagnosis))
    };
    let session = squares_on_a_wrong_gauge();
    let usual = answer(&session);
    assert!(usual.contains("sensor-gain"), "{usual}");
    let (told, tells) = mpsc::channel();
    std::thread::spawn(move || {
        let mut session = session;
        for later_s in [86_400.0, 2.6e6, 1.0e12] {
            session.recordings[4].recording.meta.start_s = later_s;
            let rig = Rig::named("handley").expect("rig");
            let outcome = diagnose(&rig, &session, &Options::default()).expect("answer");
            let causes = format!("{:?}", causes(&outcome.diagnosis));
            told.send((later_s, causes)).expect("sent");
        }
    });
    // The usual one takes a second.
    for _ in 0..3 {
        let (later_s, causes) =
            tells.recv_timeout(Duration::from_secs(120)).expect("no search without an end");
        assert_eq!(causes, usual, "{later_s} s");
    }
}
