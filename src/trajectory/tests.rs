//! References stay within what was planned, to their very end.

use std::vec::Vec;

use super::*;
use crate::Command;
use crate::generator::{GeneratorSettings, Multisine, Wave};

fn stage(trajectory: &mut Trajectory, multisines: &mut Multisines, settings: &GeneratorSettings) {
    for command in Generator::build(settings).unwrap().staging(0) {
        match command {
            Command::StagePart { part, words, .. } => {
                assert!(trajectory.stage_part(multisines, usize::from(part), &words));
            }
            Command::Stage { generator, .. } => trajectory.stage(multisines, &generator),
            other => panic!("{other:?}"),
        }
    }
}

/// Every position until it rests, and the largest change of velocity, um per tick and tick.
fn run(settings: &GeneratorSettings, ticks: usize) -> (Vec<f64>, f64) {
    let mut trajectory = Trajectory::at(Um::from_f32(2.0));
    let mut multisines = Multisines::NONE;
    stage(&mut trajectory, &mut multisines, settings);
    trajectory.start_staged(&mut multisines);
    let (mut path, mut bend) = (Vec::new(), 0.0f64);
    for _ in 0..ticks {
        let motion =
            trajectory.step(None, || multisines.step(), Um::from_f32(-100.0), Um::from_f32(100.0));
        path.push(motion.position.to_f64());
        bend = bend.max((motion.acceleration.to_f64() / 16.0).abs());
    }
    assert!(!trajectory.is_moving(), "{settings:?} is still under way");
    (path, bend)
}

#[test]
fn a_wave_that_ends_stays_within_its_amplitude_and_reaches_its_centre() {
    // Durations that end anywhere in a period; 600 Hz at 5 um changes by 1.9 um a tick, and coasting on would overshoot fivefold.
    for frequency_hz in [3.0f32, 45.0, 160.0, 600.0] {
        for tenths_of_ms in [900u16, 903, 907, 911] {
            let duration_s = f32::from(tenths_of_ms) * 1.0e-4;
            let wave = Wave {
                center_um: 6.0,
                amplitude_um: 5.0,
                frequency_hz,
                phase_turns: 0.1,
                blend_s: 0.02,
                duration_s,
            };
            let multisine = Multisine {
                center_um: 6.0,
                peak_um: 5.0,
                base_hz: frequency_hz / 30.0,
                first: 1,
                stride: 3,
                tones: 10,
                seed: 5,
                blend_s: 0.02,
                duration_s,
            };
            let sweep = GeneratorSettings::Sweep {
                center_um: 6.0,
                amplitude_um: 5.0,
                from_hz: frequency_hz / 2.0,
                to_hz: frequency_hz,
                duration_s,
                blend_s: 0.02,
            };
            for settings in [
                GeneratorSettings::Sine(wave),
                GeneratorSettings::Triangle(wave),
                GeneratorSettings::Multisine(multisine),
                sweep,
            ] {
                let (path, bend) = run(&settings, 1_300);
                let high = path.iter().copied().fold(f64::MIN, f64::max);
                let low = path.iter().copied().fold(f64::MAX, f64::min);
                assert!(high <= 11.0 + 1e-6 && low >= 1.0 - 1e-6, "{settings:?}: {low}..{high} um");
                assert!((path[path.len() - 1] - 6.0).abs() < 1e-6, "{settings:?}");
                // No corner beyond the wave's own: a sine's largest acceleration and what a blend of 200 ticks adds, or the
                // triangle's tip.
                let turn = std::f64::consts::TAU * f64::from(frequency_hz.max(10.0)) * 1e-4;
                let own = match settings {
                    GeneratorSettings::Triangle(_) => {
                        2.0 * 4.0 * 5.0 * f64::from(frequency_hz) * 1e-4
                    }
                    _ => 5.0 * turn * turn,
                };
                let blend = 10.0 * (6.0 / 200.0 / 200.0 + 2.0 * 1.5 / 200.0 * turn);
                assert!(
                    bend <= 1.05 * own + blend,
                    "{settings:?}: {bend} um/tick^2, {own} + {blend}"
                );
            }
        }
    }
}

#[test]
fn a_wave_shorter_than_its_blend_ends_at_its_centre_too() {
    let wave = Wave { duration_s: 0.01, blend_s: 0.05, ..Wave::between(1.0, 11.0, 300.0) };
    let (path, _) = run(&GeneratorSettings::Sine(wave), 800);
    assert!((path[path.len() - 1] - 6.0).abs() < 1e-6);
    assert!(path.iter().all(|x| (1.0..=11.0).contains(x)));
}
