//! What a rig may do beyond its nominal model: the catalogue. One file an effect; to add one, write the file and put
//! its name into the list below.
//!
//! An effect changes nominal values in place (`Kind::Parametric`) or adds a block at its physical place in the chain
//! (`Kind::Structural`), never a term at the output. At its zero-effect values it is not built in at all, so a rig
//! with it there simulates bit for bit like one without.

use std::fmt;

use crate::stages::model::Model;

/// Most of the stack's own stiffness, mass or damping that an effect takes from it, as a share: what is left holds it up.
pub(crate) const MOST_OF_STACK: f64 = 0.99;

mod bend;
mod hum;
pub mod walk;

/// An effect of the catalogue.
pub trait Effect: Sync {
    /// Name, parameters, physics: what people and fits need to know.
    fn info(&self) -> &'static Info;
    /// Put the effect with these values (in the order of `info().parameters`) into a model for ticks of `step_s`.
    fn apply(&self, values: &[f64], place: Place, model: &mut Model, step_s: f64);
}

/// Description of an effect.
#[derive(Debug)]
pub struct Info {
    /// Name, as in rig files and diagnoses.
    pub name: &'static str,
    /// Where it sits in the chain.
    pub stage: Stage,
    /// Wrong value or missing physics.
    pub kind: Kind,
    /// What it acts on.
    pub scope: Scope,
    /// Parameters, the leading size first.
    pub parameters: &'static [Parameter],
    /// Whether its response has a threshold: small sizes may do nothing, so screen at several sizes.
    pub threshold: bool,
    /// What happens physically, with the equation.
    pub physics: &'static str,
    /// Where the form and the sizes come from.
    pub source: &'static str,
    /// Excitation that reveals it.
    pub revealed_by: &'static str,
    /// Effects that it is easily confused with, the likeliest first.
    pub confused_with: &'static [&'static str],
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// Key in the rig file.
    pub name: &'static str,
    /// Unit; "1" is a plain number.
    pub unit: &'static str,
    /// Size or shape.
    pub role: Role,
    /// Value without effect (sizes); for shapes the value that a rig file means by leaving the key out.
    pub zero: f64,
    /// Least value.
    pub min: f64,
    /// Greatest value.
    pub max: f64,
    /// A size worth finding, or the usual shape.
    pub typical: f64,
    /// Whether fits should step it by ratios.
    pub log: bool,
    /// What it is.
    pub about: &'static str,
}

impl Parameter {
    /// A size: at `zero` there is no effect.
    pub const fn size(
        name: &'static str,
        unit: &'static str,
        zero: f64,
        bounds: (f64, f64),
        typical: f64,
        about: &'static str,
    ) -> Self {
        let (min, max) = bounds;
        Self { name, unit, role: Role::Size, zero, min, max, typical, log: false, about }
    }

    /// A shape: matters only while some size is not zero.
    pub const fn shape(
        name: &'static str,
        unit: &'static str,
        bounds: (f64, f64),
        typical: f64,
        about: &'static str,
    ) -> Self {
        let (min, max) = bounds;
        Self { name, unit, role: Role::Shape, zero: typical, min, max, typical, log: false, about }
    }

    /// The same, to be stepped by ratios in a fit.
    pub const fn by_ratio(self) -> Self {
        Self { log: true, ..self }
    }

    /// Value to start from.
    pub const fn start(&self) -> f64 {
        self.zero
    }
}

/// Size or shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// How much: an effect is off while all its sizes are at their zero values.
    Size,
    /// How: where it bends, how fast it fades.
    Shape,
}

/// Where in the chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// From command to amplifier.
    Drive,
    /// Amplifier.
    Amplifier,
    /// Stack.
    Piezo,
    /// Mechanism.
    Mechanism,
    /// Sensor.
    Sensor,
    /// Surroundings.
    Environment,
}

impl Stage {
    /// Name, as in diagnoses.
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Drive => "drive",
            Stage::Amplifier => "amplifier",
            Stage::Piezo => "piezo",
            Stage::Mechanism => "mechanism",
            Stage::Sensor => "sensor",
            Stage::Environment => "environment",
        }
    }
}

/// Wrong value or missing physics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A nominal value that is wrong.
    Parametric,
    /// Physics that the nominal model lacks.
    Structural,
}

impl Kind {
    /// Name, as in diagnoses.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Parametric => "parametric",
            Kind::Structural => "structural",
        }
    }
}

/// What an effect acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// One axis.
    Axis,
    /// One axis, from another one.
    Pair,
    /// Two axes, each on the other.
    ReciprocalPair,
}

/// Axis or axes that a setting acts on, counted from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Place {
    /// One axis.
    Axis(usize),
    /// `on` is affected by `from`.
    Pair {
        /// The axis that is affected.
        on: usize,
        /// The axis that it comes from.
        from: usize,
    },
}

impl Place {
    /// The one way to name a place: reciprocal pairs have the lower axis first.
    pub fn normalised(self, scope: Scope) -> Place {
        match (self, scope) {
            (Place::Pair { on, from }, Scope::ReciprocalPair) if on > from => {
                Place::Pair { on: from, from: on }
            }
            _ => self,
        }
    }

    /// The axis that is affected (the first one of a reciprocal pair).
    pub fn on(self) -> usize {
        match self {
            Place::Axis(on) | Place::Pair { on, .. } => on,
        }
    }

    /// The other axis of a pair; the same one of a single axis.
    pub fn from(self) -> usize {
        match self {
            Place::Axis(on) => on,
            Place::Pair { from, .. } => from,
        }
    }

    /// Every place of an effect of this scope in a rig of `axes` axes.
    pub fn all(scope: Scope, axes: usize) -> Vec<Place> {
        let pairs = (0..axes).flat_map(|on| (0..axes).map(move |from| (on, from)));
        match scope {
            Scope::Axis => (0..axes).map(Place::Axis).collect(),
            Scope::Pair => pairs
                .filter(|(on, from)| on != from)
                .map(|(on, from)| Place::Pair { on, from })
                .collect(),
            Scope::ReciprocalPair => pairs
                .filter(|(on, from)| on < from)
                .map(|(on, from)| Place::Pair { on, from })
                .collect(),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Axis(axis) => write!(f, "axis {}", axis + 1),
            Place::Pair { on, from } => write!(f, "axis {} from axis {}", on + 1, from + 1),
        }
    }
}

macro_rules! catalogue {
    ($($module:ident),* $(,)?) => {
        $(mod $module;)*
        static CATALOGUE: &[&dyn Effect] = &[$(&$module::EFFECT),*];
    };
}

// In the order of the chain; blocks of one stage act in this order.
catalogue! {
    drive_gain,
    drive_offset,
    drive_crosstalk,
    drive_delay,
    amplifier_bandwidth,
    amplifier_current_limit,
    amplifier_clipping,
    amplifier_hum,
    piezo_gain,
    hysteresis_shape,
    hysteresis_rate,
    creep,
    stiffness,
    stiffness_coupling,
    stiffness_hardening,
    preload_loss,
    inertia,
    second_mass,
    viscoelasticity,
    friction,
    sensor_crosstalk,
    sensor_nonlinearity,
    sensor_gain,
    sensor_bandwidth,
    sensor_hum,
    sensor_drift,
    sensor_offset,
}

mod drive_bend;
mod floor_hum;
mod gauge_high_pass;
mod gauge_play;
mod gauge_tilt;
mod gauge_warming;
mod stage_drag;

/// What a rig may do too, and a diagnosis does not name: it is told from effects of the catalogue that look like it.
static STRANGERS: &[&dyn Effect] = &[
    &floor_hum::EFFECT,
    &stage_drag::EFFECT,
    &gauge_warming::EFFECT,
    &gauge_play::EFFECT,
    &gauge_high_pass::EFFECT,
    &gauge_tilt::EFFECT,
    &drive_bend::EFFECT,
];

/// Effects outside the catalogue. Rig files take them.
pub fn strangers() -> &'static [&'static dyn Effect] {
    STRANGERS
}

fn known() -> impl Iterator<Item = &'static dyn Effect> {
    CATALOGUE.iter().chain(STRANGERS).copied()
}

/// All effects, in the order of the chain.
pub fn catalogue() -> &'static [&'static dyn Effect] {
    CATALOGUE
}

/// The effect of this name, in the catalogue or outside.
pub fn find(name: &str) -> Option<&'static dyn Effect> {
    known().find(|effect| effect.info().name == name)
}

/// Place of an effect in the catalogue.
pub(crate) fn rank(effect: &dyn Effect) -> usize {
    known()
        .position(|known| known.info().name == effect.info().name)
        .unwrap_or(CATALOGUE.len() + STRANGERS.len())
}

pub(crate) fn unknown_effect(name: &str) -> String {
    let known: Vec<&str> = known().map(|effect| effect.info().name).collect();
    format!("{name}: unknown effect, expected one of {}", known.join(", "))
}

pub(crate) fn unknown_parameter(info: &Info, key: &str) -> String {
    let known: Vec<&str> = info.parameters.iter().map(|parameter| parameter.name).collect();
    format!("{key}: unknown key of {}, expected one of {}", info.name, known.join(", "))
}
