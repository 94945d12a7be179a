//! A hundred thousand packets that no honest host sends change nothing, and are counted.

use emulator::time::{MILLISECOND, SECOND};
use flexstage::link::message::{Command, Reply};
use flexstage::link::{Fields, Kind, MAX_FRAME, Profile, encode};

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
            while b.machine.soc().stack.host.queued(emulator::usb_host::Pipe::Out(1)) > 64 {
                b.run_for(MILLISECOND).unwrap();
            }
        }
    }
    b.run_until(20 * SECOND, "end of the queue", |b| {
        b.machine.soc().stack.host.queued(emulator::usb_host::Pipe::Out(1)) == 0
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
        // Not SET_ADDRESS, SET_CONFIGURATION, SET_INTERFACE or endpoint halts: those are requests to obey.
        setup[0] = [0xc0, 0xc1, 0xa0, 0xe1][i as usize % 4];
        let now = b.now();
        let id = b.machine.soc_mut().stack.control(setup, Vec::new(), now);
        b.run_until(2 * SECOND, "answer to a control request", |b| {
            b.machine.soc_mut().stack.control_result(id).is_some()
        })
        .unwrap();
    }
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    b.link.clear();
    b.run_for(SECOND / 2).unwrap();
    assert_eq!((b.link.tally.missing, b.link.tally.bad), (0, 0));
    assert!(matches!(b.command(&Command::KeepAlive).unwrap(), Reply::Done { .. }));
}
