//! What the board's limits say to a plan, and the settings under which volts are driven.

use flexstage::{AXES, Settings};

use super::plan::Experiment;
use crate::{Error, Result};

/// Refuse a plan that the board's limits would cut: what is not driven as planned probes nothing.
pub fn check(plan: &[Experiment], settings: &Settings, axes: &[usize]) -> Result<()> {
    for &axis in axes {
        let Some(axis_settings) = settings.axes.get(axis) else {
            return Err(Error::Invalid(format!(
                "there is no axis {}: expected 1 to {AXES}",
                axis + 1
            )));
        };
        let limits = &axis_settings.limits;
        let (scale, origin) = scale_um_per_v(settings, axis);
        for experiment in plan {
            let (low, high) = experiment.range_v();
            for (what, unit, found_low, found_high, min, max) in [
                ("drive", "V", low, high, limits.min_v, limits.max_v),
                (
                    "travel",
                    "um",
                    low * scale + origin,
                    high * scale + origin,
                    limits.min_um,
                    limits.max_um,
                ),
            ] {
                if found_low < f64::from(min) - 1e-6 || found_high > f64::from(max) + 1e-6 {
                    return Err(Error::Beyond(format!(
                        "`{}` needs {found_low:.1} to {found_high:.1} {unit} on axis {}, its {what} limits are {min} to {max} \
                         {unit}: choose another level or widen the limits",
                        experiment.name,
                        axis + 1
                    )));
                }
            }
        }
    }
    Ok(())
}

/// Micrometres of reference per volt of drive with [`open_loop`] settings, and the reference at 0 V.
pub fn scale_um_per_v(settings: &Settings, axis: usize) -> (f64, f64) {
    let a = &settings.axes[axis];
    let stiffness = f64::from(a.stack.stiffness_n_per_m) + f64::from(a.mechanism.stiffness_n_per_m);
    (f64::from(a.stack.transformer_n_per_v) / stiffness * 1e6, f64::from(a.origin_um))
}

/// The same settings with the loop open: the drive is the reference times a constant, limits and guard stay.
///
/// Position limits still watch the measured position; the following error is not watched, because the stack's
/// hysteresis is what is being measured. A host that goes away parks the drives after two seconds.
pub fn open_loop(settings: &Settings) -> Settings {
    let mut out = settings.clone();
    for axis in &mut out.axes {
        axis.feedforward.gain = 1.0;
        axis.feedforward.hysteresis = false;
        axis.feedforward.dynamics = false;
        axis.feedforward.amplifier_lead = false;
        axis.feedforward.creep.clear();
        axis.feedforward.advance_s = 0.0;
        axis.feedback.proportional_v_per_um = 0.0;
        axis.feedback.integral_v_per_um_s = 0.0;
        axis.feedback.derivative_v_ms_per_um = 0.0;
        axis.feedback.notches.clear();
        axis.limits.following_error_um = 0.0;
    }
    out.cross_stiffness_n_per_m = Default::default();
    out.guard.command_timeout_s = 2.0;
    out
}

#[cfg(test)]
mod tests {
    use super::super::plan::{Options, plan};
    use super::*;

    #[test]
    fn limits_are_respected_by_name() {
        let options = Options { max_v: 154.0, ..Options::default() };
        let error = check(&plan(&options), &Settings::default(), &options.axes).unwrap_err();
        assert!(
            error.to_string().contains("150 V") && error.to_string().contains("axis 1"),
            "{error}"
        );
        assert!(check(&[], &Settings::default(), &[5]).is_err());
    }
}
