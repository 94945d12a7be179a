//! Where to look first: settings to screen each effect at, taken from what the session contains.
//!
//! A clip level is only worth trying inside the range that was driven, a kink inside the travel, a current limit below the
//! current that the drive asks for, a hum at the lines of the residual's spectrum. Everything else starts from the catalogue's
//! typical size; effects that are linear in their size need no more than that.

use host_sim::effects::{Parameter, Role};
use host_sim::rig::Rig;
use rayon::prelude::*;

use crate::Error;
use crate::fitting::knobs::{EffectRef, FARTHEST_ZERO};
use crate::session::coherent::coherent;
use crate::session::floor::Kind;
use crate::session::scene::{Scene, Stack};
use crate::session::spectra::{SLOWEST_HUM_HZ, has_harmonic, lines, push_apart, resonances};

/// Periods of a gauge's ripple at which a fit begins, as shares of the travel.
const RIPPLES: [f64; 4] = [0.3, 0.5, 0.8, 1.3];
/// Current from which slip limits grow, as a share of the largest one, where those of the slowest loops have grown as well.
const FAR_BELOW: f64 = 1.0e-5;

/// What the session offers to look at.
#[derive(Debug, Clone)]
pub struct Ranges {
    /// Lowest and highest drive where recordings are scored, V.
    pub drive_v: (f64, f64),
    /// ... and where they settle as well: a clip that is met only there leaves another memory.
    pub driven_v: (f64, f64),
    /// Lowest and highest simulated travel, m.
    pub travel_m: (f64, f64),
    /// Largest current that the nominal amplifier would have to source into the stack, A.
    pub current_a: f64,
    /// Lines of the nominal position residual, Hz, strongest first.
    pub lines_hz: Vec<f64>,
    /// Lines of the monitor residual.
    pub monitor_lines_hz: Vec<f64>,
    /// Whether some line is twice another one, and three times.
    pub harmonics: [bool; 2],
    /// Frequencies of each axis where the rig answers most beyond its model, Hz, likeliest first.
    pub resonances_hz: Vec<Vec<f64>>,
    /// Stiffness of stack and mechanism together, N/m (first axis).
    pub stiffness_n_per_m: f64,
    /// Moving mass of the nominal rig, kg (first axis).
    pub mass_kg: f64,
    /// Largest sample rate, Hz.
    pub rate_hz: f64,
    /// Length of the longest recording, s.
    pub longest_s: f64,
    /// From the start of the first recording to the end of the last, s.
    pub session_s: f64,
    /// End of the last recording on the session's clock, s: walks begin where that does.
    pub ends_s: f64,
    /// Whether loops of any kind may be fitted, or plain ones only.
    pub any_loop: bool,
    /// Whether a gauge may drift as chance has it, by what it does to positions rather than by cost.
    pub chance_drift: bool,
}

impl Ranges {
    /// The `most` likeliest resonances of each axis, Hz; axes that share one give it once.
    fn peaks_hz(&self, most: usize) -> Vec<f64> {
        let mut peaks: Vec<f64> = Vec::new();
        for &hz in self.resonances_hz.iter().flat_map(|axis| axis.iter().take(most)) {
            push_apart(&mut peaks, hz);
        }
        peaks
    }
}

/// Look at the session once.
pub fn ranges(scene: &Scene, rig: &Rig, raw: &Stack) -> Result<Ranges, Error> {
    let mut drive = (f64::INFINITY, f64::NEG_INFINITY);
    let mut driven = drive;
    let mut travel = (f64::INFINITY, f64::NEG_INFINITY);
    let mut current: f64 = 0.0;
    let mut rate_hz: f64 = 0.0;
    let mut longest: f64 = 0.0;
    for track in scene.tracks.iter() {
        rate_hz = rate_hz.max(track.rate_hz);
        longest = longest.max(track.len() as f64 / track.rate_hz);
        for (axis, column) in track.drive_v.iter().enumerate() {
            let Some(position) = &track.position_um[axis] else { continue };
            for &v in &column[track.settle..] {
                drive = (drive.0.min(v), drive.1.max(v));
            }
            for &v in column {
                driven = (driven.0.min(v), driven.1.max(v));
            }
            for (&p, _) in position[track.settle..]
                .iter()
                .zip(&track.present[track.settle..])
                .filter(|(_, p)| **p)
            {
                travel = (travel.0.min(f64::from(p) * 1.0e-6), travel.1.max(f64::from(p) * 1.0e-6));
            }
            let stage = &rig.axes[axis];
            let piezo = &stage.piezo;
            let stiffness = piezo.stiffness_n_per_m + stage.mechanism.stiffness_n_per_m;
            let farads = piezo.capacitance_f + piezo.transformer_n_per_v.powi(2) / stiffness;
            // A first-order amplifier answers a step of V with V / tau, and never faster than its command.
            let tau = stage.amplifier.time_constant_s.max(1.0 / track.rate_hz);
            let mut out = column.first().copied().unwrap_or(0.0);
            let share = 1.0 - (-1.0 / (track.rate_hz * tau)).exp();
            for &v in column {
                let slew = (v - out) / tau;
                current = current.max((slew * farads).abs());
                out += (v - out) * share;
            }
        }
    }
    let (starts_s, ends_s) = scene.clock_s();
    let [positions, monitors] = [Kind::Position, Kind::Monitor].map(|kind| lines(scene, raw, kind));
    let strongest = |lines: &[f64], kind| -> Vec<f64> {
        lines.par_iter().take(3).map(|&hz| coherent(scene, raw, kind, hz)).collect()
    };
    Ok(Ranges {
        drive_v: drive,
        driven_v: driven,
        travel_m: travel,
        current_a: current,
        lines_hz: strongest(&positions, Kind::Position),
        monitor_lines_hz: strongest(&monitors, Kind::Monitor),
        harmonics: [2.0, 3.0]
            .map(|order| has_harmonic(&positions, order) || has_harmonic(&monitors, order)),
        resonances_hz: resonances(scene, raw, rig.sample_rate_hz),
        stiffness_n_per_m: rig.axes[0].piezo.stiffness_n_per_m
            + rig.axes[0].mechanism.stiffness_n_per_m,
        mass_kg: rig.axes[0].piezo.mass_kg + rig.axes[0].mechanism.mass_kg,
        rate_hz,
        longest_s: longest,
        session_s: ends_s - starts_s,
        ends_s,
        any_loop: false,
        chance_drift: false,
    })
}

/// Share of the whole drive beyond what is scored from which a clip is tried there.
const ONLY_SETTLING: f64 = 0.02;

/// Settings of an effect to screen, each a full set of parameter values.
pub fn settings(effect: EffectRef, ranges: &Ranges) -> Vec<Vec<f64>> {
    let info = effect.info();
    let parameters = info.parameters;
    let rest: Vec<f64> =
        parameters.iter().map(|p| if p.role == Role::Size { p.zero } else { p.typical }).collect();
    let index = |name: &str| parameters.iter().position(|p| p.name == name);
    // A setting from the resting one with some parameters named.
    let with = |named: &[(&str, f64)]| -> Option<Vec<f64>> {
        let mut values = rest.clone();
        for (name, value) in named {
            let k = index(name)?;
            values[k] = value.clamp(parameters[k].min, parameters[k].max);
        }
        Some(values)
    };
    let typical = |name: &str| index(name).map_or(0.0, |k| parameters[k].typical);
    let (low, high) = ranges.drive_v;
    let (near, far) = ranges.travel_m;
    let span = (far - near).max(1.0e-9);
    let mut wanted: Vec<Option<Vec<f64>>> = Vec::new();
    match info.name {
        "amplifier-clipping" => {
            for share in [0.99, 0.97, 0.9, 0.8, 0.65, 0.5] {
                wanted.push(with(&[("max_v", low + share * (high - low))]));
            }
            for share in [0.006, 0.02, 0.06, 0.15, 0.3] {
                wanted.push(with(&[("min_v", low + share * (high - low))]));
            }
            let (lowest, highest) = ranges.driven_v;
            let beyond = |more: f64| more > ONLY_SETTLING * (highest - lowest);
            for share in [0.01, 0.03, 0.1, 0.2] {
                let inwards = share * (highest - lowest);
                if beyond(highest - high) {
                    wanted.push(with(&[("max_v", highest - inwards)]));
                }
                if beyond(low - lowest) {
                    wanted.push(with(&[("min_v", lowest + inwards)]));
                }
            }
        }
        "amplifier-current-limit" => {
            // A knee acts with more than its square: a fit that starts from a corner never finds it.
            for knee in [0.0, 0.3] {
                for share in [0.8, 0.5, 0.25, 0.1] {
                    wanted.push(with(&[("current_a", share * ranges.current_a), ("knee", knee)]));
                }
            }
            // One fast edge in a slow session asks for many times what all else does.
            for share in [0.04, 0.015] {
                wanted.push(with(&[("current_a", share * ranges.current_a)]));
            }
        }
        "preload-loss" => {
            for share in [0.02, 0.08, 0.2, 0.35, 0.55, 0.8] {
                for since_zero in [0.0, 1.0] {
                    wanted.push(with(&[
                        ("lost_share", typical("lost_share")),
                        ("contact_m", near + share * span),
                        ("since_zero", since_zero),
                    ]));
                }
            }
        }
        "stiffness-hardening" => {
            for name in ["cubic_n_per_m3", "quadratic_n_per_m2"] {
                wanted.push(with(&[(name, typical(name))]));
            }
            for share in [0.3, 0.6, 0.85] {
                wanted.push(with(&[
                    ("extra_n_per_m", typical("extra_n_per_m")),
                    ("kink_m", near + share * span),
                ]));
            }
        }
        "inertia" => {
            // A mass is where its resonance is: try resonances over the band, at what was seen, and at what that may be the alias of.
            let band = (0..12).map(|k| 150.0 * 2.0_f64.powf(0.45 * f64::from(k)));
            let mut hz: Vec<f64> = band.filter(|f| *f < 0.6 * ranges.rate_hz).collect();
            for peak in ranges.peaks_hz(usize::MAX) {
                hz.extend([0.9, 0.95, 1.0, 1.05].map(|r| r * peak));
            }
            let lightly = hz.into_iter().map(|f| (f, 0.01));
            // A mass that hardly rings shows no line, and a fit does not get to it from one that does: its damping runs down to none.
            let heavily = [220.0, 400.0, 750.0, 1400.0, 2600.0].into_iter();
            let heavily = heavily.filter(|f| *f < 0.5 * ranges.rate_hz).map(|f| (f, 0.2));
            for (f, damping_ratio) in lightly.chain(heavily) {
                let omega = std::f64::consts::TAU * f;
                let kg = ranges.stiffness_n_per_m / (omega * omega) - ranges.mass_kg;
                if kg > 0.0 {
                    let damping = 2.0 * damping_ratio * (ranges.stiffness_n_per_m * kg).sqrt();
                    wanted.push(with(&[("added_kg", kg), ("added_damping_n_s_per_m", damping)]));
                }
            }
            wanted.push(with(&[("added_damping_n_s_per_m", typical("added_damping_n_s_per_m"))]));
        }
        "second-mass" => {
            let mass = typical("mass_kg");
            let mut hz = vec![80.0, 250.0, 600.0, 1200.0, 2400.0];
            for peak in ranges.peaks_hz(1) {
                hz.extend([0.93 * peak, peak, 1.08 * peak]);
            }
            for f in hz.into_iter().filter(|f| *f < 0.5 * ranges.rate_hz) {
                wanted.push(with(&[("mass_kg", mass), ("frequency_hz", f)]));
                wanted.push(with(&[
                    ("mass_kg", mass),
                    ("frequency_hz", f),
                    ("damping_ratio", 0.1),
                ]));
            }
        }
        "sensor-hum" | "amplifier-hum" | "floor-hum" => {
            let (cos, sin, lines) = match info.name {
                "sensor-hum" => ("cos_m", "sin_m", &ranges.lines_hz),
                "amplifier-hum" => ("cos_v", "sin_v", &ranges.monitor_lines_hz),
                _ => ("cos_n", "sin_n", &ranges.lines_hz),
            };
            let lines = if lines.is_empty() { &ranges.lines_hz } else { lines };
            for &hz in lines.iter().filter(|hz| **hz >= SLOWEST_HUM_HZ) {
                wanted.push(with(&[(cos, typical(cos)), ("frequency_hz", hz)]));
                wanted.push(with(&[(sin, typical(sin)), ("frequency_hz", hz)]));
            }
        }
        "sensor-drift" => {
            wanted.push(with(&[("rate_m_per_s", typical("rate_m_per_s"))]));
            for seconds in [0.1, 0.4, 1.5] {
                let settling_s = (seconds * ranges.session_s).max(1.0);
                wanted.push(with(&[
                    ("settling_m", typical("settling_m")),
                    ("settling_s", settling_s),
                ]));
            }
            for sessions in [0.45, 0.7, 1.0, 1.5, 2.5, 5.0] {
                for swing in ["swing_sin_m", "swing_cos_m"] {
                    let cycle = ("cycle_s", sessions * ranges.session_s);
                    wanted.push(with(&[(swing, typical(swing)), cycle]));
                }
            }
        }
        "stage-drag" => {
            for speed in [3.0e-4, 1.0e-3, 3.0e-3, 1.0e-2] {
                wanted.push(with(&[("brake_n", typical("brake_n")), ("speed_m_per_s", speed)]));
            }
            wanted.push(with(&[("fluid_n", typical("fluid_n"))]));
        }
        "gauge-high-pass" => {
            for seconds in [0.3, 3.0, 30.0] {
                wanted.push(with(&[("fading", typical("fading")), ("time_constant_s", seconds)]));
            }
        }
        "creep" => {
            // A fit goes from one beginning of the growth to the other, but slowly.
            for (onset, sharp) in [(0.01, 1.0), (0.1, 1.0), (1.0, 1.0), (0.03, 0.0), (0.3, 0.0)] {
                wanted.push(with(&[
                    ("per_decade", typical("per_decade")),
                    ("onset_s", onset),
                    ("sharp", sharp),
                ]));
            }
        }
        "viscoelasticity" => {
            // A spread acts with its square: a fit that starts without one never finds it.
            let spread = ("spread_decades", 0.2);
            for seconds in [0.003, 0.03, 0.3, 3.0] {
                wanted.push(with(&[
                    ("branch_n_per_m", typical("branch_n_per_m")),
                    ("time_constant_s", seconds),
                    spread,
                ]));
            }
            wanted.push(with(&[
                ("branch_n_per_m", typical("branch_n_per_m")),
                ("time_constant_s", 0.3),
                ("relaxed_share", 1.0),
                spread,
            ]));
            wanted.push(with(&[("damping_n_s_per_m", typical("damping_n_s_per_m"))]));
        }
        "hysteresis-rate" => {
            let resistance = ("resistance_ohm", typical("resistance_ohm"));
            let growth = ("per_decade", typical("per_decade"));
            wanted.push(with(&[growth]));
            // Where it began far below what creeps, the slowest loops have grown as well.
            let far_below = ("reference_a", FAR_BELOW * ranges.current_a);
            wanted.push(with(&[growth, far_below, ("stiffening", 0.0)]));
            wanted.push(with(&[resistance]));
            wanted.push(with(&[resistance, ("loss_exponent", 0.4)]));
            let strain_loss = ("strain_loss_v", typical("strain_loss_v"));
            for share in [3.0e-4, 3.0e-3, 3.0e-2] {
                let current_a = ("strain_loss_a", share * ranges.current_a);
                for onset in [1.0, 2.0] {
                    wanted.push(with(&[strain_loss, current_a, ("strain_onset", onset)]));
                }
            }
        }
        "sensor-nonlinearity" => {
            // The line may end far beyond what was driven.
            for zero_m in [0.0, far, FARTHEST_ZERO * far] {
                for name in ["quadratic_per_m", "cubic_per_m2"] {
                    wanted.push(with(&[(name, typical(name)), ("zero_m", zero_m)]));
                }
            }
            // A fit finds the phase, but not the period.
            for share in RIPPLES {
                let sine = ("ripple_sine_m", typical("ripple_sine_m"));
                wanted.push(with(&[sine, ("ripple_period_m", share * span)]));
            }
        }
        "gauge-warming" => {
            for share in [0.1, 0.5, 2.0] {
                let time_s = ("time_constant_s", share * ranges.session_s);
                wanted.push(with(&[("growth", typical("growth")), time_s]));
            }
        }
        "drive-bend" => {
            for name in ["bow_v", "ess_v"] {
                wanted.push(with(&[(name, typical(name))]));
            }
            for kink_v in [20.0, 40.0, 60.0, 80.0] {
                wanted.push(with(&[("kink", typical("kink")), ("kink_v", kink_v)]));
            }
        }
        "piezo-gain" => {
            for polarisation in [0.0, 1.0] {
                wanted.push(with(&[("ratio", typical("ratio")), ("polarisation", polarisation)]));
            }
        }
        "drive-delay" => {
            // Of a delay of many ticks the first tick's derivative says little.
            for ticks in [1.0, 4.0, 16.0] {
                wanted.push(with(&[("delay_s", ticks * typical("delay_s"))]));
            }
        }
        "sensor-bandwidth" => {
            // What a fast conditioner does to edges says little of one that is slower than the amplifier.
            for times in [1.0, 5.0, 25.0] {
                let seconds = times * typical("time_constant_s");
                wanted.push(with(&[("time_constant_s", seconds)]));
            }
        }
        "amplifier-bandwidth" => {
            for ratio in [typical("ratio"), 4.0] {
                wanted.push(with(&[("ratio", ratio)]));
            }
            wanted.push(with(&[("further_pole", typical("further_pole"))]));
            // Two poles that ring out of step with what was recorded are worse than none: from there no fit gets to them.
            for (ratio, further_pole) in
                [(0.6, 2.0), (1.0, 2.0), (1.5, 2.0), (0.6, 5.0), (1.2, 5.0)]
            {
                wanted.push(with(&[("ratio", ratio), ("further_pole", further_pole)]));
            }
        }
        "friction" => {
            for metres in [0.003, 0.03, 0.2] {
                wanted.push(with(&[
                    ("coulomb_n", typical("coulomb_n")),
                    ("presliding_m", metres * span),
                ]));
            }
            for speed in [1.0e-4, 1.0e-3, 4.0e-3] {
                wanted.push(with(&[
                    ("coulomb_n", typical("coulomb_n")),
                    ("presliding_m", 0.003 * span),
                    ("creeping_m_per_s", speed),
                ]));
            }
        }
        _ => {
            let rests =
                |p: &&Parameter| !ranges.any_loop && crate::search::loops::rests(info.name, p.name);
            for p in parameters.iter().filter(|p| p.role == Role::Size && !rests(p)) {
                wanted.push(with(&[(p.name, p.typical)]));
            }
        }
    }
    wanted.into_iter().flatten().collect()
}

/// Scale and fixed step of knobs whose catalogue bounds say nothing about how finely they act, in the unit of the parameter.
pub fn fine_step(effect: &str, parameter: &str, ranges: &Ranges) -> Option<f64> {
    let (low, high) = ranges.drive_v;
    let span = (ranges.travel_m.1 - ranges.travel_m.0).max(1.0e-9);
    match (effect, parameter) {
        ("amplifier-clipping", "max_v" | "min_v") => Some(5.0e-3 * (high - low)),
        ("preload-loss", "contact_m")
        | ("stiffness-hardening", "kink_m")
        | ("sensor-nonlinearity", "zero_m") => Some(1.0e-2 * span),
        // A light damping makes a dip of one per cent in the mass: a thousandth of one whose resonance is a quarter of the rate.
        ("inertia", "added_kg") => {
            let fast = 0.25 * std::f64::consts::TAU * ranges.rate_hz;
            Some(2.0e-3 * ranges.stiffness_n_per_m / (fast * fast))
        }
        ("viscoelasticity", "power") => Some(0.1),
        // An eighth of a turn from the first recording to the last: a hum runs on between them.
        ("sensor-hum" | "amplifier-hum" | "floor-hum", "frequency_hz") => {
            Some(0.02 / ranges.session_s.max(1.0))
        }
        _ => None,
    }
}
