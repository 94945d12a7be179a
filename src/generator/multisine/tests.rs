//! A multisine is its sum of sines, for hours, and periodic to the bit.

use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::generator::waves::multisine_sum;
use crate::generator::{GeneratorSettings, Multisine};
use crate::math::ONE_Q30;

impl Multisines {
    /// One that has just been started.
    pub(in crate::generator) fn running(generator: &Generator) -> Self {
        let mut multisines = Self::NONE;
        let mut is_complete = multisines.stage(generator);
        for part in 0..generator.parts() {
            assert!(!is_complete);
            is_complete = multisines.take(part, &generator.part(part)).expect("a part that lacks");
        }
        assert!(is_complete);
        multisines.start();
        multisines
    }

    /// Goes on by many blocks at once; the block that is being put out stays what it is.
    fn skip(&mut self, blocks: u32) {
        let Tones { first, stride, first_step, stride_step, .. } =
            &mut self.banks[self.running].tones;
        *first = first.wrapping_add(first_step.wrapping_mul(blocks));
        *stride = stride.wrapping_add(stride_step.wrapping_mul(blocks));
    }
}

fn generator(first: u16, stride: u16, tones: u8, base_hz: f32, seed: u32) -> Generator {
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
    Generator::build(&settings).unwrap()
}

/// A sixteenth of the sum of the tones, in double precision, and by the recurrence that the amplitude was found with.
fn sums(g: &Generator, phase: u32) -> [f64; 2] {
    let Shape::Multisine { first, stride, tones, signs, .. } = g.shape else { unreachable!() };
    let turn = |phase: u32| f64::from(phase) / 4_294_967_296.0 * std::f64::consts::TAU;
    // Sines of sums of angles: as exact, and quicker than a sine a tone.
    let (mut sin, mut cos) = turn(phase.wrapping_mul(u32::from(first))).sin_cos();
    let (sin_x, cos_x) = turn(phase.wrapping_mul(u32::from(stride))).sin_cos();
    let mut exact = 0.0;
    for k in 0..tones {
        exact += if signs >> k & 1 == 0 { sin } else { -sin };
        (sin, cos) = (sin * cos_x + cos * sin_x, cos * cos_x - sin * sin_x);
    }
    let recurrence = multisine_sum(phase, first, stride, tones, signs);
    [exact / 16.0, f64::from(recurrence) / f64::from(ONE_Q30)]
}

/// Largest distance of some values from the sum of the tones, from a tick on, as a share of all sixteen.
fn worst(g: &Generator, values: impl Iterator<Item = i32>, tick: u32) -> f64 {
    let Shape::Multisine { amplitude, .. } = g.shape else { unreachable!() };
    let (mut phase, mut worst) = (g.step.wrapping_mul(tick), 0.0f64);
    for value in values {
        let [exact, recurrence] = sums(g, phase);
        assert!((exact - recurrence).abs() < 1e-6, "{phase:#x}: {exact}, {recurrence}");
        let sixteenth = f64::from(value) / (16.0 * f64::from(amplitude));
        worst = worst.max((sixteenth - exact).abs());
        phase = phase.wrapping_add(g.step);
    }
    worst
}

/// Tones close together, far apart, few, and up to a quarter of the tick rate.
#[test]
fn it_is_its_sum_of_sines_for_ten_minutes() {
    for (first, stride, tones, base_hz, seed) in [
        (1, 1, 16, 1.0, 1),
        (3, 7, 16, 0.1, 7),
        (5, 166, 16, 0.99, 99),
        (100, 60, 16, 2.0, 3),
        (1, 2, 1, 900.0, 4),
        (7, 300, 9, 1.0, 12),
    ] {
        let g = generator(first, stride, tones, base_hz, seed);
        let mut multisines = Multisines::running(&g);
        let values = (0..600 * crate::TICK_HZ).map(|_| multisines.step());
        let worst = worst(&g, values, 0);
        println!("{first} {stride} {tones}: {worst:.2e}");
        assert!(worst < 1e-6, "{first} {stride} {tones}: {worst}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 256,
        rng_seed: prop::test_runner::RngSeed::Fixed(2026),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Any settings, at the start and after up to 79 days.
    #[test]
    fn it_is_its_sum_of_sines_whatever_and_whenever(
        tones in 1u8..=16,
        (first, stride) in (1u16..300, 1u16..240),
        share in 0.0f32..1.0,
        seed in any::<u32>(),
        blocks in any::<u32>(),
    ) {
        let highest = f32::from(first) + f32::from(stride) * f32::from(tones - 1);
        prop_assume!(highest <= 4_096.0);
        let g = generator(first, stride, tones, share * (2_500.0 / highest).min(1_000.0), seed);
        let mut multisines = Multisines::running(&g);
        let early = worst(&g, (0..1_000).map(|_| multisines.step()), 0);
        prop_assert!(early < 1e-6, "{early}");
        // A thousand ticks end in the middle of a block, whose values are ready, and whose successor's are not begun.
        multisines.skip(blocks);
        for _ in 1_000..1_024 {
            multisines.step();
        }
        let from = 1_024u32.wrapping_add(blocks.wrapping_mul(16));
        let late = worst(&g, (0..1_000).map(|_| multisines.step()), from);
        prop_assert!(late < 1e-6, "{late} after {blocks} blocks");
    }
}

/// A period of 2 048 ticks is 128 blocks. The first block, which comes with the waveform, is as all others.
#[test]
fn it_is_periodic_to_the_bit() {
    for (first, stride, tones, seed) in [(3, 7, 16, 7), (1, 1, 5, 2), (9, 30, 16, 40)] {
        let mut g = generator(first, stride, tones, 4.882_812_5, seed);
        assert_eq!(g.step, 1 << 21);
        g.step = 1 << 21;
        let mut multisines = Multisines::running(&g);
        let period: Vec<i32> = (0..2_048).map(|_| multisines.step()).collect();
        for round in 0..20 {
            for (n, value) in period.iter().enumerate() {
                assert_eq!(multisines.step(), *value, "round {round}, tick {n}");
            }
        }
    }
}

#[test]
fn it_never_leaves_its_peak() {
    // One tone fills it; an amplitude that is too large is cut, not wrapped.
    let mut g = generator(1, 1, 16, 7.0, 5);
    let Shape::Multisine { amplitude, .. } = &mut g.shape else { unreachable!() };
    *amplitude = ONE_Q30 / 3;
    let mut multisines = Multisines::running(&g);
    let values: Vec<i32> = (0..5_000).map(|_| multisines.step()).collect();
    let (least, most) = (values.iter().min().unwrap(), values.iter().max().unwrap());
    assert!(*most <= ONE_Q30 && *least >= -ONE_Q30, "{least} to {most}");
    assert!(*most > ONE_Q30 - 8 || *least < 8 - ONE_Q30, "{least} to {most}");
}

#[test]
fn parts_are_taken_once_and_in_their_order() {
    let g = generator(3, 7, 16, 1.0, 7);
    let words = [0; PART_WORDS];
    let mut multisines = Multisines::NONE;
    assert_eq!(multisines.take(0, &words), None, "nothing is staged");
    assert!(!multisines.stage(&g));
    assert_eq!(multisines.take(PARTS, &words), None);
    assert_eq!(multisines.take(usize::MAX, &words), None);
    assert_eq!(multisines.take(1, &words), None, "not its turn");
    for part in 0..PARTS {
        assert_eq!(multisines.take(part, &words), Some(part == PARTS - 1));
        assert_eq!(multisines.take(part, &words), None, "once");
    }
    assert_eq!(multisines.take(0, &words), None, "complete");
    assert!(multisines.stage(&Generator::STOP), "another waveform has no parts");
    assert_eq!(multisines.take(0, &words), None);
}
