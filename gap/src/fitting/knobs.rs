//! What a fit turns: parameters of catalogue effects at their places, or nominal values of the rig.

use host_sim::effects::{Effect, Parameter, Place, Role, Scope};
use host_sim::rig::Rig;

use crate::Error;
use crate::fitting::guess::{Ranges, fine_step};
use crate::session::scene::Wanted;

/// An effect of the catalogue.
pub type EffectRef = &'static dyn Effect;

/// One number that a fit turns, with its bounds and natural scale.
#[derive(Clone)]
pub struct Knob {
    /// What it changes in the rig.
    pub target: Target,
    /// Lower bound.
    pub min: f64,
    /// Upper bound.
    pub max: f64,
    /// Value without effect; the origin of linear steps.
    pub origin: f64,
    /// A size worth finding, from the origin (or as a ratio, for knobs stepped by ratios): sets steps and scaling.
    pub scale: f64,
    /// Stepped multiplicatively.
    pub log: bool,
    /// Step of finite differences in the unit of the value, where the scale says too little.
    pub fixed_step: Option<f64>,
    /// What was known before, for nominal values.
    pub prior: Option<Prior>,
}

/// A normal prior in the knob's own steps (logarithm or multiples of its scale).
#[derive(Debug, Clone, Copy)]
pub struct Prior {
    /// Expected value.
    pub centre: f64,
    /// Standard deviation, in steps.
    pub sd: f64,
}

/// Where the number lives.
#[derive(Clone)]
pub enum Target {
    /// Parameter `index` of an effect at a place.
    Effect {
        /// Effect.
        effect: EffectRef,
        /// Axis or pair.
        place: Place,
        /// Index into its parameters.
        index: usize,
    },
    /// A nominal value.
    Nominal {
        /// Axis whose channels see it first.
        axis: usize,
        /// Writes the value.
        write: fn(&mut Rig, usize, usize, f64),
        /// Element or column, for values that are arrays.
        element: usize,
        /// Only the gauge of this axis sees it, whatever the sensor geometry.
        own_gauge: bool,
        /// `false` when monitors cannot see it.
        monitors: bool,
        /// Name for people.
        name: &'static str,
        /// Unit of the value.
        unit: &'static str,
    },
}

/// Natural scale of a shape that is a share.
const SHARE_STEP: f64 = 0.1;

impl Knob {
    /// Knob for a parameter of an effect.
    pub fn effect(effect: EffectRef, place: Place, index: usize) -> Self {
        let p = &effect.info().parameters[index];
        let (origin, scale) = if p.log {
            (0.0, p.typical)
        } else if p.role == Role::Size {
            (p.zero, (p.typical - p.zero).abs())
        } else if (p.min, p.max) == (0.0, 1.0) {
            // From one kind to another: a fit has to get there from either end.
            (0.0, SHARE_STEP)
        } else {
            (0.0, p.typical.abs().max(1.0e-3 * (p.max - p.min)))
        };
        Self {
            target: Target::Effect { effect, place, index },
            min: p.min,
            max: p.max,
            origin,
            scale,
            log: p.log,
            fixed_step: None,
            prior: None,
        }
    }

    /// Keep it where the simulation follows it: beyond, a fit would see that nothing changes, and stay there.
    pub(crate) fn keep_to_simulated(&mut self, rig: &Rig) {
        let Target::Effect { effect, place, index } = &self.target else { return };
        let info = effect.info();
        let lowest = rig.lowest_simulated(info.name, *place, info.parameters[*index].name);
        if let Some(lowest) = lowest.filter(|_| !self.is_frozen()) {
            self.min = self.min.max(lowest);
        }
    }

    /// Write `value` into the rig.
    pub fn write(&self, rig: &mut Rig, value: f64) -> Result<(), Error> {
        let value = value.clamp(self.min, self.max);
        match &self.target {
            Target::Effect { effect, place, index } => {
                let info = effect.info();
                rig.set(info.name, *place, info.parameters[*index].name, value)
                    .map_err(|e| Error::Rig(e.to_string()))
            }
            Target::Nominal { axis, write, element, .. } => {
                write(rig, *axis, *element, value);
                Ok(())
            }
        }
    }

    /// Whether there is nothing to turn.
    pub fn is_frozen(&self) -> bool {
        self.min == self.max
    }

    /// Parameter of an effect that it turns.
    pub(crate) fn parameter(&self) -> Option<&'static str> {
        let Target::Effect { effect, index, .. } = &self.target else { return None };
        Some(effect.info().parameters[*index].name)
    }

    /// Whether it only tells two varieties of an effect apart that is one number in most rigs.
    pub fn is_variety(&self) -> bool {
        let Target::Effect { effect, index, .. } = &self.target else { return false };
        let info = effect.info();
        VARIETIES.contains(&(info.name, info.parameters[*index].name))
    }

    /// Whether it ties the motion of axes together.
    pub fn couples(&self) -> bool {
        matches!(&self.target, Target::Effect { effect, .. } if effect.info().scope != Scope::Axis)
    }

    /// Channels that see this knob directly.
    pub fn wanted(&self, rig: &Rig) -> Wanted {
        match &self.target {
            Target::Effect { effect, place, .. } => {
                let monitors = sees_monitor(*effect);
                Wanted { axes: axes_seen(rig, *effect, *place), monitors }
            }
            Target::Nominal { axis, monitors, .. } => {
                Wanted { axes: spread_by_output(rig, 1 << axis), monitors: *monitors }
            }
        }
    }
}

/// Whether an effect can change the amplifier's measured output.
pub fn sees_monitor(effect: EffectRef) -> bool {
    use host_sim::effects::Stage;
    matches!(effect.info().stage, Stage::Drive | Stage::Amplifier)
}

/// Axes whose position an effect at `place` changes to first order.
pub fn axes_seen(rig: &Rig, effect: EffectRef, place: Place) -> u32 {
    let own = match place {
        Place::Axis(axis) => 1 << axis,
        Place::Pair { on, from } if effect.info().scope == Scope::ReciprocalPair => {
            1 << on | 1 << from
        }
        Place::Pair { on, .. } => 1 << on,
    };
    // A gauge effect stays on its own gauge; everything before it is spread by the sensor geometry.
    if effect.info().stage == host_sim::effects::Stage::Sensor {
        own
    } else {
        spread_by_output(rig, own)
    }
}

/// Gauges that see the given axes through the sensor geometry.
fn spread_by_output(rig: &Rig, axes: u32) -> u32 {
    let Some(map) = &rig.output_map else { return axes };
    let mut seen = 0;
    for (sensor, row) in map.iter().enumerate() {
        if row.iter().enumerate().any(|(axis, &gain)| gain != 0.0 && axes >> axis & 1 == 1) {
            seen |= 1 << sensor;
        }
    }
    seen
}

/// Places where an effect may sit in a rig of `axes` axes.
pub fn places(effect: EffectRef, axes: usize) -> Vec<Place> {
    match effect.info().scope {
        Scope::Axis => (0..axes).map(Place::Axis).collect(),
        Scope::Pair => (0..axes)
            .flat_map(|on| {
                (0..axes).filter(move |&from| from != on).map(move |from| Place::Pair { on, from })
            })
            .collect(),
        Scope::ReciprocalPair => (0..axes)
            .flat_map(|on| (on + 1..axes).map(move |from| Place::Pair { on, from }))
            .collect(),
    }
}

/// Parameters that only tell varieties of an effect apart.
const VARIETIES: [(&str, &str); 6] = [
    ("amplifier-clipping", "ahead"),
    ("piezo-gain", "polarisation"),
    ("amplifier-bandwidth", "further_pole"),
    ("viscoelasticity", "spread_decades"),
    ("creep", "sharp"),
    ("stiffness-coupling", "own"),
];

/// Whether an effect is one number, or has one beside which others only tell varieties apart.
pub(crate) fn is_plain(effect: EffectRef) -> bool {
    let info = effect.info();
    let is_variety = |p: &&Parameter| VARIETIES.contains(&(info.name, p.name));
    info.parameters.iter().filter(|p| !is_variety(p)).count() == 1
}

/// Parameters of an effect that has laws of its own kind, or parts, one list each: a fit that starts from one of them stays with it.
const LAWS: [(&str, &[&[&str]]); 6] = [
    (
        "hysteresis-rate",
        &[
            &["per_decade", "reference_a", "stiffening", "resistance_ohm", "loss_exponent"],
            &["strain_loss_v", "strain_loss_a", "strain_onset"],
        ],
    ),
    (
        "sensor-drift",
        &[
            &["rate_m_per_s", "settling_m", "settling_s"],
            &["swing_sin_m", "swing_cos_m", "cycle_s"],
            &WANDERS,
        ],
    ),
    (
        "sensor-nonlinearity",
        &[
            &["quadratic_per_m", "cubic_per_m2", "zero_m"],
            &["ripple_sine_m", "ripple_cosine_m", "ripple_period_m"],
        ],
    ),
    ("creep", &[&["per_decade", "onset_s", "sharp"], &["level", "tilt"]]),
    (
        "hysteresis-shape",
        &[
            &["strength", "slip", "tilt", "bend", "skew", "imprint_v", "yield", "spread", "recoil"],
            &["beside_v", "beside_c", "beside_exponent", "beside_recoil"],
        ],
    ),
    (
        "second-mass",
        &[
            &["mass_kg", "frequency_hz", "damping_ratio"],
            &["further_kg", "further_hz", "further_damping"],
        ],
    ),
];

/// Sizes of a drift without a period, slowest part first.
pub(crate) const WANDERS: [&str; 16] = [
    "wander_1_m",
    "wander_2_m",
    "wander_3_m",
    "wander_4_m",
    "wander_5_m",
    "wander_6_m",
    "wander_7_m",
    "wander_8_m",
    "wander_9_m",
    "wander_10_m",
    "wander_11_m",
    "wander_12_m",
    "wander_13_m",
    "wander_14_m",
    "wander_15_m",
    "wander_16_m",
];
/// How far the grid runs ahead of the frequency of a hum, slowest part first.
pub(crate) const AHEAD: [&str; 12] = [
    "ahead_1_turns",
    "ahead_2_turns",
    "ahead_3_turns",
    "ahead_4_turns",
    "ahead_5_turns",
    "ahead_6_turns",
    "ahead_7_turns",
    "ahead_8_turns",
    "ahead_9_turns",
    "ahead_10_turns",
    "ahead_11_turns",
    "ahead_12_turns",
];
/// ... and the time over which such walks are described.
pub(crate) const WANDER_S: &str = "wander_s";

/// Where a random walk is expected to come to over a session, standard deviation, m. Between what was recorded it is taken to go straight, whatever
/// this is.
const WANDERS_TO_M: f64 = 0.3e-6;
/// The same of the phase of a grid, turns.
const RUNS_AHEAD_TURNS: f64 = 2.0;

/// Standard deviation that is expected of a term of a random walk's series, of one that is expected to come to `end`: it goes with 1 over the order,
/// which begins with 0 here.
fn walks(order: usize, end: f64) -> f64 {
    end * std::f64::consts::SQRT_2 / ((order as f64 + 0.5) * std::f64::consts::PI)
}

/// Effects of which a part has one law or the other.
const EXCLUSIVE: [&str; 2] = ["hysteresis-rate", "sensor-drift"];

/// Parameters that stay at their lower bound in a fit that starts there: a variety of the effect, of which there are starts of its own.
const STAYS: [(&str, &str); 5] = [
    ("friction", "creeping_m_per_s"),
    ("friction", "corner"),
    ("friction", "stribeck"),
    ("friction", "spread_decades"),
    ("amplifier-current-limit", "knee"),
];

/// Parameters that no fit turns: a matrix, a spring or a base, and nothing in between.
const ONE_OR_OTHER: [(&str, &str); 1] = [("stiffness-coupling", "own")];

/// Shapes that matter only while another one of the same effect, the one before it, is not zero.
const OF_THE_ONE_BEFORE: [(&str, &str); 1] = [("friction", "stribeck_m_per_s")];

/// Freeze the parameters of laws that do nothing at `values` beside one that does, at the same place, and those of varieties that do nothing.
pub(crate) fn keep_laws(knobs: &mut [Knob], values: &[f64]) {
    let law_of = |knob: &Knob| {
        let Target::Effect { effect, place, index } = &knob.target else { return None };
        let info = effect.info();
        let (_, laws) = LAWS.iter().find(|(name, _)| *name == info.name)?;
        let parameter = &info.parameters[*index];
        let law = laws.iter().position(|names| names.contains(&parameter.name))?;
        Some((info.name, *place, law, parameter))
    };
    let acting: Vec<_> = knobs
        .iter()
        .zip(values)
        .filter_map(|(knob, value)| law_of(knob).map(|law| (law, value)))
        .filter(|((.., parameter), value)| {
            parameter.role == Role::Size && **value != parameter.zero
        })
        .map(|((name, place, law, _), _)| (name, place, law))
        .collect();
    let mut before = 0.0;
    for (knob, &value) in knobs.iter_mut().zip(values) {
        if let Target::Effect { effect, index, .. } = &knob.target {
            let info = effect.info();
            let name = info.parameters[*index].name;
            let does_nothing = OF_THE_ONE_BEFORE.contains(&(info.name, name)) && before == 0.0;
            if does_nothing || ONE_OR_OTHER.contains(&(info.name, name)) {
                (knob.min, knob.max) = (value, value);
            }
            before = value;
            if STAYS.contains(&(info.name, name)) && value <= knob.min {
                knob.max = knob.min;
            }
            if AHEAD.contains(&name) && value == 0.0 {
                (knob.min, knob.max) = (0.0, 0.0);
            }
        }
        let Some((name, place, law, _)) = law_of(knob) else { continue };
        let acts = |other: usize| acting.contains(&(name, place, other));
        // Beside a further law the first one goes on, but where they exclude each other.
        let may_go_on = law == 0 && !EXCLUSIVE.contains(&name);
        if !acts(law) && !may_go_on && LAWS.iter().any(|(_, laws)| (0..laws.len()).any(acts)) {
            (knob.min, knob.max) = (value, value);
        }
    }
}

/// Fastest mode that is told from inertia, as a share of the sample rate.
pub(crate) const FASTEST_MODE: f64 = 0.35;

/// ... of a further mode beside one that is: a stage with one has others beyond what samples tell.
const FASTEST_FURTHER_MODE: f64 = 1.0;

/// Step in the frequency of a mode, as a ratio: a lightly damped one is a per cent wide.
const MODE_STEP: f64 = 4.0e-3;

/// Farthest end of a gauge's calibration, as a multiple of the travel.
pub(crate) const FARTHEST_ZERO: f64 = 1.5;

/// Longest period of a gauge's ripple, as a multiple of the travel.
const LONGEST_RIPPLE: f64 = 2.0;

/// Knobs of an effect at one place: sizes and shapes in the order of its parameters.
pub fn knobs_at(effect: EffectRef, place: Place, ranges: &Ranges) -> Vec<Knob> {
    let info = effect.info();
    info.parameters
        .iter()
        .enumerate()
        .map(|(index, p)| {
            let mut knob = Knob::effect(effect, place, index);
            // A mass on a spring that is faster than the samples can tell is one that sits fast: inertia.
            if info.name == "second-mass" && ["frequency_hz", "further_hz"].contains(&p.name) {
                let fastest =
                    if p.name == "further_hz" { FASTEST_FURTHER_MODE } else { FASTEST_MODE };
                knob.max = knob.max.min(fastest * ranges.rate_hz);
                knob.fixed_step = Some(MODE_STEP);
            }
            if p.name == WANDER_S {
                let over_s = ranges.ends_s.clamp(p.min, p.max);
                (knob.min, knob.max) = (over_s, over_s);
            }
            // The terms of a random walk.
            for (names, end) in [(&WANDERS[..], WANDERS_TO_M), (&AHEAD, RUNS_AHEAD_TURNS)] {
                if let Some(order) = names.iter().position(|name| *name == p.name) {
                    knob.prior = Some(Prior { centre: 0.0, sd: walks(order, end) / knob.scale });
                }
            }
            // A bend that ends far beyond the travel is a gain.
            if (info.name, p.name) == ("sensor-nonlinearity", "zero_m") {
                knob.max = knob.max.min(FARTHEST_ZERO * ranges.travel_m.1.abs());
            }
            // A ripple that is much longer than the travel is one, or a bend.
            if p.name == "ripple_period_m" {
                let span = ranges.travel_m.1 - ranges.travel_m.0;
                knob.max = knob.max.min(LONGEST_RIPPLE * span).max(knob.min);
            }
            // A hum has the harmonics that the spectrum shows.
            for (order, seen) in ["second_", "third_"].iter().zip(ranges.harmonics) {
                if info.name.ends_with("-hum") && p.name.starts_with(order) && !seen {
                    (knob.min, knob.max) = (p.zero, p.zero);
                }
            }
            if !ranges.any_loop && crate::search::loops::rests(info.name, p.name) {
                (knob.min, knob.max) = (p.zero, p.zero);
            }
            if let Some(step) = fine_step(info.name, p.name, ranges) {
                knob.origin = 0.0;
                knob.scale = step;
                knob.fixed_step = Some(step);
            }
            knob
        })
        .collect()
}

/// `true` when a parameter decides how large the effect is rather than how it is shaped.
pub fn is_size(effect: EffectRef, index: usize) -> bool {
    effect.info().parameters[index].role == Role::Size
}
