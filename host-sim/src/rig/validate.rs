//! What a rig must satisfy before anything is simulated. One line a fault, naming the key as it stands in the file.

use super::{Axis, Rig};

/// Most axes that a rig may have.
pub const MAX_AXES: usize = 8;
/// Most Maxwell elements that a stack may have.
pub const MAX_ELEMENTS: usize = 1024;

/// Check every value; the error is the message without the name of the file.
pub fn check(rig: &Rig) -> Result<(), String> {
    if rig.name.trim().is_empty() {
        return Err("name: expected a name, found an empty one".into());
    }
    within("sample_rate_hz", rig.sample_rate_hz, 1.0, 1.0e6)?;
    if rig.axes.is_empty() || rig.axes.len() > MAX_AXES {
        return Err(format!(
            "axis: expected 1 to {MAX_AXES} [[axis]] tables, found {}",
            rig.axes.len()
        ));
    }
    for (index, axis) in rig.axes.iter().enumerate() {
        check_axis(axis).map_err(|message| format!("axis {}: {message}", index + 1))?;
    }
    if let Some(map) = &rig.output_map {
        let n = rig.axes.len();
        if map.len() != n || map.iter().any(|row| row.len() != n) {
            return Err(format!("output_map: expected {n} rows of {n} numbers, one row a sensor"));
        }
        if map.iter().flatten().any(|value| !value.is_finite()) {
            return Err("output_map: expected finite numbers".into());
        }
    }
    rig.effects.iter().try_for_each(|setting| setting.check(rig.axes.len()))
}

fn check_axis(axis: &Axis) -> Result<(), String> {
    let Axis { amplifier, piezo, mechanism, sensor, monitor } = axis;
    within("amplifier.time_constant_s", amplifier.time_constant_s, 0.0, 10.0)?;
    within("amplifier.min_v", amplifier.min_v, -1.0e5, 1.0e5)?;
    within("amplifier.max_v", amplifier.max_v, -1.0e5, 1.0e5)?;
    if amplifier.min_v >= amplifier.max_v {
        return Err(format!(
            "amplifier.min_v: expected less than max_v = {}, found {}",
            amplifier.max_v, amplifier.min_v
        ));
    }
    positive("piezo.transformer_n_per_v", piezo.transformer_n_per_v)?;
    positive("piezo.capacitance_f", piezo.capacitance_f)?;
    positive("piezo.stiffness_n_per_m", piezo.stiffness_n_per_m)?;
    not_negative("piezo.damping_n_s_per_m", piezo.damping_n_s_per_m)?;
    positive("piezo.mass_kg", piezo.mass_kg)?;
    let hysteresis = &piezo.hysteresis;
    if hysteresis.capacitance_f.len() != hysteresis.limit_v.len() {
        return Err(format!(
            "piezo.hysteresis: expected as many capacitance_f as limit_v, found {} and {}",
            hysteresis.capacitance_f.len(),
            hysteresis.limit_v.len()
        ));
    }
    if hysteresis.limit_v.len() > MAX_ELEMENTS {
        return Err(format!(
            "piezo.hysteresis: expected at most {MAX_ELEMENTS} elements, found {}",
            hysteresis.limit_v.len()
        ));
    }
    for value in &hysteresis.capacitance_f {
        positive("piezo.hysteresis.capacitance_f", *value)?;
    }
    for value in &hysteresis.limit_v {
        positive("piezo.hysteresis.limit_v", *value)?;
    }
    not_negative("mechanism.stiffness_n_per_m", mechanism.stiffness_n_per_m)?;
    not_negative("mechanism.mass_kg", mechanism.mass_kg)?;
    not_negative("mechanism.damping_n_s_per_m", mechanism.damping_n_s_per_m)?;
    not_negative("sensor.noise_rms_m", sensor.noise_rms_m)?;
    not_negative("sensor.resolution_m", sensor.resolution_m)?;
    within("sensor.offset_m", sensor.offset_m, -1.0, 1.0)?;
    if let Some(monitor) = monitor {
        not_negative("monitor.noise_rms_v", monitor.noise_rms_v)?;
        not_negative("monitor.resolution_v", monitor.resolution_v)?;
    }
    Ok(())
}

fn within(key: &str, value: f64, min: f64, max: f64) -> Result<(), String> {
    if value.is_finite() && (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(format!("{key}: expected {min} to {max}, found {value}"))
    }
}

fn positive(key: &str, value: f64) -> Result<(), String> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(format!("{key}: expected a number above 0, found {value}"))
    }
}

fn not_negative(key: &str, value: f64) -> Result<(), String> {
    if value.is_finite() && value >= 0.0 {
        Ok(())
    } else {
        Err(format!("{key}: expected 0 or more, found {value}"))
    }
}
