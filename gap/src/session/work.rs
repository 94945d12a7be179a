//! How much a diagnosis simulates, counted so that it ends in a time that goes with the recordings, and at the same point on every machine.
//!
//! A search could go on for as long as there are effects to put together. What it may spend is a number of passes over the session; what is
//! spent is counted in ticks of an axis without effects, by what simulations take of it
//! (`cargo run --release -p host-sim --example effect_speed`).

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use host_sim::rig::Rig;

/// Passes over the session, every axis without effects, that a search may spend before it settles for the best that it has: 20 to 30 s on two
/// cores of 2026 for half a minute of three axes at 10 kHz. Three of the 120 sessions of the blind set 18181 come that far.
const MOST_PASSES: u64 = 2000;
/// What a tick takes with an effect there, in tenths of one without, beyond it.
const HEAVY: [(&str, u64); 10] = [
    ("friction", 25),
    ("hysteresis-rate", 50),
    ("hysteresis-shape", 8),
    ("stage-drag", 45),
    ("stiffness-coupling", 90),
    ("stiffness-hardening", 12),
    ("preload-loss", 10),
    ("second-mass", 40),
    ("inertia", 20),
    ("floor-hum", 10),
];
/// The same for one without.
const PLAIN: u64 = 10;

/// What was simulated, and how much there is.
#[derive(Debug)]
pub(crate) struct Work {
    /// Tenths of plain ticks of an axis.
    spent: AtomicU64,
    /// Samples of all recordings on all axes.
    session: u64,
    /// Whether something was left out because of it.
    ended: AtomicBool,
}

impl Work {
    /// For a session of so many samples of all axes together.
    pub(crate) fn new(samples: usize) -> Self {
        Self {
            spent: AtomicU64::new(0),
            session: samples.max(1) as u64,
            ended: AtomicBool::new(false),
        }
    }

    /// Count a simulation of the axes in a mask over so many ticks.
    pub(crate) fn count(&self, rig: &Rig, axes: u32, ticks: usize) {
        let here = |on: usize| axes >> on & 1 == 1;
        let heavy =
            |name: &str| HEAVY.iter().find(|(n, _)| *n == name).map_or(0, |(_, more)| *more);
        let plain = u64::from(axes.count_ones()) * PLAIN;
        let effects = rig.effects.iter().filter(|s| here(s.place.on()));
        let more: u64 = effects.map(|s| heavy(s.effect.info().name)).sum();
        self.spent.fetch_add((plain + more) * ticks as u64, Ordering::Relaxed);
    }

    /// Whether a search has spent what it may, asked where more could be tried.
    pub(crate) fn is_spent(&self) -> bool {
        let is_spent = self.passes() > MOST_PASSES;
        if is_spent {
            self.ended.store(true, Ordering::Relaxed);
        }
        is_spent
    }

    /// Passes that were spent, if something was not tried because of them.
    pub(crate) fn ended_after(&self) -> Option<u64> {
        self.ended.load(Ordering::Relaxed).then(|| self.passes())
    }

    /// Passes over the session that were spent.
    fn passes(&self) -> u64 {
        self.spent.load(Ordering::Relaxed) / (PLAIN * self.session)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::effects::Place;

    #[test]
    fn what_is_simulated_is_counted_by_what_it_takes() {
        let mut rig = Rig::named("handley").expect("library rig");
        let work = Work::new(3000);
        work.count(&rig, 0b111, 1000);
        assert_eq!(work.passes(), 1);
        rig.set("friction", Place::Axis(1), "coulomb_n", 5.0).expect("known parameter");
        // Three and a half times the plain one on one of the axes, and nothing more on the other.
        work.count(&rig, 0b011, 2000);
        assert_eq!(work.passes(), 1 + 3);
        assert!(!work.is_spent());
        work.count(&rig, 0b100, 3000 * 2000);
        // Nobody wanted more yet.
        assert_eq!(work.ended_after(), None);
        assert!(work.is_spent());
        assert_eq!(work.ended_after(), Some(2004));
    }
}
