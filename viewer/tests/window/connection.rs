//! A board that is unplugged and comes back, one that somebody else has, one of another version.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use flexstage::link::{Deframer, Identity, Kind, MAX_FRAME, encode};
use telemetry::transport::Transport;
use telemetry::virtual_board::{Options, VirtualBoard};
use telemetry::{Device, Target, serve};
use viewer::Source;

use crate::common::{Window, click, shows, until, window_of};

/// A board on a socket, until it is dropped: the cable.
struct Cable {
    address: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Cable {
    fn plug(board: impl Transport + 'static, address: &str) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (tell, ready) = mpsc::channel();
        let (flag, address) = (stop.clone(), address.to_owned());
        let thread = std::thread::spawn(move || {
            serve::serve(Box::new(board), &address, &flag, &mut |event| {
                if let serve::Event::Listening(address) = event {
                    let _ = tell.send(address);
                }
            })
            .unwrap();
        });
        let address = ready.recv_timeout(Duration::from_secs(20)).unwrap();
        Self { address, stop, thread: Some(thread) }
    }

    fn target(&self) -> Target {
        Target::Socket(self.address.clone())
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn board() -> VirtualBoard {
    VirtualBoard::start(&Options::default()).unwrap()
}

/// Samples in memory.
fn samples(harness: &Window) -> u64 {
    let (first, end) = harness.state().link().history().ticks();
    end - first
}

#[test]
fn an_unplugged_board_is_missed_and_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let cable = Cable::plug(board(), "127.0.0.1:0");
    let mut harness = window_of(Source::Board(cable.target()), folder.path());
    until(&mut harness, "samples", |h| samples(h) > 1000);
    click(&mut harness, "Record (R)");
    until(&mut harness, "half a second on disk", |h| {
        h.state().link().recording().is_some_and(|r| r.seconds > 0.5)
    });
    let address = cable.address.clone();
    drop(cable);
    until(&mut harness, "the loss", |h| !h.state().link().is_connected());
    // The recording is whole up to there, and a sentence says so.
    until(&mut harness, "the end of the recording", |h| h.state().link().recorded().is_some());
    let kept =
        recording::Recording::read(&harness.state().link().recorded().unwrap().path).unwrap();
    assert!(kept.len() > 4000, "{}", kept.len());
    until(&mut harness, "words about it", |h| shows(h, "cannot connect") || shows(h, "was lost"));
    assert!(samples(&harness) > 1000, "the picture stays");
    assert!(shows(&harness, "no connection"), "the last state is not shown as the present one");
    let _cable = Cable::plug(board(), &address);
    until(&mut harness, "the board again", |h| h.state().link().is_connected());
    until(&mut harness, "fresh samples", |h| {
        h.state().link().history().last().is_some_and(|s| s.tick < 100_000)
    });
}

#[test]
fn a_board_in_use_is_named_and_taken_when_it_is_free() {
    let folder = tempfile::tempdir().unwrap();
    let cable = Cable::plug(board(), "127.0.0.1:0");
    let somebody = Device::open(&cable.target()).unwrap();
    let mut harness = window_of(Source::Board(cable.target()), folder.path());
    until(&mut harness, "the refusal", |h| shows(h, "in use by another program"));
    somebody.close();
    until(&mut harness, "the board", |h| h.state().link().is_connected());
}

/// A board whose firmware was built from other message definitions.
struct Other {
    board: VirtualBoard,
    deframer: Box<Deframer>,
}

impl Transport for Other {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> telemetry::Result<()> {
        self.board.send(bytes)
    }

    fn receive(&mut self, timeout: Duration) -> telemetry::Result<Option<Vec<u8>>> {
        let Some(bytes) = self.board.receive(timeout)? else { return Ok(None) };
        let mut out = Vec::new();
        self.deframer.push(&bytes, |frame| {
            let mut payload = frame.payload.to_vec();
            if frame.kind == Kind::Identity
                && let Some(mut identity) = Identity::from_bytes(&payload)
            {
                identity.schema ^= 1;
                identity.firmware = [9, 8, 7];
                payload = identity.to_bytes().to_vec();
            }
            let mut buffer = [0; MAX_FRAME];
            out.extend(encode(&mut buffer, frame.kind, frame.sequence, &payload).unwrap());
        });
        Ok(Some(out))
    }
}

#[test]
fn firmware_of_another_version_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let other = Other { board: board(), deframer: Box::default() };
    let cable = Cable::plug(other, "127.0.0.1:0");
    let mut harness = window_of(Source::Board(cable.target()), folder.path());
    until(&mut harness, "the refusal", |h| shows(h, "firmware 9.8.7"));
    assert!(shows(&harness, "flexstage flash"));
    assert!(!harness.state().link().is_connected());
}
