//! References against the same waveforms in double precision, from the first tick to the end of their fading out.

mod common;

use common::Bench;
use flexstage::generator::{GeneratorSettings, Wave};
use flexstage::{Command, Generator, Settings};
use proptest::prelude::*;
use std::f64::consts::TAU;

const TICK_S: f64 = 1.0e-4;
/// The reference of a record is the point that was worked out three ticks before.
const AHEAD: usize = 3;
const TICKS: usize = 6_000;

/// References of axis 1 from the first point of a waveform on, and where it was before, um.
fn references(settings: &GeneratorSettings) -> (f64, Vec<f64>) {
    let mut stage = Settings::default();
    for axis in &mut stage.axes {
        axis.limits.following_error_um = 0.0;
        axis.limits.min_um = -100.0;
        axis.limits.max_um = 100.0;
    }
    stage.guard.arming_s = 0.01;
    let mut bench = Bench::new(&stage, 8.0);
    bench.arm();
    let generator = Generator::build(settings).unwrap();
    bench.controller.command(&bench.config, Command::Stage { axis: 0, generator }).unwrap();
    bench.controller.command(&bench.config, Command::Start { axes: 1 }).unwrap();
    let mut reference = || bench.tick().axes[0].reference.to_f64();
    let start = (0..AHEAD).map(|_| reference()).last().unwrap();
    (start, (0..TICKS).map(|_| reference()).collect())
}

fn smooth(u: f64) -> f64 {
    u * u * (3.0 - 2.0 * u)
}

/// From 0 to 1 with parabolas over the first and the last eighth, straight between.
fn rounded(u: f64) -> f64 {
    match u {
        u if u > 0.5 => 1.0 - rounded(1.0 - u),
        u if u < 0.125 => 32.0 / 7.0 * u * u,
        u => 8.0 / 7.0 * (u - 1.0 / 16.0),
    }
}

/// Share of a time of `seconds` that is over after `ticks`.
fn share(ticks: usize, seconds: f32) -> f64 {
    let all = (f64::from(seconds) / TICK_S).round();
    if all <= 1.0 { 1.0 } else { (ticks as f64 / all).min(1.0) }
}

/// What a blend over `way_um` may be off by at its point `n`: its step a tick is rounded down to 2^-32, and no blend is steeper than
/// 1.5; then a few units of Q1.30 and of the position.
fn blend_rounding_um(n: usize, way_um: f64) -> f64 {
    let way_um = way_um.abs();
    way_um * (1.5 * (n + 1) as f64 * 0.5_f64.powi(32) + 6.0 * 0.5_f64.powi(30))
        + 3.0 * 0.5_f64.powi(24)
}

/// Largest deviation beyond what rounding explains, um. `shape(turns)` is the waveform, of which no part is steeper than `steepness` a
/// turn.
fn beyond(
    settings: &GeneratorSettings,
    wave: &Wave,
    shape: impl Fn(f64) -> f64,
    steepness: f64,
) -> f64 {
    let (start, found) = references(settings);
    let (center, amplitude) = (f64::from(wave.center_um), f64::from(wave.amplitude_um));
    let duration = (f64::from(wave.duration_s) / TICK_S).round() as usize;
    let mut worst = f64::NEG_INFINITY;
    for (n, found) in found.iter().enumerate() {
        let turns = f64::from(wave.phase_turns) + n as f64 * f64::from(wave.frequency_hz) * TICK_S;
        let mut w = shape(turns);
        if duration != 0 && n + 1 > duration {
            w *= 1.0 - smooth(share(n + 1 - duration, wave.blend_s));
        }
        let target = center + amplitude * w;
        let exact = start + smooth(share(n + 1, wave.blend_s)) * (target - start);
        // Half a unit of the phase's 2^-32 a tick, single-precision settings, a few units of Q1.30; the fading out is a blend too.
        let phase = n as f64 * 0.5_f64.powi(33) + 2.0e-7;
        let rounding = amplitude * (steepness * phase + 6.0 * 0.5_f64.powi(30))
            + blend_rounding_um(n, target - start)
            + if w == shape(turns) { 0.0 } else { blend_rounding_um(n - duration, amplitude) };
        worst = worst.max((found - exact).abs() - rounding);
    }
    worst
}

fn triangle(turns: f64) -> f64 {
    (TAU * turns).sin().asin() / (TAU / 4.0)
}

fn wave() -> impl Strategy<Value = Wave> {
    (
        -20.0f32..20.0,
        0.0f32..20.0,
        0.0f32..2_500.0,
        -1.0f32..1.0,
        0.0f32..0.1,
        prop_oneof![Just(0.0f32), 0.01f32..0.3],
    )
        .prop_map(
            |(center_um, amplitude_um, frequency_hz, phase_turns, blend_s, duration_s)| Wave {
                center_um,
                amplitude_um,
                frequency_hz,
                phase_turns,
                blend_s,
                duration_s,
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        rng_seed: proptest::test_runner::RngSeed::Fixed(2026),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn sines_and_triangles(wave in wave()) {
        let sine = beyond(&GeneratorSettings::Sine(wave), &wave, |turns| (TAU * turns).sin(), TAU);
        prop_assert!(sine <= 0.0, "sine off by {sine} um more than rounding");
        let other = beyond(&GeneratorSettings::Triangle(wave), &wave, triangle, 4.0);
        prop_assert!(other <= 0.0, "triangle off by {other} um more than rounding");
    }

    #[test]
    fn squares(wave in wave(), ratio in 1.0f32..50.0) {
        // A triangle that is `ratio` times as steep, cut at its amplitude; none where the slope has a range of its own.
        let slope_um_per_ms = 4.0e-3 * wave.amplitude_um * wave.frequency_hz * ratio;
        prop_assume!((1.0e-3..1.0e3).contains(&slope_um_per_ms));
        let square = GeneratorSettings::Square { wave, slope_um_per_ms };
        let steep = f64::from(ratio);
        let shape = |turns: f64| (steep * triangle(turns)).clamp(-1.0, 1.0);
        // The ratio has 16 bits after the point, and is worked out in single precision.
        let rounding = f64::from(wave.amplitude_um) * 2.0e-5;
        let off = beyond(&square, &wave, shape, 4.0 * steep) - rounding;
        prop_assert!(off <= 0.0, "off by {off} um more than rounding");
    }

    #[test]
    fn moves(to_um in -50.0f32..50.0, seconds in 2.0e-4f32..0.5) {
        for (settings, blend) in [
            (GeneratorSettings::Hold { position_um: to_um, blend_s: seconds }, smooth as fn(f64) -> f64),
            (GeneratorSettings::Ramp { target_um: to_um, duration_s: seconds }, rounded),
        ] {
            let (start, found) = references(&settings);
            for (n, found) in found.iter().enumerate() {
                let exact = start + blend(share(n + 1, seconds)) * (f64::from(to_um) - start);
                let rounding = blend_rounding_um(n, f64::from(to_um) - start);
                prop_assert!((found - exact).abs() < rounding, "{settings:?}, point {n}: {found} um, not {exact} um");
            }
        }
    }

    #[test]
    fn sweeps(amplitude_um in 0.1f32..20.0, from_hz in 1.0f32..1_000.0, to_hz in 1.0f32..1_000.0, duration_s in 0.45f32..0.55) {
        let sweep = GeneratorSettings::Sweep { center_um: 5.0, amplitude_um, from_hz, to_hz, duration_s, blend_s: 0.0 };
        prop_assume!(Generator::build(&sweep).is_ok());
        let (_, found) = references(&sweep);
        let ticks = f64::from(duration_s) / TICK_S;
        let ratio_ln = (f64::from(to_hz) / f64::from(from_hz)).ln();
        let growth = (ratio_ln / ticks).exp();
        let (mut turns, mut step) = (0.0, f64::from(from_hz) * TICK_S);
        for (n, found) in found.iter().enumerate().take(ticks as usize) {
            let exact = 5.0 + f64::from(amplitude_um) * (TAU * turns).sin();
            // `math::ln` is good to 2e-5 of 1 + |ln|, which is by how much the frequency is off in the end.
            let rounding = f64::from(amplitude_um) * TAU * (2.0e-5 * (1.0 + ratio_ln.abs()) * turns + 1.0e-6) + 1.0e-6;
            prop_assert!((found - exact).abs() < rounding, "point {n}: {found} um, not {exact} um");
            turns += step;
            step *= growth;
        }
    }
}
