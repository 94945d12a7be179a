//! Rigs that ship with the program, so that it runs without any file.

use super::Rig;

const RIGS: &[(&str, &str)] = &[
    ("handley", include_str!("../../rigs/handley.toml")),
    ("different", include_str!("../../rigs/different.toml")),
    ("fsm", include_str!("../../rigs/fsm.toml")),
    ("fsm-independent", include_str!("../../rigs/fsm-independent.toml")),
    ("micromanipulator", include_str!("../../rigs/micromanipulator.toml")),
];

impl Rig {
    /// An embedded rig: `handley` (the first paper's stage), `different` (a plant that the controller does not know),
    /// `fsm`, `fsm-independent` and `micromanipulator` (measured systems).
    pub fn named(name: &str) -> Option<Rig> {
        let (_, text) = RIGS.iter().find(|(known, _)| *known == name)?;
        Some(Rig::parse(text, name).expect("embedded rigs are tested"))
    }

    /// Names of the embedded rigs.
    pub fn names() -> impl Iterator<Item = &'static str> {
        RIGS.iter().map(|(name, _)| *name)
    }
}
