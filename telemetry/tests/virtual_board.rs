//! A whole session against the virtual board: identify, stream without loss, refuse, arm, move, save, restart.

use std::time::{Duration, Instant};

use flexstage::link::message::{Command, Reply};
use flexstage::link::{Fields, Profile};
use flexstage::{Flags, GeneratorSettings, Settings, State};
use telemetry::virtual_board::{Options, Speed};
use telemetry::{Device, Error, Sample, Target};

fn open() -> Device {
    let options = Options { speed: Speed::Max, ..Options::default() };
    Device::open(&Target::Virtual(options)).unwrap()
}

fn stream_on(device: &Device) {
    let fields = Fields::RECORDING.with(Fields::CYCLES);
    let reply = device.command(Command::StreamOn { fields, profile: Profile::Exact }).unwrap();
    assert!(matches!(reply, Reply::Streaming { sample_bytes: 54, .. }), "{reply:?}");
}

/// Samples until one satisfies the condition.
fn until(device: &Device, what: &str, done: impl Fn(&Sample) -> bool) -> Vec<Sample> {
    let stream = device.subscribe();
    let deadline = Instant::now() + Duration::from_secs(60);
    let mut all = Vec::new();
    while Instant::now() < deadline {
        let Ok(batch) = stream.recv_timeout(Duration::from_secs(5)) else { break };
        all.extend_from_slice(&batch.samples);
        if batch.samples.iter().any(&done) {
            return all;
        }
    }
    panic!("{what} did not happen in {} samples: {:?}", all.len(), all.last());
}

fn state(sample: &Sample) -> State {
    Flags(sample.flags).state()
}

#[test]
fn identifies_itself() {
    let device = open();
    assert_eq!(device.info().sample_rate_hz, 10_000.0);
    assert_eq!(device.info().firmware, env!("CARGO_PKG_VERSION"));
    assert!(device.info().serial.starts_with("7669727475616c"));
}

#[test]
fn arms_moves_and_parks_without_losing_a_tick() {
    let device = open();
    stream_on(&device);
    until(&device, "parked", |s| Flags(s.flags).is_parked());
    device.command(Command::Arm).unwrap();
    until(&device, "hold", |s| state(s) == State::Hold);
    for axis in 0..3 {
        let generator = GeneratorSettings::Ramp { target_um: 5.0 + axis as f32, duration_s: 0.2 };
        device.command(Command::Stage { axis, generator }).unwrap();
    }
    device.command(Command::Start { axes: 0b111 }).unwrap();
    let moved = until(&device, "the ramp", |s| {
        state(s) == State::Hold && s.reference_um == [5.0, 6.0, 7.0]
    });
    let end = moved.last().unwrap();
    for axis in 0..3 {
        let error = (end.reference_um[axis] - end.position_um[axis]).abs();
        assert!(error < 0.15, "axis {axis}: {end:?}");
        assert!((30.0..80.0).contains(&end.drive_v[axis]), "{end:?}");
        assert!((end.monitor_v[axis] - end.drive_v[axis]).abs() < 0.2, "{end:?}");
    }
    device.command(Command::Disarm).unwrap();
    let parking = until(&device, "parked again", |s| Flags(s.flags).is_parked());
    let slew = parking.windows(2).map(|w| (w[1].drive_v[2] - w[0].drive_v[2]).abs());
    assert!(slew.fold(0.0, f32::max) <= 0.0501, "soft return at 0.5 V/ms");
    let statistics = device.statistics();
    assert_eq!((statistics.lost_ticks, statistics.malformed, statistics.restarts), (0, 0, 0));
    assert!(statistics.samples > 5_000, "{statistics:?}");
}

#[test]
fn the_recorded_drive_is_the_one_that_acts() {
    // Contract: drive_v acts from its tick to the next, position is sampled before it acts. A 40 V step in
    // one tick must therefore move the monitor (time constant 0.4 ms, 22 % a tick) exactly one sample later.
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        axis.limits.slew_v_per_ms = 2000.0;
        axis.limits.following_error_um = 0.0;
        axis.feedforward.hysteresis = false;
        axis.feedforward.dynamics = false;
        axis.feedforward.amplifier_lead = false;
    }
    settings.guard.max_step_um = 0.0;
    settings.guard.stuck_drive_v = 0.0;
    let options = Options { speed: Speed::Max, settings, ..Options::default() };
    let device = Device::open(&Target::Virtual(options)).unwrap();
    stream_on(&device);
    until(&device, "parked", |s| Flags(s.flags).is_parked());
    device.command(Command::Arm).unwrap();
    until(&device, "hold", |s| state(s) == State::Hold);
    let generator = GeneratorSettings::Hold { position_um: 8.0, blend_s: 0.0 };
    device.command(Command::Stage { axis: 0, generator }).unwrap();
    let stream = device.subscribe();
    device.command(Command::Start { axes: 1 }).unwrap();
    let mut samples: Vec<Sample> = Vec::new();
    while !samples.last().is_some_and(|s| s.drive_v[0] > 40.0) {
        samples.extend_from_slice(&stream.recv_timeout(Duration::from_secs(5)).unwrap().samples);
    }
    samples.extend_from_slice(&stream.recv_timeout(Duration::from_secs(5)).unwrap().samples);
    let step = samples.iter().position(|s| s.drive_v[0] > 40.0).unwrap();
    let monitor = |i: usize| samples[i].monitor_v[0] - samples[step - 1].monitor_v[0];
    assert!(monitor(step).abs() < 0.2, "nothing yet when the drive is latched: {}", monitor(step));
    assert!(monitor(step + 1) > 8.0, "one sample later it has moved: {}", monitor(step + 1));
}

#[test]
fn refusals_say_why() {
    let device = open();
    let start = device.command(Command::Start { axes: 1 }).unwrap_err();
    assert!(matches!(start, Error::Refused { .. }));
    assert!(start.to_string().contains("not armed"), "{start}");
    let mut settings = Settings::default();
    settings.axes[1].feedback.derivative_filter_hz = -5.0;
    let bad = device.command(Command::SetSettings(settings)).unwrap_err().to_string();
    assert!(bad.contains("axis 2") && bad.contains("derivative_filter_hz"), "{bad}");
    let axis = Command::Stage { axis: 7, generator: GeneratorSettings::Stop };
    assert!(device.command(axis).is_err());
}

#[test]
fn settings_take_effect_and_are_acknowledged() {
    let device = open();
    let mut settings = Settings::default();
    settings.axes[0].feedback.proportional_v_per_um = 1.5;
    let Reply::Configured { digest, .. } =
        device.command(Command::SetSettings(settings.clone())).unwrap()
    else {
        panic!("not configured")
    };
    assert_eq!(digest, flexstage::Config::build(&settings).unwrap().digest());
    assert_eq!(device.command(Command::ReadSettings).unwrap(), Reply::Settings(settings));
    let Reply::Status(status) = device.command(Command::Status).unwrap() else { panic!() };
    assert!(!status.is_stored && status.digest == digest);
}

#[test]
fn in_real_time_a_host_that_does_not_read_loses_ticks_and_knows_it() {
    use telemetry::transport::Transport;
    let mut board = telemetry::virtual_board::VirtualBoard::start(&Options::default()).unwrap();
    let mut buffer = [0; 2048];
    let on = Command::StreamOn { fields: Fields::RECORDING, profile: Profile::Packed };
    let bytes = flexstage::link::message::encode_command(&mut buffer, 9, &on).unwrap();
    board.send(bytes).unwrap();
    std::thread::sleep(Duration::from_millis(400));
    let mut decoder = telemetry::decode::StreamDecoder::new(170_000_000);
    let end = Instant::now() + Duration::from_millis(400);
    while Instant::now() < end {
        if let Some(bytes) = board.receive(Duration::from_millis(5)).unwrap() {
            decoder.push(&bytes);
        }
    }
    let s = decoder.statistics();
    assert!(s.lost_ticks > 500, "{s:?}");
    assert_eq!((s.lost_ticks, s.lost_in_transit), (s.dropped_by_board, 0), "{s:?}");
}
