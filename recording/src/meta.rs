//! What a recording says about itself: the JSON object under the file metadata key `flexstage`.

use std::path::Path;

use serde_json::{Map, Value, json};

use crate::{Error, Result};

/// Key of the Parquet file metadata that holds the JSON object.
pub const METADATA_KEY: &str = "flexstage";
/// Value of `format`.
pub const FORMAT: &str = "flexstage-recording";
/// Value of `version` that this crate reads and writes.
pub const VERSION: u64 = 1;

/// What a recording says about itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Meta {
    /// Free text: what was done.
    pub experiment: String,
    /// Samples a second (Hz).
    pub sample_rate_hz: f64,
    /// The first part (s) only brings the stack to a known memory: simulate it, score nothing in it.
    pub settle_s: f64,
    /// Start of this file on the session's clock (s).
    pub start_s: f64,
    /// Name of the rig.
    pub rig: String,
    /// Period of a periodic excitation (s).
    pub period_s: Option<f64>,
    /// Deflection (um) from which a platform returns freely.
    pub initial_position_um: Option<f64>,
}

impl Meta {
    /// Metadata of a recording that starts the session's clock and has nothing to settle.
    pub fn new(experiment: impl Into<String>, sample_rate_hz: f64) -> Self {
        Self {
            experiment: experiment.into(),
            sample_rate_hz,
            settle_s: 0.0,
            start_s: 0.0,
            rig: String::new(),
            period_s: None,
            initial_position_um: None,
        }
    }

    /// The JSON object of the contract.
    pub fn to_json(&self) -> String {
        let mut object = json!({
            "format": FORMAT,
            "version": VERSION,
            "experiment": self.experiment,
            "sample_rate_hz": self.sample_rate_hz,
            "settle_s": self.settle_s,
            "start_s": self.start_s,
            "rig": self.rig,
        });
        if let Some(period) = self.period_s {
            object["period_s"] = json!(period);
        }
        if let Some(position) = self.initial_position_um {
            object["initial_position_um"] = json!(position);
        }
        object.to_string()
    }

    /// Reads the JSON object; unknown keys are ignored.
    pub fn from_json(text: &str, path: &Path) -> Result<Self> {
        let value: Value = serde_json::from_str(text).map_err(|error| {
            Error::invalid(path, format!("metadata `flexstage`: expected JSON: {error}"))
        })?;
        let Value::Object(object) = value else {
            return Err(Error::invalid(
                path,
                format!("metadata `flexstage`: expected a JSON object, found {value}"),
            ));
        };
        let keys = Keys { object: &object, path };
        let format = keys.text("format")?.unwrap_or_default();
        if format != FORMAT {
            return Err(keys.wrong("format", &format!("\"{FORMAT}\"")));
        }
        match object.get("version") {
            Some(version) if version.as_f64() == Some(VERSION as f64) => {}
            _ => return Err(keys.wrong("version", &VERSION.to_string())),
        }
        let Some(sample_rate_hz) = keys.number("sample_rate_hz")? else {
            return Err(keys.wrong("sample_rate_hz", "a number of samples per second"));
        };
        let meta = Self {
            experiment: keys.text("experiment")?.unwrap_or_default(),
            sample_rate_hz,
            settle_s: keys.number("settle_s")?.unwrap_or(0.0),
            start_s: keys.number("start_s")?.unwrap_or(0.0),
            rig: keys.text("rig")?.unwrap_or_default(),
            period_s: keys.number("period_s")?,
            initial_position_um: keys.number("initial_position_um")?,
        };
        meta.check(path)?;
        Ok(meta)
    }

    /// Checks that the values are possible.
    pub fn check(&self, path: &Path) -> Result<()> {
        let wrong = |key: &str, expected: &str, found: f64| {
            Err(Error::invalid(
                path,
                format!("metadata `flexstage`, key `{key}`: expected {expected}, found {found}"),
            ))
        };
        // Outside this range no piezo stage is sampled, and a simulation would never end or never begin.
        if !(1e-3..=1e8).contains(&self.sample_rate_hz) {
            return wrong(
                "sample_rate_hz",
                "samples per second in 0.001 to 1e8",
                self.sample_rate_hz,
            );
        }
        if !(self.settle_s >= 0.0 && self.settle_s.is_finite()) {
            return wrong("settle_s", "seconds, zero or more", self.settle_s);
        }
        if !self.start_s.is_finite() {
            return wrong("start_s", "seconds on the session's clock", self.start_s);
        }
        match self.period_s {
            Some(period) if !(period > 0.0 && period.is_finite()) => {
                return wrong("period_s", "seconds, more than zero", period);
            }
            _ => {}
        }
        match self.initial_position_um {
            Some(position) if !position.is_finite() => {
                wrong("initial_position_um", "micrometres", position)
            }
            _ => Ok(()),
        }
    }
}

struct Keys<'a> {
    object: &'a Map<String, Value>,
    path: &'a Path,
}

impl Keys<'_> {
    fn wrong(&self, key: &str, expected: &str) -> Error {
        let found = match self.object.get(key) {
            Some(value) => value.to_string(),
            None => "nothing".into(),
        };
        Error::invalid(
            self.path,
            format!("metadata `flexstage`, key `{key}`: expected {expected}, found {found}"),
        )
    }

    fn number(&self, key: &str) -> Result<Option<f64>> {
        match self.object.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(value) => match value.as_f64() {
                Some(number) => Ok(Some(number)),
                None => Err(self.wrong(key, "a number")),
            },
        }
    }

    fn text(&self, key: &str) -> Result<Option<String>> {
        match self.object.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(Value::String(text)) => Ok(Some(text.clone())),
            Some(_) => Err(self.wrong(key, "text")),
        }
    }
}
