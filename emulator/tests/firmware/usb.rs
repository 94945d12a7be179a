//! The device as a strict host sees it.

use emulator::bench::Bench;
use emulator::time::{MILLISECOND, SECOND};
use flexstage::generator::Multisine;
use flexstage::link::message::{Command, Refusal, Reply};
use flexstage::link::{self, Fields, Profile, message::SCHEMA_HASH};
use flexstage::{Flags, GeneratorSettings};

use crate::common::{armed, bench, image};

#[test]
fn enumerates_with_correct_descriptors() {
    let Some(image) = image() else { return };
    let mut b = Bench::handley(image, 1).unwrap();
    let device = b.enumerate().unwrap();
    println!("{device:#?}");
    assert_eq!((device.vid, device.pid), (link::USB_VENDOR_ID, link::USB_PRODUCT_ID));
    assert_eq!(device.strings[0], link::USB_MANUFACTURER);
    assert_eq!(device.strings[1], link::USB_PRODUCT);
    let uid = b.machine.soc().uid();
    assert!(
        device.strings[2].len() >= 12 && uid.iter().any(|w| *w != 0),
        "serial number {:?}",
        device.strings[2]
    );
    assert_eq!(device.usb, 0x0210, "BOS needs USB 2.1");
    assert_eq!(device.interfaces.len(), 1);
    assert_eq!(device.interfaces[0][1], 0xff, "vendor class");
    let mut endpoints: Vec<_> =
        device.endpoints.iter().map(|e| (e.address, e.kind, e.max_packet)).collect();
    endpoints.sort();
    assert_eq!(endpoints, [(link::USB_ENDPOINT_OUT, 2, 64), (link::USB_ENDPOINT_IN, 2, 64)]);
    assert_eq!(device.compatible_ids, ["WINUSB"]);
    assert_eq!(device.interface_guids.len(), 1);
    let guid = &device.interface_guids[0];
    assert!(guid.len() == 38 && guid.starts_with('{') && guid.ends_with('}'), "{guid}");
    assert!(device.max_power_ma <= 500);
    // embassy-usb answers DEVICE_QUALIFIER, which a full-speed-only device should refuse; hosts do not mind.
    let problems: Vec<_> =
        device.problems.iter().filter(|p| !p.contains("DEVICE_QUALIFIER")).collect();
    assert!(problems.is_empty(), "{problems:#?}");
}

#[test]
fn identifies_itself() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    let identity = b.identify().unwrap();
    println!("{identity:?}");
    assert_eq!(identity.schema, SCHEMA_HASH);
    assert_eq!(
        (identity.axes, identity.sample_rate_hz, identity.core_hz),
        (3, 10_000, 170_000_000)
    );
    assert_eq!(identity.has_crash_report, 0);
    assert_eq!(identity.has_stored_config, 0);
    assert_eq!(identity.self_test, 0, "self-test bits");
    let serial: String = identity.serial.iter().map(|b| format!("{b:02X}")).collect();
    assert_eq!(serial, b.machine.soc().stack.device().unwrap().strings[2]);
    assert_eq!(b.link.malformed(), 0);
}

#[test]
fn survives_reset_unplugging_and_sleep_of_the_host() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    for round in 0..3 {
        let now = b.now();
        match round {
            0 => b.machine.soc_mut().stack.host.reset(now),
            1 => {
                b.machine.soc_mut().stack.host.unplug(now);
                b.run_for(50 * MILLISECOND).unwrap();
                b.machine.soc_mut().stack.host.plug();
            }
            _ => {
                b.machine.soc_mut().stack.host.sleep(true, now);
                b.run_for(100 * MILLISECOND).unwrap();
                let now = b.now();
                b.machine.soc_mut().stack.host.sleep(false, now);
            }
        }
        b.run_for(10 * MILLISECOND).unwrap();
        b.run_until(2 * SECOND, "device after the interruption", |b| {
            b.machine.soc().stack.device().is_some()
        })
        .unwrap();
        b.identify().unwrap_or_else(|e| panic!("round {round}: {e}"));
    }
    let counters = b.counters().unwrap();
    println!("{counters:?}");
    assert_eq!(counters.overruns, 0);
}

/// A multisine is staged in 17 orders to the tick, one a tick: an order to open the loop that comes meanwhile acts at once.
#[test]
fn disarming_does_not_wait_for_staging() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 1, |_| {});
    b.stream(Fields::RECORDING, Profile::Packed).unwrap();
    b.run_for(20 * MILLISECOND).unwrap();
    b.link.samples = Some(Vec::new());
    let sent = u64::from(b.counters().unwrap().ticks);
    let multisine = GeneratorSettings::Multisine(Multisine {
        center_um: 5.0,
        peak_um: 1.0,
        base_hz: 1.0,
        first: 3,
        stride: 7,
        tones: 16,
        seed: 7,
        blend_s: 0.01,
        duration_s: 0.0,
    });
    let (staging, bytes) = b.link.command(&Command::Stage { axis: 0, generator: multisine });
    b.send(bytes).unwrap();
    let (disarming, bytes) = b.link.command(&Command::Disarm);
    b.send(bytes).unwrap();
    b.run_for(50 * MILLISECOND).unwrap();
    let tick = |reply| match reply {
        Some(Reply::Done { tick }) => u64::from(tick),
        other => panic!("{other:?}"),
    };
    let staged = b.link.reply(staging);
    let answered = tick(b.link.reply(disarming));
    let samples = b.link.samples.take().unwrap();
    let open = samples.iter().find(|s| !Flags(s.flags).state().is_active()).unwrap().tick;
    println!("sent at tick {sent}, open from {open}, disarming answered at {answered}; {staged:?}");
    assert!(open <= sent + 20, "sent at tick {sent}, open from {open}");
    assert!(open + 10 < answered, "open from tick {open}, the answer comes in turn: {answered}");
    // What is left of the staging finds the loop open.
    let refusal = Refusal::Control(flexstage::Refusal::NotArmed);
    assert_eq!(staged, Some(Reply::Refused(refusal)));
}
