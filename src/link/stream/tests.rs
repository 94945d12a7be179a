//! Samples survive the wire in both profiles, and damaged frames are refused.

use super::*;
use crate::link::{MAX_FRAME, encode};
use proptest::prelude::*;
use std::vec::Vec;

fn any_sample() -> impl Strategy<Value = Sample> {
    let axes = || any::<[i32; 3]>();
    let codes = || any::<[u16; 3]>();
    (axes(), axes(), axes(), axes(), any::<u32>(), any::<u16>(), codes(), codes()).prop_map(
        |(reference, position, drive, monitor, flags, cycles, gauge_code, dac_code)| Sample {
            tick: 0,
            reference,
            position,
            drive,
            monitor,
            flags,
            cycles,
            gauge_code,
            dac_code,
        },
    )
}

#[test]
fn sizes_are_what_the_documentation_says() {
    assert_eq!(sample_bytes(Fields::RECORDING, Profile::Packed), 28);
    assert_eq!(sample_bytes(Fields::RECORDING.with(Fields::CYCLES), Profile::Exact), 54);
    assert_eq!(sample_bytes(Fields::ALL, Profile::Exact), 66);
    assert_eq!(sample_bytes(Fields(0), Profile::Exact), 0);
}

#[test]
fn a_frame_holds_consecutive_ticks_only() {
    let mut buffer = [0; MAX_FRAME];
    let mut writer = StreamWriter::new(&mut buffer, Fields::POSITION, Profile::Packed);
    assert!(writer.push(&Sample { tick: 5, ..Sample::default() }));
    assert!(!writer.push(&Sample { tick: 7, ..Sample::default() }));
    assert!(writer.push(&Sample { tick: 6, ..Sample::default() }));
    assert_eq!(writer.count(), 2);
}

#[test]
fn packing_saturates_and_rounds() {
    assert_eq!(unpack_displacement(pack_displacement(i32::MAX)), i32::from(i16::MAX) << 14);
    assert_eq!(unpack_displacement(pack_displacement(i32::MIN)), i32::from(i16::MIN) << 14);
    assert_eq!(unpack_voltage(pack_voltage(150 << 22)), 150 << 22);
    assert_eq!(unpack_voltage(pack_voltage(i32::MAX)), (0xffff << 14) - (32 << 22));
    assert_eq!(unpack_voltage(pack_voltage(i32::MIN)), -(32 << 22));
}

proptest! {
    #[test]
    fn exact_samples_survive(
        mut samples in prop::collection::vec(any_sample(), 1..40),
        first in any::<u32>(),
        mask in 1u16..=0xff,
    ) {
        for (i, sample) in samples.iter_mut().enumerate() {
            sample.tick = u64::from(first) + i as u64;
        }
        let mut buffer = [0; MAX_FRAME];
        let fields = Fields(mask);
        let mut writer = StreamWriter::new(&mut buffer, fields, Profile::Exact);
        let written = samples.iter().take_while(|s| writer.push(s)).count();
        prop_assert!(written >= samples.len().min(14));
        let length = writer.finish(3, 17).unwrap();
        let frame = frame::decode(&buffer[..length]).unwrap();
        let stream = StreamFrame::parse(&frame).unwrap();
        prop_assert_eq!(stream.dropped, 17);
        let back: Vec<Sample> = stream.samples().collect();
        prop_assert_eq!(back.len(), written);
        for (sample, back) in samples.iter().zip(back) {
            let kept = |field, values: [i32; 3]| if fields.contains(field) { values } else { [0; 3] };
            let codes = |field, values: [u16; 3]| if fields.contains(field) { values } else { [0; 3] };
            let expected = Sample {
                tick: sample.tick,
                reference: kept(Fields::REFERENCE, sample.reference),
                position: kept(Fields::POSITION, sample.position),
                drive: kept(Fields::DRIVE, sample.drive),
                monitor: kept(Fields::MONITOR, sample.monitor),
                flags: if fields.contains(Fields::FLAGS) { sample.flags } else { 0 },
                cycles: if fields.contains(Fields::CYCLES) { sample.cycles } else { 0 },
                gauge_code: codes(Fields::GAUGE_CODE, sample.gauge_code),
                dac_code: codes(Fields::DAC_CODE, sample.dac_code),
            };
            prop_assert_eq!(back, expected);
        }
    }

    #[test]
    fn packed_is_within_half_a_step(um in -31.9f64..31.9, volts in -31.9f64..223.9) {
        let position = (um * f64::from(1 << 24)) as i32;
        let drive = (volts * f64::from(1 << 22)) as i32;
        let error = unpack_displacement(pack_displacement(position)) - position;
        prop_assert!(error.abs() <= 1 << 13);
        let error = unpack_voltage(pack_voltage(drive)) - drive;
        prop_assert!(error.abs() <= 1 << 13);
    }

    #[test]
    fn any_payload_is_read_or_refused(payload in prop::collection::vec(any::<u8>(), 0..200)) {
        let mut buffer = [0; MAX_FRAME];
        let bytes = encode(&mut buffer, Kind::Stream, 0, &payload).unwrap();
        if let Ok(stream) = StreamFrame::parse(&frame::decode(bytes).unwrap()) {
            prop_assert_eq!(stream.samples().count(), usize::from(stream.count));
        }
    }
}
