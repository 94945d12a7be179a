//! What the guard takes for a fault of a gauge or of the motion, and what it forgives.

mod common;

use common::Bench;
use flexstage::settings::AxisSettings;
use flexstage::{Command, Faults, Generator, GeneratorSettings, Refusal, Settings, State};

/// A stage that follows to 1 nm or so, without a model or feedback that would answer the faults of a gauge.
fn armed(following_error_um: f32) -> Bench {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        *axis = AxisSettings::open_loop(7.52);
        axis.limits.following_error_um = following_error_um;
    }
    let mut bench = Bench::new(&settings, 7.52);
    bench.arm();
    bench
}

/// At rest at 5 um.
fn holding() -> Bench {
    let mut bench = armed(1.0);
    go_to(&mut bench, 5.0);
    for _ in 0..3_000 {
        bench.tick();
    }
    assert_eq!(bench.controller.faults(), Faults::NONE);
    bench
}

fn go_to(bench: &mut Bench, position_um: f32) {
    let generator =
        Generator::build(&GeneratorSettings::Hold { position_um, blend_s: 0.1 }).unwrap();
    for axis in 0..3 {
        bench.stage(axis, generator);
    }
    bench.controller.command(&bench.config, Command::Start { axes: 7 }).unwrap();
}

/// One tick with the gauges `um` off.
fn glitch(bench: &mut Bench, um: f64) {
    bench.disturbance_um = um;
    bench.tick();
    bench.disturbance_um = 0.0;
}

#[test]
fn a_loose_connector_is_found_between_good_samples() {
    let mut bench = holding();
    let mut ticks = 0;
    while bench.controller.faults().is_empty() {
        glitch(&mut bench, 5.0);
        for _ in 0..5 {
            bench.tick();
        }
        ticks += 6;
        assert!(ticks < 60, "two jumps in every six ticks for {ticks} ticks");
    }
    assert_eq!(bench.controller.faults(), Faults::DISCONNECTED);
    assert!(ticks > 12, "not from two glitches alone");
}

#[test]
fn seldom_glitches_are_forgiven() {
    let mut bench = holding();
    for _ in 0..20 {
        glitch(&mut bench, 5.0);
        for _ in 0..100 {
            bench.tick();
        }
    }
    assert_eq!(bench.controller.faults(), Faults::NONE);
    assert_eq!(bench.controller.state(), State::Hold);
}

#[test]
fn what_is_staged_waits_for_its_start_or_is_refused() {
    let mut settings = Settings::default();
    settings.guard.arming_s = 0.01;
    let mut bench = Bench::new(&settings, 7.52);
    let mut generators = [5.0, 6.0].map(|position_um| {
        Generator::build(&GeneratorSettings::Hold { position_um, blend_s: 0.1 }).unwrap()
    });
    let stage = |bench: &mut Bench, generator: &Generator| {
        let command = Command::Stage { axis: 0, generator: *generator };
        bench.controller.command(&bench.config, command)
    };
    let start =
        |bench: &mut Bench| bench.controller.command(&bench.config, Command::Start { axes: 1 });
    while !bench.tick().flags.is_parked() {}
    assert_eq!(stage(&mut bench, &generators[0]), Err(Refusal::NotArmed));
    // As soon as the loop is being closed it is kept, before the first tick of that too.
    bench.controller.command(&bench.config, Command::Arm).unwrap();
    assert_eq!(stage(&mut bench, &generators[0]), Ok(()));
    while bench.tick().flags.state() == State::Arming {}
    assert_eq!(start(&mut bench), Ok(()));
    // Opening the loop forgets it.
    generators.swap(0, 1);
    assert_eq!(stage(&mut bench, &generators[0]), Ok(()));
    bench.controller.command(&bench.config, Command::Disarm).unwrap();
    bench.arm();
    assert_eq!(start(&mut bench), Err(Refusal::NothingStaged));
    bench.controller.trip(Faults::CONVERTER);
    assert_eq!(stage(&mut bench, &generators[0]), Err(Refusal::Faulted));
}

#[test]
fn a_loop_that_was_just_opened_does_not_close_before_the_drives_are_back() {
    type Open = fn(&mut Bench);
    let ways: [Open; 2] = [
        |b| b.controller.command(&b.config, Command::Disarm).unwrap(),
        |b| {
            b.controller.trip(Faults::CONVERTER);
            b.controller.command(&b.config, Command::ClearFaults).unwrap();
        },
    ];
    for open in ways {
        let mut bench = holding();
        assert!(bench.drive_v[0] > 30.0);
        // All before the same tick.
        open(&mut bench);
        let again = bench.controller.command(&bench.config, Command::Arm);
        assert_eq!(again, Err(Refusal::NotParked));
        assert_eq!(bench.tick().flags.state(), State::Off);
        assert!(bench.controller.command(&bench.config, Command::Arm).is_err());
        bench.arm();
    }
}

/// Ticks with the code of one gauge frozen at what it is, until a fault or for `ticks`.
fn frozen(bench: &mut Bench, ticks: usize) -> Faults {
    let held = bench.codes()[1];
    for _ in 0..ticks {
        let mut gauge = bench.codes();
        gauge[1] = held;
        bench.tick_reading(gauge);
        if !bench.controller.faults().is_empty() {
            break;
        }
    }
    bench.controller.faults()
}

#[test]
fn a_gauge_is_stuck_only_where_its_drive_moves() {
    // The following error is not watched: it would be found first.
    let mut bench = armed(0.0);
    assert_eq!(frozen(&mut bench, 5_000), Faults::NONE, "at rest");
    go_to(&mut bench, 2.0);
    assert_eq!(frozen(&mut bench, 5_000), Faults::NONE, "15 V are less than 20");
    go_to(&mut bench, 8.0);
    assert_eq!(frozen(&mut bench, 5_000), Faults::STUCK, "60 V are more");
}

#[test]
fn a_lasting_error_of_the_motion_is_a_fault_and_a_short_one_is_not() {
    let mut bench = holding();
    let lasting = Settings::default().axes[0].limits.following_error_s;
    let ticks = (f64::from(lasting) * 10_000.0) as usize;
    assert!(ticks > 10);
    // A slow push, which is no jump of the gauge.
    let push = |bench: &mut Bench, for_ticks: usize| {
        for tick in 0..for_ticks + 20 {
            bench.disturbance_um = (0.1 * tick.min(20) as f64).min(2.0);
            bench.tick();
        }
        bench.disturbance_um = 1.0;
        bench.tick();
        bench.disturbance_um = 0.0;
        bench.tick();
    };
    push(&mut bench, ticks / 2);
    assert_eq!(bench.controller.faults(), Faults::NONE);
    push(&mut bench, 2 * ticks);
    assert_eq!(bench.controller.faults(), Faults::FOLLOWING_ERROR);
}

/// Ticks with the gauges at `code` until a fault, `most` of them at most.
fn reading(bench: &mut Bench, code: i32, most: usize) -> Faults {
    for nth in 0..most {
        // The converter's noise.
        bench.tick_reading([code + [0, 3, -2][nth % 3]; 3]);
    }
    bench.controller.faults()
}

#[test]
fn a_gauge_at_its_end_need_not_reach_the_last_code() {
    // Buffers stop some 20 mV before the supplies: 397 codes.
    for code in [397, 65_520 - 397, 4, 65_516] {
        let mut bench = armed(0.0);
        assert!(reading(&mut bench, code, 200).contains(Faults::RAILED), "{code}");
    }
}

#[test]
fn the_default_travel_is_watched_within_what_the_default_gauge_reads() {
    for um in [-2.5, 18.5] {
        let mut settings = Settings::default();
        for axis in &mut settings.axes {
            axis.limits.following_error_um = 0.0;
        }
        let mut bench = Bench::new(&settings, 7.52);
        bench.arm();
        let code = bench.config.gauge_code(0, um);
        let found = reading(&mut bench, code, 200);
        assert!(found.contains(Faults::TRAVEL), "{um} um: {found:?}");
        assert!(!found.contains(Faults::RAILED), "{um} um: {found:?}");
    }
}

#[test]
fn no_time_is_no_patience_and_does_not_switch_a_watch_off() {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        *axis = AxisSettings::open_loop(7.52);
        axis.limits.following_error_um = 1.0;
        axis.limits.following_error_s = 0.0;
    }
    let mut bench = Bench::new(&settings, 7.52);
    bench.arm();
    glitch(&mut bench, 2.0);
    assert_eq!(bench.controller.faults(), Faults::FOLLOWING_ERROR);
}

#[test]
fn a_return_that_the_watchdog_would_cut_short_is_refused() {
    let mut settings = Settings::default();
    settings.guard.return_v_per_ms = 0.2;
    let error = flexstage::Config::build(&settings).unwrap_err();
    assert_eq!((error.group, error.field), ("guard", "return_v_per_ms"));
    // 150 V within 0.6 s.
    assert!((error.min - 0.25).abs() < 1e-6, "{error}");
    settings.guard.return_v_per_ms = 0.25;
    flexstage::Config::build(&settings).unwrap();
    settings.guard.safe_v = 75.0;
    settings.guard.return_v_per_ms = 0.15;
    flexstage::Config::build(&settings).unwrap();
}

/// Ticks, at 0.1 um a tick, until the gauges are `um` off.
fn push_to(bench: &mut Bench, um: f64) {
    while (bench.disturbance_um - um).abs() > 0.05 {
        bench.disturbance_um += 0.1_f64.copysign(um - bench.disturbance_um);
        bench.tick();
    }
}

#[test]
fn over_travel_counts_where_it_lasts_and_while_the_loop_is_active() {
    // The following error is not watched: it would be found first.
    let lowest = -1.5;
    let armed = || {
        let mut settings = Settings::default();
        for axis in &mut settings.axes {
            *axis = AxisSettings::open_loop(7.52);
            axis.limits.following_error_um = 0.0;
            (axis.limits.min_um, axis.limits.travel_margin_um) = (-1.0, 0.5);
        }
        let mut bench = Bench::new(&settings, 7.52);
        bench.arm();
        bench
    };
    let mut bench = armed();
    push_to(&mut bench, lowest - 0.5);
    let mut lasting = 0;
    while bench.controller.faults().is_empty() {
        bench.tick();
        lasting += 1;
        assert!(lasting < 10_000, "never found");
    }
    assert_eq!(bench.controller.faults(), Faults::TRAVEL);
    // In and out again does not add up.
    let mut bench = armed();
    for _ in 0..2 * lasting {
        push_to(&mut bench, lowest - 0.1);
        push_to(&mut bench, lowest + 0.5);
    }
    assert_eq!(bench.controller.faults(), Faults::NONE);
    // A parked stage may be moved by hand.
    let mut bench = armed();
    bench.controller.command(&bench.config, Command::Disarm).unwrap();
    while !bench.tick().flags.is_parked() {}
    push_to(&mut bench, lowest - 0.5);
    for _ in 0..20 * lasting {
        bench.tick();
    }
    bench.controller.command(&bench.config, Command::Arm).expect("its gauges are well");
}
