//! A hundred thousand packets that no honest host sends change nothing, and are counted. Endpoints that a host halts go on when it says so.

use emulator::bench::Bench;
use emulator::time::{MICROSECOND, MILLISECOND, SECOND};
use emulator::usb_host::{Completion, Pipe, Status};
use flexstage::link::message::{Command, Reply};
use flexstage::link::{
    Fields, Kind, MAX_FRAME, Profile, USB_ENDPOINT_IN, USB_ENDPOINT_OUT, encode,
};

use crate::common::{armed, image};

struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
    fn bytes(&mut self, n: usize) -> Vec<u8> {
        (0..n).map(|_| self.next() as u8).collect()
    }
}

/// A control request and how it ended.
fn control(b: &mut Bench, setup: [u8; 8]) -> Completion {
    let now = b.now();
    let id = b.machine.soc_mut().stack.control(setup, Vec::new(), now);
    let mut ended = None;
    b.run_until(2 * SECOND, "answer to a control request", |b| {
        ended = b.machine.soc_mut().stack.control_result(id);
        ended.is_some()
    })
    .unwrap();
    ended.unwrap()
}

/// SET_FEATURE or CLEAR_FEATURE of ENDPOINT_HALT.
fn halt(b: &mut Bench, address: u8, is_halted: bool) -> Status {
    control(b, [0x02, if is_halted { 3 } else { 1 }, 0, 0, address, 0, 0, 0]).status
}

/// GET_STATUS of an endpoint: whether it is halted.
fn is_halted(b: &mut Bench, address: u8) -> bool {
    let answer = control(b, [0x82, 0, 0, 0, address, 0, 2, 0]);
    assert_eq!(answer.status, Status::Done, "GET_STATUS of endpoint {address:#04x}");
    answer.data == [1, 0]
}

fn read(b: &mut Bench, is_reading: bool) {
    let now = b.now();
    b.machine.soc_mut().stack.set_reading(is_reading, now);
}

#[test]
fn a_hundred_thousand_hostile_packets() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 31, |_| {});
    let settings = b.command(&Command::ReadSettings).unwrap();
    let status = b.status().unwrap();
    let before = b.counters().unwrap();
    let mut noise = Noise(0x5eed_0001);
    let (_, good) = b.link.command(&Command::Disarm);
    let (_, long) = b.link.command(&Command::SetSettings(crate::common::settings()));
    let mut sent = 0u64;
    let mut round = 0;
    while sent < 100_000 {
        let bytes = match round % 6 {
            // Random bytes, any length.
            0 => {
                let n = (noise.next() % 65) as usize;
                noise.bytes(n)
            }
            // A good frame with one bit flipped: the CRC must catch it.
            1 => {
                let mut f = good.clone();
                let bit = noise.next() as usize % (8 * f.len());
                f[bit / 8] ^= 1 << (bit % 8);
                f
            }
            // A good frame cut short.
            2 => good[..noise.next() as usize % good.len()].to_vec(),
            // A long frame cut short, then garbage.
            3 => {
                let mut f = long[..noise.next() as usize % long.len()].to_vec();
                let n = (noise.next() % 200) as usize;
                f.extend(noise.bytes(n));
                f
            }
            // A whole frame of this schema with a payload of noise: decodes to nothing.
            4 => {
                let n = (noise.next() % 48) as usize;
                let mut payload = noise.bytes(n);
                // Not the number of a command, which needs one byte: the first says that there are more, the second that
                // they are not nothing.
                if let [first, second, ..] = payload.as_mut_slice() {
                    *first |= 0x80;
                    *second |= 1;
                } else if let [only] = payload.as_mut_slice() {
                    *only |= 0x80;
                }
                let mut buffer = [0; MAX_FRAME];
                encode(&mut buffer, Kind::Command, round as u16, &payload).unwrap().to_vec()
            }
            // A header that promises more than a frame may hold.
            _ => {
                let mut f = good.clone();
                f[8] = 0xff;
                f[9] = 0xff;
                f
            }
        };
        sent += bytes.len().div_ceil(64).max(1) as u64;
        round += 1;
        if b.machine.soc_mut().stack.send(bytes).is_none() {
            panic!("the device is gone after {sent} packets; log:\n{}", b.log_tail(10));
        }
        if round % 64 == 0 {
            b.run_for(2 * MILLISECOND).unwrap();
            while b.machine.soc().stack.host.queued(Pipe::Out(1)) > 64 {
                b.run_for(MILLISECOND).unwrap();
            }
        }
    }
    b.run_until(20 * SECOND, "end of the queue", |b| {
        b.machine.soc().stack.host.queued(Pipe::Out(1)) == 0
    })
    .unwrap();
    // An incomplete frame may still wait for its rest: a run of empty bytes longer than a frame ends it.
    b.send(vec![0; MAX_FRAME + 64]).unwrap();
    b.run_for(100 * MILLISECOND).unwrap();
    let counters = b.counters().unwrap();
    println!("{sent} packets in {round} transfers: {counters:?}");
    assert!(counters.malformed > 10_000, "{counters:?}");
    // Nothing but this question itself.
    assert_eq!(counters.commands, before.commands + 1, "{counters:?}");
    assert_eq!(counters.overruns, 0);
    assert_eq!(b.command(&Command::ReadSettings).unwrap(), settings, "settings unchanged");
    let now = b.status().unwrap();
    assert_eq!(
        (now.flags, now.digest, now.stream),
        (status.flags, status.digest, status.stream),
        "state unchanged"
    );
    assert_eq!(b.machine.resets.len(), 1);
    // Control requests that make no sense are stalled, and the device lives on.
    for i in 0..200u64 {
        let mut setup = [0; 8];
        setup.copy_from_slice(&noise.bytes(8));
        // Not SET_ADDRESS, SET_CONFIGURATION, SET_INTERFACE or endpoint halts: those are requests to obey (halts: below).
        setup[0] = [0xc0, 0xc1, 0xa0, 0xe1][i as usize % 4];
        control(&mut b, setup);
    }
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    b.link.clear();
    b.run_for(SECOND / 2).unwrap();
    assert_eq!((b.link.tally.missing, b.link.tally.bad), (0, 0));
    assert!(matches!(b.command(&Command::KeepAlive).unwrap(), Reply::Done { .. }));
}

/// Hosts clear halts that are none as well, to start over (macOS, FreeBSD); both sides begin with DATA0 then.
#[test]
fn a_stream_goes_on_after_a_halt() {
    let Some(image) = image() else { return };
    for address in [USB_ENDPOINT_IN, USB_ENDPOINT_OUT] {
        for with_halt in [false, true] {
            let what = format!("endpoint {address:#04x}, halted before: {with_halt}");
            let mut b = armed(&image, 32, |_| {});
            let before = b.counters().unwrap();
            b.stream(Fields::RECORDING, Profile::Exact).unwrap();
            for round in 0..40 {
                b.run_for(20 * MILLISECOND + round * 130 * MICROSECOND).unwrap();
                // A host takes back what it has queued before it asks. Packets wait in the endpoint, or not.
                read(&mut b, false);
                b.run_for(round % 3 * MILLISECOND).unwrap();
                if with_halt {
                    assert_eq!(halt(&mut b, address, true), Status::Done, "{what}");
                    assert!(is_halted(&mut b, address), "{what}");
                    if address == USB_ENDPOINT_IN {
                        // Every transfer ends at once.
                        read(&mut b, true);
                        b.run_for(MILLISECOND).unwrap();
                        read(&mut b, false);
                    } else {
                        let (_, bytes) = b.link.command(&Command::KeepAlive);
                        b.machine.soc_mut().stack.sent.clear();
                        b.send(bytes).unwrap();
                        b.run_for(MILLISECOND).unwrap();
                        let sent = b.machine.soc().stack.sent.back().copied();
                        assert_eq!(sent.map(|s| s.1), Some(Status::Stall), "{what}");
                    }
                }
                assert_eq!(halt(&mut b, address, false), Status::Done, "{what}");
                assert!(!is_halted(&mut b, address), "{what}");
                read(&mut b, true);
                let reply = b.command(&Command::KeepAlive).unwrap();
                assert!(matches!(reply, Reply::Done { .. }), "{what}: {reply:?}");
            }
            b.run_for(100 * MILLISECOND).unwrap();
            let tally = b.link.tally.clone();
            println!("{what}: {tally:?}");
            assert_eq!((tally.missing, tally.bad, tally.dropped), (0, 0, 0), "{what}: {tally:?}");
            assert!(tally.samples > 10_000, "{what}: {tally:?}");
            assert_eq!(b.link.malformed(), 0, "{what}");
            assert_eq!(b.machine.resets.len(), 1, "{what}");
            let after = b.counters().unwrap();
            assert_eq!(after.overruns, 0, "{what}");
            // None was lost or came twice: one a round, and this question itself.
            let commands = after.commands - before.commands;
            assert_eq!(commands, 42, "{what}");
        }
    }
}

/// An answer that is written while the endpoint is halted, and a packet that was taken before and not read yet.
#[test]
fn what_waits_at_a_halt_goes_on_after_it() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 34, |_| {});
    read(&mut b, false);
    halt(&mut b, USB_ENDPOINT_IN, true);
    let (sequence, bytes) = b.link.command(&Command::KeepAlive);
    b.send(bytes).unwrap();
    b.run_for(5 * MILLISECOND).unwrap();
    halt(&mut b, USB_ENDPOINT_IN, false);
    read(&mut b, true);
    b.run_until(SECOND, "answer", |b| b.link.reply(sequence).is_some()).unwrap();

    // The board takes packets ahead until its room is full; the last one stays in the endpoint.
    let before = b.counters().unwrap();
    read(&mut b, false);
    b.machine.soc_mut().stack.sent.clear();
    for _ in 0..100 {
        let (_, bytes) = b.link.command(&Command::KeepAlive);
        b.send(bytes).unwrap();
    }
    b.run_for(50 * MILLISECOND).unwrap();
    let now = b.now();
    let stack = &mut b.machine.soc_mut().stack;
    assert!(stack.host.queued(Pipe::Out(USB_ENDPOINT_OUT)) > 0, "there is room for all");
    stack.host.cancel(Pipe::Out(USB_ENDPOINT_OUT), now);
    halt(&mut b, USB_ENDPOINT_OUT, true);
    halt(&mut b, USB_ENDPOINT_OUT, false);
    read(&mut b, true);
    b.run_for(100 * MILLISECOND).unwrap();
    let sent = &b.machine.soc().stack.sent;
    let taken = sent.iter().filter(|(_, status)| *status == Status::Done).count() as u32;
    let commands = b.counters().unwrap().commands - before.commands;
    println!("{taken} of 100 commands were taken before the halt, {commands} obeyed");
    // And this question itself.
    assert_eq!(commands, taken + 1);
    assert_eq!(b.machine.resets.len(), 1);
}

/// The control pipe cannot be halted, and there are no endpoints but one each way.
#[test]
fn halts_of_other_endpoints_do_nothing() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 33, |_| {});
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    for number in (0..16).filter(|n| n | 0x80 != USB_ENDPOINT_IN) {
        for address in [number, number | 0x80] {
            for on in [true, false] {
                halt(&mut b, address, on);
                assert!(!is_halted(&mut b, address), "endpoint {address:#04x}");
            }
        }
    }
    b.run_for(100 * MILLISECOND).unwrap();
    assert!(matches!(b.command(&Command::KeepAlive).unwrap(), Reply::Done { .. }));
    let tally = &b.link.tally;
    assert_eq!((tally.missing, tally.bad, tally.dropped), (0, 0, 0), "{tally:?}");
    assert_eq!(b.machine.resets.len(), 1);
}
