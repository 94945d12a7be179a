//! The image boots as the reference manual wants, ticks exactly, and closes the loop.

use emulator::bench::Bench;
use emulator::periph::ResetCause;
use emulator::periph::nvic::exception::irq;
use emulator::time::{CYCLE, MICROSECOND, MILLISECOND, SECOND, TICK, milliseconds};
use flexstage::State;
use flexstage::link::identity::self_test;
use flexstage::link::{Fields, Profile};

use crate::common::{armed, bench, hold, image};

/// The interrupt of ADC3: the tick.
const ADC3: u32 = 47;

#[test]
fn boots_to_170_mhz_with_outputs_parked_first() {
    let Some(image) = image() else { return };
    let mut b = Bench::handley(image, 1).unwrap();
    // The outputs stand at 0 V before anything else happens, and stay there.
    b.run_for(100 * MICROSECOND).unwrap();
    let codes = [(0, 0), (0, 1), (1, 0)].map(|(d, c)| b.machine.soc().dac[d].output(c));
    println!("outputs after 100 us: {codes:?} at {}", b.machine.location());
    assert_eq!(codes, [Some(256); 3], "parked within 100 us of the reset");
    b.run_for(200 * MILLISECOND).unwrap();
    assert!(b.machine.soc().full_speed(), "{} Hz", b.machine.soc().core_hz());
    assert_eq!(b.board.0.borrow().fastest_step_v, 0.0, "no step on any output during boot");
    let broken: Vec<_> =
        b.machine.soc().violations.iter().chain(&b.machine.soc().flash.violations).collect();
    assert!(broken.is_empty(), "{broken:?}");
    assert!(b.machine.resets.len() == 1, "{:?}", b.machine.resets);
    for line in &b.machine.rtt.lines {
        assert!(line.level != "error", "{line:?}");
    }
    println!("boot log:\n{}", b.log_tail(20));
    println!("registers without a model: {:x?}", b.machine.soc().plain_registers);
}

#[test]
fn a_crystal_that_dies_during_start_up_is_replaced() {
    let Some(image) = image() else { return };
    let mut b = Bench::handley(image, 1).unwrap();
    // It says once that it is ready, and never again: embassy waits for it without end.
    b.machine.soc_mut().rcc.hse_dies_after = Some(1);
    b.enumerate().unwrap();
    let resets: Vec<_> = b.machine.resets.iter().map(|(_, cause)| *cause).collect();
    assert_eq!(resets, [ResetCause::PowerOn, ResetCause::Watchdog]);
    assert_eq!(b.identify().unwrap().self_test, self_test::CRYSTAL);
    b.arm().unwrap();
}

#[test]
fn ticks_every_100_us_and_outputs_follow_one_period_later() {
    let Some(image) = image() else { return };
    // One cycle an instruction, then two: the timing of inputs and outputs does not depend on the code's speed.
    for cycles in [16, 32] {
        let mut b = armed(&image, 1, |_| {});
        b.machine.soc_mut().set_cycles_per_instruction(cycles);
        b.stream(Fields::ALL, Profile::Packed).unwrap();
        b.start(&[(0, hold(5.0)), (1, hold(7.0)), (2, hold(9.0))]).unwrap();
        b.link.samples = Some(Vec::new());
        b.board.0.borrow_mut().log = Some(Vec::new());
        b.machine.soc_mut().trigger_period = (u64::MAX, 0);
        b.machine.profile().clear();
        b.run_for(SECOND / 2).unwrap();
        assert_eq!(
            b.machine.soc().trigger_period,
            (TICK, TICK),
            "period of the trigger, shortest and longest"
        );
        let board = b.board.0.borrow();
        let log = board.log.as_ref().unwrap();
        for w in log.windows(2) {
            assert_eq!(w[1].at - w[0].at, TICK);
        }
        // A sample's gauge codes identify its trigger; its DAC codes appear at the next one.
        let samples = b.link.samples.as_ref().unwrap();
        let first = log[0].gauge.map(|g| g as u16);
        // The first samples were taken before the log began.
        let offset = samples
            .iter()
            .position(|s| s.gauge_code == first)
            .expect("sample of the first trigger");
        let mut compared = 0;
        for (s, pair) in samples[offset..].iter().zip(log.windows(2)) {
            assert_eq!(
                s.gauge_code,
                pair[0].gauge.map(|g| g as u16),
                "tick {}: sampled at its own edge",
                s.tick
            );
            assert_eq!(s.dac_code, pair[1].codes, "tick {}: out at the next edge", s.tick);
            compared += 1;
        }
        assert!(compared > 4_000, "{compared} ticks compared");
        let cost = b.machine.soc().triggers;
        drop(board);
        let tick = b.machine.profile().costs[&irq(ADC3)];
        println!(
            "{:.2} cycles an instruction: {compared} ticks, {} instructions at most, {:.2} us at most, {cost} triggers",
            cycles as f64 / 16.0,
            tick.max,
            tick.longest as f64 / MICROSECOND as f64
        );
        assert!(tick.longest < TICK / 2);
        assert_eq!(b.counters().unwrap().overruns, 0);
    }
}

#[test]
fn the_loop_settles_on_a_reference() {
    let Some(image) = image() else { return };
    let mut b = armed(&image, 3, |_| {});
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    b.start(&[(0, hold(3.0)), (1, hold(6.0)), (2, hold(9.0))]).unwrap();
    b.run_for(SECOND).unwrap();
    let truth = b.board.0.borrow().newest.unwrap();
    for (k, wanted) in [3.0, 6.0, 9.0].into_iter().enumerate() {
        let error = truth.true_um[k] - wanted;
        println!("axis {}: {:+.1} nm", k + 1, 1e3 * error);
        assert!(error.abs() < 0.03, "axis {}: {error} um", k + 1);
    }
    assert_eq!(flexstage::Flags(b.status().unwrap().flags).state(), State::Hold);
}

#[test]
fn every_interrupt_is_below_the_tick() {
    let Some(image) = image() else { return };
    let b = {
        let mut b = bench(&image, 1);
        b.run_for(50 * MILLISECOND).unwrap();
        b
    };
    let nvic = &b.machine.soc().nvic;
    assert_eq!(nvic.priority_of(irq(ADC3)), 0);
    let enabled: Vec<u32> = (0..102).filter(|n| nvic.is_enabled(irq(*n))).collect();
    println!(
        "enabled: {:?}",
        enabled.iter().map(|n| (n, nvic.priority_of(irq(*n)) >> 4)).collect::<Vec<_>>()
    );
    let urgent: Vec<u32> = enabled.into_iter().filter(|n| nvic.priority_of(irq(*n)) == 0).collect();
    // TIM7 is the tick's own deadline.
    assert!(urgent.iter().all(|n| matches!(*n, ADC3 | 55)), "interrupts at priority 0: {urgent:?}");
    println!("longest boot: {:.1} ms; one cycle is {CYCLE} units", milliseconds(b.now()));
}
