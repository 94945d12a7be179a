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
/// are 1200 passes, 20 to 50 s on two cores of 2026, by their speed and by what is simulated. With 720 and 250 million a session of
/// `gap/tests/axes.rs` is answered otherwise (friction beside a loop).
const MOST_BEYOND: u64 = 300_000_000;
/// Part of that, one in so many, which may be granted for other forms of what was found: no more is begun then.
const GRANTED: u64 = 4;
/// What a tick takes with an effect there, in tenths of one without, beyond it.
const HEAVY: [(&str, u64); 14] = [
    ("amplifier-clipping", 4),
    ("amplifier-current-limit", 4),
    ("friction", 25),
    ("hysteresis-shape", 8),
    ("stage-drag", 45),
    (TYING, 60),
    ("stiffness-hardening", 12),
    ("preload-loss", 10),
    ("second-mass", 15),
    ("inertia", 8),
    ("floor-hum", 10),
    ("sensor-hum", 8),
    ("amplifier-hum", 10),
    ("sensor-drift", 5),
];
/// The same for a law of an effect that has several, by the parameter that is not at its zero.
const HEAVY_LAWS: [(&str, &str, u64); 5] = [
    ("hysteresis-shape", "beside_v", 60),
    ("friction", "spread_decades", 12),
    ("hysteresis-rate", "per_decade", 17),
    // That of a power of the current, which a fit turns it into.
    ("hysteresis-rate", "resistance_ohm", 29),
    ("hysteresis-rate", "strain_loss_v", 56),
];
/// The same of a part of a tick alone, by how much longer elements that give way take where an axis moves. A lively tick that is not taken in
/// parts takes that much longer as well; counted there it cut short a search that finds more (`gap/tests/axes.rs`, friction beside a loop).
const LAWS_IN_PARTS: [(&str, &str, u64); 2] =
    [("hysteresis-shape", "yield", 40), ("hysteresis-shape", "spread", 90)];
/// The same for one without.
const PLAIN: u64 = 10;
/// Effects that take a lively tick in parts, as a mechanism does that weighs something by itself, and every one where something asks for all of
/// them, however calm.
const IN_PARTS: [&str; 2] = ["inertia", "second-mass"];
/// What such a part takes of an axis that nothing ties and that has nothing else; of one that is tied it takes [`PLAIN`].
const PART: u64 = 4;
/// What ties axes together: each takes the parts of a tick that the mass on any of them asks for,
const TYING: &str = "stiffness-coupling";
/// and then a spring takes so much more, in tenths of a plain tick: neighbours move less in a part of a tick than in a whole one.
const TYING_A_PART: u64 = 15;

/// What was simulated, and how much there is.
#[derive(Debug)]
pub(crate) struct Work {
    /// Tenths of plain ticks of an axis.
    spent: AtomicU64,
    /// How much of that was granted beyond the rest.
    granted: AtomicU64,
    /// Whether what is counted is granted.
    is_granting: AtomicBool,
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
            is_granting: AtomicBool::new(false),
            session: samples.max(1) as u64,
            ended: AtomicBool::new(false),
        }
    }

    /// Count a simulation of the axes in a mask.
    pub(crate) fn count(&self, rig: &Rig, axes: u32, ticks: &Ticks) {
        let price = price(rig, axes, ticks);
        if self.is_granting.load(Ordering::Relaxed) {
            self.granted.fetch_add(price, Ordering::Relaxed);
        }
        self.spent.fetch_add(price, Ordering::Relaxed);
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
        self.is_granting.store(true, Ordering::Relaxed);
        let result = done();
        self.is_granting.store(false, Ordering::Relaxed);
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

/// What a simulation goes through.
pub(crate) struct Ticks<'a> {
    /// How many there are,
    pub(crate) many: usize,
    /// how long each is, s,
    pub(crate) step_s: f64,
    /// and which share of them is lively, of every axis.
    pub(crate) lively: &'a [f64],
}

/// What a simulation of the axes in a mask takes, in tenths of plain ticks of an axis.
pub(crate) fn price(rig: &Rig, axes: u32, ticks: &Ticks) -> u64 {
    let groups = tied(rig, axes).into_iter();
    let a_tick: f64 = groups.map(|group| of_group(rig, group, ticks)).sum();
    (a_tick * ticks.many as f64) as u64
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

/// What a tick of axes that springs tie together takes, or of one alone, calm and lively ones together.
fn of_group(rig: &Rig, group: u32, ticks: &Ticks) -> f64 {
    let here = rig.effects.iter().filter(|s| group >> s.place.on() & 1 == 1 && s.is_active());
    let here: Vec<&Setting> = here.collect();
    let members = || (0..rig.axes.len()).filter(|on| group >> on & 1 == 1);
    let many = u64::from(group.count_ones());
    let whole = PLAIN * many + here.iter().map(|s| more(s)).sum::<u64>();
    let is_in_parts = |s: &Setting| IN_PARTS.contains(&s.effect.info().name);
    let weighs = |on: usize| rig.axes[on].mechanism.mass_kg > 0.0;
    if !members().any(weighs) && !here.iter().any(|s| is_in_parts(s)) {
        return whole as f64;
    }
    let model = Model::new(rig, ticks.step_s);
    // What rubs on a mass takes it through the parts of every tick.
    let follows = |on: usize| {
        let axis = &model.axes[on];
        axis.follows_every_tick() || axis.mechanism.forces.iter().any(|force| force.rubs())
    };
    let share = members().map(|on| if follows(on) { 1.0 } else { ticks.lively[on] });
    let share = share.fold(0.0, f64::max);
    let parts = members().map(|on| substeps(&model.axes[on], ticks.step_s)).max().unwrap_or(1);
    let of_part = |s: &Setting| match s.effect.info().name {
        name if IN_PARTS.contains(&name) => 0,
        TYING => TYING_A_PART,
        _ => more(s) + of_laws(&LAWS_IN_PARTS, s),
    };
    let bare = if many > 1 { PLAIN * many } else { PART };
    let in_parts = parts as u64 * (bare + here.iter().map(|s| of_part(s)).sum::<u64>());
    share * in_parts.max(whole) as f64 + (1.0 - share) * whole as f64
}

/// What a tick takes with an effect, beyond one without.
fn more(setting: &Setting) -> u64 {
    let name = setting.effect.info().name;
    let whole = HEAVY.iter().find(|(heavy, _)| *heavy == name).map_or(0, |(_, more)| *more);
    whole + of_laws(&HEAVY_LAWS, setting)
}

/// What it takes by the laws that are there.
fn of_laws(laws: &[(&str, &str, u64)], setting: &Setting) -> u64 {
    let info = setting.effect.info();
    let is_there = |parameter: &str| {
        let mut values = info.parameters.iter().zip(&setting.values);
        values.any(|(p, value)| p.name == parameter && *value != p.zero)
    };
    let laws = laws.iter().filter(|(name, law, _)| *name == info.name && is_there(law));
    laws.map(|(_, _, more)| more).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_sim::effects::Place;

    /// Ticks of 0.1 ms, lively in such shares.
    fn ticks(many: usize, lively: &[f64]) -> Ticks<'_> {
        Ticks { many, step_s: 1.0e-4, lively }
    }

    #[test]
    fn what_is_simulated_is_counted_by_what_it_takes() {
        let mut rig = Rig::named("handley").expect("library rig");
        let work = Work::new(3000);
        let half = [0.5; 3];
        work.count(&rig, 0b111, &ticks(1000, &half));
        assert_eq!(work.passes(), 1);
        rig.set("friction", Place::Axis(1), "coulomb_n", 5.0).expect("known parameter");
        // Three and a half times the plain one on one of the axes, and nothing more on the other.
        work.count(&rig, 0b011, &ticks(2000, &half));
        assert_eq!(work.passes(), 1 + 3);
        // A mass: four tenths in each of eight parts of a lively tick, eight tenths more in a calm one.
        rig.set("inertia", Place::Axis(2), "added_kg", 0.1).expect("known parameter");
        for (share, a_tick) in [(0.0, 18), (1.0, 32), (0.5, 25)] {
            let found = price(&rig, 0b100, &ticks(1000, &[0.0, 0.0, share]));
            assert_eq!(found, 1000 * a_tick, "{share}");
        }
        rig.set("hysteresis-rate", Place::Axis(2), "strain_loss_v", 0.3).expect("known parameter");
        // A loss of strain makes every tick one in parts, however calm.
        work.count(&rig, 0b100, &ticks(3000, &[0.0; 3]));
        assert_eq!(work.passes(), 1 + 3 + 48);
        let zeros = [("strain_loss_v", 0.0), ("per_decade", 0.1)];
        for (parameter, value) in zeros {
            rig.set("hysteresis-rate", Place::Axis(2), parameter, value).expect("known parameter");
        }
        rig.set("inertia", Place::Axis(2), "added_kg", 0.0).expect("known parameter");
        // 2.7 times.
        work.count(&rig, 0b100, &ticks(3000, &half));
        assert_eq!(work.passes(), 1 + 3 + 48 + 2);
        assert!(!work.is_spent());
    }

    #[test]
    fn a_mechanism_that_weighs_something_is_counted_in_parts() {
        let mut rig = Rig::named("handley").expect("library rig");
        let of = |rig: &Rig, share: f64| price(rig, 0b001, &ticks(100, &[share, 0.0, 0.0]));
        assert_eq!([of(&rig, 0.0), of(&rig, 1.0)], [1000, 1000]);
        // The mass of `inertia` in the test above, without its own price: four tenths in each of eight parts.
        rig.axes[0].mechanism.mass_kg = 0.1;
        assert_eq!([of(&rig, 0.0), of(&rig, 1.0)], [1000, 3200]);
    }

    #[test]
    fn elements_that_give_way_count_in_every_part_of_a_tick() {
        let mut rig = Rig::named("handley").expect("library rig");
        let place = Place::Axis(0);
        rig.set("hysteresis-shape", place, "yield", 0.3).expect("known parameter");
        let of = |rig: &Rig, share: f64| price(rig, 0b001, &ticks(100, &[share, 0.0, 0.0]));
        assert_eq!([of(&rig, 0.0), of(&rig, 1.0)], [1800, 1800]);
        rig.set("inertia", place, "added_kg", 0.1).expect("known parameter");
        // A lively tick goes in eight parts.
        assert_eq!([of(&rig, 0.0), of(&rig, 1.0)], [2600, 8 * 5200]);
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
        let lively = [0.0, 0.0, 1.0];
        assert_eq!(price(&rig, 0b100, &ticks(1, &lively)), 80);
        // A mass on either of them is one for both.
        for axis in [1, 2] {
            let mut heavy = rig.clone();
            heavy.set("inertia", Place::Axis(axis), "added_kg", 0.1).expect("known parameter");
            assert_eq!(price(&heavy, 0b010, &ticks(1, &lively)), 8 * 35, "{axis}");
            assert_eq!(price(&heavy, 0b010, &ticks(1, &[0.0; 3])), 88, "{axis}");
            // And where the other asks for every part of a tick.
            let rate = ("hysteresis-rate", Place::Axis(3 - axis), "strain_loss_v");
            heavy.set(rate.0, rate.1, rate.2, 0.3).expect("known parameter");
            assert_eq!(price(&heavy, 0b010, &ticks(1, &[0.0; 3])), 8 * (35 + 56), "{axis}");
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
            work.count(&rig, 0b001, &ticks(passes * samples, &[0.5; 3]));
            assert!(!work.is_spent(), "{samples}");
            assert_eq!(work.ended_after(), None);
            work.count(&rig, 0b001, &ticks(samples, &[0.5; 3]));
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
        let pass = || work.count(&rig, 0b111, &ticks(1000, &[0.5; 3]));
        let before = work.most() - work.spent.load(Ordering::Relaxed);
        let is_cut_short = work.grant(|| {
            (0..1000).for_each(|_| pass());
            work.most() - work.spent.load(Ordering::Relaxed) != before
        });
        assert!(!is_cut_short, "what is granted uses up the rest while it runs");
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
