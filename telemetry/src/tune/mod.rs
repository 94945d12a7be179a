//! Proposals for feedback and feedforward from a measured frequency response.
//!
//! Feedback: the loop gain is the measured plant times the controller's exact discrete response, so delay, amplifier and resonance
//! are in it as they are. Gains are searched for the smallest mean sensitivity up to
//! 100 Hz such that the modulus margin stays at or above a limit; a notch is set on a resonance.
//!
//! Feedforward: static gain, amplifier time constant and delay are fitted to the same response.

use std::f64::consts::TAU;

use flexstage::settings::{AxisSettings, FeedbackSettings, NotchSettings};
use flexstage::{Settings, TICK_HZ};
use num_complex::Complex64;
use serde::Serialize;

use crate::measure::margins::{Margins, margins};
use crate::measure::{Frf, FrfPoint};

pub mod study;

/// Smallest distance of the loop gain from -1 that a proposal may have: 0.6 bounds the sensitivity peak at 1.67, which
/// implies at least 35 degrees and 8 dB (K. J. Astrom, R. M. Murray, "Feedback Systems", section 10.3).
const MODULUS_MARGIN: f64 = 0.6;
/// Band in which the sensitivity is minimised, Hz.
const BAND_HZ: f64 = 100.0;

/// Position error (um) to drive (V) of the core's feedback at a frequency: P, I (sum), D (difference, first-order low-pass), notches.
///
/// Same arithmetic as `flexstage::feedback` and `flexstage::filter`, in the frequency domain.
pub fn controller_response(feedback: &FeedbackSettings, frequency_hz: f64) -> Complex64 {
    let rate = f64::from(TICK_HZ);
    let back = Complex64::from_polar(1.0, -TAU * frequency_hz / rate);
    let one = Complex64::new(1.0, 0.0);
    let pole = (-TAU * f64::from(feedback.derivative_filter_hz) / rate).exp();
    // V ms/um to V per um and tick.
    let derivative = f64::from(feedback.derivative_v_ms_per_um) * rate / 1e3;
    let integral = f64::from(feedback.integral_v_per_um_s) / rate;
    let mut out = one * f64::from(feedback.proportional_v_per_um)
        + one * derivative * (1.0 - pole) * (one - back) / (one - back * pole);
    if integral != 0.0 {
        out += one * integral / (one - back);
    }
    for notch in &feedback.notches {
        out *= notch_response(notch, back);
    }
    out
}

fn notch_response(notch: &NotchSettings, back: Complex64) -> Complex64 {
    let angle = TAU * f64::from(notch.frequency_hz) / f64::from(TICK_HZ);
    let alpha = f64::from(notch.damping_ratio) * angle.sin();
    let depth = f64::from(notch.depth);
    let middle = back * (-2.0 * angle.cos());
    let square = back * back;
    let zeros = middle + (1.0 + depth * alpha) + square * (1.0 - depth * alpha);
    let poles = middle + (1.0 + alpha) + square * (1.0 - alpha);
    zeros / poles
}

/// The controller's last act: codes computed in a tick are latched by the next one.
pub fn latch(frequency_hz: f64) -> Complex64 {
    Complex64::from_polar(1.0, -TAU * frequency_hz / f64::from(TICK_HZ))
}

/// Reference (um) to drive (V) of the same feedback: the derivative takes only its share of the setpoint, and the reference waits for the
/// sensor.
pub fn setpoint_response(feedback: &FeedbackSettings, frequency_hz: f64) -> Complex64 {
    let weighted = FeedbackSettings {
        derivative_v_ms_per_um: feedback.derivative_v_ms_per_um * feedback.setpoint_weight,
        ..feedback.clone()
    };
    let delay = TAU * frequency_hz * f64::from(feedback.sensor_delay_s);
    controller_response(&weighted, frequency_hz) * Complex64::from_polar(1.0, -delay)
}

/// What the feedforward's amplifier lead multiplies the drive by.
fn lead_response(axis: &AxisSettings, frequency_hz: f64) -> Complex64 {
    let rate = f64::from(TICK_HZ);
    if !axis.feedforward.amplifier_lead {
        return Complex64::new(1.0, 0.0);
    }
    let change = 1.0 - Complex64::from_polar(1.0, -TAU * frequency_hz / rate);
    1.0 + change * f64::from(axis.amplifier_time_constant_s) * rate
}

/// Reference to position with new settings, from what was measured with the old ones.
///
/// With position y, reference r, plant P (from the drive as it is held, with the latch before it), feedforward F and feedback C (C' as
/// the reference sees it), y = P (F r + C' r - C y). The measured closed loop T = (P F + P C') / (1 + P C) gives P F without a model of the hysteresis in it; new feedback and lead go in
/// by the same equation. Only where both were measured with coherence.
pub fn predict_closed_loop(
    plant: &Frf,
    closed: &Frf,
    old: &AxisSettings,
    new: &AxisSettings,
) -> Frf {
    let points = closed
        .points
        .iter()
        .filter_map(|t| {
            let near =
                |p: &&FrfPoint| (p.frequency_hz - t.frequency_hz).abs() < 1e-3 * t.frequency_hz;
            let p = plant.points.iter().find(near)?;
            let f = t.frequency_hz;
            let plant = p.response * latch(f);
            let forward = t.response * (1.0 + plant * controller_response(&old.feedback, f))
                - plant * setpoint_response(&old.feedback, f);
            let forward = forward * lead_response(new, f) / lead_response(old, f);
            let response = (forward + plant * setpoint_response(&new.feedback, f))
                / (1.0 + plant * controller_response(&new.feedback, f));
            Some(FrfPoint { response, coherence: t.coherence.min(p.coherence), ..*t })
        })
        .collect();
    Frf { points }
}

/// First-order lag with delay fitted to a response.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PlantFit {
    /// Static gain, um/V.
    pub gain_um_per_v: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
    /// Delay, s.
    pub delay_s: f64,
    /// Root mean square of the relative misfit.
    pub misfit: f64,
}

impl PlantFit {
    /// Response at a frequency.
    pub fn at(&self, frequency_hz: f64) -> Complex64 {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        self.gain_um_per_v * (-s * self.delay_s).exp() / (1.0 + s * self.time_constant_s)
    }
}

/// Fit of gain, lag and delay to the coherent lines up to 1 kHz.
pub fn fit_plant(plant: &Frf) -> Option<PlantFit> {
    let points: Vec<&FrfPoint> =
        plant.points.iter().filter(|p| p.coherence > 0.8 && p.frequency_hz < 1000.0).collect();
    if points.len() < 5 {
        return None;
    }
    let mut best: Option<PlantFit> = None;
    for i in 0..120 {
        // 20 us to 20 ms.
        let time_constant_s = 2e-5 * 10f64.powf(f64::from(i) / 40.0);
        let lag = |p: &FrfPoint| 1.0 + Complex64::new(0.0, TAU * p.frequency_hz * time_constant_s);
        // What is left must be a gain and a delay: phase proportional to frequency.
        let (mut top, mut bottom) = (0.0, 0.0);
        for p in &points {
            let phase = (p.response * lag(p)).arg();
            let w = TAU * p.frequency_hz;
            top -= phase * w;
            bottom += w * w;
        }
        let delay_s = (top / bottom).max(0.0);
        let unit = PlantFit { gain_um_per_v: 1.0, time_constant_s, delay_s, misfit: 0.0 };
        // Relative least squares for the gain: mean of the quotient.
        let gain = points.iter().map(|p| (p.response / unit.at(p.frequency_hz)).re).sum::<f64>()
            / points.len() as f64;
        let fit = PlantFit { gain_um_per_v: gain, ..unit };
        let square = points
            .iter()
            .map(|p| (p.response / fit.at(p.frequency_hz) - 1.0).norm_sqr())
            .sum::<f64>();
        let fit = PlantFit { misfit: (square / points.len() as f64).sqrt(), ..fit };
        if best.is_none_or(|b| fit.misfit < b.misfit) {
            best = Some(fit);
        }
    }
    best
}

/// What a loop is good for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopFigures {
    /// Margins.
    pub margins: Margins,
    /// Mean magnitude of the sensitivity up to 100 Hz: the part of a disturbance that is left.
    pub left_of_disturbance: f64,
    /// Loop gain at the highest frequency measured.
    pub gain_at_end: f64,
    /// Whether the loop is stable as far as it was measured, and in the simple way: the phase stays above -180 degrees while the gain is
    /// above a half, and the gain has fallen below a half before the data end.
    pub is_stable: bool,
}

/// A proposal for one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// The settings with the proposal in them.
    pub settings: Settings,
    /// What is there now.
    pub before: LoopFigures,
    /// What is predicted.
    pub predicted: LoopFigures,
    /// The fitted plant.
    pub plant: PlantFit,
    /// What changes, in words.
    pub changes: Vec<String>,
    /// What the measured response says of the plant, in words, with what that changes in the feedforward.
    pub plant_notes: Vec<String>,
}

/// Loop gain of a measured plant (held drive to position) with a feedback.
pub fn loop_gain(plant: &Frf, feedback: &FeedbackSettings) -> Frf {
    plant.map(|f| controller_response(feedback, f) * latch(f))
}

fn figures(plant: &Frf, feedback: &FeedbackSettings) -> LoopFigures {
    let loop_gain = loop_gain(plant, feedback);
    let low: Vec<f64> = loop_gain
        .points
        .iter()
        .filter(|p| p.frequency_hz <= BAND_HZ)
        .map(|p| 1.0 / (1.0 + p.response).norm())
        .collect();
    let left = low.iter().sum::<f64>() / low.len().max(1) as f64;
    let gain_at_end = loop_gain.points.last().map_or(f64::INFINITY, |p| p.response.norm());
    let phase = loop_gain.phase_deg();
    let leads = loop_gain
        .points
        .iter()
        .zip(phase)
        .all(|(p, phase)| p.response.norm() < 0.5 || phase > -180.0);
    LoopFigures {
        margins: margins(&loop_gain),
        left_of_disturbance: left,
        gain_at_end,
        is_stable: leads && gain_at_end < 0.5,
    }
}

/// Whether a closed loop with a stable plant is stable and keeps its distance from instability.
fn is_safe(figures: &LoopFigures) -> bool {
    figures.is_stable
        && figures.margins.modulus_margin.is_some_and(|m| m >= MODULUS_MARGIN)
        && figures.margins.phase_margin_deg.is_none_or(|m| m > 35.0)
        && figures.margins.gain_margin_db.is_none_or(|m| m > 6.0)
}

/// Propose settings for an axis (from 0) from its measured response.
pub fn propose(plant: &Frf, settings: &Settings, axis: usize) -> Option<Proposal> {
    let plant = plant.coherent(0.8);
    let fit = fit_plant(&plant)?;
    let before = settings.axes[axis].feedback.clone();
    // The gain for small motion, in which all slip elements stick, is the lowest that the stage has; on a long stroke they slip and
    // leave T / (k_p + k). The margins have to hold for both.
    let model_gain = {
        let a = &settings.axes[axis];
        f64::from(a.stack.transformer_n_per_v)
            / f64::from(a.stack.stiffness_n_per_m + a.mechanism.stiffness_n_per_m)
            * 1e6
    };
    let growth = (model_gain / fit.gain_um_per_v).clamp(1.0, 2.0);
    let strong = plant.map(|_| Complex64::new(growth, 0.0));
    let mut base = before.clone();
    base.notches.clear();
    if let Some((frequency_hz, _)) = plant.resonance() {
        // The list was just cleared, so there is room.
        let _ = base.notches.push(NotchSettings {
            frequency_hz: frequency_hz as f32,
            damping_ratio: 0.3,
            depth: 0.05,
        });
    }
    let mut best: Option<(LoopFigures, FeedbackSettings)> = None;
    for p in 0..16 {
        for i in 0..14 {
            for d in 0..8 {
                let mut trial = base.clone();
                // In units of the plant's own gain, so that any stage is covered.
                let unit = 1.0 / fit.gain_um_per_v.abs();
                trial.proportional_v_per_um = (unit * 0.05 * 1.35f64.powi(p)) as f32;
                trial.integral_v_per_um_s = (unit * 10.0 * 1.5f64.powi(i)) as f32;
                let lead = f64::from(d) * 1e-4 * unit * 0.05 * 1.35f64.powi(p);
                trial.derivative_v_ms_per_um = (lead * 1e3) as f32;
                trial.derivative_filter_hz = 1_000.0;
                let figures = figures(&plant, &trial);
                let is_better = best
                    .as_ref()
                    .is_none_or(|(b, _)| figures.left_of_disturbance < b.left_of_disturbance);
                if is_better && is_safe(&figures) && is_safe(&self::figures(&strong, &trial)) {
                    best = Some((figures, trial));
                }
            }
        }
    }
    let (predicted, feedback) = best?;
    let mut out = settings.clone();
    let target = &mut out.axes[axis];
    target.feedback = feedback;
    // Small-signal gain T / (k_p + k) of the linear stack: what is left of it is the load's stiffness.
    let transformer = f64::from(target.stack.transformer_n_per_v);
    let stack = f64::from(target.stack.stiffness_n_per_m);
    let mut notes = Vec::new();
    let stiffness = transformer / (fit.gain_um_per_v * 1e-6) - stack;
    if fit.misfit < 0.1 {
        target.amplifier_time_constant_s = fit.time_constant_s as f32;
        notes.push(format!(
            "measured small-signal gain {:.4} um/V (feedforward assumes {:.4}; hysteresis makes the small-signal gain lower), \
             load stiffness by it {:.2} N/um",
            fit.gain_um_per_v,
            transformer / (stack + f64::from(target.mechanism.stiffness_n_per_m)) * 1e6,
            stiffness / 1e6
        ));
    } else {
        notes.push(format!(
            "one lag and a delay describe the response only to {:.0} %: the feedforward is left alone",
            100.0 * fit.misfit
        ));
    }
    let (old, new) = (&settings.axes[axis], &out.axes[axis]);
    let line = |name: &str, old: f32, new: f32, unit: &str| {
        (old != new).then(|| format!("{name}: {old:.4} -> {new:.4} {unit}"))
    };
    let mut changes = Vec::new();
    let mut change = |name: &str, old: f32, new: f32, unit: &str| {
        changes.extend(line(name, old, new, unit));
    };
    change(
        "proportional",
        old.feedback.proportional_v_per_um,
        new.feedback.proportional_v_per_um,
        "V/um",
    );
    change(
        "integral",
        old.feedback.integral_v_per_um_s,
        new.feedback.integral_v_per_um_s,
        "V/(um s)",
    );
    change(
        "derivative",
        old.feedback.derivative_v_ms_per_um,
        new.feedback.derivative_v_ms_per_um,
        "V ms/um",
    );
    for notch in &new.feedback.notches {
        changes.push(format!("notch at {:.0} Hz", notch.frequency_hz));
    }
    let lag = line(
        "amplifier time constant",
        old.amplifier_time_constant_s * 1e3,
        new.amplifier_time_constant_s * 1e3,
        "ms",
    );
    Some(Proposal {
        settings: out,
        before: figures(&plant, &before),
        predicted,
        plant: fit,
        changes,
        plant_notes: lag.into_iter().chain(notes).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flexstage::units::{Um, Volt};
    use flexstage::{Command, Config, Controller, Sample, Table};

    fn lag(gain: f64, tau: f64, delay: f64) -> Frf {
        let fit =
            PlantFit { gain_um_per_v: gain, time_constant_s: tau, delay_s: delay, misfit: 0.0 };
        let points = (1..256)
            .step_by(2)
            .map(|k| {
                let frequency_hz = k as f64 * 9.765_625;
                FrfPoint { frequency_hz, response: fit.at(frequency_hz), coherence: 1.0 }
            })
            .collect();
        Frf { points }
    }

    #[test]
    fn the_fit_finds_a_lag_and_a_delay() {
        let fit = fit_plant(&lag(0.133, 4e-4, 1.5e-4)).unwrap();
        assert!((fit.gain_um_per_v - 0.133).abs() < 0.001, "{fit:?}");
        assert!((fit.time_constant_s - 4e-4).abs() < 2e-5, "{fit:?}");
        assert!((fit.delay_s - 1.5e-4).abs() < 1e-5, "{fit:?}");
    }

    #[test]
    fn a_gain_that_does_not_fall_in_the_band_is_not_safe() {
        // 1 kHz of data: whatever crosses 0 dB above it is unknown, and a delay makes it unstable.
        let mut plant = lag(0.133, 1e-5, 1.5e-4);
        plant.points.retain(|p| p.frequency_hz < 1000.0);
        let feedback =
            FeedbackSettings { proportional_v_per_um: 20.0, ..FeedbackSettings::default() };
        let found = figures(&plant, &feedback);
        assert!(found.margins.crossover_hz.is_none() && !is_safe(&found), "{found:?}");
        // Here the data show it: past -180 degrees at a gain above 1, whatever the margins read.
        let found = figures(&lag(0.133, 4e-4, 4e-4), &feedback);
        assert!(!found.is_stable && !is_safe(&found), "{found:?}");
    }

    #[test]
    fn a_proposal_keeps_its_margins_and_beats_a_weak_loop() {
        let plant = lag(0.133, 4e-4, 1.5e-4);
        let mut settings = Settings::default();
        settings.axes[1].feedback.proportional_v_per_um = 0.5;
        settings.axes[1].feedback.integral_v_per_um_s = 0.0;
        let proposal = propose(&plant, &settings, 1).unwrap();
        assert!(is_safe(&proposal.predicted));
        assert!(proposal.predicted.left_of_disturbance < 0.5 * proposal.before.left_of_disturbance);
        assert!(Config::build(&proposal.settings).is_ok());
        assert_eq!(proposal.settings.axes[0], settings.axes[0], "other axes are left alone");
    }

    #[test]
    fn the_response_is_the_cores() {
        // Sine on the gauge, reference held: the drive is the core's feedback at work.
        let mut settings = Settings::default();
        for axis in &mut settings.axes {
            axis.feedforward.gain = 0.0;
            axis.feedforward.hysteresis = false;
            axis.feedback.proportional_v_per_um = 3.0;
            axis.feedback.integral_v_per_um_s = 400.0;
            axis.feedback.derivative_v_ms_per_um = 1.0;
            axis.feedback.sensor_delay_s = 0.0;
            axis.feedback.notches.clear();
            let _ = axis.feedback.notches.push(NotchSettings::default());
            axis.limits.slew_v_per_ms = 4000.0;
            axis.limits.min_v = -50.0;
        }
        settings.guard.max_step_um = 0.0;
        settings.guard.stuck_drive_v = 0.0;
        settings.guard.arming_s = 0.1;
        let config = Config::build(&settings).unwrap();
        let hz = 312.5; // 32 ticks a period
        let mut controller = Controller::new();
        let mut sum = Complex64::new(0.0, 0.0);
        let (start, ticks) = (20_000u32, 3200u32);
        for n in 0..start + ticks {
            let angle = TAU * hz * f64::from(n) / 1e4;
            let um = if n < 10 { 0.0 } else { angle.sin() };
            let code = config.gauge_code(0, 5.0 + um);
            let sample = Sample {
                gauge: [code; 3],
                monitor: [config.monitor_code(0, 0.0); 3],
                overrun: false,
            };
            if n == 5 {
                controller.command(&config, Command::Arm).unwrap();
            }
            let record = controller.tick(&config, &Table::EMPTY, &sample);
            if n >= start {
                let _: (Um, Volt) = (record.axes[0].position, record.axes[0].drive);
                sum += record.axes[0].drive.to_f64() * Complex64::from_polar(1.0, -angle);
            }
        }
        // drive = C (0 - y), y = Im e^(i angle): the sum is ticks / 2 * -C / i.
        let found = -sum * 2.0 / f64::from(ticks) * Complex64::i();
        let expected = controller_response(&settings.axes[0].feedback, hz);
        assert!((found - expected).norm() < 0.02 * expected.norm(), "{found} {expected}");
    }
}
