//! docs/rig.md is what a user reads: it must name every effect with every parameter and its unit.

use host_sim::effects::{catalogue, strangers};

#[test]
fn the_table_of_effects_is_the_catalogue() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/rig.md");
    let text = std::fs::read_to_string(path).expect(path);
    let mut missing = Vec::new();
    for effect in catalogue().iter().chain(strangers()) {
        let info = effect.info();
        let row = text
            .lines()
            .find(|line| line.starts_with(&format!("| `{}` |", info.name)))
            .unwrap_or_else(|| panic!("docs/rig.md has no row for {}", info.name));
        for p in info.parameters {
            for expected in [format!("`{}`", p.name), format!(" [{}] ", p.unit)] {
                if !row.contains(&expected) {
                    missing.push(format!("{}: {expected}", info.name));
                }
            }
        }
    }
    assert!(missing.is_empty(), "docs/rig.md lacks {missing:#?}");
}
