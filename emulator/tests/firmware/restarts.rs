//! Whatever ends a run of the firmware brings the drives to where they will float before it lets go of them, and does it slowly.

use emulator::bench::Bench;
use emulator::time::{MILLISECOND, SECOND};
use flexstage::link::message::{Command, Refusal, Reply};
use flexstage::link::session::ready;
use flexstage::store::{MAX_PAYLOAD, Memory, MemoryError, SLOT_BYTES, save};
use flexstage::{Faults, Flags, Settings};

use crate::common::{armed, bench, hold, image, settings};

/// Largest step of a drive: 13 codes a millisecond without a controller (docs/board.md), and one of noise shaping.
const SOFT_STEP_V: f64 = 14.0 * 0.039_07;

/// A board whose drives are up.
fn raised(image: &std::rc::Rc<emulator::cpu::image::Image>, seed: u64) -> Bench {
    let mut b = armed(image, seed, |_| {});
    b.start(&[(0, hold(8.0)), (1, hold(12.0)), (2, hold(10.0))]).unwrap();
    b.run_for(SECOND / 2).unwrap();
    let drives = b.board.0.borrow().drive_v();
    assert!(drives.iter().all(|volts| *volts > 50.0), "{drives:?} V");
    b.board.0.borrow_mut().fastest_step_v = 0.0;
    b
}

fn ends_softly(b: &mut Bench, what: &str) {
    let before = b.machine.resets.len();
    b.run_until(3 * SECOND, "reset", |b| b.machine.resets.len() > before).unwrap();
    b.run_for(20 * MILLISECOND).unwrap();
    let board = b.board.0.borrow();
    let (step, drives) = (board.fastest_step_v, board.drive_v());
    println!("{what}: {:?}, steps of {step:.3} V at most", b.machine.resets.last().unwrap().1);
    assert!(step > 0.0 && step <= SOFT_STEP_V, "{what}: a step of {step} V");
    assert!(drives.iter().all(|volts| volts.abs() < 0.05), "{what}: {drives:?} V");
}

#[test]
fn a_panic_ends_softly() {
    let Some(image) = image() else { return };
    let mut b = raised(&image, 41);
    b.machine.panic("index out of bounds", "src/board/somewhere.rs", 123).unwrap();
    ends_softly(&mut b, "panic");
}

#[test]
fn a_hard_fault_ends_softly() {
    let Some(image) = image() else { return };
    let mut b = raised(&image, 42);
    // No code is there.
    b.machine.derail(0x0003_fff0 | 0x3000_0000).unwrap();
    ends_softly(&mut b, "hard fault");
}

#[test]
fn tasks_that_hang_end_softly() {
    let Some(image) = image() else { return };
    let mut b = raised(&image, 43);
    // The tick goes on: it returns the drives before the watchdog bites.
    b.machine.derail_task_into_loop().unwrap();
    ends_softly(&mut b, "tasks hang");
}

#[test]
fn tasks_that_pause_are_found_and_the_drives_return() {
    let Some(image) = image() else { return };
    let mut b = raised(&image, 43);
    // Longer than the tick is patient, and shorter than the watchdog.
    b.machine.hold_task(700 * MILLISECOND).unwrap();
    let status = b.status().unwrap();
    assert_eq!(b.machine.resets.len(), 1);
    let (faults, step) = (Flags(status.flags).faults(), b.board.0.borrow().fastest_step_v);
    assert_eq!(faults, Faults::STARVED, "{:?}", faults.names().collect::<Vec<_>>());
    assert!(Flags(status.flags).is_parked());
    assert!(step > 0.0 && step <= SOFT_STEP_V, "a step of {step} V");
}

#[test]
fn a_restart_ends_softly_where_the_drives_are_parked_up() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 44);
    let mut parked_up = settings();
    parked_up.guard.safe_v = 60.0;
    b.command(&Command::SetSettings(parked_up)).unwrap();
    b.run_for(SECOND / 2).unwrap();
    let drives = b.board.0.borrow().drive_v();
    assert!(drives.iter().all(|volts| *volts > 59.0), "{drives:?} V");
    b.board.0.borrow_mut().fastest_step_v = 0.0;
    b.command(&Command::Reboot).unwrap();
    // Nothing begins in the time that the reply has to leave.
    let reply = b.ask(&Command::Arm).unwrap();
    assert_eq!(reply, Reply::Refused(Refusal::Busy));
    ends_softly(&mut b, "restart, parked at 60 V");
}

/// Flash as a host has it.
struct Slots([Vec<u8>; 2]);

impl Memory for Slots {
    fn read(&self, slot: u8) -> Result<&[u8], MemoryError> {
        Ok(&self.0[usize::from(slot)])
    }
    async fn erase(&mut self, slot: u8) -> Result<(), MemoryError> {
        self.0[usize::from(slot)].fill(0xff);
        Ok(())
    }
    async fn program(
        &mut self,
        slot: u8,
        offset: usize,
        bytes: [u8; 8],
    ) -> Result<(), MemoryError> {
        self.0[usize::from(slot)][offset..offset + 8].copy_from_slice(&bytes);
        Ok(())
    }
}

#[test]
fn settings_in_flash_for_other_converters_are_reported() {
    let Some(image) = image() else { return };
    // As a firmware saved them that did not ask.
    let mut wrong = settings();
    wrong.axes[0].dac.full_code = 8_191;
    let mut slots = Slots([vec![0xff; SLOT_BYTES], vec![0xff; SLOT_BYTES]]);
    let mut scratch = [0; MAX_PAYLOAD];
    let (_, slot) = ready(save(&mut slots, &wrong, &mut scratch)).unwrap().unwrap();
    assert_eq!(slot, 0);
    let mut b = bench(&image, 46);
    b.machine.soc_mut().flash.overwrite(0, &slots.0[0]);
    b.machine.power_on(None);
    b.run_for(100 * MILLISECOND).unwrap();
    b.enumerate().unwrap();
    let status = b.status().unwrap();
    assert!(Flags(status.flags).faults().contains(Faults::BAD_CONFIG), "{:?}", status.flags);
    let reply = b.command(&Command::ReadSettings).unwrap();
    assert_eq!(reply, Reply::Settings(Settings::default()));
}

#[test]
fn codes_that_the_converters_do_not_have_are_refused() {
    let Some(image) = image() else { return };
    let mut b = bench(&image, 45);
    type Change = fn(&mut Settings);
    let changes: [(&str, Change); 3] = [
        ("dac", |s| s.axes[2].dac.full_code = 8_191),
        ("gauge", |s| s.axes[2].gauge.full_code = 65_535),
        ("monitor", |s| s.axes[2].monitor.full_code = 4_095),
    ];
    for (group, change) in changes {
        let mut wrong = settings();
        change(&mut wrong);
        let reply = b.ask(&Command::SetSettings(wrong)).unwrap();
        let Reply::Refused(Refusal::Settings(bad)) = reply else { panic!("{group}: {reply:?}") };
        assert_eq!(
            (bad.group.as_str(), bad.field.as_str(), bad.axis),
            (group, "full_code", Some(3))
        );
    }
}
