//! Messages survive the wire, the longest fit, and damaged ones are refused.

use super::*;
use crate::link::MAX_FRAME;
use crate::settings::{CreepSettings, MaxwellSettings, NotchSettings};
use proptest::prelude::*;

/// Every list full: the longest settings there are.
fn longest_settings() -> Settings {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        axis.stack.hysteresis.clear();
        while axis.stack.hysteresis.push(MaxwellSettings::default()).is_ok() {}
        while axis.feedforward.creep.push(CreepSettings::default()).is_ok() {}
        while axis.feedback.notches.push(NotchSettings::default()).is_ok() {}
        axis.gauge.full_code = u32::MAX;
        axis.monitor.full_code = u32::MAX;
        axis.dac.full_code = u32::MAX;
    }
    settings
}

fn round_trip(command: &Command) -> Command {
    let mut buffer = [0; MAX_FRAME];
    let bytes = encode_command(&mut buffer, 5, command).unwrap();
    decode_command(&frame::decode(bytes).unwrap()).unwrap()
}

#[test]
fn nothing_else_is_taken_for_disarm() {
    let mut buffer = [0; MAX_FRAME];
    let mut packet = |command: &Command| encode_command(&mut buffer, 5, command).unwrap().to_vec();
    let disarm = packet(&Command::Disarm);
    assert!(ends_with_disarm(&disarm));
    for other in [
        Command::Status,
        Command::Arm,
        Command::Hold,
        Command::ClearFaults,
        Command::KeepAlive,
        Command::Start { axes: 5 },
        Command::SetSettings(longest_settings()),
    ] {
        assert!(!ends_with_disarm(&packet(&other)), "{other:?}");
    }
    for length in 0..disarm.len() {
        assert!(!ends_with_disarm(&disarm[..length]), "{length} bytes of it");
    }
    assert!(!ends_with_disarm(&[&disarm[..], &[0]].concat()), "something behind it");
    let behind_another = [packet(&Command::KeepAlive), disarm.clone()].concat();
    assert!(ends_with_disarm(&behind_another), "what comes last holds");
    assert!(!ends_with_disarm(&[&disarm[..], &packet(&Command::Arm)].concat()), "Arm comes last");
    for bit in 0..8 * disarm.len() {
        let mut damaged = disarm.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(!ends_with_disarm(&damaged), "bit {bit}");
    }
}

#[test]
fn the_longest_messages_fit_a_frame() {
    let settings = longest_settings();
    let command = Command::SetSettings(settings.clone());
    assert_eq!(round_trip(&command), command);
    let mut buffer = [0; MAX_FRAME];
    let reply = Reply::Settings(settings);
    let bytes = encode_reply(&mut buffer, 5, &reply).unwrap().to_vec();
    assert_eq!(decode_reply(&frame::decode(&bytes).unwrap()).unwrap(), reply);
    let Reply::Settings(settings) = reply else { unreachable!() };
    let length = encode_settings(&mut buffer, 5, &settings);
    assert_eq!(buffer[..length], bytes);
    let mut points = Vec::new();
    while points.push(-0.5).is_ok() {}
    let command = Command::WriteTable { offset: 768, points };
    assert_eq!(round_trip(&command), command);
    let counters = Counters {
        cycles_histogram: [u32::MAX; HISTOGRAM_BINS],
        ticks: u32::MAX,
        ..Counters::default()
    };
    encode_reply(&mut buffer, 5, &Reply::Counters(counters)).unwrap();
}

#[test]
fn a_refused_setting_arrives_with_its_reason() {
    let mut settings = Settings::default();
    settings.axes[1].limits.slew_v_per_ms = f32::NAN;
    let error = crate::Config::build(&settings).unwrap_err();
    let refusal = Refusal::Settings(error.into());
    let mut buffer = [0; MAX_FRAME];
    let bytes = encode_reply(&mut buffer, 1, &Reply::Refused(refusal)).unwrap();
    let Ok(Reply::Refused(back)) = decode_reply(&frame::decode(bytes).unwrap()) else {
        panic!("not a refusal");
    };
    assert!(format!("{back}").starts_with("axis 2: limits.slew_v_per_ms must be"));
}

#[test]
fn another_schema_is_not_misread() {
    let mut buffer = [0; MAX_FRAME];
    let bytes = encode_command(&mut buffer, 1, &Command::Arm).unwrap();
    let mut frame = frame::decode(bytes).unwrap();
    frame.schema ^= 1;
    assert_eq!(decode_command(&frame), Err(MessageError::Schema { found: SCHEMA_HASH ^ 1 }));
}

#[test]
fn bytes_left_over_are_refused() {
    let mut buffer = [0; MAX_FRAME];
    let payload = postcard::to_slice(&Command::Arm, &mut buffer).unwrap().len();
    let content = buffer[..=payload].to_vec();
    let bytes = super::super::encode(&mut buffer, Kind::Command, 1, &content).unwrap();
    let decoded = decode_command(&frame::decode(bytes).unwrap());
    assert_eq!(decoded, Err(MessageError::Payload));
}

proptest! {
    #[test]
    fn any_payload_is_decoded_or_refused(
        payload in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        let mut buffer = [0; MAX_FRAME];
        let bytes = super::super::encode(&mut buffer, Kind::Command, 1, &payload).unwrap();
        let _ = decode_command(&frame::decode(bytes).unwrap());
        let bytes = super::super::encode(&mut buffer, Kind::Reply, 1, &payload).unwrap();
        let _ = decode_reply(&frame::decode(bytes).unwrap());
    }

    /// Settings of which any byte was overwritten are refused or still settings: never a panic, in decoding nor in building.
    #[test]
    fn damaged_settings_never_panic(at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let mut buffer = [0; MAX_FRAME];
        let command = Command::SetSettings(longest_settings());
        let mut payload = postcard::to_slice(&command, &mut buffer).unwrap().to_vec();
        let at = at.index(payload.len());
        payload[at] = byte;
        let mut buffer = [0; MAX_FRAME];
        let bytes = super::super::encode(&mut buffer, Kind::Command, 1, &payload).unwrap();
        if let Ok(Command::SetSettings(settings)) = decode_command(&frame::decode(bytes).unwrap()) {
            let _ = crate::Config::build(&settings);
        }
    }
}
