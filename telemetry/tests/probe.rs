//! The probe suite on the virtual board: a session folder that the other tools read, and a rig that is left as it was.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use flexstage::link::Deframer;
use flexstage::link::message::{self, Command, Reply};
use flexstage::{Flags, Settings};
use telemetry::probe::waveform::Waveform;
use telemetry::probe::{self, Experiment, Length, Mode, Phase};
use telemetry::transport::Transport;
use telemetry::virtual_board::{Options, Speed, VirtualBoard};
use telemetry::{Device, Error, Result, Target};

fn open() -> Device {
    Device::open(&Target::Virtual(Options { speed: Speed::Max, ..Options::default() })).unwrap()
}

fn quick() -> (probe::Options, Vec<Experiment>) {
    let options = probe::Options { length: Length::Quick, axes: vec![1], ..Default::default() };
    let plan = probe::plan(&options);
    (options, plan)
}

fn settings(device: &Device) -> Settings {
    let Reply::Settings(settings) = device.command(Command::ReadSettings).unwrap() else {
        panic!()
    };
    settings
}

#[test]
fn a_session_folder_comes_out_whole() {
    let device = open();
    let before = settings(&device);
    let (options, plan) = quick();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("session");
    let mut seen = Vec::new();
    let report = probe::run(
        &device,
        &plan,
        &options.axes,
        "handley-2002",
        &folder,
        &AtomicBool::new(false),
        &mut |p| seen.push(p.done_s),
    )
    .unwrap();
    assert_eq!((report.files.len(), report.lost_ticks), (plan.len(), 0));
    assert!(seen.windows(2).all(|w| w[1] >= w[0] - 0.5), "progress goes on");
    let session = recording::Session::read(&folder, None).unwrap();
    assert_eq!(session.recordings.len(), plan.len());
    for (entry, experiment) in session.recordings.iter().zip(&plan) {
        let r = &entry.recording;
        let name = &experiment.name;
        assert_eq!(&r.meta.experiment, name);
        // At full speed the host is late by some simulated time: longer than planned, never shorter.
        let seconds = r.span_ticks() as f64 / 1e4 - r.meta.settle_s;
        assert!(seconds >= experiment.duration_s - 1e-3, "{name}: {seconds} s");
        let high = r.drive_v[1].iter().copied().fold(f32::MIN, f32::max);
        let (_, planned) = experiment.range_v();
        assert!(
            (f64::from(high) - planned).abs() < 0.02 * planned + 0.5,
            "{name}: {high} {planned}"
        );
        // Single precision rounds; nothing else goes beyond what was asked for.
        assert!(f64::from(high) < options.max_v + 1e-3, "{name}: {high}");
        // The other axes stay where they are.
        assert!(r.drive_v[0].iter().all(|v| v.abs() < 2.0), "{name}");
    }
    assert_eq!(settings(&device), before, "settings are put back");
    let Reply::Status(status) = device.command(Command::Status).unwrap() else { panic!() };
    assert!(Flags(status.flags).is_parked());
}

#[test]
fn a_stop_parks_and_keeps_what_was_complete() {
    let device = open();
    let before = settings(&device);
    let (options, plan) = quick();
    let folder = tempfile::tempdir().unwrap();
    let stop = AtomicBool::new(false);
    let error = probe::run(&device, &plan, &options.axes, "", folder.path(), &stop, &mut |p| {
        if p.index == 2 {
            stop.store(true, Ordering::Release);
        }
    })
    .unwrap_err();
    assert!(matches!(error, Error::Stopped(_)), "{error}");
    let session = recording::Session::read(folder.path(), None).unwrap();
    assert_eq!(session.recordings.len(), 2);
    assert_eq!(settings(&device), before);
    let Reply::Status(status) = device.command(Command::Status).unwrap() else { panic!() };
    assert!(Flags(status.flags).is_parked());
}

/// The command that bytes for the board are.
fn command_in(bytes: &[u8]) -> Option<Command> {
    let mut deframer = Deframer::new();
    deframer.feed(bytes);
    message::decode_command(&deframer.next_frame()?).ok()
}

/// Notes the commands for the board; asks for a stop while the first waveform is on its way.
struct StopAtStaging {
    board: VirtualBoard,
    stop: Arc<AtomicBool>,
    sent: Arc<Mutex<Vec<Command>>>,
}

impl Transport for StopAtStaging {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<()> {
        if let Some(command) = command_in(bytes) {
            if matches!(command, Command::Stage { .. }) {
                self.stop.store(true, Ordering::Release);
            }
            self.sent.lock().unwrap().push(command);
        }
        self.board.send(bytes)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>> {
        self.board.receive(timeout)
    }
}

#[test]
fn a_stop_while_waveforms_are_staged_is_the_next_command() {
    let board = VirtualBoard::start(&Options { speed: Speed::Max, ..Options::default() }).unwrap();
    let (stop, sent) = (Arc::<AtomicBool>::default(), Arc::<Mutex<Vec<Command>>>::default());
    let transport = StopAtStaging { board, stop: stop.clone(), sent: sent.clone() };
    let device = Device::start(Box::new(transport)).unwrap();
    let options = probe::Options { length: Length::Quick, axes: vec![0, 1, 2], ..quick().0 };
    let plan = probe::plan(&options);
    let folder = tempfile::tempdir().unwrap();
    let error = probe::run(&device, &plan, &options.axes, "", folder.path(), &stop, &mut |_| {})
        .unwrap_err();
    assert!(matches!(error, Error::Stopped(_)), "{error}");
    let sent = sent.lock().unwrap().clone();
    let staged = sent.iter().position(|c| matches!(c, Command::Stage { .. })).unwrap();
    let next = sent[staged + 1..].iter().find(|c| !matches!(c, Command::KeepAlive));
    assert!(matches!(next, Some(Command::Disarm)), "{next:?}");
}

/// A board whose stream falls silent once a waveform has been started, though it still takes commands; and one that then takes no settings.
struct Silent {
    board: VirtualBoard,
    is_silent: bool,
    takes_settings: bool,
}

impl Transport for Silent {
    fn name(&self) -> String {
        self.board.name()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<()> {
        if let Some(command) = command_in(bytes) {
            self.is_silent |= matches!(command, Command::Start { .. });
            if self.is_silent && !self.takes_settings && matches!(command, Command::SetSettings(_))
            {
                return Ok(());
            }
        }
        self.board.send(bytes)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Vec<u8>>> {
        let received = self.board.receive(timeout)?;
        Ok(received.filter(|bytes| {
            let kind = flexstage::link::frame::decode(bytes).map(|frame| frame.kind);
            !(self.is_silent && kind == Ok(flexstage::link::Kind::Stream))
        }))
    }
}

#[test]
fn a_stream_that_falls_silent_leaves_no_settings_of_the_probe() {
    for takes_settings in [true, false] {
        let options = Options { speed: Speed::Max, ..Options::default() };
        let board = VirtualBoard::start(&options).unwrap();
        let transport = Silent { board, is_silent: false, takes_settings };
        let device = Device::start(Box::new(transport)).unwrap();
        let before = settings(&device);
        let (options, plan) = quick();
        let folder = tempfile::tempdir().unwrap();
        let stop = AtomicBool::new(false);
        let error =
            probe::run(&device, &plan, &options.axes, "", folder.path(), &stop, &mut |_| {})
                .unwrap_err()
                .to_string();
        assert!(error.contains("no samples for 3 s"), "{error}");
        let Reply::Status(status) = device.command(Command::Status).unwrap() else { panic!() };
        assert!(Flags(status.flags).is_parked());
        assert_eq!(settings(&device) == before, takes_settings);
        assert_eq!(error.contains("still has the probe's settings"), !takes_settings, "{error}");
    }
}

#[test]
fn a_folder_with_files_is_not_touched() {
    let device = open();
    let (options, plan) = quick();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("mine.txt"), "x").unwrap();
    let stop = AtomicBool::new(false);
    let error = probe::run(&device, &plan, &options.axes, "", folder.path(), &stop, &mut |_| {})
        .unwrap_err();
    assert!(error.to_string().contains("empty folder"), "{error}");
}

#[test]
fn nothing_between_recordings_goes_beyond_them() {
    // A stack remembers the farthest that it was driven. Edges of 4 V a tick: what a wave coasts on with would be tens of volts.
    let wave =
        Waveform::Square { low_v: 20.0, high_v: 40.0, frequency_hz: 700.0, slope_v_per_ms: 40.0 };
    let ramp = Waveform::Ramp { to_v: 30.0, duration_s: 0.1 };
    let phases = || {
        vec![
            Phase { at_s: 0.0, moves: vec![(1, ramp.clone())] },
            Phase { at_s: 0.15, moves: vec![(1, wave.clone())] },
        ]
    };
    let plan: Vec<Experiment> = (0..6)
        .map(|n| Experiment {
            name: format!("wave-{n}"),
            condition_v: 0.0,
            phases: phases(),
            duration_s: 0.3,
            period_s: None,
            table: None,
        })
        .collect();
    let device = open();
    let stream = device.subscribe();
    let mut recorded = 0.0_f32;
    let stop = AtomicBool::new(false);
    let mut take = |_, recording: recording::Recording| {
        recorded = recording.drive_v[1].iter().copied().fold(recorded, f32::max);
        Ok(())
    };
    probe::capture(&device, &plan, &[1], Mode::OpenLoop, &stop, &mut |_| (), &mut take).unwrap();
    drop(device);
    let of =
        |batch: telemetry::Batch| batch.samples.iter().map(|s| s.drive_v[1]).fold(0.0, f32::max);
    let farthest = stream.iter().map(of).fold(0.0, f32::max);
    assert!(recorded > 35.0 && farthest < recorded + 0.1, "{farthest} V, recorded {recorded} V");
}
