//! References against the same waveforms in double precision, from the first tick to the end of their fading out.

mod common;

use common::{Bench, cases, wave};
use flexstage::generator::{GeneratorSettings, Multisine, Wave};
use flexstage::{Command, Generator, Settings, Table};
use proptest::prelude::*;
use std::f64::consts::TAU;

const TICK_S: f64 = 1.0e-4;
/// The reference of a record is the point that was worked out three ticks before.
const AHEAD: usize = 3;
const TICKS: usize = 6_000;

/// References of axis 1 from the first point of a waveform on, and where it was before, um.
fn references(settings: &GeneratorSettings, table: &Table) -> (f64, Vec<f64>) {
    let mut stage = Settings::default();
    for axis in &mut stage.axes {
        axis.limits.following_error_um = 0.0;
        axis.limits.min_um = -100.0;
        axis.limits.max_um = 100.0;
    }
    stage.guard.arming_s = 0.01;
    let mut bench = Bench::new(&stage, 8.0);
    bench.table = table.clone();
    bench.arm();
    let generator = Generator::build(settings).unwrap();
    bench.stage(0, generator);
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
    beyond_with(settings, &Table::EMPTY, wave, shape, steepness)
}

/// The same with a table in the controller.
fn beyond_with(
    settings: &GeneratorSettings,
    table: &Table,
    wave: &Wave,
    shape: impl Fn(f64) -> f64,
    steepness: f64,
) -> f64 {
    let (start, found) = references(settings, table);
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

/// Treads and edges: `steps` up and as many down, an edge being `steep` times as steep as the triangle.
fn staircase(turns: f64, steps: f64, steep: f64) -> f64 {
    let height = (triangle(turns) + 1.0) / 2.0 * steps;
    let edge = (steep * (height.fract() - 0.5) + 0.5).clamp(0.0, 1.0);
    2.0 * (height.floor() + edge) / steps - 1.0
}

/// Through the points of one period by the cubics of Catmull and Rom (1974), cut at +-1.
fn through(points: &[f32], turns: f64) -> f64 {
    let place = turns.rem_euclid(1.0) * points.len() as f64;
    let (index, t) = (place as usize, place.fract());
    let p = |offset: usize| f64::from(points[(index + points.len() + offset - 1) % points.len()]);
    let [before, from, to, after] = [p(0), p(1), p(2), p(3)];
    // Hermite's form: both ends, and half the way between their neighbours as slopes.
    let (start, end) = ((to - before) / 2.0, (after - from) / 2.0);
    let (t2, t3) = (t * t, t * t * t);
    let on_the_curve = (2.0 * t3 - 3.0 * t2 + 1.0) * from
        + (t3 - 2.0 * t2 + t) * start
        + (3.0 * t2 - 2.0 * t3) * to
        + (t3 - t2) * end;
    on_the_curve.clamp(-1.0, 1.0)
}

/// Multiples of the base frequency, and the phases that the seed's hash draws, turns.
fn tones(m: &Multisine) -> Vec<(f64, f64)> {
    let mut hash = m.seed;
    for (shift, factor) in [(16, 0x85eb_ca6b), (13, 0xc2b2_ae35), (16, 1)] {
        hash = (hash ^ (hash >> shift)).wrapping_mul(factor);
    }
    (0..u32::from(m.tones))
        .map(|n| {
            let phase = f64::from(hash >> n & 1) / 2.0;
            (f64::from(u32::from(m.first) + n * u32::from(m.stride)), phase)
        })
        .collect()
}

proptest! {
    #![proptest_config(cases(64))]

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
    fn staircases(wave in wave(), steps in 1u16..50, ratio in 1.0f32..50.0) {
        let slope_um_per_ms = 4.0e-3 * wave.amplitude_um * wave.frequency_hz * ratio;
        prop_assume!((1.0e-3..1.0e3).contains(&slope_um_per_ms));
        let settings = GeneratorSettings::Staircase { wave, steps, slope_um_per_ms };
        let (steps, steep) = (f64::from(steps), f64::from(ratio));
        let shape = |turns: f64| staircase(turns, steps, steep);
        // Heights have 16 bits after the point, in steps before the edge and in the whole after it; the ratio as with squares.
        let unit = 0.5_f64.powi(16);
        let rounding = f64::from(wave.amplitude_um) * (2.0 * unit * (steep + 2.0) / steps + 4.0 * unit + 2.0e-5);
        let off = beyond(&settings, &wave, shape, 4.0 * steep) - rounding;
        prop_assert!(off <= 0.0, "off by {off} um more than rounding");
    }

    #[test]
    fn tables(wave in wave(), points in prop::collection::vec(-1.0f32..1.0, 4..200)) {
        let mut table = Table::EMPTY;
        table.set(&points).unwrap();
        let settings = GeneratorSettings::Table(wave);
        // No cubic through values within +-1 is steeper than 4 a point, wherever it is.
        let steepness = 4.0 * points.len() as f64;
        let off = beyond_with(&settings, &table, &wave, |turns| through(&points, turns), steepness);
        prop_assert!(off <= 0.0, "off by {off} um more than rounding");
    }

    /// The tones and their phases exactly; their common scale by the peak over a period.
    #[test]
    fn multisines(peak_um in 0.1f32..20.0, base_hz in 0.1f32..20.0, first in 1u16..20, stride in 1u16..6, tone_count in 1u8..=16, seed in any::<u32>()) {
        let m = Multisine { center_um: 3.0, peak_um, base_hz, first, stride, tones: tone_count, seed, blend_s: 0.0, duration_s: 0.0 };
        let tones = tones(&m);
        let sum = |turns: f64| tones.iter().map(|(multiple, phase)| (TAU * (multiple * turns + phase)).sin()).sum::<f64>();
        let (_, found) = references(&GeneratorSettings::Multisine(m), &Table::EMPTY);
        let exact: Vec<f64> = (0..TICKS).map(|n| sum(n as f64 * f64::from(base_hz) * TICK_S)).collect();
        let power: f64 = exact.iter().map(|x| x * x).sum();
        let scale = exact.iter().zip(&found).map(|(x, y)| x * (y - 3.0)).sum::<f64>() / power;
        let highest = tones.iter().map(|(multiple, _)| *multiple).fold(0.0, f64::max);
        let grid = 64 * highest as usize;
        let peak = (0..grid).map(|n| sum(n as f64 / grid as f64).abs()).fold(0.0, f64::max);
        let reached = scale * peak / f64::from(peak_um);
        // Sixteen samples a turn of the highest tone miss at most 2 % of its peak.
        prop_assert!((0.979..=1.0).contains(&reached), "the peak is {reached} of what was asked for");
        let steepness = scale * TAU * tones.iter().map(|(multiple, _)| multiple).sum::<f64>();
        for (n, (found, x)) in found.iter().zip(&exact).enumerate() {
            // Half a unit of the phase a tick; the recurrence is good to 1e-6 of sixteen tones.
            let phase = n as f64 * 0.5_f64.powi(33) + 2.0e-7;
            let rounding = steepness * phase + scale * 16.0e-6 + 0.5_f64.powi(23);
            prop_assert!((found - 3.0 - scale * x).abs() <= rounding, "point {n}: {found} um, not {} um, rounding {rounding}", 3.0 + scale * x);
        }
    }

    #[test]
    fn moves(to_um in -50.0f32..50.0, seconds in 2.0e-4f32..0.5) {
        for (settings, blend) in [
            (GeneratorSettings::Hold { position_um: to_um, blend_s: seconds }, smooth as fn(f64) -> f64),
            (GeneratorSettings::Ramp { target_um: to_um, duration_s: seconds }, rounded),
        ] {
            let (start, found) = references(&settings, &Table::EMPTY);
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
        let (_, found) = references(&sweep, &Table::EMPTY);
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
