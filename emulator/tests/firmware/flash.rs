//! Settings in flash: saved, read back after a restart, and whole after a power cut at any moment of a save.

use emulator::bench::Bench;
use emulator::cpu::Event;
use emulator::periph::ResetCause;
use emulator::periph::flash::{Cut, Operation};
use emulator::time::{MILLISECOND, SECOND};
use flexstage::Settings;
use flexstage::link::message::{Command, Reply};

use crate::common::{armed, bench, hold, image, settings};

fn with_gain(gain: f32) -> Settings {
    let mut s = settings();
    for axis in &mut s.axes {
        axis.feedback.proportional_v_per_um = gain;
    }
    s
}

fn gain_of(b: &mut Bench) -> f32 {
    match b.command(&Command::ReadSettings).unwrap() {
        Reply::Settings(s) => s.axes[2].feedback.proportional_v_per_um,
        other => panic!("ReadSettings was answered by {other:?}"),
    }
}

/// The program on the host finds the board again after it restarted.
fn back(b: &mut Bench) {
    b.run_until(2 * SECOND, "detached device", |b| b.machine.soc().stack.device().is_none())
        .unwrap();
    b.link.clear();
    b.enumerate().unwrap();
}

#[test]
fn saved_settings_survive_a_restart() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    for (version, gain) in [(1, 0.5), (2, 0.75), (3, 1.0)] {
        b.command(&Command::SetSettings(with_gain(gain))).unwrap();
        let ticks = b.counters().unwrap();
        let reply = b.command(&Command::Save).unwrap();
        assert!(matches!(reply, Reply::Saved { version: v, .. } if v == version), "{reply:?}");
        let after = b.counters().unwrap();
        assert_eq!(after.overruns, 0, "saving must not disturb the tick: {ticks:?} {after:?}");
        b.command(&Command::Reboot).unwrap();
        back(&mut b);
        assert_eq!(b.machine.resets.last().unwrap().1, ResetCause::Software);
        assert_eq!(gain_of(&mut b), gain);
        let identity = b.identify().unwrap();
        assert_eq!((identity.has_stored_config, identity.has_crash_report), (1, 0));
    }
    assert!(b.machine.soc().flash.violations.is_empty(), "{:?}", b.machine.soc().flash.violations);
}

#[test]
fn a_save_is_refused_unless_parked() {
    let Some(image) = image() else { return };
    let mut b = crate::common::armed(&image, 1, |_| {});
    for command in [Command::Save, Command::Reboot, Command::RebootToDfu] {
        let reply = b.ask(&command).unwrap();
        assert!(matches!(reply, Reply::Refused(_)), "{command:?}: {reply:?}");
    }
    assert!(b.machine.soc().flash.journal.is_empty());
}

/// Cuts the power at operation `n` of a save that replaces `old`, powers up again, and returns the gain found.
fn cut_at(b: &mut Bench, n: usize, how: Cut, new: f32) -> f32 {
    b.command(&Command::SetSettings(with_gain(new))).unwrap();
    b.machine.soc_mut().flash.seed(0x1234_5678 + n as u64 * 3 + how as u64);
    b.machine.soc_mut().flash.cut = Some((n, how));
    let (_, bytes) = b.link.command(&Command::Save);
    b.send(bytes).unwrap();
    let event = b.machine.run_for(2 * SECOND).unwrap();
    assert_eq!(event, Event::PowerLost, "operation {n} of the save");
    // Off for long enough that RAM forgets.
    b.machine.power_on(Some(n as u64));
    back(b);
    gain_of(b)
}

#[test]
fn power_cut_at_every_program_and_erase_leaves_old_or_new() {
    let Some(image) = image() else { return };
    // How many operations a save has: the third one overwrites an old slot, as every later one does.
    let mut b = bench(&image, 1);
    for gain in [0.5, 0.75] {
        b.command(&Command::SetSettings(with_gain(gain))).unwrap();
        b.command(&Command::Save).unwrap();
    }
    let before = b.machine.soc().flash.journal.len();
    b.command(&Command::SetSettings(with_gain(1.0))).unwrap();
    b.command(&Command::Save).unwrap();
    let journal = b.machine.soc().flash.journal[before..].to_vec();
    let erases = journal.iter().filter(|(_, o)| matches!(o, Operation::Erase(_))).count();
    println!("a save: {} double words, {erases} erases, {:.1} ms", journal.len() - erases, {
        (journal.last().unwrap().0 - journal[0].0) as f64 / MILLISECOND as f64
    });
    assert!(journal.len() >= 10 && erases >= 1);

    let mut gain = gain_of(&mut b);
    let (mut old, mut new, mut ecc) = (0, 0, 0);
    for (n, (_, operation)) in journal.iter().enumerate() {
        for how in [Cut::Before, Cut::Torn, Cut::After] {
            let base = b.machine.soc().flash.journal.len();
            let next = if gain == 1.0 { 1.25 } else { 1.0 };
            let found = cut_at(&mut b, base + n, how, next);
            assert!(
                found == gain || found == next,
                "cut {how:?} at {n} ({operation:?}): gain {found}, expected {gain} or {next}"
            );
            let identity = b.identify().unwrap();
            assert_eq!(identity.has_stored_config, 1, "cut {how:?} at {n}");
            if found == next {
                new += 1
            } else {
                old += 1
            }
            ecc += (b.counters().unwrap().flash_errors > 0) as u32;
            // A whole save must work again, from whatever the cut left.
            gain = found;
        }
    }
    println!(
        "{} cuts: {old} left the old settings, {new} the new; {ecc} boots met words that fail their ECC",
        old + new
    );
    assert!(old > 0 && new > 0 && ecc > 0, "the cuts cover both outcomes and torn words");
    // After all this a save still works.
    b.command(&Command::SetSettings(with_gain(2.0))).unwrap();
    b.command(&Command::Save).unwrap();
    b.command(&Command::Reboot).unwrap();
    back(&mut b);
    assert_eq!(gain_of(&mut b), 2.0);
    assert!(b.machine.soc().flash.violations.is_empty(), "{:?}", b.machine.soc().flash.violations);
}

#[test]
fn reboots_into_the_dfu_loader() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    b.command(&Command::RebootToDfu).unwrap();
    let mut reached = false;
    for _ in 0..2_000 {
        match b.machine.run_for(MILLISECOND).unwrap() {
            Event::Bootloader => {
                reached = true;
                break;
            }
            _ => continue,
        }
    }
    assert!(reached, "the ROM loader was not entered; the core is at {}", b.machine.location());
    // As after a reset: the loader finds the clocks and USB as it expects them.
    assert_eq!(b.machine.soc().rcc.sysclk_hz(), Some(16_000_000));
    assert!(!b.machine.soc().usb.attached());
    assert!(!b.machine.soc().iwdg.running(), "the watchdog would reset the loader");
    // And back: power off and on boots the firmware.
    b.machine.power_on(None);
    back(&mut b);
    b.identify().unwrap();
}

#[test]
fn a_fault_is_reported_after_the_reset() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    // A fault in a task: the core is sent to an address where no code is.
    b.machine.derail(0x0003_fff0 | 0x3000_0000).unwrap();
    let message = crash_report(&mut b);
    assert!(message.starts_with("hard fault at "), "{message}");
}

#[test]
fn a_panic_is_reported_after_the_reset() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 1, |_| {});
    b.start(&[(0, hold(8.0))]).unwrap();
    b.run_for(SECOND / 2).unwrap();
    b.machine.panic("index out of bounds", "src/board/somewhere.rs", 123).unwrap();
    let message = crash_report(&mut b);
    assert!(message.contains("index out of bounds"), "{message}");
    assert!(message.contains("src/board/somewhere.rs:123"), "{message}");
}

#[test]
fn a_crash_is_of_the_last_run_only() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 1);
    // A start before the crash, so that it is not the first run that ends with it.
    for (run, ends) in ["reboot", "crash", "reboot", "reboot", "crash", "crash", "power", "reboot"]
        .into_iter()
        .enumerate()
    {
        let resets = b.machine.resets.len();
        match ends {
            "crash" => b.machine.panic("index out of bounds", "src/somewhere.rs", 1).unwrap(),
            // Off for so short a time that RAM forgets nothing.
            "power" => b.machine.reset(ResetCause::PowerOn),
            _ => {
                b.command(&Command::Reboot).unwrap();
            }
        }
        b.run_until(5 * SECOND, "restart", |b| b.machine.resets.len() > resets).unwrap();
        back(&mut b);
        let has_crashed = ends == "crash";
        let what = format!("run {run} ended by {ends}");
        assert_eq!(b.identify().unwrap().has_crash_report != 0, has_crashed, "{what}");
        let Reply::Crash(crash) = b.command(&Command::Crash).unwrap() else { panic!("{what}") };
        assert_eq!(!crash.message.is_empty(), has_crashed, "{what}: {:?}", crash.message);
    }
    let said = b.machine.rtt.lines.iter().filter(|l| l.text.contains("the last run crashed"));
    assert_eq!(said.count(), 3);
}

/// Waits for the restart; what it reports, and that the loop works again.
fn crash_report(b: &mut Bench) -> String {
    b.run_until(5 * SECOND, "restart", |b| b.machine.resets.len() > 1).unwrap();
    println!("reset {:?}", b.machine.resets.last().unwrap());
    back(b);
    let identity = b.identify().unwrap();
    assert_eq!(identity.has_crash_report, 1);
    let message = match b.command(&Command::Crash).unwrap() {
        Reply::Crash(crash) => crash.message.to_string(),
        other => panic!("{other:?}"),
    };
    println!("crash report: {message:?}");
    // The loop works again.
    b.command(&Command::SetSettings(settings())).unwrap();
    b.arm().unwrap();
    message
}
