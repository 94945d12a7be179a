//! A waveform waits for its start once all of it has come, and what waits does not touch what runs.

mod common;

use common::Bench;
use flexstage::generator::{Multisine, PARTS, Wave};
use flexstage::{Command, Generator, GeneratorSettings, Record, Refusal, Settings};

fn multisine(seed: u32) -> Generator {
    Generator::build(&GeneratorSettings::Multisine(Multisine {
        center_um: 6.0,
        peak_um: 4.0,
        base_hz: 3.0,
        first: 2,
        stride: 3,
        tones: 16,
        seed,
        blend_s: 0.05,
        duration_s: 0.0,
    }))
    .unwrap()
}

fn sine() -> Generator {
    Generator::build(&GeneratorSettings::Sine(Wave::between(3.0, 9.0, 7.0))).unwrap()
}

fn armed() -> Bench {
    let mut settings = Settings::default();
    settings.guard.arming_s = 0.01;
    let mut bench = Bench::new(&settings, 7.52);
    bench.arm();
    bench
}

fn tell(bench: &mut Bench, command: Command) -> Result<(), Refusal> {
    bench.controller.command(&bench.config, command)
}

const START: Command = Command::Start { axes: 1 };

#[test]
fn an_incomplete_staging_is_refused() {
    let commands: Vec<Command> = multisine(1).staging(0).collect();
    assert_eq!(commands.len(), 1 + PARTS);
    assert_eq!(sine().staging(0).count(), 1);
    // Each command but the last leaves it incomplete, and so does each that is left out: then its successor is refused.
    for left_out in 1..commands.len() {
        let mut bench = armed();
        for command in &commands[..left_out] {
            tell(&mut bench, *command).unwrap();
            assert_eq!(tell(&mut bench, START), Err(Refusal::NothingStaged));
            bench.tick();
        }
        for command in &commands[left_out + 1..] {
            assert_eq!(tell(&mut bench, *command), Err(Refusal::NothingStaged));
        }
        assert_eq!(tell(&mut bench, START), Err(Refusal::NothingStaged), "without {left_out}");
        for command in &commands[left_out..] {
            tell(&mut bench, *command).unwrap();
        }
        tell(&mut bench, START).unwrap();
        assert_eq!(tell(&mut bench, START), Err(Refusal::NothingStaged), "it waits no longer");
    }
}

#[test]
fn parts_that_nothing_waits_for_are_refused() {
    let mut bench = armed();
    let commands: Vec<Command> = multisine(1).staging(0).collect();
    assert_eq!(tell(&mut bench, commands[1]), Err(Refusal::NothingStaged));
    let words = [i32::MIN; 16];
    for part in 0..=u8::MAX {
        let far = Command::StagePart { axis: 3, part, words };
        assert_eq!(tell(&mut bench, far), Err(Refusal::NoSuchAxis));
    }
    bench.stage(0, multisine(1));
    assert_eq!(tell(&mut bench, commands[1]), Err(Refusal::NothingStaged), "it has all of them");
    // Another waveform takes its place: its parts are not waited for.
    tell(&mut bench, commands[0]).unwrap();
    bench.stage(0, sine());
    assert_eq!(tell(&mut bench, commands[1]), Err(Refusal::NothingStaged));
    tell(&mut bench, commands[0]).unwrap();
    for part in PARTS as u8..=u8::MAX {
        let wrong = Command::StagePart { axis: 0, part, words };
        assert_eq!(tell(&mut bench, wrong), Err(Refusal::NothingStaged), "part {part}");
    }
}

fn same(a: &Record, b: &Record, when: &str) {
    assert_eq!(a.axes, b.axes, "{when}, tick {}", a.tick);
}

#[test]
fn what_is_staged_leaves_what_runs_alone() {
    let (mut disturbed, mut alone) = (armed(), armed());
    for bench in [&mut disturbed, &mut alone] {
        bench.stage(0, multisine(1));
        tell(bench, START).unwrap();
    }
    // One command a tick, as on the board; staged twice, and never started at first.
    for command in multisine(2).staging(0).chain(multisine(3).staging(0)).chain(sine().staging(1)) {
        tell(&mut disturbed, command).unwrap();
        for _ in 0..3 {
            same(&disturbed.tick(), &alone.tick(), "while another one is staged");
        }
    }
    for _ in 0..1_000 {
        same(&disturbed.tick(), &alone.tick(), "while another one waits");
    }
    // The one that was staged last is the one that starts.
    alone.stage(0, multisine(3));
    for bench in [&mut disturbed, &mut alone] {
        tell(bench, START).unwrap();
    }
    for _ in 0..1_000 {
        same(&disturbed.tick(), &alone.tick(), "after its start");
    }
    // Back and forth: each start takes the room of the one that ran before.
    for (seed, ticks) in [(4, 5), (5, 16), (6, 1), (7, 100)] {
        for bench in [&mut disturbed, &mut alone] {
            bench.stage(0, multisine(seed));
            tell(bench, START).unwrap();
        }
        tell(&mut disturbed, multisine(9).staging(0).next().unwrap()).unwrap();
        for _ in 0..ticks {
            same(&disturbed.tick(), &alone.tick(), "in turns");
        }
    }
}

#[test]
fn the_loop_that_opens_forgets_what_waits() {
    let mut bench = armed();
    bench.stage(0, multisine(1));
    tell(&mut bench, Command::Disarm).unwrap();
    bench.tick();
    bench.arm();
    assert_eq!(tell(&mut bench, START), Err(Refusal::NothingStaged));
    bench.stage(0, multisine(1));
    tell(&mut bench, START).unwrap();
}
