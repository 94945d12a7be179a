//! What a controller needs of a stage, identified from a session: gain and slip elements, amplifier, moving mass, creep.
//!
//! Other than [`identify()`](crate::identify()), which refits the nominal parameters so that a simulation follows the recordings (output error), this
//! fits the inverse that the controller computes, part by part, each by linear least squares on the parts of the session that
//! show it:
//!
//! - `creep`: the longest stretch in which the drive is held after a step
//! - `inverse`: slow motion, for stiffness and hysteresis
//! - `lag`: fast motion, for the amplifier and the resonance
//!
//! Slow motion is essential; what else a session does not show stays as it was, and the answer says so.

use std::fmt::Write as _;

use host_sim::Place;
use host_sim::rig::{Axis, Rig};
use rayon::prelude::*;
use recording::Session;

use crate::Error;
use crate::session::intake;

mod bounded;
mod creep;
mod inverse;
mod lag;
mod series;

pub use creep::Creep;
pub use inverse::Inverse;
pub use lag::{Estimate, Lag, Mode};
use series::Series;

/// Effects that the fits account for, under the names of their own: a rig that has them would count them twice.
const REPLACED: [&str; 11] = [
    "drive-gain",
    "drive-offset",
    "amplifier-bandwidth",
    "piezo-gain",
    "hysteresis-shape",
    "hysteresis-rate",
    "creep",
    "stiffness",
    "inertia",
    "sensor-gain",
    "sensor-offset",
];
/// A drive that spans less than this share of the amplifier's range is none.
const DRIVEN: f64 = 1.0e-3;
/// Why nothing is known about an axis at rest.
const NOT_DRIVEN: &str = "no recording drives it and measures its position";
/// Creep counts from this many standard errors.
const SIGNIFICANT: f64 = 2.0;

/// A rig for a controller.
pub struct ForControl {
    /// The rig with what was found.
    pub rig: Rig,
    /// One entry an axis of the rig; `None` where nothing could be found out, and all is as it was.
    pub axes: Vec<Option<Findings>>,
    /// What was left as it was, and why; one line each.
    pub notes: Vec<String>,
}

/// What was found out about one axis.
#[derive(Clone, Debug)]
pub struct Findings {
    /// Stiffness and hysteresis.
    pub inverse: Inverse,
    /// Amplifier and resonance.
    pub lag: Lag,
    /// Creep.
    pub creep: Option<Creep>,
}

/// Identify what a controller needs to know. `rig` is the rig as believed before: its springs, capacitances and rails stay.
pub fn for_control(rig: &Rig, session: &Session) -> Result<ForControl, Error> {
    let is_identity = |map: &Vec<Vec<f64>>| {
        let mut entries = map
            .iter()
            .enumerate()
            .flat_map(|(i, r)| r.iter().enumerate().map(move |(j, g)| (i, j, g)));
        entries.all(|(i, j, g)| *g == if i == j { 1.0 } else { 0.0 })
    };
    if rig.output_map.as_ref().is_some_and(|map| !is_identity(map)) {
        return Err(Error::Rig(format!(
            "{}: output_map: expected sensors that see one axis each, found a geometry: the controller has none",
            rig.name
        )));
    }
    let (tracks, mut notes) = intake::tracks(rig, session)?;
    let found: Vec<(Result<Findings, String>, Vec<String>)> = rig
        .axes
        .par_iter()
        .enumerate()
        .map(|(number, axis)| {
            let mut notes = Vec::new();
            let believed = rig.get("creep", Place::Axis(number), "per_decade").unwrap_or(0.0);
            let found = identify_axis(&tracks, number, axis, believed, &mut notes);
            (found, notes)
        })
        .collect();
    let mut identified = rig.clone();
    let mut axes = Vec::new();
    let (mut first_error, mut not_driven) = (None, true);
    for (number, (found, said)) in found.into_iter().enumerate() {
        match found {
            Ok(found) => {
                notes.extend(said.into_iter().map(|n| format!("axis {}: {n}", number + 1)));
                notes.extend(write(&mut identified, number, &found)?);
                axes.push(Some(found));
            }
            Err(missing) => {
                notes.push(format!("axis {}: all as it was: {missing}", number + 1));
                // What a driven axis lacks says more than that another one is not driven.
                if first_error.is_none() || (not_driven && missing != NOT_DRIVEN) {
                    not_driven = missing == NOT_DRIVEN;
                    first_error = Some(format!("axis {}: {missing}", number + 1));
                }
                axes.push(None);
            }
        }
    }
    match first_error {
        Some(missing) if axes.iter().all(Option::is_none) => {
            Err(Error::Session(format!("{missing}; `flexstage probe` records what is needed")))
        }
        _ => {
            identified.validate().map_err(|e| Error::Rig(e.to_string()))?;
            Ok(ForControl { rig: identified, axes, notes })
        }
    }
}

fn identify_axis(
    tracks: &[intake::Track],
    number: usize,
    axis: &Axis,
    believed_creep: f64,
    notes: &mut Vec<String>,
) -> Result<Findings, String> {
    let measured = tracks.iter().filter(|t| t.position_um[number].is_some());
    let (low, high) = measured
        .flat_map(|t| &t.drive_v[number])
        .fold((f64::MAX, f64::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    let span_v = high - low;
    if span_v.is_nan() || span_v <= DRIVEN * (axis.amplifier.max_v - axis.amplifier.min_v) {
        return Err(NOT_DRIVEN.into());
    }
    let mut series: Vec<Series> =
        tracks.iter().flat_map(|track| Series::of(track, number, axis, span_v)).collect();
    creep::remember(&mut series);
    let creep = creep::creep(&series, span_v);
    match creep {
        None => notes.push(
            "no creep: no recording holds the drive for 2 s and more after a step; as it was"
                .into(),
        ),
        Some(c) if c.per_decade < SIGNIFICANT * c.sd => notes.push(format!(
            "no creep to be seen in {:.1} s of held drive ({:.2} +- {:.2} % a decade)",
            c.held_s,
            100.0 * c.per_decade,
            100.0 * c.sd
        )),
        Some(_) => {}
    }
    let per_decade = creep.map_or(believed_creep, significant);
    let inverse = inverse::fit(&series, per_decade, span_v)?;
    let lag = lag::fit(&series);
    if !series.iter().any(|s| s.has_monitor) {
        notes.push(format!(
            "no monitor_v_{} that follows the drive: the amplifier is taken as it was, its lag of {:.3} ms behind the drive",
            number + 1,
            axis.amplifier.time_constant_s * 1.0e3
        ));
    } else if lag.time_constant_s.is_none() {
        notes.push(
            "amplifier as it was: no fast excitation that reaches its lag (multisine, sweep or square)".into(),
        );
    }
    if lag.mode.is_none() {
        notes.push(if lag.highest_hz > 0.0 {
            format!(
                "mass and damping as they were: no resonance to be seen with excitation up to {:.0} Hz",
                lag.highest_hz
            )
        } else {
            "mass and damping as they were: no fast excitation (multisine, sweep or square)".into()
        });
    }
    Ok(Findings { inverse, lag, creep })
}

/// Creep that the controller is to compensate.
fn significant(creep: Creep) -> f64 {
    if creep.per_decade >= SIGNIFICANT * creep.sd { creep.per_decade } else { 0.0 }
}

/// Put what was found into the rig; returns what had to go.
fn write(rig: &mut Rig, number: usize, found: &Findings) -> Result<Vec<String>, Error> {
    let mut notes = Vec::new();
    for effect in REPLACED {
        if (effect != "creep" || found.creep.is_some()) && rig.remove(effect, Place::Axis(number)) {
            notes.push(format!("axis {}: {effect} removed: it is in what was fitted", number + 1));
        }
    }
    let inverse = &found.inverse;
    let model = &mut rig.axes[number];
    // Stiffness and transformer ratio act as one number; the springs are believed, the ratio is corrected.
    let stiffness = model.piezo.stiffness_n_per_m + model.mechanism.stiffness_n_per_m;
    let transformer = stiffness / (inverse.v_per_um * 1.0e6);
    model.piezo.transformer_n_per_v = transformer;
    // q = T x + C v with v = x / g.
    let c_per_um = (transformer + model.piezo.capacitance_f * 1.0e6 * inverse.v_per_um) * 1.0e-6;
    let hysteresis = &mut model.piezo.hysteresis;
    hysteresis.capacitance_f.clear();
    hysteresis.limit_v.clear();
    for (threshold_um, v_per_um) in &inverse.elements {
        hysteresis.limit_v.push(v_per_um * threshold_um);
        hysteresis.capacitance_f.push(c_per_um / v_per_um);
    }
    if let Some(mode) = found.lag.mode {
        // v = v_t + s q with q = T x + C v_t and v_t = (k x + m x'') / T: the slip elements see the force too, through C.
        let elastance = ((mode.v_per_um - inverse.v_per_um) / c_per_um).max(0.0);
        let newton = transformer * 1.0e6 / (1.0 + elastance * model.piezo.capacitance_f);
        let kg = newton * mode.inertia_v_s2_per_um;
        // Not so the damping: most of what the spectra show is loss in the stack (slip, rate), a voltage and not a force.
        let n_s_per_m = transformer * 1.0e6 * mode.damping_v_s_per_um;
        model.mechanism.mass_kg = (kg - model.piezo.mass_kg).max(0.0);
        model.mechanism.damping_n_s_per_m = (n_s_per_m - model.piezo.damping_n_s_per_m).max(0.0);
    }
    if let Some(time_constant) = found.lag.time_constant_s {
        model.amplifier.time_constant_s = time_constant.value;
    }
    let per_decade = found.creep.map_or(0.0, significant);
    if per_decade > 0.0 {
        rig.set("creep", Place::Axis(number), "per_decade", per_decade)
            .map_err(|e| Error::Rig(e.to_string()))?;
    }
    Ok(notes)
}

impl Findings {
    /// One line for people.
    pub fn line(&self) -> String {
        let inverse = &self.inverse;
        let nm = |v: f64| 1.0e3 * v / inverse.linear_v_per_um;
        let mut line = format!(
            "{:.4} V/um with {} slip elements: misfit {:.3} V = {:.1} nm over {:.1} s of slow motion (straight line {:.2} V = \
             {:.0} nm); last third of every recording, not fitted: {:.3} V = {:.1} nm (straight line {:.2} V = {:.0} nm)",
            inverse.v_per_um,
            inverse.elements.len(),
            inverse.misfit_v,
            nm(inverse.misfit_v),
            inverse.slow_s,
            inverse.linear_misfit_v,
            nm(inverse.linear_misfit_v),
            inverse.held_out_v,
            nm(inverse.held_out_v),
            inverse.held_out_linear_v,
            nm(inverse.held_out_linear_v),
        );
        // Writing to a string cannot fail.
        if let Some(tau) = self.lag.time_constant_s {
            let _ = write!(line, "; amplifier {:.3} ms", tau.value * 1.0e3);
        }
        if let Some(mode) = self.lag.mode {
            let _ = write!(line, "; resonance {:.0} Hz", mode.resonance_hz);
        }
        if let Some(creep) = self.creep {
            let _ = write!(
                line,
                "; creep {:.2} % a decade ({:.1} s held)",
                100.0 * creep.per_decade,
                creep.held_s
            );
        }
        line
    }
}
