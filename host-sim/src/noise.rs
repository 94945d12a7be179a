//! The noise of a plant's readings.

use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Numbers drawn at once: in a row they take half the time of the same numbers one by one between other work.
const BLOCK: usize = 256;

/// Normal numbers of mean 0 and variance 1, in the order in which the generator gives them.
pub struct Noise {
    random: Xoshiro256PlusPlus,
    block: [f64; BLOCK],
    taken: usize,
}

impl Noise {
    /// From a seed.
    pub fn new(seed: u64) -> Self {
        let random = Xoshiro256PlusPlus::seed_from_u64(seed);
        Self { random, block: [0.0; BLOCK], taken: BLOCK }
    }

    /// The next number.
    #[inline]
    pub fn draw(&mut self) -> f64 {
        if self.taken >= BLOCK {
            self.refill();
        }
        let number = self.block[self.taken];
        self.taken += 1;
        number
    }

    #[cold]
    #[inline(never)]
    fn refill(&mut self) {
        // A copy of the generator stays in registers through the loop.
        let mut random = self.random.clone();
        for number in &mut self.block {
            *number = random.sample(StandardNormal);
        }
        self.random = random;
        self.taken = 0;
    }
}
