//! Causes as the answer states them: parameters of an accepted effect, what else it could be, and the experiment that tells.

use std::collections::BTreeMap;

use host_sim::platform::{Mass, PlatformRig, compliance_m_per_n, rig::SensorEffects};

use super::{
    catalogue::Effect,
    fit::Fit,
    identify::{self, Named},
    select::{Accepted, Selection},
};
use crate::diagnosis::{Cause, NextExperiment, Parameter};

/// One accepted effect with its parameters, from the fit to all samples.
pub(super) fn cause(accepted: &Accepted, found: &Fit, memory: f64) -> Cause {
    let effect = accepted.effect;
    let mut parameters = BTreeMap::new();
    for named in effect_parameters(effect, found, memory) {
        parameters.insert(
            named.name,
            Parameter {
                value: named.estimate.value,
                ci95: named.estimate.ci95,
                unit: named.unit.to_owned(),
            },
        );
    }
    let mut others: Vec<String> =
        accepted.indistinguishable.iter().map(|(rival, _)| rival.name().to_owned()).collect();
    if effect == Effect::Damping {
        others.push("stiffness".to_owned()); // only k/c can be told
    }
    Cause {
        effect: effect.name().to_owned(),
        kind: effect.kind(),
        stage: effect.stage().to_owned(),
        axes: vec![1],
        closes: accepted.closes,
        parameters,
        confidence: accepted.confidence,
        indistinguishable_from: others,
    }
}

/// Parameters that an effect brings.
pub fn effect_parameters(effect: Effect, found: &Fit, memory: f64) -> Vec<Named> {
    let sensor = |name: &str, unit, log, pick: fn(&SensorEffects) -> f64| {
        let estimate = found.estimate(memory, log, |rig| pick(&rig.effects));
        vec![Named { name: name.to_owned(), estimate, unit }]
    };
    let masses = found.model.rig.masses.len();
    let each = |name: &str, unit, log, pick: &dyn Fn(&Mass) -> Option<f64>| -> Vec<Named> {
        (0..masses)
            .filter(|i| pick(&found.model.rig.masses[*i]).is_some())
            .map(|i| Named {
                name: format!("{name}_{}", i + 1),
                estimate: found.estimate(memory, log, |rig| pick(&rig.masses[i]).unwrap_or(0.0)),
                unit,
            })
            .collect()
    };
    match effect {
        Effect::Damping | Effect::SecondMass | Effect::ThirdMass => {
            identify::chain_parameters(found, memory)
        }
        Effect::Inertia => each("mass_kg", "kg", true, &|mass| Some(mass.mass_kg)),
        Effect::Viscoelasticity => {
            let mut list = identify::chain_parameters(found, memory);
            list.extend(each("branch_stiffness_n_per_m", "N/m", true, &|mass| {
                mass.effects.viscoelasticity.as_ref()?.stiffness_n_per_m.first().copied()
            }));
            list.extend(each("branch_damping_n_s_per_m", "N s/m", true, &|mass| {
                mass.effects.viscoelasticity.as_ref()?.damping_n_s_per_m.first().copied()
            }));
            list
        }
        Effect::StiffnessHardening => each("cubic_n_per_m3", "N/m^3", false, &|mass| {
            mass.effects.stiffness_hardening.map(|e| e.cubic_n_per_m3)
        }),
        Effect::Friction => {
            each("force_n", "N", false, &|mass| mass.effects.friction.map(|e| e.force_n))
        }
        Effect::SensorGain => {
            sensor("factor", "", false, |e| e.sensor_gain.map_or(1.0, |e| e.factor))
        }
        Effect::SensorOffset => {
            sensor("offset_m", "m", false, |e| e.sensor_offset.map_or(0.0, |e| e.offset_m))
        }
        Effect::SensorDrift => sensor("drift_m_per_s", "m/s", false, |e| {
            e.sensor_drift.map_or(0.0, |e| e.drift_m_per_s)
        }),
        Effect::SensorBandwidth => sensor("time_constant_s", "s", true, |e| {
            e.sensor_bandwidth.map_or(0.0, |e| e.time_constant_s)
        }),
        Effect::SensorNonlinearity => sensor("quadratic_per_m", "1/m", false, |e| {
            e.sensor_nonlinearity.map_or(0.0, |e| e.quadratic_per_m)
        }),
    }
}

/// The experiment that separates what these returns do not, from the fitted rivals themselves.
pub(super) fn ambiguity(selection: &Selection, found: &Fit) -> Option<NextExperiment> {
    let (accepted, rival) = selection
        .accepted
        .iter()
        .find_map(|accepted| accepted.indistinguishable.first().map(|rival| (accepted, rival)))
        .map_or((None, None), |(a, r)| (Some(a), Some(r)));
    if let (Some(accepted), Some((_, rival))) = (accepted, rival) {
        let mut separates = vec![accepted.effect.name().to_owned()];
        separates
            .extend(accepted.indistinguishable.iter().map(|(rival, _)| rival.name().to_owned()));
        let rig = &found.model.rig;
        let excitation = if rig.masses.len() > 1 && rig.is_linear() && rival.model.rig.is_linear() {
            let held = host_sim::platform::statics::held_positions_m(rig, 1e-3).unwrap_or_default();
            let joint = held.first().copied().unwrap_or(0.0) * 1e6;
            let apart = separating_frequency_hz(rig, &rival.model.rig).map_or_else(
                || "at no frequency up to 1 MHz".to_owned(),
                |hz| format!("only above {:.1} kHz, where the masses act", hz / 1e3),
            );
            format!(
                "Record the joint between the lower and the upper links together with the platform during one more free \
                 return: with a second mass it starts {joint:.0} um away for every 1000 um of the platform and comes back \
                 on a time constant of its own; a single relaxing mass has no such joint. Another deflection tells \
                 nothing (both models are linear). A forced test at the platform (hammer or sine, force recorded) \
                 separates them {apart}."
            )
        } else {
            "A free return from a deflection at least twice as large and one half as large: the rivals scale differently."
                .to_owned()
        };
        return Some(NextExperiment { excitation, separates });
    }
    selection.accepted.iter().any(|accepted| accepted.effect == Effect::Damping).then(|| {
        NextExperiment {
            excitation: "Static test: known forces on the platform and the displacement that each one holds; the return \
                         itself tells only stiffness over damping."
                .to_owned(),
            separates: vec!["damping".to_owned(), "stiffness".to_owned()],
        }
    })
}

/// Lowest frequency at which the compliance of two rigs differs by a tenth.
fn separating_frequency_hz(a: &PlatformRig, b: &PlatformRig) -> Option<f64> {
    (0..=160).map(|step| 10f64.powf(-2.0 + f64::from(step) / 20.0)).find(|hz| {
        let (a, b) = (compliance_m_per_n(a, *hz), compliance_m_per_n(b, *hz));
        (a - b).norm() > 0.1 * a.norm()
    })
}
