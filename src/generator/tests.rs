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
    let generator = Generator::build(&multisine).unwrap();
    let mut multisines = Multisines::running(&generator);
    let values = (0..10_000).map(|_| multisines.step() as f64 / ONE_Q30 as f64);
    let (low, high) = values.fold((9.0f64, -9.0f64), |(low, high), x| (x.min(low), x.max(high)));
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
