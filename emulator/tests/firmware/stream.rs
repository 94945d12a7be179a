//! Every tick of all three axes reaches the host, and what does not is counted.

use std::time::Instant;

use emulator::time::{MILLISECOND, SECOND, seconds};
use flexstage::GeneratorSettings;
use flexstage::generator::Wave;
use flexstage::link::{Fields, Profile};

use crate::common::{armed, image};

fn motion() -> Vec<(u8, GeneratorSettings)> {
    vec![
        (0, GeneratorSettings::Sine(Wave::between(1.0, 9.0, 7.0))),
        (1, GeneratorSettings::Triangle(Wave::between(2.0, 8.0, 3.0))),
        (2, GeneratorSettings::Sine(Wave::between(0.5, 10.0, 31.0))),
    ]
}

/// Time that this thread has had a processor, so that a busy machine does not count as a slow emulator.
fn processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1.0e-9)
}

/// Streams every tick of three moving axes for so long; nothing may be lost.
fn stream_for(whole_seconds: u64) {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 5, |_| {});
    b.start(&motion()).unwrap();
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    b.link.clear();
    let (wall, processor, start) = (Instant::now(), processor_s(), b.now());
    for _ in 0..whole_seconds {
        b.run_for(SECOND).unwrap();
        assert_eq!(b.link.tally.missing, 0, "{:?}", b.link.tally);
    }
    let t = b.link.tally.clone();
    let emulated = seconds(b.now() - start);
    let spent = processor.zip(processor_s()).map_or(f64::NAN, |(from, to)| to - from);
    println!(
        "{emulated:.0} s emulated in {:.1} s, {spent:.1} s of one core ({:.1} x real time; aim: 3): {} samples in {} frames, {:.0} kB/s, {} missing, {} dropped",
        wall.elapsed().as_secs_f64(),
        emulated / spent,
        t.samples,
        t.frames,
        t.bytes as f64 / emulated / 1e3,
        t.missing,
        t.dropped
    );
    assert_eq!((t.missing, t.dropped, t.bad), (0, 0, 0));
    assert!(t.samples >= whole_seconds * 10_000 - 2_000, "{} samples", t.samples);
    let counters = b.counters().unwrap();
    assert_eq!(counters.overruns, 0, "{counters:?}");
    assert_eq!(b.link.malformed(), 0);
}

#[test]
fn ten_minutes_without_losing_a_tick() {
    stream_for(600);
}

#[test]
fn exact_stream_of_every_field_keeps_up() {
    let Some(image) = image() else { return };
    for (fields, profile) in [
        (Fields::RECORDING, Profile::Exact),
        (Fields::ALL, Profile::Exact),
        (Fields::ALL, Profile::Packed),
    ] {
        let mut b = armed(&image, 5, |_| {});
        b.start(&motion()).unwrap();
        b.stream(fields, profile).unwrap();
        b.link.clear();
        b.run_for(3 * SECOND).unwrap();
        let t = &b.link.tally;
        println!(
            "{fields:?} {profile:?}: {:.0} kB/s, {} missing, {} dropped",
            t.bytes as f64 / 3e3,
            t.missing,
            t.dropped
        );
        assert_eq!((t.missing, t.dropped, t.bad), (0, 0, 0), "{fields:?} {profile:?}: {t:?}");
    }
}

#[test]
fn what_the_board_loses_is_not_lost_on_the_way() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 7, |_| {});
    b.start(&motion()).unwrap();
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    b.run_for(50 * MILLISECOND).unwrap();
    b.link.clear();
    for _ in 0..5 {
        // A tick takes more than two periods, and every second trigger at least finds the one before still waiting.
        b.machine.soc_mut().set_cycles_per_instruction(800);
        b.run_for(5 * MILLISECOND).unwrap();
        b.machine.soc_mut().set_cycles_per_instruction(16);
        b.run_for(50 * MILLISECOND).unwrap();
    }
    let t = &b.link.tally;
    println!("{t:?}");
    assert!(t.missing >= 125, "{t:?}");
    // By the frame behind each gap, not some frame later or earlier.
    assert_eq!((t.lost_in_transit, t.dropped_at_start, t.bad), (0, 0, 0), "{t:?}");
    assert_eq!(t.missing, u64::from(t.dropped), "{t:?}");
}

#[test]
fn a_host_that_stops_reading() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 6, |_| {});
    b.start(&motion()).unwrap();
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    b.run_for(SECOND / 2).unwrap();
    b.link.clear();
    let ticks_before = b.counters().unwrap().overruns;

    let mut stall = |time| {
        b.machine.soc_mut().stack.host.stall(true);
        b.run_for(time).unwrap();
        b.machine.soc_mut().stack.host.stall(false);
        b.run_for(SECOND).unwrap();
        b.link.tally.clone()
    };
    let short = stall(120 * MILLISECOND);
    println!("120 ms: {short:?}");
    assert_eq!((short.missing, short.dropped), (0, 0), "120 ms must lose nothing");
    let long = stall(5 * SECOND);
    println!("5 s: {long:?}");
    assert!(long.missing > 40_000, "a stall of 5 s cannot be hidden: {long:?}");
    assert_eq!(
        long.missing,
        (long.dropped - long.dropped_at_start) as u64,
        "every lost tick is counted"
    );
    assert_eq!(long.bad, 0);
    let counters = b.counters().unwrap();
    assert_eq!((counters.overruns, ticks_before), (0, 0), "the loop never missed a tick");
}
