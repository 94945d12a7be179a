//! The board and `host-sim` run the same core: over a minute of mixed motion every sample agrees to the bit.

use emulator::bench::Bench;
use emulator::time::{MILLISECOND, SECOND};
use flexstage::generator::Wave;
use flexstage::link::message::Command as Ask;
use flexstage::link::{Fields, Profile};
use flexstage::{AXES, Command, Generator, GeneratorSettings, Settings};
use host_sim::Options;
use host_sim::closed_loop::ClosedLoop;

use crate::common::{hold, image, rig, settings};

/// What the board was told, and from which tick on it acts.
enum Told {
    Settings(Box<Settings>),
    Control(Command),
}

fn wave(low: f32, high: f32, hz: f32) -> Wave {
    Wave::between(low, high, hz)
}

#[test]
fn a_minute_of_mixed_motion_is_bit_identical() {
    let Some(image) = image() else { return };
    let seed = 11;
    let mut b = Bench::handley(image, seed).unwrap();
    b.board.0.borrow_mut().log = Some(Vec::new());
    b.enumerate().unwrap();
    let mut told: Vec<(u32, Told)> = Vec::new();
    let with_feedback = {
        let mut s = settings();
        for axis in &mut s.axes {
            axis.feedback.proportional_v_per_um = 1.0;
            axis.feedback.integral_v_per_um_s = 300.0;
            axis.feedback.derivative_v_ms_per_um = 0.3;
        }
        s
    };
    // Fewer slip elements, and others.
    let with_model = {
        let mut s = with_feedback.clone();
        for axis in &mut s.axes {
            axis.stack.hysteresis.truncate(5);
            axis.stack.hysteresis.iter_mut().for_each(|element| element.limit_v *= 1.2);
        }
        s
    };
    b.link.samples = Some(Vec::new());
    b.stream(Fields::RECORDING, Profile::Exact).unwrap();
    let tick = b.act(&Ask::SetSettings(settings())).unwrap();
    told.push((tick, Told::Settings(Box::new(settings()))));
    let tick = b.arm().unwrap();
    told.push((tick, Told::Control(Command::Arm)));

    let start = |b: &mut Bench, told: &mut Vec<(u32, Told)>, waves: &[(u8, GeneratorSettings)]| {
        let tick = b.start(waves).unwrap();
        let mut axes = 0;
        for (axis, generator) in waves {
            let generator = Generator::build(generator).unwrap();
            // Staging changes nothing until the start, so the tick of the start will do.
            told.extend(generator.staging(*axis).map(|command| (tick, Told::Control(command))));
            axes |= 1 << axis;
        }
        told.push((tick, Told::Control(Command::Start { axes })));
    };
    use GeneratorSettings::{Multisine, Ramp, Sine, Square, Staircase, Sweep, Triangle};
    let multisine = flexstage::generator::Multisine {
        center_um: 5.0,
        peak_um: 4.0,
        base_hz: 0.5,
        first: 1,
        stride: 3,
        tones: 12,
        seed: 99,
        blend_s: 0.1,
        duration_s: 0.0,
    };
    let program: [&[(u8, GeneratorSettings)]; 7] = [
        &[(0, hold(4.0)), (1, hold(5.0)), (2, hold(6.0))],
        &[
            (0, Sine(wave(1.0, 9.0, 10.0))),
            (1, Triangle(wave(2.0, 8.0, 2.0))),
            (2, Sine(wave(4.0, 6.0, 120.0))),
        ],
        &[(1, Square { wave: wave(3.0, 6.0, 4.0), slope_um_per_ms: 0.2 })],
        &[(0, Multisine(multisine)), (2, Ramp { target_um: 11.0, duration_s: 1.5 })],
        &[(
            2,
            Sweep {
                center_um: 5.0,
                amplitude_um: 1.0,
                from_hz: 1.0,
                to_hz: 400.0,
                duration_s: 6.0,
                blend_s: 0.1,
            },
        )],
        &[(0, Staircase { wave: wave(0.0, 10.0, 0.3), steps: 10, slope_um_per_ms: 0.1 })],
        &[
            (0, Sine(wave(0.0, 12.0, 1.0))),
            (1, Sine(wave(0.0, 12.0, 1.7))),
            (2, Sine(wave(0.0, 12.0, 2.3))),
        ],
    ];
    for (i, waves) in program.iter().enumerate() {
        start(&mut b, &mut told, waves);
        b.run_for(8 * SECOND).unwrap();
        // Changes of settings in motion.
        let changed = match i {
            3 => &with_feedback,
            5 => &with_model,
            _ => continue,
        };
        let tick = b.act(&Ask::SetSettings(changed.clone())).unwrap();
        told.push((tick, Told::Settings(Box::new(changed.clone()))));
    }
    let tick = b.act(&Ask::Disarm).unwrap();
    told.push((tick, Told::Control(Command::Disarm)));
    b.run_for(5 * SECOND + 50 * MILLISECOND).unwrap();

    let samples = b.link.samples.take().unwrap();
    let board = b.board.0.borrow();
    let log = board.log.as_ref().unwrap();
    assert_eq!((b.link.tally.missing, b.link.tally.bad), (0, 0));
    assert!(samples.len() >= 600_000, "{} samples", samples.len());

    // The same core, the same plant, from the first tick; settings of the boot until the board was told others.
    let mut host =
        ClosedLoop::new(&rig(), &settings(), Options { seed, ..Options::default() }).unwrap();
    host.set_settings(&Settings::default()).unwrap();
    let first = samples[0].tick;
    let mut told = told.into_iter().peekable();
    let (mut compared, mut sample) = (0u64, samples.iter());
    let last = samples.last().unwrap().tick;
    let mut outside = Vec::new();
    let mut latched = [256; AXES];
    let mut held = [0; AXES];
    for tick in 0..=last {
        while let Some((_, order)) = told.next_if(|(at, _)| u64::from(*at) <= tick) {
            match order {
                Told::Settings(s) => host.set_settings(&s).unwrap(),
                Told::Control(c) => host.command(c).unwrap(),
            }
        }
        let step = host.step();
        let record = step.record;
        assert_eq!(u64::from(record.tick), tick);
        if tick >= first {
            let s = sample.next().unwrap();
            assert_eq!(s.tick, tick);
            // What acts from this tick on was computed by the one before.
            for (k, (axis, held)) in record.axes.iter().zip(held).enumerate() {
                let host = (
                    axis.reference.to_bits(),
                    axis.position.to_bits(),
                    held,
                    axis.monitor.to_bits(),
                );
                let board = (s.reference[k], s.position[k], s.drive[k], s.monitor[k]);
                assert_eq!(
                    board,
                    host,
                    "tick {tick}, axis {}: reference, position, drive, monitor",
                    k + 1
                );
            }
            assert_eq!(s.flags, record.flags.0, "tick {tick}: flags");
            compared += 1;
        }
        outside.push((latched, step.true_um));
        latched = record.axes.map(|a| a.dac);
        held = record.axes.map(|a| a.drive.to_bits());
    }
    // The outside world too: the codes that the board's DACs latched at each edge, the true positions of its plant.
    for (n, (t, o)) in log.iter().zip(&outside).enumerate() {
        assert_eq!((t.codes, t.true_um), *o, "edge {n}: DAC codes and true positions");
    }
    println!("{compared} ticks ({:.1} s) of three axes: identical", compared as f64 / 1e4);
}
