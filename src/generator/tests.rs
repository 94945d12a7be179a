//! Waveforms fill their amplitude and no more, and bad settings are refused by name.

use std::string::ToString;
use std::vec::Vec;

use super::*;
use crate::math::ONE_Q30;

fn range(generator: &Generator, table: &Table) -> (f64, f64) {
    let values = (0..100_000u32)
        .map(|n| generator.wave(Some(table), n.wrapping_mul(42_949)) as f64 / ONE_Q30 as f64);
    values.fold((9.0, -9.0), |(low, high), x| (x.min(low), x.max(high)))
}

#[test]
fn every_waveform_fills_its_amplitude_and_no_more() {
    let wave = Wave::between(0.0, 10.0, 1.0);
    let mut table = Table::EMPTY;
    let points: Vec<f32> =
        (0..64).map(|i| (i as f32 / 64.0 * std::f32::consts::TAU).sin()).collect();
    table.set(&points).unwrap();
    for settings in [
        GeneratorSettings::Triangle(wave),
        GeneratorSettings::Sine(wave),
        GeneratorSettings::Square { wave, slope_um_per_ms: 1.0 },
        GeneratorSettings::Staircase { wave, steps: 5, slope_um_per_ms: 1.0 },
        GeneratorSettings::Table(wave),
    ] {
        let (low, high) = range(&Generator::build(&settings).unwrap(), &table);
        assert!(
            (high - 1.0).abs() < 1e-3 && (low + 1.0).abs() < 1e-3,
            "{settings:?}: {low} {high}"
        );
    }
    let multisine = GeneratorSettings::Multisine(Multisine {
        center_um: 5.0,
        peak_um: 4.0,
        base_hz: 1.0,
        first: 3,
        stride: 7,
        tones: 16,
        seed: 7,
        blend_s: 0.1,
        duration_s: 0.0,
    });
    let (low, high) = range(&Generator::build(&multisine).unwrap(), &table);
    assert!(high.max(-low) > 0.97 && high.max(-low) <= 1.0, "{low} {high}");
}

#[test]
fn a_table_is_followed_between_its_points() {
    let mut table = Table::EMPTY;
    let points: Vec<f32> =
        (0..64).map(|i| (i as f32 / 64.0 * std::f32::consts::TAU).sin()).collect();
    table.set(&points).unwrap();
    for n in 0..10_000u32 {
        let phase = n.wrapping_mul(429_497);
        let exact = (phase as f64 / 4_294_967_296.0 * std::f64::consts::TAU).sin();
        assert!((table.at(phase) as f64 / ONE_Q30 as f64 - exact).abs() < 2e-4);
    }
    assert!(table.set(&[0.0, 2.0, 0.0, 0.0]).is_err());
    assert_eq!(table.len(), 64, "a refused table leaves the old one");
}

#[test]
fn staircase_has_flat_treads() {
    let wave = Wave::between(0.0, 10.0, 1.0);
    let g =
        Generator::build(&GeneratorSettings::Staircase { wave, steps: 4, slope_um_per_ms: 1.0 })
            .unwrap();
    let mut levels: Vec<i32> = Vec::new();
    let mut previous = g.wave(None, 0);
    for n in 1..10_000u32 {
        let w = g.wave(None, n.wrapping_mul(429_497));
        if w == previous && !levels.contains(&w) {
            levels.push(w);
        }
        previous = w;
    }
    assert_eq!(levels.len(), 5, "{levels:?}");
}

#[test]
fn bad_settings_are_refused_by_name() {
    let wave = Wave { frequency_hz: f32::NAN, ..Wave::between(0.0, 1.0, 1.0) };
    let error = Generator::build(&GeneratorSettings::Sine(wave)).unwrap_err();
    assert_eq!(error.field, "frequency_hz");
    assert!(error.to_string().contains("generator.frequency_hz"), "{error}");
}

/// The recurrence against a sum of sines in double precision, in every tick of ten minutes, for tones close together, far apart, few,
/// and up to a quarter of the tick rate.
#[test]
fn a_multisine_is_its_sum_of_sines_for_ten_minutes() {
    for (first, stride, tones, base_hz, seed) in [
        (1, 1, 16, 1.0, 1),
        (3, 7, 16, 0.1, 7),
        (5, 166, 16, 0.99, 99),
        (100, 60, 16, 2.0, 3),
        (1, 2, 1, 900.0, 4),
        (7, 300, 9, 1.0, 12),
    ] {
        let settings = GeneratorSettings::Multisine(Multisine {
            center_um: 0.0,
            peak_um: 1.0,
            base_hz,
            first,
            stride,
            tones,
            seed,
            blend_s: 0.0,
            duration_s: 0.0,
        });
        let g = Generator::build(&settings).unwrap();
        let signs = multisine_signs(seed);
        let turn = |phase: u32| f64::from(phase) / 4_294_967_296.0 * std::f64::consts::TAU;
        let (mut phase, mut worst) = (g.phase, 0.0f64);
        for _ in 0..600 * crate::TICK_HZ {
            // Sines of sums of angles: as exact, and quicker than a sine a tone.
            let (mut sin, mut cos) = turn(phase.wrapping_mul(u32::from(first))).sin_cos();
            let (sin_x, cos_x) = turn(phase.wrapping_mul(u32::from(stride))).sin_cos();
            let mut exact = 0.0;
            for k in 0..tones {
                exact += if signs >> k & 1 == 0 { sin } else { -sin };
                (sin, cos) = (sin * cos_x + cos * sin_x, cos * cos_x - sin * sin_x);
            }
            let sum = multisine_sum(phase, first, stride, tones, signs);
            worst = worst.max((f64::from(sum) / f64::from(ONE_Q30) - exact / 16.0).abs());
            phase = phase.wrapping_add(g.step);
        }
        println!("{first} {stride} {tones}: {worst:.2e}");
        assert!(worst < 1e-6, "{first} {stride} {tones}: {worst}");
    }
}
