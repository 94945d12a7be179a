//! Effects that no rig can have: a spring or a mass below nothing, clips that cross each other.
//!
//! Refused where a rig file is read, and there alone: a search may pass such places, and what is simulated there holds the values at
//! the last possible ones. A rig is written with what it is simulated with, so that what a search ends with can be read again.

use super::{Axis, Rig, Setting};
use crate::effects::{MOST_OF_STACK, Place};

impl Rig {
    /// Lowest value of a parameter of an effect at a place that is simulated as it stands, in the parameter's unit. Lower ones are simulated as
    /// this one. None where every value is simulated as it stands.
    pub fn lowest_simulated(&self, effect: &str, place: Place, parameter: &str) -> Option<f64> {
        let axis = self.axes.get(place.on())?;
        lowest(axis, effect, parameter).map(|(lowest, _)| lowest)
    }
}

/// Lowest value of a parameter of an effect, and what it is counted from: stack and mechanism together.
fn lowest(axis: &Axis, effect: &str, parameter: &str) -> Option<(f64, f64)> {
    let (stack, mechanism) = match (effect, parameter) {
        ("stiffness", "change_n_per_m") => {
            (axis.piezo.stiffness_n_per_m, axis.mechanism.stiffness_n_per_m)
        }
        ("inertia", "added_kg") => (axis.piezo.mass_kg, axis.mechanism.mass_kg),
        ("inertia", "added_damping_n_s_per_m") => {
            (axis.piezo.damping_n_s_per_m, axis.mechanism.damping_n_s_per_m)
        }
        _ => return None,
    };
    Some((-MOST_OF_STACK * stack - mechanism, stack + mechanism))
}

/// Values of a setting as they are simulated.
pub(super) fn simulated(rig: &Rig, setting: &Setting) -> Vec<f64> {
    let info = setting.effect.info();
    let mut values = setting.values.clone();
    if let Some(axis) = rig.axes.get(setting.place.on()) {
        for (value, parameter) in values.iter_mut().zip(info.parameters) {
            if let Some((lowest, _)) = lowest(axis, info.name, parameter.name) {
                *value = value.max(lowest);
            }
        }
    }
    if let Some((min, max)) = clips(setting) {
        values[min] = values[min].min(values[max]);
    }
    values
}

/// Places of the lower and the upper limit of a clip.
fn clips(setting: &Setting) -> Option<(usize, usize)> {
    let is_clip = setting.effect.info().name == "amplifier-clipping";
    is_clip.then(|| setting.index("min_v").zip(setting.index("max_v"))).flatten()
}

/// Check what a file says; the error is the message without the name of the file.
pub(super) fn check(rig: &Rig) -> Result<(), String> {
    for setting in &rig.effects {
        let (info, place) = (setting.effect.info(), setting.place);
        let (Place::Axis(on) | Place::Pair { on, .. }) = place;
        let Some(axis) = rig.axes.get(on) else { continue };
        for (&value, parameter) in setting.values.iter().zip(info.parameters) {
            match lowest(axis, info.name, parameter.name) {
                Some((_, total)) if total + value <= 0.0 => {
                    return Err(format!(
                        "{place}: effects.{}.{}: expected more than {} (stack and mechanism together have {total} {}), found {value}",
                        info.name, parameter.name, -total, parameter.unit
                    ));
                }
                _ => {}
            }
        }
        if let Some((min, max)) = clips(setting)
            && setting.values[min] > setting.values[max]
        {
            return Err(format!(
                "{place}: effects.{}.min_v: expected at most max_v = {}, found {}",
                info.name, setting.values[max], setting.values[min]
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_that_cannot_be() {
        let good = Rig::named("handley").expect("rig");
        for (effect, values, expected) in [
            (
                "stiffness",
                &[("change_n_per_m", -1.0e12)][..],
                "stiffness.change_n_per_m: expected more than -",
            ),
            ("inertia", &[("added_kg", -100.0)], "inertia.added_kg: expected more than -"),
            (
                "inertia",
                &[("added_damping_n_s_per_m", -1.0e5)],
                "inertia.added_damping_n_s_per_m: expected more than -",
            ),
            (
                "amplifier-clipping",
                &[("max_v", -5.0), ("min_v", 20.0)],
                "amplifier-clipping.min_v: expected at most max_v = -5, found 20",
            ),
        ] {
            let table: String = values.iter().map(|(key, v)| format!("{key} = {v:?}\n")).collect();
            let text = good.to_toml() + &format!("[axis.effects.{effect}]\n{table}");
            let said = Rig::parse(&text, "rig.toml").expect_err("refused").to_string();
            assert!(said.starts_with("rig.toml: axis 3") && said.contains(expected), "{said}");

            // What a search ends with is another matter: it is written as it is simulated, and read.
            let mut rig = good.clone();
            for (key, value) in values {
                rig.set(effect, Place::Axis(1), key, *value).expect("a parameter");
            }
            rig.validate().expect("simulated as far as it goes");
            let read =
                Rig::parse(&rig.to_toml(), "rig.toml").expect("written so that it can be read");
            let drive = vec![10.0; 40];
            let drive = vec![&drive[..]; good.axes.len()];
            let input = crate::Input {
                sample_rate_hz: 10_000.0,
                start_s: 0.0,
                ticks: None,
                drive_v: &drive,
                monitor_v: None,
                initial: &[],
            };
            let [a, b] = [&rig, &read].map(|rig| {
                crate::simulate(rig, &input, crate::Axes::All).expect("simulated").position_m
            });
            for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
                assert!((a - b).abs() <= 1e-9 * a.abs().max(1e-12), "{effect}: {a} and {b}");
            }
        }
    }
}
