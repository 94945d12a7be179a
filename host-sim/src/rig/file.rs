//! Rig files: TOML in, TOML out. An unknown key is an error that names it; effects are a table each.
//!
//! An effect of an axis is `[axis.effects.NAME]` with its parameters; an effect between two axes is a list under the
//! axis that it acts on: `[[axis.effects.NAME]]` with `from = K` and its parameters.

use std::path::Path;

use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::{
    Amplifier, Axis, Mechanism, Monitor, Piezo, Rig, RigError, Sensor, Setting, physical, validate,
};
use crate::effects::{self, Place, Role, Scope};

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    kind: Option<String>,
    sample_rate_hz: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    output_map: Option<Vec<Vec<f64>>>,
    axis: Vec<AxisDocument>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisDocument {
    amplifier: Amplifier,
    piezo: Piezo,
    mechanism: Mechanism,
    sensor: Sensor,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    monitor: Option<Monitor>,
    #[serde(default, skip_serializing_if = "Table::is_empty")]
    effects: Table,
}

/// Text of a rig file of any kind.
pub(crate) fn read_text(path: &Path) -> Result<String, RigError> {
    use std::io::ErrorKind;
    std::fs::read_to_string(path).map_err(|error| {
        let what = match error.kind() {
            ErrorKind::NotFound => "there is no such file".to_owned(),
            ErrorKind::IsADirectory => "this is a folder".to_owned(),
            ErrorKind::InvalidData => "this is not a text file".to_owned(),
            _ => format!("cannot be read ({error})"),
        };
        RigError::new(
            path.display().to_string(),
            format!("{what}: expected a rig file in TOML; docs/rig.md describes it, host-sim/rigs holds examples"),
        )
    })
}

impl Rig {
    /// Read a rig file.
    pub fn load(path: &Path) -> Result<Rig, RigError> {
        Rig::parse(&read_text(path)?, &path.display().to_string())
    }

    /// Read a rig from TOML; `source` names it in errors.
    pub fn parse(text: &str, source: &str) -> Result<Rig, RigError> {
        let document: Document =
            toml::from_str(text).map_err(|error| RigError::new(source, toml_line(text, &error)))?;
        let fail = |message: String| RigError::new(source, message);
        if let Some(kind) = document.kind.filter(|kind| kind != "stage") {
            return Err(fail(format!("kind: expected \"stage\" here, found \"{kind}\"")));
        }
        let mut rig = Rig {
            name: document.name,
            sample_rate_hz: document.sample_rate_hz,
            output_map: document.output_map,
            axes: Vec::new(),
            effects: Vec::new(),
        };
        let mut tables = Vec::new();
        for axis in document.axis {
            let AxisDocument { amplifier, piezo, mechanism, sensor, monitor, effects } = axis;
            rig.axes.push(Axis { amplifier, piezo, mechanism, sensor, monitor });
            tables.push(effects);
        }
        for (axis, table) in tables.into_iter().enumerate() {
            read_effects(&mut rig, axis, table)
                .map_err(|message| fail(format!("axis {}: effects.{message}", axis + 1)))?;
        }
        validate::check(&rig).and_then(|()| physical::check(&rig)).map_err(fail)?;
        Ok(rig)
    }

    /// Check every value of a rig that was built or changed in memory.
    pub fn validate(&self) -> Result<(), RigError> {
        validate::check(self).map_err(|message| RigError::new(&self.name, message))
    }

    /// The rig as TOML, effects included, with the values that are simulated: `Rig::parse` of it gives a rig that does the same.
    pub fn to_toml(&self) -> String {
        let axis = self.axes.iter().enumerate().map(|(index, axis)| {
            let Axis { amplifier, piezo, mechanism, sensor, monitor } = axis.clone();
            let effects = write_effects(self, index);
            AxisDocument { amplifier, piezo, mechanism, sensor, monitor, effects }
        });
        let document = Document {
            name: self.name.clone(),
            kind: None,
            sample_rate_hz: self.sample_rate_hz,
            output_map: self.output_map.clone(),
            axis: axis.collect(),
        };
        toml::to_string(&document).expect("a rig is plain numbers and names")
    }
}

/// The first line of a TOML error with its place in the file, in the words of the rig file.
fn toml_line(text: &str, error: &toml::de::Error) -> String {
    let what = error.message().lines().next().unwrap_or("cannot be read as TOML");
    let what = what.replace("unknown field", "unknown key").replace("missing field", "missing key");
    match error.span() {
        Some(span) => {
            let before = text.get(..span.start).unwrap_or(text);
            format!("line {}: {what}", before.matches('\n').count() + 1)
        }
        None => what,
    }
}

fn read_effects(rig: &mut Rig, axis: usize, table: Table) -> Result<(), String> {
    for (name, value) in table {
        let effect = effects::find(&name).ok_or_else(|| effects::unknown_effect(&name))?;
        let info = effect.info();
        match (info.scope, value) {
            (Scope::Axis, Value::Table(table)) => {
                read_setting(rig, effect, Place::Axis(axis), table)
                    .map_err(|message| format!("{name}.{message}"))?;
            }
            (Scope::Axis, _) => {
                return Err(format!("{name}: expected a table of parameters"));
            }
            (_, Value::Array(list)) => {
                for entry in list {
                    let Value::Table(mut table) = entry else {
                        return Err(format!("{name}: expected a list of tables with `from`"));
                    };
                    let from = match table.remove("from") {
                        Some(Value::Integer(from)) if from >= 1 => from as usize - 1,
                        found => {
                            let found = found.map_or("nothing".into(), |v| v.to_string());
                            return Err(format!(
                                "{name}.from: expected the number of the other axis, found {found}"
                            ));
                        }
                    };
                    let place = Place::Pair { on: axis, from }.normalised(info.scope);
                    if rig.setting(&name, place).is_some() {
                        return Err(format!("{name}: {place} is given twice"));
                    }
                    read_setting(rig, effect, place, table)
                        .map_err(|message| format!("{name}.{message}"))?;
                }
            }
            (_, _) => return Err(format!("{name}: expected a list of tables with `from`")),
        }
    }
    Ok(())
}

fn read_setting(
    rig: &mut Rig,
    effect: &'static dyn effects::Effect,
    place: Place,
    table: Table,
) -> Result<(), String> {
    let mut setting = Setting::at_zero(effect, place);
    for (key, value) in table {
        let index =
            setting.index(&key).ok_or_else(|| effects::unknown_parameter(effect.info(), &key))?;
        setting.values[index] = match value {
            Value::Float(value) => value,
            Value::Integer(value) => value as f64,
            other => return Err(format!("{key}: expected a number, found {other}")),
        };
    }
    *rig.setting_mut(effect, place) = setting;
    Ok(())
}

fn write_effects(rig: &Rig, axis: usize) -> Table {
    let mut tables = Table::new();
    for setting in &rig.effects {
        let info = setting.effect.info();
        let on = match setting.place {
            Place::Axis(on) | Place::Pair { on, .. } => on,
        };
        if on != axis {
            continue;
        }
        let mut table = Table::new();
        if let Place::Pair { from, .. } = setting.place {
            table.insert("from".into(), Value::Integer(from as i64 + 1));
        }
        for (parameter, value) in info.parameters.iter().zip(&physical::simulated(rig, setting)) {
            // A size at zero is what a missing key means; shapes are written, so that a change of default moves nothing.
            if parameter.role == Role::Shape || *value != parameter.zero {
                table.insert(parameter.name.into(), Value::Float(*value));
            }
        }
        match setting.place {
            Place::Axis(_) => {
                tables.insert(info.name.into(), Value::Table(table));
            }
            Place::Pair { .. } => {
                let list = tables.entry(info.name).or_insert_with(|| Value::Array(Vec::new()));
                list.as_array_mut().expect("made above").push(Value::Table(table));
            }
        }
    }
    tables
}
