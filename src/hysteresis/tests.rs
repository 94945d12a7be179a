//! The line until the next slip, and models that follow each other, against every element in every tick.

use super::takeover::FIT_AT_ONCE;
use super::*;
use std::vec::Vec;

/// The model as the paper writes it: every element in every tick.
struct Plain {
    elastic: Vec<MicroCoulomb>,
    charge: MicroCoulomb,
}

impl Plain {
    fn step(&mut self, elements: &[Maxwell], charge: MicroCoulomb) -> Volt {
        let change = charge - self.charge;
        self.charge = charge;
        let mut sum = Wide::ZERO;
        for (elastic, element) in self.elastic.iter_mut().zip(elements) {
            *elastic = (*elastic + change).limit(-element.slip(), element.slip());
            sum = sum + element.elastance() * *elastic;
        }
        sum.narrow()
    }
}

fn random(seed: &mut u64) -> u32 {
    *seed ^= *seed << 13;
    *seed ^= *seed >> 7;
    *seed ^= *seed << 17;
    (*seed >> 20) as u32
}

#[test]
fn a_line_until_the_next_slip_is_the_clamp_of_every_element() {
    let mut seed = 0x1234_5678_9abc_def1;
    for round in 0..200 {
        let mut elements: Vec<Maxwell> = (0..random(&mut seed) % 17)
            .map(|_| {
                Maxwell::new(
                    Gain::from_f32((random(&mut seed) % 1000) as f32 * 1e-3),
                    MicroCoulomb::from_bits((random(&mut seed) % 40_000_000) as i32),
                )
            })
            .collect();
        elements.sort_by_key(|e| e.slip());
        let mut plain =
            Plain { elastic: std::vec![MicroCoulomb::ZERO; 16], charge: MicroCoulomb::ZERO };
        let mut state = HysteresisState::RELAXED;
        state.relax(&elements, MicroCoulomb::ZERO);
        let mut charge = 0i32;
        for n in 0..5_000 {
            // Strides from a standstill to jumps over all elements.
            let most = 1u32 << (random(&mut seed) % 27);
            let stride = (random(&mut seed) % most) as i32 - (most / 2) as i32;
            charge = (charge + stride).clamp(-400_000_000, 400_000_000);
            let q = MicroCoulomb::from_bits(charge);
            let (fast, slow) = (state.step(&elements, q), plain.step(&elements, q));
            assert_eq!(fast, slow, "round {round}, tick {n}");
        }
    }
}

/// The same as [`HysteresisState`] with one form for both directions: charges are mirrored while they fall, and every sum saturates.
struct Mirrored {
    last: i32,
    falling: i32,
    slipping: usize,
    line: (Gain<MicroCoulomb, Volt>, Wide<Volt>),
    stiffest: Gain<MicroCoulomb, Volt>,
    places: Vec<MicroCoulomb>,
}

impl Mirrored {
    fn step(&mut self, elements: &[Maxwell], charge: MicroCoulomb) -> Volt {
        if charge.to_bits() ^ self.falling < self.last {
            let turned = MicroCoulomb::from_bits(self.last ^ self.falling);
            self.falling = !self.falling;
            for place in &mut self.places[..self.slipping] {
                *place = turned - *place;
            }
            self.line.1 = self.line.1 - (self.stiffest - self.line.0) * turned;
            (self.line.0, self.slipping) = (self.stiffest, 0);
        }
        self.last = charge.to_bits() ^ self.falling;
        while let Some(element) = elements.get(self.slipping) {
            let place = &mut self.places[self.slipping];
            let at = (place.to_bits() ^ self.falling).saturating_add(element.slip().to_bits());
            if self.last <= at {
                break;
            }
            let at = MicroCoulomb::from_bits(at ^ self.falling);
            *place = at - *place;
            self.line.0 = self.line.0 - element.elastance();
            self.line.1 = self.line.1 + element.elastance() * at;
            self.slipping += 1;
        }
        (self.line.0 * charge + self.line.1).narrow()
    }
}

#[test]
fn both_directions_are_one_mirrored_to_the_ends_of_the_range() {
    let mut seed = 0x0bad_5eed_1234_5679;
    for round in 0..200 {
        let most = [40_000_000, i32::MAX as u32][round % 2];
        let mut elements: Vec<Maxwell> = (0..1 + random(&mut seed) % 16)
            .map(|_| {
                Maxwell::new(
                    Gain::from_f32((random(&mut seed) % 1000) as f32 * 1e-3),
                    MicroCoulomb::from_bits((random(&mut seed) % most) as i32),
                )
            })
            .collect();
        elements.sort_by_key(|e| e.slip());
        let mut state = HysteresisState::RELAXED;
        state.relax(&elements, MicroCoulomb::ZERO);
        let mut mirrored = Mirrored {
            last: 0,
            falling: 0,
            slipping: 0,
            line: (state.slope, state.offset),
            stiffest: state.stiffest,
            places: std::vec![MicroCoulomb::ZERO; 16],
        };
        let (mut charge, mut ends) = (0i32, 0);
        for n in 0..2_000 {
            let most = 1u32 << (random(&mut seed) % 32);
            let stride = (random(&mut seed) % most).wrapping_sub(most / 2) as i32;
            charge = charge.saturating_add(stride.saturating_mul(2));
            ends += usize::from(charge == i32::MIN) + usize::from(charge == i32::MAX);
            let q = MicroCoulomb::from_bits(charge);
            let (one, other) = (state.step(&elements, q), mirrored.step(&elements, q));
            assert_eq!(
                (one, state.slipping),
                (other, mirrored.slipping),
                "round {round}, tick {n}"
            );
        }
        assert!(ends > 20, "{ends} times at an end of the range");
    }
}

#[test]
fn other_elements_take_over_where_the_old_ones_stood() {
    let element =
        |slip_uc: f32| Maxwell::new(Gain::from_f32(0.03), MicroCoulomb::from_f32(slip_uc));
    let (three, two) = ([element(1.0), element(2.0), element(4.0)], [element(1.0), element(3.0)]);
    let mut state = HysteresisState::RELAXED;
    let at = MicroCoulomb::from_f32;
    state.relax(&three, at(0.0));
    let before = state.step(&three, at(3.0)).to_f64();
    assert!((before - 0.03 * (1.0 + 2.0 + 3.0)).abs() < 1e-5);
    // Another charge for the same position, one element less.
    state.carry(at(5.0));
    let carried = state.step(&three, at(5.0)).to_f64();
    assert!((carried - before).abs() < 1e-5, "{carried}");
    while !state.fit(&two) {}
    let moved = state.take_over(&two).to_f64();
    let after = state.step(&two, at(5.0)).to_f64();
    assert!((after - before - moved).abs() < 1e-5, "{moved}");
    assert!((after - 0.03 * (1.0 + 2.0)).abs() < 1e-5, "{after}");
    let on = state.step(&two, at(5.5)).to_f64();
    assert!((on - 0.03 * (1.0 + 2.5)).abs() < 1e-5, "{on}");
    let back = state.step(&two, at(4.5)).to_f64();
    assert!((back - 0.03 * (0.0 + 1.5)).abs() < 1e-5, "{back}");
}
/// As far from the charge as they were, as far as the limits of some first elements allow.
fn fit_plainly(elastic: &mut [MicroCoulomb], elements: &[Maxwell]) {
    let (mut last, mut slip) = (0, 0);
    for (e, element) in elastic.iter_mut().zip(elements) {
        let room = element.slip().to_bits() - slip;
        slip = element.slip().to_bits();
        last = e.to_bits().clamp(last - room, last + room);
        *e = MicroCoulomb::from_bits(last);
    }
}

/// From then on it is the clamp of every new element, to the bit, even if one more model came before the first had taken over.
#[test]
fn elements_that_took_over_are_the_clamp_of_every_one() {
    let mut seed = 0x9876_5432_1abc_def7;
    let draw = |seed: &mut u64| {
        let mut elements: Vec<Maxwell> = (0..1 + random(seed) % 16)
            .map(|_| {
                Maxwell::new(
                    Gain::from_f32((random(seed) % 1000) as f32 * 1e-3),
                    MicroCoulomb::from_bits((random(seed) % 40_000_000) as i32),
                )
            })
            .collect();
        elements.sort_by_key(|e| e.slip());
        elements
    };
    for round in 0..300 {
        let mut elements = draw(&mut seed);
        let zero = MicroCoulomb::ZERO;
        let mut plain = Plain { elastic: std::vec![zero; 16], charge: zero };
        let mut state = HysteresisState::RELAXED;
        state.relax(&elements, zero);
        let mut charge = 0i32;
        for change in 0..6 {
            for n in 0..300 {
                let most = 1u32 << (random(&mut seed) % 27);
                let stride = (random(&mut seed) % most) as i32 - (most / 2) as i32;
                charge = (charge + stride).clamp(-400_000_000, 400_000_000);
                let q = MicroCoulomb::from_bits(charge);
                let (fast, slow) = (state.step(&elements, q), plain.step(&elements, q));
                assert_eq!(fast, slow, "round {round}, change {change}, tick {n}");
            }
            let before = state.step(&elements, plain.charge);
            plain.elastic[elements.len()..].fill(zero);
            let parts = if random(&mut seed).is_multiple_of(2) { random(&mut seed) % 6 } else { 0 };
            if parts > 0 {
                // This one does not get as far as to take over.
                elements = draw(&mut seed);
                state.carry(MicroCoulomb::from_bits(charge / 2 + 77));
                let mut fitted = 0;
                for _ in 0..parts {
                    if !state.fit(&elements) {
                        fitted = elements.len().min(fitted + FIT_AT_ONCE);
                    }
                }
                fit_plainly(&mut plain.elastic, &elements[..fitted]);
            }
            elements = draw(&mut seed);
            charge = charge / 3 - 1_234;
            plain.charge = MicroCoulomb::from_bits(charge);
            state.carry(plain.charge);
            let carried = state.step(&elements, plain.charge);
            assert!((carried - before).abs().to_bits() <= 1, "round {round}: {before} {carried}");
            while !state.fit(&elements) {}
            fit_plainly(&mut plain.elastic, &elements);
            let moved = state.take_over(&elements);
            let now = state.step(&elements, plain.charge);
            assert_eq!(now, plain.step(&elements, plain.charge), "round {round}, {change}");
            assert!((now - carried - moved).abs().to_bits() <= 1, "round {round}: {moved}");
            assert!(!state.is_carried());
        }
    }
}
