//! Controller settings from a rig file: the controller knows of the rig what the file says.

use flexstage::settings::{
    AxisSettings, CreepSettings, FeedbackSettings, FeedforwardSettings, LimitSettings,
    MaxwellSettings, MechanismSettings, NotchSettings, StackSettings,
};
use flexstage::{AXES, MAX_MAXWELL, Settings};

use crate::effects::Place;
use crate::rig::{Axis, Rig};

/// Settings with the rig's own model as feedforward, a feedback that suits its resonance, and the board's converters.
///
/// Parameters of effects that the controller has a counterpart for (inertia, creep, stiffness between axes, amplifier
/// bandwidth, gains) are used, so that a rig corrected by `diagnose` gives a better controller. Axes beyond the controller's three are ignored.
pub fn controller_settings(rig: &Rig) -> Settings {
    let mut settings = Settings::default();
    for (k, axis) in rig.axes.iter().take(AXES).enumerate() {
        settings.axes[k] = axis_settings(rig, k, axis);
        // Back from either rail in half a second: the board refuses slower returns than 0.6 s.
        let rail_v = axis.amplifier.max_v.max(-axis.amplifier.min_v) as f32;
        let guard = &mut settings.guard;
        guard.return_v_per_ms = guard.return_v_per_ms.max(rail_v / 500.0);
    }
    for on in 0..AXES.min(rig.axes.len()) {
        for from in 0..AXES.min(rig.axes.len()) {
            if on != from {
                let place = Place::Pair { on, from };
                if let Some(n_per_m) = rig.get("stiffness-coupling", place, "stiffness_n_per_m") {
                    settings.cross_stiffness_n_per_m[on][from] = n_per_m as f32;
                }
            }
        }
    }
    settings
}

/// Decades of creep in Kelvin-Voigt form: equal gains at time constants a decade apart give a straight line in log time, and gains that go
/// with a power of them one that bends. What goes with the level is left to the loop.
pub fn log_creep(per_decade: f64, tilt: f64) -> impl Iterator<Item = CreepSettings> {
    [0.1f32, 1.0, 10.0, 100.0, 1_000.0].into_iter().map(move |time_constant_s| CreepSettings {
        gain: (per_decade * f64::from(time_constant_s).powf(tilt)) as f32,
        time_constant_s,
    })
}

fn axis_settings(rig: &Rig, k: usize, axis: &Axis) -> AxisSettings {
    let effect = |name, parameter| rig.get(name, Place::Axis(k), parameter);
    let ratio = |name, parameter| effect(name, parameter).unwrap_or(1.0);
    let piezo = &axis.piezo;
    let elements: Vec<(f64, f64)> = piezo
        .hysteresis
        .capacitance_f
        .iter()
        .copied()
        .zip(piezo.hysteresis.limit_v.iter().copied())
        .collect();
    let stack = StackSettings {
        transformer_n_per_v: piezo.transformer_n_per_v as f32,
        capacitance_f: piezo.capacitance_f as f32,
        stiffness_n_per_m: piezo.stiffness_n_per_m as f32,
        damping_n_s_per_m: piezo.damping_n_s_per_m as f32,
        mass_kg: piezo.mass_kg as f32,
        hysteresis: reduce(elements, MAX_MAXWELL)
            .into_iter()
            .map(|(c, v)| MaxwellSettings { capacitance_f: c as f32, limit_v: v as f32 })
            .collect(),
    };
    let added = |name, parameter| effect(name, parameter).unwrap_or(0.0);
    let mass_kg = axis.mechanism.mass_kg + added("inertia", "added_kg");
    let mechanism = MechanismSettings {
        stiffness_n_per_m: (axis.mechanism.stiffness_n_per_m + added("stiffness", "change_n_per_m"))
            as f32,
        mass_kg: mass_kg as f32,
        damping_n_s_per_m: (axis.mechanism.damping_n_s_per_m
            + added("inertia", "added_damping_n_s_per_m")) as f32,
    };
    let feedforward = FeedforwardSettings {
        creep: effect("creep", "per_decade")
            .filter(|c| *c > 0.0)
            .map(|per_decade| log_creep(per_decade, added("creep", "tilt")))
            .into_iter()
            .flatten()
            .collect(),
        ..FeedforwardSettings::default()
    };
    let volts_per_um = (piezo.stiffness_n_per_m + f64::from(mechanism.stiffness_n_per_m))
        / piezo.transformer_n_per_v
        * 1.0e-6;
    let moving_kg = piezo.mass_kg + mass_kg;
    let resonance_hz =
        ((piezo.stiffness_n_per_m + f64::from(mechanism.stiffness_n_per_m)) / moving_kg).sqrt()
            / std::f64::consts::TAU;
    // The core models one pole: a second one delays about as much as a slower first, and so do two that ring.
    let further = effect("amplifier-bandwidth", "further_pole").unwrap_or(0.0).min(1.0);
    let time_constant_s =
        axis.amplifier.time_constant_s * ratio("amplifier-bandwidth", "ratio") * (1.0 + further);
    AxisSettings {
        stack,
        mechanism,
        amplifier_time_constant_s: time_constant_s as f32,
        feedforward,
        feedback: feedback(volts_per_um, resonance_hz),
        limits: LimitSettings {
            min_v: axis.amplifier.min_v as f32,
            max_v: axis.amplifier.max_v as f32,
            ..LimitSettings::default()
        },
        ..AxisSettings::default()
    }
}

/// Feedback for a stage of `volts_per_um` whose first resonance is at `resonance_hz`.
pub fn feedback(volts_per_um: f64, resonance_hz: f64) -> FeedbackSettings {
    let mut settings = FeedbackSettings {
        proportional_v_per_um: (0.3 * volts_per_um) as f32,
        integral_v_per_um_s: (1_500.0 * volts_per_um) as f32,
        derivative_v_ms_per_um: (0.03 * volts_per_um) as f32,
        ..FeedbackSettings::default()
    };
    // Above half the sampling rate there is nothing to filter.
    if resonance_hz < 4_500.0 {
        let notch =
            NotchSettings { frequency_hz: resonance_hz as f32, damping_ratio: 0.6, depth: 0.05 };
        let _ = settings.notches.push(notch);
    }
    settings
}

/// At most `most` slip elements (capacitance, limit): neighbours in slip charge are merged, the rise of the voltage at small charges
/// and its saturation are kept.
pub fn reduce(mut elements: Vec<(f64, f64)>, most: usize) -> Vec<(f64, f64)> {
    let slip = |&(c, v): &(f64, f64)| c * v;
    elements.retain(|e| e.0 > 0.0 && e.1 > 0.0);
    elements.sort_by(|a, b| slip(a).total_cmp(&slip(b)));
    while elements.len() > most.max(1) {
        let gap = |pair: &[(f64, f64)]| slip(&pair[1]) / slip(&pair[0]);
        let at = (0..elements.len() - 1)
            .min_by(|&i, &j| gap(&elements[i..]).total_cmp(&gap(&elements[j..])))
            .unwrap_or(0);
        let (a, b) = (elements[at], elements.remove(at + 1));
        // Parallel slopes add (elastances 1/C), limits add.
        elements[at] = (1.0 / (1.0 / a.0 + 1.0 / b.0), a.1 + b.1);
    }
    elements
}
