//! How much a diagnosis simulates, counted so that it ends in a time that goes with the recordings, and at the same point on every machine.
//!
//! A search could go on for as long as there are effects to put together. What it may spend is a number of passes over the session, and some more
//! for a short one; what is spent is counted in ticks of an axis without effects, by what simulations take of it
//! (`cargo run --release -p host-sim --example effect_speed`).

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use host_sim::rig::{Rig, Setting};
use host_sim::stages::mechanism::substeps;
use host_sim::stages::model::Model;

/// Passes over the session, every axis without effects, that a search may spend before it settles for the best that it has,
const MOST_PASSES: u64 = 850;
/// and samples of one axis beyond them: a few seconds of recording leave room for many effects. Of half a minute of three axes at 10 kHz these
/// are 1200 passes, some 15 to 19 s on two cores of 2026 with what is left to do after it. The six slowest of the 120 sessions of the
/// blind set 18181 come that far.
const MOST_BEYOND: u64 = 300_000_000;
/// Part of that, one in so many, which may be granted for other forms of what was found: no more is begun then.
const GRANTED: u64 = 4;
/// What a tick takes with an effect there, in tenths of one without, beyond it.
const HEAVY: [(&str, u64); 12] = [
    ("friction", 25),
    ("hysteresis-shape", 8),
    ("stage-drag", 45),
    ("stiffness-coupling", 90),
    ("stiffness-hardening", 12),
    ("preload-loss", 10),
    ("second-mass", 40),
    ("inertia", 20),
    ("floor-hum", 10),
    ("sensor-hum", 8),
    ("amplifier-hum", 10),
    ("sensor-drift", 5),
];
/// The same for a law of an effect that has several, by the parameter that is not at its zero.
const HEAVY_LAWS: [(&str, &str, u64); 4] = [
    ("hysteresis-shape", "beside_v", 60),
    ("hysteresis-rate", "per_decade", 17),
    // That of a power of the current, which a fit turns it into.
    ("hysteresis-rate", "resistance_ohm", 29),
    ("hysteresis-rate", "strain_loss_v", 56),
];
/// The same for one without.
const PLAIN: u64 = 10;
/// Effects that take a tick in parts: all of them where something asks for every part of every tick, however calm.
const IN_PARTS: [&str; 2] = ["inertia", "second-mass"];
/// How many times what axes take that are tied together they take where one of them does so at times.
const TIED_IN_PARTS: u64 = 2;
/// What ties axes together.
const TYING: &str = "stiffness-coupling";

/// What was simulated, and how much there is.
#[derive(Debug)]
pub(crate) struct Work {
    /// Tenths of plain ticks of an axis.
    spent: AtomicU64,
    /// How much of that was granted beyond the rest.
    granted: AtomicU64,
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
            granted: AtomicU64::new(0),
            session: samples.max(1) as u64,
            ended: AtomicBool::new(false),
        }
    }

    /// Count a simulation of the axes in a mask over so many ticks of `step_s`.
    pub(crate) fn count(&self, rig: &Rig, axes: u32, ticks: usize, step_s: f64) {
        self.spent.fetch_add(price(rig, axes, ticks, step_s), Ordering::Relaxed);
    }

    /// Whether a search may still spend so much, in tenths of plain ticks.
    pub(crate) fn affords(&self, price: u64) -> bool {
        self.spent.load(Ordering::Relaxed) + price <= self.most()
    }

    /// Whether a search has spent what it may, asked where more could be tried.
    pub(crate) fn is_spent(&self) -> bool {
        let is_spent = self.spent.load(Ordering::Relaxed) > self.most();
        if is_spent {
            self.ended.store(true, Ordering::Relaxed);
        }
        is_spent
    }

    /// Whether more can be granted.
    pub(crate) fn grants(&self) -> bool {
        !self.is_spent() && self.granted.load(Ordering::Relaxed) < self.plain() / GRANTED
    }

    /// Do something that is granted beyond the rest: another form of an effect that was found leaves as much for looking on. Nothing else may be
    /// counted meanwhile.
    pub(crate) fn grant<T>(&self, done: impl FnOnce() -> T) -> T {
        let before = self.spent.load(Ordering::Relaxed);
        let result = done();
        let took = self.spent.load(Ordering::Relaxed) - before;
        self.granted.fetch_add(took, Ordering::Relaxed);
        result
    }

    /// What may be spent, in tenths of plain ticks of an axis.
    fn most(&self) -> u64 {
        self.plain() + self.granted.load(Ordering::Relaxed)
    }

    /// The same without what was granted.
    fn plain(&self) -> u64 {
        PLAIN * (MOST_PASSES * self.session + MOST_BEYOND)
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

/// What a simulation of the axes in a mask takes over so many ticks of `step_s`, in tenths of plain ticks of an axis.
pub(crate) fn price(rig: &Rig, axes: u32, ticks: usize, step_s: f64) -> u64 {
    let groups = tied(rig, axes).into_iter();
    groups.map(|group| of_group(rig, group, step_s)).sum::<u64>() * ticks as u64
}

/// Axes of a mask in parts that move by themselves: each with all those that springs tie it to, in the mask or not.
pub(crate) fn tied(rig: &Rig, axes: u32) -> Vec<u32> {
    let ties = rig.effects.iter().filter(|s| s.effect.info().name == TYING && s.is_active());
    let ties: Vec<u32> = ties.map(|s| 1 << s.place.on() | 1 << s.place.from()).collect();
    let mut groups: Vec<u32> = Vec::new();
    for axis in (0..rig.axes.len()).map(|axis| 1 << axis).filter(|axis| axes & axis != 0) {
        let mut group = axis;
        // As often as there are springs: each round goes one spring further.
        for _ in &ties {
            group = ties.iter().filter(|&&tie| tie & group != 0).fold(group, |all, tie| all | tie);
        }
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    groups
}

/// What a tick of axes that springs tie together takes, or of one alone.
fn of_group(rig: &Rig, group: u32, step_s: f64) -> u64 {
    let here = rig.effects.iter().filter(|s| group >> s.place.on() & 1 == 1 && s.is_active());
    let here: Vec<&Setting> = here.collect();
    let is_in_parts = |s: &Setting| IN_PARTS.contains(&s.effect.info().name);
    let plain = PLAIN * u64::from(group.count_ones());
    let whole = plain + here.iter().map(|s| more(s)).sum::<u64>();
    if !here.iter().any(|s| is_in_parts(s)) {
        return whole;
    }
    let model = Model::new(rig, step_s);
    let members = || model.axes.iter().enumerate().filter(|(on, _)| group >> on & 1 == 1);
    if members().any(|(_, axis)| axis.follows_every_tick()) {
        let parts = members().map(|(_, axis)| substeps(axis, step_s)).max().unwrap_or(1);
        let others = here.iter().filter(|s| !is_in_parts(s));
        return parts as u64 * (plain + others.map(|s| more(s)).sum::<u64>());
    }
    // The others take the parts of a tick that the mass on one of them asks for.
    if group.count_ones() > 1 { TIED_IN_PARTS * whole } else { whole }
}

/// What a tick takes with an effect, beyond one without.
fn more(setting: &Setting) -> u64 {
    let info = setting.effect.info();
    let whole = HEAVY.iter().find(|(name, _)| *name == info.name).map_or(0, |(_, more)| *more);
    let is_there = |parameter: &str| {
        let mut values = info.parameters.iter().zip(&setting.values);
        values.any(|(p, value)| p.name == parameter && *value != p.zero)
    };
    let laws = HEAVY_LAWS.iter().filter(|(name, law, _)| *name == info.name && is_there(law));
    whole + laws.map(|(_, _, more)| more).sum::<u64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::effects::Place;

    #[test]
    fn what_is_simulated_is_counted_by_what_it_takes() {
        let mut rig = Rig::named("handley").expect("library rig");
        let work = Work::new(3000);
        work.count(&rig, 0b111, 1000, 1.0e-4);
        assert_eq!(work.passes(), 1);
        rig.set("friction", Place::Axis(1), "coulomb_n", 5.0).expect("known parameter");
        // Three and a half times the plain one on one of the axes, and nothing more on the other.
        work.count(&rig, 0b011, 2000, 1.0e-4);
        assert_eq!(work.passes(), 1 + 3);
        rig.set("hysteresis-rate", Place::Axis(2), "strain_loss_v", 0.3).expect("known parameter");
        rig.set("inertia", Place::Axis(2), "added_kg", 0.1).expect("known parameter");
        // Six times and a half the plain one in each of eight parts.
        work.count(&rig, 0b100, 3000, 1.0e-4);
        assert_eq!(work.passes(), 1 + 3 + 52);
        let zeros = [("strain_loss_v", 0.0), ("per_decade", 0.1)];
        for (parameter, value) in zeros {
            rig.set("hysteresis-rate", Place::Axis(2), parameter, value).expect("known parameter");
        }
        rig.set("inertia", Place::Axis(2), "added_kg", 0.0).expect("known parameter");
        // 2.7 times.
        work.count(&rig, 0b100, 3000, 1.0e-4);
        assert_eq!(work.passes(), 1 + 3 + 52 + 3);
        assert!(!work.is_spent());
    }

    #[test]
    fn axes_that_are_tied_are_counted_together() {
        let mut rig = Rig::named("handley").expect("library rig");
        assert_eq!(tied(&rig, 0b101), [0b001, 0b100]);
        assert!(tied(&rig, 0).is_empty());
        let pair = Place::Pair { on: 1, from: 2 };
        rig.set(TYING, pair, "stiffness_n_per_m", 1.0e5).expect("known parameter");
        assert_eq!(tied(&rig, 0b111), [0b001, 0b110]);
        assert_eq!(tied(&rig, 0b100), [0b110]);
        assert_eq!(price(&rig, 0b100, 1, 1.0e-4), 110);
        // A mass on either of them is one for both.
        for axis in [1, 2] {
            let mut heavy = rig.clone();
            heavy.set("inertia", Place::Axis(axis), "added_kg", 0.1).expect("known parameter");
            assert_eq!(price(&heavy, 0b010, 1, 1.0e-4), 2 * 130, "{axis}");
            // And where the other asks for every part of a tick: eight of them.
            let rate = ("hysteresis-rate", Place::Axis(3 - axis), "strain_loss_v");
            heavy.set(rate.0, rate.1, rate.2, 0.3).expect("known parameter");
            assert_eq!(price(&heavy, 0b010, 1, 1.0e-4), 8 * (110 + 56), "{axis}");
        }
        // A second spring makes one group of them all.
        let further = Place::Pair { on: 0, from: 1 };
        rig.set(TYING, further, "stiffness_n_per_m", 1.0e5).expect("known parameter");
        assert_eq!(tied(&rig, 0b100), [0b111]);
    }

    #[test]
    fn a_short_session_may_take_more_passes_than_a_long_one() {
        let rig = Rig::named("handley").expect("library rig");
        for (samples, passes) in [(100_000, 3850), (1_000_000, 1150), (3_000_000, 950)] {
            let work = Work::new(samples);
            work.count(&rig, 0b001, passes * samples, 1.0e-4);
            assert!(!work.is_spent(), "{samples}");
            assert_eq!(work.ended_after(), None);
            work.count(&rig, 0b001, samples, 1.0e-4);
            // Nobody wanted more yet.
            assert_eq!(work.ended_after(), None);
            assert!(work.is_spent(), "{samples}");
            assert_eq!(work.ended_after(), Some(passes as u64 + 1));
        }
    }

    #[test]
    fn what_is_granted_leaves_the_rest_and_comes_to_an_end() {
        let rig = Rig::named("handley").expect("library rig");
        let work = Work::new(3000);
        let pass = || work.count(&rig, 0b111, 1000, 1.0e-4);
        let before = work.most() - work.spent.load(Ordering::Relaxed);
        work.grant(|| (0..1000).for_each(|_| pass()));
        assert_eq!(work.passes(), 1000, "it is counted");
        assert_eq!(work.most() - work.spent.load(Ordering::Relaxed), before);
        let mut granted = 1;
        while work.grants() {
            work.grant(|| (0..1000).for_each(|_| pass()));
            granted += 1;
        }
        // A quarter of 850 passes and 3e8 ticks, in portions of a thousand passes of three axes.
        assert_eq!(granted, 26);
        assert!(!work.is_spent());
    }
}
