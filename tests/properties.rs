//! Whatever comes in, the core does not panic, does not wrap, and never steps the stack.

mod common;

use common::{Bench, cases, settings, wave};
use flexstage::generator::{GeneratorSettings, Multisine, PART_WORDS, Wave};
use flexstage::{
    AXES, Command, Config, Controller, Faults, Generator, Sample, Settings, State, Table,
};
use proptest::prelude::*;

fn generator() -> impl Strategy<Value = GeneratorSettings> {
    prop_oneof![
        Just(GeneratorSettings::Stop),
        (-50.0f32..50.0, 0.0f32..0.1)
            .prop_map(|(position_um, blend_s)| GeneratorSettings::Hold { position_um, blend_s }),
        (-50.0f32..50.0, 1.0e-4f32..0.1)
            .prop_map(|(target_um, duration_s)| GeneratorSettings::Ramp { target_um, duration_s }),
        wave().prop_map(GeneratorSettings::Triangle),
        wave().prop_map(GeneratorSettings::Sine),
        wave().prop_map(GeneratorSettings::Table),
        (wave(), 1.0e-3f32..100.0).prop_map(|(wave, slope_um_per_ms)| {
            GeneratorSettings::Square { wave, slope_um_per_ms }
        }),
        (wave(), 1u16..50, 1.0e-3f32..100.0).prop_map(|(wave, steps, slope_um_per_ms)| {
            GeneratorSettings::Staircase { wave, steps, slope_um_per_ms }
        }),
        (0.0f32..20.0, 0.1f32..5.0, 1u16..20, 0u16..5, 1u8..=16, any::<u32>()).prop_map(
            |(peak_um, base_hz, first, stride, tones, seed)| {
                GeneratorSettings::Multisine(Multisine {
                    center_um: 5.0,
                    peak_um,
                    base_hz,
                    first,
                    stride,
                    tones,
                    seed,
                    blend_s: 0.01,
                    duration_s: 0.0,
                })
            }
        ),
        (0.0f32..20.0, 1.0f32..2_000.0, 1.0f32..2_000.0, 0.5f32..2.0).prop_map(
            |(amplitude_um, from_hz, to_hz, duration_s)| GeneratorSettings::Sweep {
                center_um: 5.0,
                amplitude_um,
                from_hz,
                to_hz,
                duration_s,
                blend_s: 0.01,
            }
        ),
    ]
}

#[derive(Clone, Debug)]
enum Event {
    Command(Command),
    Stage {
        axis: u8,
        generator: Generator,
    },
    Swap(Box<Settings>),
    /// Opened and to be closed again, before the same tick.
    Rearm,
    Trip,
    Nothing,
}

fn event() -> impl Strategy<Value = Event> {
    let staged = (0u8..4, generator())
        .prop_filter_map("a waveform that can be built", |(axis, g)| {
            Generator::build(&g).ok().map(|generator| Event::Stage { axis, generator })
        });
    prop_oneof![
        3 => Just(Event::Command(Command::Arm)),
        1 => Just(Event::Command(Command::Disarm)),
        1 => Just(Event::Command(Command::Hold)),
        2 => Just(Event::Command(Command::ClearFaults)),
        4 => (0u8..9).prop_map(|axes| Event::Command(Command::Start { axes })),
        6 => staged,
        1 => (0u8..4, any::<u8>(), any::<[i32; PART_WORDS]>())
            .prop_map(|(axis, part, words)| Event::Command(Command::StagePart { axis, part, words })),
        2 => settings().prop_map(|s| Event::Swap(Box::new(s))),
        2 => Just(Event::Rearm),
        1 => Just(Event::Trip),
        2 => Just(Event::Nothing),
    ]
}

/// Codes: mostly somewhere in range, sometimes anything.
fn code() -> impl Strategy<Value = i32> {
    let ends = prop::sample::select(vec![i32::MIN, i32::MIN + 1, -1, 0, 65_520, 65_535, i32::MAX]);
    prop_oneof![16 => 9_000i32..9_400, 8 => 1i32..65_519, 1 => any::<i32>(), 1 => ends]
}

/// Ticks from one event to the next: several may come before the same one.
fn ticks() -> impl Strategy<Value = usize> {
    prop_oneof![1 => Just(0usize), 2 => 1usize..400]
}

fn table() -> Table {
    let mut table = Table::EMPTY;
    let points: Vec<f32> = (0..100).map(|i| ((i * 37) % 100) as f32 / 50.0 - 1.0).collect();
    table.set(&points).expect("points within -1 to 1");
    table
}

proptest! {
    #![proptest_config(cases(48))]

    /// Any samples, commands and exchanges of configuration: no panic, no step beyond the slew limit, no code beyond
    /// the converter, and no closed loop but from parked drives.
    #[test]
    fn nothing_makes_it_panic_or_step(
        first in settings(),
        story in prop::collection::vec((event(), prop::collection::vec(code(), 6), ticks()), 1..24),
    ) {
        let table = table();
        let mut config = Config::build(&first).unwrap();
        let mut slews = first.axes.clone().map(|a| f64::from(a.limits.slew_v_per_ms) * 0.1);
        let mut controller = Controller::new();
        let mut before = [0.0f64; AXES];
        let mut was_parked = false;
        for (event, codes, ticks) in story {
            let command = |controller: &mut Controller, command| {
                let is_taken = controller.command(&config, command).is_ok();
                prop_assert!(was_parked || command != Command::Arm || !is_taken, "armed with the drives up");
                Ok(())
            };
            match event {
                Event::Command(wanted) => command(&mut controller, wanted)?,
                Event::Rearm => {
                    command(&mut controller, Command::Disarm)?;
                    command(&mut controller, Command::Arm)?;
                }
                Event::Stage { axis, generator } => {
                    for command in generator.staging(axis) {
                        let _ = controller.command(&config, command);
                    }
                }
                Event::Swap(settings) => {
                    config = Config::build(&settings).unwrap();
                    slews = settings.axes.clone().map(|a| f64::from(a.limits.slew_v_per_ms) * 0.1);
                }
                Event::Trip => controller.trip(Faults::BAD_CONFIG),
                Event::Nothing => {}
            }
            for n in 0..ticks {
                let sample = Sample {
                    gauge: [codes[0], codes[1], codes[2].wrapping_add(n as i32)],
                    monitor: [codes[3], codes[4], codes[5]],
                    // Seldom, or nothing would ever stay armed.
                    overrun: n == 7 && codes[3] % 16 == 0,
                };
                let record = controller.tick(&config, &table, &sample);
                was_parked = record.flags.is_parked();
                for (axis, out) in record.axes.iter().enumerate() {
                    let drive = out.drive.to_f64();
                    let allowed = slews[axis].max(0.05) + 1e-5;
                    prop_assert!((drive - before[axis]).abs() <= allowed, "axis {axis}: {} -> {drive}", before[axis]);
                    prop_assert!((-10.0 - 1e-6..=150.0 + 1e-6).contains(&drive));
                    prop_assert!(out.dac <= 4_095);
                    before[axis] = drive;
                }
            }
        }
    }

    /// Joins of any waveforms are continuous: the reference moves by no more than its waveforms and the coasting allow.
    #[test]
    fn references_never_jump(story in prop::collection::vec((generator(), 1usize..500), 1..8)) {
        let mut settings = Settings::default();
        for axis in &mut settings.axes {
            axis.limits.following_error_um = 0.0;
            axis.limits.min_um = -100.0;
            axis.limits.max_um = 100.0;
        }
        // Slow waveforms: at most 2 um a tick is then far beyond any of them.
        let mut bench = Bench::new(&settings, 8.0);
        bench.arm();
        let mut before = bench.tick().axes[0].reference.to_f64();
        for (g, ticks) in story {
            let slow = match g {
                GeneratorSettings::Triangle(w) => GeneratorSettings::Triangle(Wave { frequency_hz: w.frequency_hz / 50.0, blend_s: 0.02, ..w }),
                GeneratorSettings::Sine(w) => GeneratorSettings::Sine(Wave { frequency_hz: w.frequency_hz / 50.0, blend_s: 0.02, ..w }),
                GeneratorSettings::Hold { position_um, .. } => GeneratorSettings::Hold { position_um, blend_s: 0.02 },
                GeneratorSettings::Ramp { target_um, .. } => GeneratorSettings::Ramp { target_um, duration_s: 0.02 },
                _ => GeneratorSettings::Stop,
            };
            let generator = Generator::build(&slow).unwrap();
            bench.stage(0, generator);
            bench.controller.command(&bench.config, Command::Start { axes: 1 }).unwrap();
            for _ in 0..ticks {
                let now = bench.tick().axes[0].reference.to_f64();
                prop_assert!((now - before).abs() < 2.0, "{before} -> {now} in {slow:?}");
                before = now;
            }
        }
    }
}

#[test]
fn every_fault_returns_softly_to_the_safe_voltage() {
    type Break = fn(&mut Sample);
    let cases: [(Faults, Break); 4] = [
        (Faults::RAILED, |s| s.gauge[1] = 65_520),
        (Faults::OVERRUN, |s| s.overrun = true),
        (Faults::TRAVEL, |s| s.gauge[0] += 55_000),
        (Faults::MONITOR, |s| s.monitor[2] = 60_000),
    ];
    for (fault, break_it) in cases {
        let mut settings = Settings::default();
        settings.guard.monitor_error_v = 10.0;
        for axis in &mut settings.axes {
            axis.limits.min_um = -2.0;
            axis.limits.max_um = 10.0;
        }
        let mut bench = Bench::new(&settings, 7.52);
        bench.arm();
        let generator =
            Generator::build(&GeneratorSettings::Hold { position_um: 8.0, blend_s: 0.1 }).unwrap();
        for axis in 0..3 {
            bench.stage(axis, generator);
        }
        bench.controller.command(&bench.config, Command::Start { axes: 7 }).unwrap();
        for _ in 0..3_000 {
            bench.tick();
        }
        assert!(bench.drive_v[0] > 40.0);
        let mut before = bench.drive_v;
        let mut faulted = false;
        for _ in 0..4_000 {
            let mut sample = Sample {
                gauge: std::array::from_fn(|a| bench.config.gauge_code(a, before[a] / 7.52)),
                monitor: std::array::from_fn(|a| bench.config.monitor_code(a, before[a])),
                overrun: false,
            };
            break_it(&mut sample);
            let record = bench.controller.tick(&bench.config, &Table::EMPTY, &sample);
            for (now, before) in record.axes.iter().zip(&mut before) {
                let now = now.drive.to_f64();
                if faulted {
                    assert!((now - *before).abs() <= 0.0501, "{fault:?}: {before} -> {now}");
                }
                *before = now;
            }
            faulted = record.flags.state() == State::Fault;
        }
        let record = bench.tick();
        assert!(record.flags.faults().contains(fault), "{fault:?}: {:?}", record.flags);
        assert!(record.flags.is_parked());
        assert!(before.iter().all(|v| *v == 0.0), "{before:?}");
        assert!(bench.controller.command(&bench.config, Command::Arm).is_err(), "latched");
    }
}

#[test]
fn a_silent_host_is_noticed() {
    let mut settings = Settings::default();
    settings.guard.command_timeout_s = 0.1;
    settings.guard.arming_s = 0.01;
    let mut bench = Bench::new(&settings, 7.52);
    bench.arm();
    for _ in 0..900 {
        assert_eq!(bench.tick().flags.state(), State::Hold);
        bench.controller.command(&bench.config, Command::KeepAlive).unwrap();
    }
    for _ in 0..1_002 {
        bench.tick();
    }
    assert!(bench.controller.faults().contains(Faults::COMMAND_TIMEOUT));
}

#[test]
fn the_integral_does_not_wind_up() {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        axis.feedback.integral_v_per_um_s = 2_000.0;
        axis.feedback.integral_limit_v = 300.0;
        axis.limits.following_error_um = 0.0;
        axis.limits.max_v = 60.0;
    }
    // The stage needs 15 V/um: 8 um are out of reach for ten seconds.
    let mut bench = Bench::new(&settings, 15.0);
    bench.arm();
    let go = |bench: &mut Bench, position_um: f32| {
        let g = Generator::build(&GeneratorSettings::Hold { position_um, blend_s: 0.05 }).unwrap();
        bench.stage(0, g);
        bench.controller.command(&bench.config, Command::Start { axes: 1 }).unwrap();
    };
    go(&mut bench, 8.0);
    for _ in 0..100_000 {
        bench.tick();
    }
    assert!((bench.drive_v[0] - 60.0).abs() < 1e-3);
    go(&mut bench, 2.0);
    for _ in 0..1_000 {
        bench.tick();
    }
    let position = bench.drive_v[0] / 15.0;
    assert!((position - 2.0).abs() < 0.02, "after 0.1 s at {position} um: wound up");
}

#[test]
fn a_new_configuration_makes_no_step() {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        axis.feedback.integral_v_per_um_s = 500.0;
        axis.feedback.proportional_v_per_um = 2.0;
    }
    let mut bench = Bench::new(&settings, 7.0);
    bench.arm();
    let sine = Generator::build(&GeneratorSettings::Sine(Wave::between(2.0, 10.0, 5.0))).unwrap();
    bench.stage(0, sine);
    bench.controller.command(&bench.config, Command::Start { axes: 1 }).unwrap();
    let mut largest = [0.0f64; 2];
    let mut before = bench.drive_v[0];
    for n in 0..40_000 {
        if n == 20_000 {
            for axis in &mut settings.axes {
                axis.stack.transformer_n_per_v *= 0.8;
                axis.feedback.proportional_v_per_um = 0.5;
                axis.feedback.derivative_v_ms_per_um = 0.3;
                axis.stack.hysteresis.truncate(3);
                let _ = axis.feedback.notches.push(flexstage::settings::NotchSettings::default());
            }
            bench.config = Config::build(&settings).unwrap();
        }
        let record = bench.tick();
        assert_eq!(record.flags.is_swapped(), n == 20_000);
        let step = (bench.drive_v[0] - before).abs();
        before = bench.drive_v[0];
        if n > 10_000 && n < 20_000 {
            largest[0] = largest[0].max(step);
        } else if n >= 20_000 {
            largest[1] = largest[1].max(step);
        }
    }
    assert!(
        largest[1] < 1.6 * largest[0],
        "ordinary steps {:.4} V, after the exchange {:.4} V",
        largest[0],
        largest[1]
    );
}

#[test]
fn a_step_of_the_setpoint_does_not_kick_the_derivative() {
    let mut settings = Settings::default();
    for axis in &mut settings.axes {
        axis.feedback.derivative_v_ms_per_um = 0.3;
    }
    let mut bench = Bench::new(&settings, 7.52);
    bench.arm();
    let g = Generator::build(&GeneratorSettings::Hold { position_um: 5.0, blend_s: 0.05 }).unwrap();
    bench.stage(0, g);
    bench.controller.command(&bench.config, Command::Start { axes: 1 }).unwrap();
    let mut before = bench.drive_v[0];
    let mut largest = 0.0f64;
    for _ in 0..1_000 {
        bench.tick();
        largest = largest.max((bench.drive_v[0] - before).abs());
        before = bench.drive_v[0];
    }
    // 5 um within 50 ms move 0.15 um in the fastest 1 ms; a kick would be 5 um * 0.3 V ms/um / 0.1 ms, filtered by
    // half: 7 V.
    assert!(largest < 0.5, "{largest} V in a tick");
}

/// An axis whose reference rests skips most of its tick; nobody may see that. A creep model of nothing keeps it awake.
#[test]
fn resting_changes_nothing_but_the_time_it_takes() {
    let mut asleep = Settings::default();
    for axis in &mut asleep.axes {
        // The gain of the bench is not the model's: at the end of the travel it goes too far.
        axis.limits.travel_margin_um = 0.0;
    }
    let mut awake = asleep.clone();
    for axis in &mut awake.axes {
        let _ = axis.feedforward.creep.push(flexstage::settings::CreepSettings::default());
    }
    let mut benches = [Bench::new(&asleep, 7.4), Bench::new(&awake, 7.4)];
    for bench in &mut benches {
        bench.arm();
    }
    let story = [
        GeneratorSettings::Hold { position_um: 5.0, blend_s: 0.01 },
        GeneratorSettings::Sine(Wave { duration_s: 0.03, ..Wave::between(1.0, 9.0, 40.0) }),
        GeneratorSettings::Ramp { target_um: 25.0, duration_s: 0.02 },
        GeneratorSettings::Stop,
        GeneratorSettings::Hold { position_um: 2.0, blend_s: 0.001 },
    ];
    for (n, settings) in story.iter().enumerate() {
        let generator = Generator::build(settings).unwrap();
        for bench in &mut benches {
            let axis = (n % 2) as u8;
            bench.stage(axis, generator);
            let start = Command::Start { axes: 1 << axis };
            bench.controller.command(&bench.config, start).unwrap();
            bench.disturbance_um = 0.01 * n as f64;
        }
        for tick in 0..1_500 {
            let [a, b] = benches.each_mut().map(|bench| bench.tick());
            assert_eq!(a.axes, b.axes, "story {n}, tick {tick}");
            assert_eq!(a.flags, b.flags, "story {n}, tick {tick}");
        }
    }
}

/// A model that is gone before its slip elements have taken over leaves them to the one that was there before.
#[test]
fn a_model_that_goes_at_once_leaves_the_hysteresis_alive() {
    let settings = Settings::default();
    let mut other = settings.clone();
    for axis in &mut other.axes {
        for element in &mut axis.stack.hysteresis {
            element.limit_v *= 1.5;
        }
    }
    let (config, other) = (Config::build(&settings).unwrap(), Config::build(&other).unwrap());
    for ticks in 1..24 {
        let (mut swapped, mut alone) = (Bench::new(&settings, 7.52), Bench::new(&settings, 7.52));
        let sine =
            Generator::build(&GeneratorSettings::Sine(Wave::between(2.0, 10.0, 20.0))).unwrap();
        for bench in [&mut swapped, &mut alone] {
            bench.arm();
            bench.stage(2, sine);
            bench.controller.command(&bench.config, Command::Start { axes: 4 }).unwrap();
            for _ in 0..3_300 {
                bench.tick();
            }
        }
        swapped.config.clone_from(&other);
        for _ in 0..ticks {
            swapped.tick();
            alone.tick();
        }
        swapped.config.clone_from(&config);
        let mut worst = 0.0f64;
        for n in 0..6_000 {
            swapped.tick();
            alone.tick();
            // A period after the change has faded, both remember the same turning points.
            if n > 5_000 {
                worst = worst.max((swapped.drive_v[2] - alone.drive_v[2]).abs());
            }
        }
        assert!(worst < 0.05, "{worst} V after {ticks} ticks with the other model");
    }
}
