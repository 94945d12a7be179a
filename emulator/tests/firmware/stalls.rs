//! Streams that end while a transfer is under way, and a host that sends but does not read.

use emulator::bench::Bench;
use emulator::link::Link;
use emulator::time::{MICROSECOND, MILLISECOND, SECOND};
use flexstage::generator::Multisine;
use flexstage::link::message::{Command, Refusal, Reply};
use flexstage::link::{Fields, Profile, Sample};
use flexstage::{Flags, GeneratorSettings, State};

use crate::common::{armed, bench, hold, image};

const NOT_ARMED: Refusal = Refusal::Control(flexstage::Refusal::NotArmed);
const ON: Command = Command::StreamOn { fields: Fields::RECORDING, profile: Profile::Packed };

/// Sends a command and waits for nothing; the sequence number of its answer.
fn post(b: &mut Bench, command: &Command) -> u16 {
    let (sequence, bytes) = b.link.command(command);
    b.send(bytes).unwrap();
    sequence
}

fn tick(reply: Option<Reply>) -> u64 {
    match reply {
        Some(Reply::Done { tick } | Reply::Streaming { tick, .. }) => u64::from(tick),
        other => panic!("{other:?}"),
    }
}

fn stall(b: &mut Bench, is_stalled: bool) {
    b.machine.soc_mut().stack.host.stall(is_stalled);
}

/// The first tick of an open loop.
fn opened(samples: &[Sample]) -> u64 {
    samples.iter().find(|s| !Flags(s.flags).state().is_active()).expect("the loop opens").tick
}

fn no_restart(b: &Bench, what: &str) {
    assert_eq!(b.machine.resets.len(), 1, "{what}: the board restarted:\n{}", b.log_tail(8));
}

#[test]
fn a_stream_ends_at_any_moment_of_a_transfer() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 11, |_| {});
    let (mut samples, mut wrong) = (0, Vec::new());
    for round in 0..200 {
        b.link.clear();
        let start = b.stream(Fields::RECORDING, Profile::Exact).unwrap();
        b.run_for(8 * MILLISECOND + round % 50 * 40 * MICROSECOND).unwrap();
        // Every other one is followed by the next start at once.
        let off = post(&mut b, &Command::StreamOff);
        b.run_for(round % 2 * 3 * MILLISECOND).unwrap();
        let answered = |b: &mut Bench| {
            let is_over = b.machine.resets.len() > 1;
            is_over || b.link.reply(off).is_some()
        };
        b.run_until(SECOND, "answer", answered).unwrap();
        no_restart(&b, &format!("round {round}"));
        let t = &b.link.tally;
        if (t.first_tick, t.missing, t.dropped, t.bad) != (Some(u64::from(start)), 0, 0, 0) {
            wrong.push(format!("round {round}, from tick {start}: {t:?}"));
        }
        samples += t.samples;
    }
    println!("200 streams begun and ended, {samples} samples");
    assert!(wrong.is_empty(), "{wrong:#?}");
    let counters = b.counters().unwrap();
    assert_eq!((counters.overruns, counters.dropped), (0, 0), "{counters:?}");
}

#[test]
fn a_stream_ends_and_another_begins_while_the_host_does_not_read() {
    let Some(image) = image() else { return };
    // The ring is filled in 122 ms.
    for (before, after) in [(10, 10), (10, 300), (300, 10), (300, 300)] {
        for commands in [&[ON][..], &[Command::StreamOff, ON]] {
            let mut b = armed(&image, 12, |_| {});
            b.command(&ON).unwrap();
            b.run_for(100 * MILLISECOND).unwrap();
            b.link.samples = Some(Vec::new());
            stall(&mut b, true);
            b.run_for(before * MILLISECOND).unwrap();
            let posted: Vec<u16> = commands.iter().map(|c| post(&mut b, c)).collect();
            b.run_for(after * MILLISECOND).unwrap();
            assert_eq!(b.link.samples.as_ref().map(Vec::len), Some(0), "the host read");
            stall(&mut b, false);
            b.run_for(SECOND).unwrap();
            let what = format!("{before} ms, {commands:?}, {after} ms");
            no_restart(&b, &what);
            let start = posted.iter().map(|s| tick(b.link.reply(*s))).max().unwrap();
            let samples = b.link.samples.take().unwrap();
            let (old, new): (Vec<&Sample>, Vec<&Sample>) =
                samples.iter().partition(|s| s.tick < start);
            let (first, last) = (new[0].tick, new[new.len() - 1].tick);
            let missing = last + 1 - start - new.len() as u64;
            println!(
                "{what}: {} samples of the old stream, {} of the new one from tick {start}: the first is {first}, {missing} missing",
                old.len(),
                new.len()
            );
            // Of the old stream the frame that was on its way, and nothing of all that waited behind it.
            assert!(old.len() <= 35, "{what}: {} old samples", old.len());
            assert!(samples.is_sorted_by_key(|s| s.tick), "{what}");
            assert!(new.len() > 9_000, "{what}: {} new samples", new.len());
            assert_eq!(missing, u64::from(b.link.tally.dropped), "{what}");
            if commands.len() == 2 {
                assert_eq!((first, missing), (start, 0), "{what}: it starts when the host reads");
            }
            assert_eq!(b.link.tally.bad, 0, "{what}");
        }
    }
}

#[test]
fn a_bus_reset_ends_a_stream_in_a_transfer() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 13);
    for round in 0..20 {
        b.command(&ON).unwrap();
        b.run_for(10 * MILLISECOND + round * 50 * MICROSECOND).unwrap();
        stall(&mut b, round % 2 == 0);
        let before = post(&mut b, &Command::KeepAlive);
        b.run_for(round * MILLISECOND).unwrap();
        let now = b.now();
        b.machine.soc_mut().stack.host.reset(now);
        stall(&mut b, false);
        b.run_for(MILLISECOND).unwrap();
        let answered = b.link.reply(before).is_some();
        // The program starts over too, without what came of a cut transfer.
        b.link = Link::default();
        // Reset, recovery, enumeration.
        b.run_for(100 * MILLISECOND).unwrap();
        no_restart(&b, &format!("round {round}"));
        if round > 1 {
            assert_eq!(answered, round % 2 == 1, "round {round}");
        }
        assert_eq!(b.link.reply(before), None, "round {round}: an answer for the host before");
        b.run_for(20 * MILLISECOND).unwrap();
        assert_eq!(b.link.tally.frames, 0, "round {round}: nobody has asked for a stream");
    }
    let start = tick(Some(b.command(&ON).unwrap()));
    b.run_for(100 * MILLISECOND).unwrap();
    let t = &b.link.tally;
    assert_eq!((t.first_tick, t.missing, t.dropped), (Some(start), 0, 0), "{t:?}");
}

#[test]
fn disarming_does_not_wait_for_a_host_that_does_not_read() {
    let Some(image) = image() else { return };
    // So many commands before it, and whether all are in one packet.
    for (ahead, is_one_packet) in [(1, false), (2, false), (50, false), (2, true)] {
        let mut b = armed(&image, 14, |_| {});
        b.command(&ON).unwrap();
        b.run_for(50 * MILLISECOND).unwrap();
        b.link.samples = Some(Vec::new());
        let ticks = b.counters().unwrap().ticks;
        let counted = b.now();
        stall(&mut b, true);
        b.run_for(20 * MILLISECOND).unwrap();
        let mut commands = vec![Command::KeepAlive; ahead];
        commands.push(Command::Disarm);
        let (mut sequences, mut together) = (Vec::new(), Vec::new());
        for command in &commands {
            let (sequence, bytes) = b.link.command(command);
            sequences.push(sequence);
            together.extend_from_slice(&bytes);
            if !is_one_packet {
                b.send(bytes).unwrap();
            }
        }
        if is_one_packet {
            assert!(together.len() <= 64, "one packet");
            b.send(together).unwrap();
        }
        let sent = u64::from(ticks) + (b.now() - counted) / (MILLISECOND / 10);
        b.run_for(50 * MILLISECOND).unwrap();
        stall(&mut b, false);
        b.run_for(200 * MILLISECOND).unwrap();
        let open = opened(&b.link.samples.take().unwrap());
        println!(
            "{ahead} commands before it, one packet: {is_one_packet}: sent at tick {sent}, open from {open}"
        );
        assert!(open <= sent + 60, "sent at tick {sent}, open from {open}");
        let answers: Vec<u64> = sequences.iter().map(|s| tick(b.link.reply(*s))).collect();
        assert!(answers.is_sorted(), "answered in turn: {answers:?}");
    }
}

/// A host that does not read and sends `Arm`, then `Disarm` so much later: what it said last holds, although there is no room for the answers.
#[test]
fn what_arms_ahead_of_a_disarm_does_not_outlive_it() {
    let Some(image) = image() else { return };
    let both = [Command::Arm, Command::Disarm];
    // Of a loop that is open and one that is closed; more than one pair, as each `Disarm` ends only what stands before it.
    for (is_armed, pairs) in [(false, 1), (true, 1), (false, 3), (true, 3)] {
        for apart in [None, Some(0), Some(40), Some(100)] {
            let mut b = armed(&image, 18, |_| {});
            b.start(&[(0, hold(9.0)), (1, hold(9.0))]).unwrap();
            b.run_for(200 * MILLISECOND).unwrap();
            if !is_armed {
                b.command(&Command::Disarm).unwrap();
                b.run_for(SECOND).unwrap();
                assert!(Flags(b.status().unwrap().flags).is_parked());
            }
            b.command(&ON).unwrap();
            b.run_for(50 * MILLISECOND).unwrap();
            let (ticks, counted) = (b.counters().unwrap().ticks, b.now());
            // Longer than it takes to fill the ring.
            stall(&mut b, true);
            b.run_for(300 * MILLISECOND).unwrap();
            let mut posted = Vec::new();
            for _ in 0..pairs {
                match apart {
                    // In one packet.
                    None => {
                        let [(arm, mut bytes), (disarm, more)] =
                            both.each_ref().map(|c| b.link.command(c));
                        bytes.extend_from_slice(&more);
                        b.send(bytes).unwrap();
                        posted.extend([arm, disarm]);
                    }
                    Some(microseconds) => {
                        posted.push(post(&mut b, &Command::Arm));
                        b.run_for(microseconds * MICROSECOND).unwrap();
                        posted.push(post(&mut b, &Command::Disarm));
                    }
                }
            }
            let sent = u64::from(ticks) + (b.now() - counted) / (MILLISECOND / 10);
            let what = format!("armed: {is_armed}, {pairs} pairs, {apart:?} us apart");
            b.run_for(SECOND).unwrap();
            let codes = [(0, 0), (0, 1), (1, 0)].map(|(d, c)| b.machine.soc().dac[d].output(c));
            b.link.samples = Some(Vec::new());
            stall(&mut b, false);
            b.run_for(200 * MILLISECOND).unwrap();
            let samples = b.link.samples.take().unwrap();
            // The ring holds older ones; the newest of these are from before the host read again.
            let after: Vec<&Sample> = samples.iter().filter(|s| s.tick > sent + 60).collect();
            let closed = after.iter().filter(|s| Flags(s.flags).state().is_active()).count();
            let answers: Vec<_> = posted.iter().map(|s| b.link.reply(*s)).collect();
            println!(
                "{what}: drives at {codes:?}, closed in {closed} of {} ticks after it; {answers:?}",
                after.len()
            );
            assert!(after[0].tick < sent + 10_100, "{what}: from {}", after[0].tick);
            assert_eq!((codes, closed), ([Some(256); 3], 0), "{what}");
            assert!(answers.iter().all(Option::is_some), "{what}: {answers:?}");
            assert_eq!(Flags(b.status().unwrap().flags).state(), State::Off, "{what}");
            no_restart(&b, &what);
            // The order is done with.
            b.arm().unwrap();
        }
    }
}

#[test]
fn only_a_stream_drops_samples_and_its_count_stays() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 15);
    b.run_for(SECOND / 2).unwrap();
    assert_eq!(b.counters().unwrap().dropped, 0, "nobody has listened yet");
    b.command(&ON).unwrap();
    b.run_for(50 * MILLISECOND).unwrap();
    b.link.clear();
    stall(&mut b, true);
    b.run_for(SECOND / 2).unwrap();
    stall(&mut b, false);
    b.run_for(SECOND / 2).unwrap();
    assert_eq!(b.counters().unwrap().dropped, b.link.tally.dropped);
    b.command(&Command::StreamOff).unwrap();
    let t = b.link.tally.clone();
    println!("{t:?}");
    assert!(t.missing > 3_000, "{t:?}");
    // Twice, as the second end ends nothing.
    for _ in 0..2 {
        b.run_for(100 * MILLISECOND).unwrap();
        assert_eq!(u64::from(b.counters().unwrap().dropped), t.missing);
        b.command(&Command::StreamOff).unwrap();
    }
    b.command(&ON).unwrap();
    b.run_for(100 * MILLISECOND).unwrap();
    assert_eq!(b.counters().unwrap().dropped, 0, "a new stream");
}

/// Sixteen tones up to 4096 times the base: as long a search for the peak as there is.
fn longest() -> GeneratorSettings {
    GeneratorSettings::Multisine(Multisine {
        center_um: 5.0,
        peak_um: 1.0,
        base_hz: 0.5,
        first: 1,
        stride: 273,
        tones: 16,
        seed: 7,
        blend_s: 0.01,
        duration_s: 0.0,
    })
}

#[test]
fn disarming_does_not_wait_for_the_longest_multisine() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 16, |_| {});
    b.command(&ON).unwrap();
    b.run_for(50 * MILLISECOND).unwrap();
    b.link.clear();
    b.link.samples = Some(Vec::new());
    let generator = longest();
    let (begun, start) = (b.now(), u64::from(b.counters().unwrap().ticks));
    b.command(&Command::Stage { axis: 0, generator }).unwrap();
    let whole = (b.now() - begun) / MILLISECOND;
    // Once more, and in its midst the loop is to open.
    let staging = post(&mut b, &Command::Stage { axis: 1, generator });
    b.run_for(30 * MILLISECOND).unwrap();
    let sent = start + (b.now() - begun) / (MILLISECOND / 10);
    let disarming = post(&mut b, &Command::Disarm);
    let mut staged = None;
    let answered = |b: &mut Bench| {
        staged = b.link.reply(staging);
        staged.is_some()
    };
    let searched = b.run_until(SECOND, "answer", answered).unwrap() / MILLISECOND;
    b.run_for(SECOND).unwrap();
    let open = opened(&b.link.samples.take().unwrap());
    assert_eq!(staged, Some(Reply::Refused(NOT_ARMED)), "the loop is open by then");
    tick(b.link.reply(disarming));
    let t = &b.link.tally;
    println!(
        "staged within {whole} ms; disarming at tick {sent}: open from {open}; staging refused {searched} ms later; {t:?}"
    );
    assert!(open <= sent + 20, "sent at tick {sent}, open from {open}");
    assert!(searched > 10, "{searched} ms: the search was over before");
    assert_eq!((t.missing, t.dropped, t.bad), (0, 0, 0), "{t:?}");
    assert_eq!(b.counters().unwrap().overruns, 0);
}

/// Twelve at once, so that the ring does not hide what the stream cannot keep up with; nor may the watch be silent for 0.25 s.
#[test]
fn staging_the_longest_multisines_loses_no_sample() {
    let Some(image) = image() else { return };
    for (fields, profile) in [(Fields::RECORDING, Profile::Packed), (Fields::ALL, Profile::Exact)] {
        let mut b = armed(&image, 17, |_| {});
        b.stream(fields, profile).unwrap();
        b.run_for(50 * MILLISECOND).unwrap();
        b.link.clear();
        let stage = |axis| Command::Stage { axis, generator: longest() };
        let posted: Vec<u16> = (0..12).map(|n| post(&mut b, &stage(n % 3))).collect();
        b.run_for(4 * SECOND).unwrap();
        no_restart(&b, "twelve at once");
        let staged: Vec<u64> = posted.iter().map(|s| tick(b.link.reply(*s))).collect();
        println!("{fields:?} {profile:?}: staged from ticks {staged:?}");
        assert_eq!(b.link.first_fault, None, "{profile:?}: the loop stays closed");
        assert!(Flags(b.status().unwrap().flags).state().is_active());
        let t = &b.link.tally;
        assert_eq!((t.missing, t.dropped, t.bad), (0, 0, 0), "{profile:?}: {t:?}");
        assert_eq!(b.counters().unwrap().overruns, 0);
    }
}
