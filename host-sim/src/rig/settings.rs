//! Values of an effect at a place in the rig, and how fits reach them.

use super::{Rig, RigError};
use crate::effects::{self, Effect, Place, Role, Scope};

/// One effect at one place with the values of its parameters, in the order of `info().parameters`.
#[derive(Clone)]
pub struct Setting {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// The axis, or the pair of axes, that it acts on.
    pub place: Place,
    /// One value a parameter, in the parameter's unit.
    pub values: Vec<f64>,
}

impl Setting {
    /// The effect at rest: sizes at zero, shapes at their typical values.
    pub fn at_zero(effect: &'static dyn Effect, place: Place) -> Self {
        let values = effect.info().parameters.iter().map(|p| p.start()).collect();
        Self { effect, place, values }
    }

    /// Whether the effect does anything: some size differs from its zero-effect value.
    pub fn is_active(&self) -> bool {
        let parameters = self.effect.info().parameters;
        parameters.iter().zip(&self.values).any(|(p, v)| p.role == Role::Size && *v != p.zero)
    }

    /// Index of a parameter.
    pub fn index(&self, parameter: &str) -> Option<usize> {
        self.effect.info().parameters.iter().position(|p| p.name == parameter)
    }

    pub(super) fn check(&self, axes: usize) -> Result<(), String> {
        let info = self.effect.info();
        let (a, b) = match self.place {
            Place::Axis(axis) => (axis, None),
            Place::Pair { on, from } => (on, Some(from)),
        };
        let name = info.name;
        if a >= axes || b.is_some_and(|b| b >= axes) {
            return Err(format!("{name} on {}: expected axes 1 to {axes}", self.place));
        }
        if b == Some(a) {
            return Err(format!("{name} on {}: expected two different axes", self.place));
        }
        if matches!(info.scope, Scope::Axis) == b.is_some() {
            return Err(format!("{name}: does not act on {}", self.place));
        }
        if self.values.len() != info.parameters.len() {
            return Err(format!(
                "{name} on {}: expected {} values, found {}",
                self.place,
                info.parameters.len(),
                self.values.len()
            ));
        }
        for (p, value) in info.parameters.iter().zip(&self.values) {
            if !value.is_finite() || *value < p.min || *value > p.max {
                return Err(format!(
                    "{name}.{} on {}: expected {} to {} {}, found {value}",
                    p.name, self.place, p.min, p.max, p.unit
                ));
            }
        }
        Ok(())
    }
}

impl PartialEq for Setting {
    fn eq(&self, other: &Self) -> bool {
        self.effect.info().name == other.effect.info().name
            && self.place == other.place
            && self.values == other.values
    }
}

impl std::fmt::Debug for Setting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} on {}: {:?}", self.effect.info().name, self.place, self.values)
    }
}

impl Rig {
    /// The setting of an effect at a place; added at rest when there is none. A reciprocal pair has one setting,
    /// whichever way round it is named.
    pub fn setting_mut(&mut self, effect: &'static dyn Effect, place: Place) -> &mut Setting {
        let place = place.normalised(effect.info().scope);
        let rank = effects::rank(effect);
        let found =
            self.effects.iter().position(|s| s.place == place && effects::rank(s.effect) == rank);
        let at = found.unwrap_or_else(|| {
            let at = self
                .effects
                .partition_point(|s| (effects::rank(s.effect), s.place) < (rank, place));
            self.effects.insert(at, Setting::at_zero(effect, place));
            at
        });
        &mut self.effects[at]
    }

    /// The setting of an effect at a place, if the rig has one.
    pub fn setting(&self, effect: &str, place: Place) -> Option<&Setting> {
        let known = effects::find(effect)?;
        let place = place.normalised(known.info().scope);
        self.effects.iter().find(|s| s.effect.info().name == effect && s.place == place)
    }

    /// Set one parameter of an effect by name. Does not check the bounds: `validate` does.
    pub fn set(
        &mut self,
        effect: &str,
        place: Place,
        parameter: &str,
        value: f64,
    ) -> Result<(), RigError> {
        let known = effects::find(effect)
            .ok_or_else(|| RigError::new(&self.name, effects::unknown_effect(effect)))?;
        let index =
            known.info().parameters.iter().position(|p| p.name == parameter).ok_or_else(|| {
                RigError::new(&self.name, effects::unknown_parameter(known.info(), parameter))
            })?;
        self.setting_mut(known, place).values[index] = value;
        Ok(())
    }

    /// Value of one parameter of an effect, if the rig has the effect there.
    pub fn get(&self, effect: &str, place: Place, parameter: &str) -> Option<f64> {
        let setting = self.setting(effect, place)?;
        Some(setting.values[setting.index(parameter)?])
    }

    /// Take an effect away from a place; whether there was one.
    pub fn remove(&mut self, effect: &str, place: Place) -> bool {
        let before = self.effects.len();
        if let Some(known) = effects::find(effect) {
            let place = place.normalised(known.info().scope);
            self.effects.retain(|s| s.effect.info().name != effect || s.place != place);
        }
        self.effects.len() != before
    }
}
