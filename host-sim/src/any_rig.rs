//! A rig file of either kind: a piezo stage (first paper) or a compliant platform (second paper).

use std::path::Path;

use serde::Deserialize;

use crate::{
    platform::PlatformRig,
    rig::{Rig, RigError, read_text},
};

/// What a rig file describes; its key `kind` says which (`"stage"`, also when it is left out, or `"platform"`).
#[derive(Debug, Clone, PartialEq)]
pub enum AnyRig {
    /// Three (or any number of) stacks in a flexure mechanism.
    Stage(Rig),
    /// A chain of lumped masses.
    Platform(PlatformRig),
}

/// The one key that is looked at before the file is read in full.
#[derive(Deserialize)]
struct Kind {
    #[serde(default)]
    kind: Option<toml::Value>,
}

impl AnyRig {
    /// Read a rig file.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        Self::parse(&read_text(path)?, &path.display().to_string())
    }

    /// Read a rig from text; `source` is what an error calls it.
    pub fn parse(text: &str, source: &str) -> Result<Self, RigError> {
        // A file that is not TOML at all is explained by the stage's reader.
        let kind = toml::from_str::<Kind>(text).ok().and_then(|k| k.kind);
        match kind.as_ref().map(|kind| kind.as_str().ok_or(kind)) {
            None | Some(Ok("stage")) => Rig::parse(text, source).map(Self::Stage),
            Some(Ok("platform")) => PlatformRig::parse(text, source)
                .map(Self::Platform)
                .map_err(|error| RigError::new(source, error.message())),
            Some(Ok(other)) => Err(RigError::new(
                source,
                format!("kind must be \"stage\" or \"platform\", found \"{other}\""),
            )),
            Some(Err(other)) => Err(RigError::new(
                source,
                format!("kind must be \"stage\" or \"platform\", found {other}"),
            )),
        }
    }

    /// The rig as a file.
    pub fn to_toml(&self) -> String {
        match self {
            Self::Stage(rig) => rig.to_toml(),
            Self::Platform(rig) => rig.to_toml(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kind_decides() {
        let platform = "name = \"p\"\nkind = \"platform\"\nsample_rate_hz = 200.0\n[[mass]]\nmass_kg = 0.05\n\
                        stiffness_n_per_m = 4.0e3\ndamping_n_s_per_m = 4.1e3\n";
        assert!(matches!(AnyRig::parse(platform, "p"), Ok(AnyRig::Platform(_))));
        for wrong in ["\"ship\"", "3"] {
            let text = platform.replace("\"platform\"", wrong);
            let error = AnyRig::parse(&text, "rig.toml").unwrap_err().to_string();
            assert!(
                error.starts_with("rig.toml: kind must be") && error.contains(wrong),
                "{error}"
            );
        }
        let error = AnyRig::parse(&platform.replace("mass_kg", "mass_g"), "rig.toml").unwrap_err();
        assert!(
            error.to_string().contains("`mass_g`")
                && error.to_string().matches("rig.toml").count() == 1
        );
    }
}
