//! Every fault that can be injected, in the running image: its code, how fast, how softly, and that the board recovers.

use emulator::bench::Bench;
use emulator::board::{AmplifierFault, GaugeFault};
use emulator::periph::ResetCause;
use emulator::time::{MILLISECOND, SECOND, TICK, milliseconds};
use flexstage::generator::Wave;
use flexstage::link::message::Command;
use flexstage::link::{Fields, Profile};
use flexstage::{AXES, Faults, Flags, GeneratorSettings, Settings, State};

use crate::common::{armed, bench, hold, image, settings};

/// Fastest a drive may move after a fault was found: the return rate of the settings, plus one DAC code of noise shaping.
const SOFT_V_PER_MS: f64 = 0.5 + 0.1;

fn watched(s: &mut Settings) {
    for axis in &mut s.axes {
        axis.feedback.proportional_v_per_um = 0.5;
        axis.feedback.integral_v_per_um_s = 100.0;
        axis.limits.following_error_um = 1.0;
    }
    s.guard.monitor_error_v = 15.0;
    s.guard.monitor_error_s = 0.02;
}

struct Row {
    fault: &'static str,
    codes: Faults,
    after_ms: f64,
    slope: f64,
    recovered: &'static str,
}

fn moving(b: &mut Bench) {
    let wave = |hz| GeneratorSettings::Sine(Wave::between(2.0, 8.0, hz));
    b.start(&[(0, wave(2.0)), (1, wave(3.0)), (2, wave(5.0))]).unwrap();
    b.run_for(SECOND / 2).unwrap();
}

/// Codes that a fault must raise, and those that it may raise besides; no others.
#[derive(Clone, Copy)]
struct Expected {
    must: Faults,
    may: Faults,
}

fn only(must: Faults) -> Expected {
    Expected { must, may: Faults::NONE }
}

impl Expected {
    fn or_also(self, may: Faults) -> Self {
        Expected { may, ..self }
    }

    fn check(self, fault: &str, codes: Faults) {
        let (must, all) = (self.must, self.must.with(self.may));
        assert!(
            codes.contains(must) && all.contains(codes),
            "{fault}: {:?}, expected {:?} and no others than {:?}",
            names(codes),
            names(must),
            names(all)
        );
    }
}

/// Injects a fault into a moving board, follows it to rest, repairs it, and starts again.
fn try_fault(
    b: &mut Bench,
    fault: &'static str,
    expected: Expected,
    inject: impl FnOnce(&mut Bench),
    repair: impl FnOnce(&mut Bench),
) -> Row {
    moving(b);
    b.link.clear();
    b.link.samples = Some(Vec::new());
    let before = b.counters().unwrap();
    let edge = b.machine.soc().triggers;
    let tick_offset = edge - before.ticks as u64;
    inject(b);
    b.run_for(2 * SECOND).unwrap();
    let samples = b.link.samples.take().unwrap();
    let found = samples.iter().position(|s| !Flags(s.flags).faults().is_empty());
    let found = found.unwrap_or_else(|| panic!("{fault}: no fault within 2 s"));
    let at = samples[found].tick + tick_offset;
    let last = samples.last().unwrap();
    let codes = samples.iter().fold(0, |f, s| f | Flags(s.flags).faults().to_bits());
    let codes = Faults::from_bits(codes);
    expected.check(fault, codes);
    let volts = |bits: i32| bits as f64 / (1u32 << 22) as f64;
    let mut slope = 0.0f64;
    for pair in samples[found..].windows(2) {
        if pair[1].tick == pair[0].tick + 1 {
            for k in 0..AXES {
                slope = slope.max((volts(pair[1].drive[k]) - volts(pair[0].drive[k])).abs() * 10.0);
            }
        }
    }
    assert_eq!(Flags(last.flags).state(), State::Fault, "{fault}");
    assert!(Flags(last.flags).is_parked(), "{fault}: drives {:?} V", last.drive.map(volts));
    assert!(slope <= SOFT_V_PER_MS, "{fault}: {slope:.2} V/ms after it was found");
    // A trigger without a tick has no record, and is told from a loss on the way by the board's own count.
    let tally = &b.link.tally;
    assert_eq!(tally.missing, u64::from(tally.dropped), "{fault}: samples lost on the way");
    if !expected.must.contains(Faults::OVERRUN) {
        assert_eq!(tally.missing, 0, "{fault}: samples lost");
    }
    repair(b);
    b.run_for(50 * MILLISECOND).unwrap();
    b.command(&Command::ClearFaults).unwrap();
    b.arm().unwrap_or_else(|e| panic!("{fault}: {e}"));
    let overruns = b.counters().unwrap().overruns - before.overruns;
    assert!(
        overruns == 0 || expected.must.contains(Faults::OVERRUN),
        "{fault}: {overruns} ticks missed"
    );
    let after_ms = at.saturating_sub(edge) as f64 * milliseconds(TICK);
    Row { fault, codes, after_ms, slope, recovered: "repaired, cleared, armed" }
}

fn names(f: Faults) -> Vec<&'static str> {
    f.names().collect()
}

fn print(rows: &[Row]) {
    println!("| fault | code | found after | fastest drive after that | recovered |");
    println!("|---|---|---:|---:|---|");
    for r in rows {
        println!(
            "| {} | {} | {:.1} ms | {:.2} V/ms | {} |",
            r.fault,
            names(r.codes).join(" "),
            r.after_ms,
            r.slope,
            r.recovered
        );
    }
}

fn gauge(fault: GaugeFault) -> impl FnOnce(&mut Bench) {
    move |b| b.board.0.borrow_mut().gauge_fault[1] = Some(fault)
}

fn amplifier(fault: AmplifierFault) -> impl FnOnce(&mut Bench) {
    move |b| b.board.0.borrow_mut().amplifier_fault[1] = Some(fault)
}

fn whole(b: &mut Bench) {
    let mut board = b.board.0.borrow_mut();
    board.gauge_fault = [None; AXES];
    board.amplifier_fault = [None; AXES];
}

#[test]
fn gauges_and_amplifiers() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 21, watched);
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    let railed = only(Faults::RAILED).or_also(Faults::TRAVEL);
    let frozen = b.board.0.borrow().newest.unwrap().gauge[1];
    let rows = vec![
        try_fault(&mut b, "gauge open", railed, gauge(GaugeFault::Open), whole),
        try_fault(&mut b, "gauge short", railed, gauge(GaugeFault::Short), whole),
        try_fault(
            &mut b,
            "gauge stuck",
            only(Faults::STUCK),
            gauge(GaugeFault::Stuck(frozen)),
            whole,
        ),
        try_fault(
            &mut b,
            "gauge noisy",
            only(Faults::DISCONNECTED),
            |b| {
                // A burst: the guard holds jumps against a gauge for a while after they are over.
                b.board.0.borrow_mut().gauge_fault[1] = Some(GaugeFault::Noisy(12_000));
                b.run_for(20 * MILLISECOND).unwrap();
                whole(b);
            },
            |b| b.run_for(300 * MILLISECOND).unwrap(),
        ),
        try_fault(
            &mut b,
            "gauges swapped",
            only(Faults::FOLLOWING_ERROR),
            |b| {
                let mut board = b.board.0.borrow_mut();
                board.gauge_fault[0] = Some(GaugeFault::Swapped(2));
                board.gauge_fault[2] = Some(GaugeFault::Swapped(0));
            },
            whole,
        ),
        try_fault(
            &mut b,
            "over-travel",
            only(Faults::TRAVEL).or_also(Faults::RAILED),
            gauge(GaugeFault::Pushed(12.0)),
            whole,
        ),
        try_fault(
            &mut b,
            "amplifier dead",
            only(Faults::MONITOR),
            amplifier(AmplifierFault::Dead),
            whole,
        ),
        try_fault(
            &mut b,
            "amplifier railed",
            only(Faults::MONITOR),
            amplifier(AmplifierFault::Railed(150.0)),
            whole,
        ),
        try_fault(
            &mut b,
            "monitor disagrees",
            only(Faults::MONITOR),
            amplifier(AmplifierFault::Monitor(40.0)),
            whole,
        ),
    ];
    print(&rows);
}

#[test]
fn converters_time_and_silence() {
    let Some(image) = image() else { return };
    let mut rows = Vec::new();
    for (index, name) in [
        (0, "ADC1 stops converting"),
        (2, "ADC3 stops converting"),
        (4, "ADC5 (monitor) stops converting"),
    ] {
        let mut b = armed(&image, 22, watched);
        b.stream(Fields::RECORDING, Profile::Exact).unwrap();
        rows.push(try_fault(
            &mut b,
            name,
            only(Faults::CONVERTER),
            move |b| b.machine.soc_mut().adc[index].dead = true,
            move |b| b.machine.soc_mut().adc[index].dead = false,
        ));
    }
    let mut b = armed(&image, 23, watched);
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    rows.push(try_fault(
        &mut b,
        "tick too long",
        only(Faults::OVERRUN),
        |b| {
            // Ten times as many cycles for every instruction, for 2 ms.
            b.machine.soc_mut().set_cycles_per_instruction(160);
            b.run_for(2 * MILLISECOND).unwrap();
            b.machine.soc_mut().set_cycles_per_instruction(16);
        },
        |_| {},
    ));
    let mut b = armed(&image, 24, |s| {
        watched(s);
        s.guard.command_timeout_s = 1.2;
    });
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    let expected = only(Faults::COMMAND_TIMEOUT);
    rows.push(try_fault(&mut b, "command silence", expected, |_| {}, |_| {}));
    print(&rows);
}

/// At rest a converter that stops says what it should: nothing else gives it away for long.
#[test]
fn a_converter_that_stops_at_rest_is_found() {
    let Some(image) = image() else { return };
    for index in 0..5 {
        let mut b = armed(&image, 22, watched);
        b.start(&[(0, hold(5.0)), (1, hold(5.0)), (2, hold(5.0))]).unwrap();
        b.run_for(SECOND).unwrap();
        assert_eq!(Flags(b.status().unwrap().flags).state(), State::Hold);
        b.machine.soc_mut().adc[index].dead = true;
        b.run_for(2 * MILLISECOND).unwrap();
        let status = b.status().unwrap();
        only(Faults::CONVERTER)
            .check(&format!("ADC{} stops at rest", index + 1), Flags(status.flags).faults());
    }
}

#[test]
fn time_goes_on_where_no_tick_ran() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 29, watched);
    moving(&mut b);
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    b.run_for(20 * MILLISECOND).unwrap();
    // An answer comes some ticks after it was written: the quickest of several.
    let ahead = |b: &mut Bench| {
        let once = |_| {
            let ticks = b.counters().unwrap().ticks;
            b.machine.soc().triggers.abs_diff(u64::from(ticks))
        };
        (0..20).map(once).min().expect("twenty answers")
    };
    let before = ahead(&mut b);
    // A tick takes more than two periods, and every second trigger at least finds the one before still waiting.
    b.machine.soc_mut().set_cycles_per_instruction(800);
    b.run_for(5 * MILLISECOND).unwrap();
    b.machine.soc_mut().set_cycles_per_instruction(16);
    b.run_for(50 * MILLISECOND).unwrap();
    let (after, tally) = (ahead(&mut b), b.link.tally.clone());
    assert!(tally.missing >= 25, "{tally:?}");
    assert_eq!(tally.missing, u64::from(tally.dropped), "{tally:?}");
    assert!(
        after.abs_diff(before) <= 2,
        "triggers ahead of ticks: {before}, then {after}; {tally:?}"
    );
    println!("triggers ahead of ticks: {before}, then {after}; {tally:?}");
}

#[test]
fn resets_in_motion() {
    let Some(image) = image() else { return };
    println!("| fault | how the board came back |");
    println!("|---|---|");
    // The watchdog: the tick and everything else stop for good.
    let mut b = armed(&image, 25, watched);
    moving(&mut b);
    let at = b.now();
    b.machine.derail_into_loop().unwrap();
    b.run_until(3 * SECOND, "reset by the watchdog", |b| b.machine.resets.len() > 1).unwrap();
    let (when, cause) = *b.machine.resets.last().unwrap();
    assert!(matches!(cause, ResetCause::Watchdog | ResetCause::Software), "{cause:?}");
    println!("| tasks starved | {cause:?} reset after {:.0} ms |", milliseconds(when - at));
    comes_back(&mut b);

    // Brown-out: the supply fails and returns, RAM forgets.
    for noise in [None, Some(77)] {
        let mut b = armed(&image, 26, watched);
        moving(&mut b);
        b.machine.power_on(noise);
        b.run_for(MILLISECOND).unwrap();
        let codes = [(0, 0), (0, 1), (1, 0)].map(|(d, c)| b.machine.soc().dac[d].output(c));
        assert_eq!(codes, [Some(256); 3], "parked again within 1 ms");
        comes_back(&mut b);
        println!(
            "| brown-out in motion, RAM {} | parked within 1 ms, Off |",
            if noise.is_some() { "lost" } else { "wiped" }
        );
    }

    // Damaged settings in both slots: reported, defaults, no motion.
    let mut b = bench(&image, 27);
    b.command(&Command::SetSettings(settings())).unwrap();
    b.command(&Command::Save).unwrap();
    let written: Vec<usize> =
        (0..0x6000).filter(|i| b.machine.soc().flash.bytes()[*i] != 0xff).collect();
    let middle = written[written.len() / 2];
    let old = b.machine.soc().flash.bytes()[middle];
    b.machine.soc_mut().flash.overwrite(middle, &[old ^ 0x10]);
    b.machine.power_on(None);
    b.run_for(100 * MILLISECOND).unwrap();
    b.enumerate().unwrap();
    let status = b.status().unwrap();
    let faults = Flags(status.flags).faults();
    println!("| settings in flash corrupted | {} |", names(faults).join(" "));
    assert!(faults.contains(Faults::BAD_CONFIG), "{:?}", names(faults));
    b.command(&Command::SetSettings(settings())).unwrap();
    b.command(&Command::ClearFaults).unwrap();
    b.command(&Command::Save).unwrap();
    b.arm().unwrap();
}

fn comes_back(b: &mut Bench) {
    b.run_for(50 * MILLISECOND).unwrap();
    b.enumerate().unwrap();
    let status = b.status().unwrap();
    assert_eq!(Flags(status.flags).state(), State::Off);
    b.command(&Command::SetSettings(settings())).unwrap();
    b.arm().unwrap();
}

#[test]
fn usb_trouble_mid_stream_does_not_touch_the_loop() {
    let Some(image) = image() else { return };
    println!("| fault | ticks missed | stream |");
    println!("|---|---:|---|");
    for what in ["reset", "unplug", "sleep"] {
        let mut b = armed(&image, 28, watched);
        b.stream(Fields::RECORDING, Profile::Packed).unwrap();
        moving(&mut b);
        let now = b.now();
        match what {
            "reset" => b.machine.soc_mut().stack.host.reset(now),
            "unplug" => b.machine.soc_mut().stack.host.unplug(now),
            _ => b.machine.soc_mut().stack.host.sleep(true, now),
        }
        b.run_for(300 * MILLISECOND).unwrap();
        b.machine.soc_mut().stack.host.plug();
        let now = b.now();
        b.machine.soc_mut().stack.host.sleep(false, now);
        b.run_for(100 * MILLISECOND).unwrap();
        b.enumerate().unwrap();
        b.link = Default::default();
        b.stream(Fields::RECORDING, Profile::Packed).unwrap();
        b.run_for(SECOND).unwrap();
        let t = b.link.tally.clone();
        assert_eq!((t.missing, t.bad), (0, 0), "{what}: {t:?}");
        assert!(t.samples > 9_000, "{what}: {t:?}");
        assert_eq!(b.machine.soc().trigger_period, (TICK, TICK), "{what}");
        let counters = b.counters().unwrap();
        assert_eq!(counters.overruns, 0, "{what}");
        println!("| USB {what} | 0 | restarted, {} samples without a gap |", t.samples);
    }
}
