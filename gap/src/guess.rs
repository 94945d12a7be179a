//! Where to look first: settings to screen each effect at, taken from what the session contains.
//!
//! A clip level is only worth trying inside the range that was driven, a kink inside the travel, a current limit below the
//! current that the drive asks for, a hum at the lines of the residual's spectrum. Everything else starts from the catalogue's
//! typical size; effects that are linear in their size need no more than that.

use host_sim::effects::Role;
use host_sim::rig::Rig;
use realfft::RealFftPlanner;

use crate::Error;
use crate::floor::Kind;
use crate::knobs::EffectRef;
use crate::scene::{Scene, Stack};

/// What the session offers to look at.
#[derive(Debug, Clone)]
pub struct Ranges {
    /// Lowest and highest drive, V.
    pub drive_v: (f64, f64),
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
    /// Frequency where the rig answers most beyond its model, Hz.
    pub resonance_hz: Option<f64>,
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
}

/// Look at the session once.
pub fn ranges(scene: &Scene, rig: &Rig, raw: &Stack) -> Result<Ranges, Error> {
    let mut drive = (f64::INFINITY, f64::NEG_INFINITY);
    let mut travel = (f64::INFINITY, f64::NEG_INFINITY);
    let mut current: f64 = 0.0;
    let mut rate_hz: f64 = 0.0;
    let mut longest: f64 = 0.0;
    let mut clock = (f64::INFINITY, f64::NEG_INFINITY);
    for track in scene.tracks.iter() {
        rate_hz = rate_hz.max(track.rate_hz);
        let length_s = track.len() as f64 / track.rate_hz;
        longest = longest.max(length_s);
        clock = (clock.0.min(track.start_s), clock.1.max(track.start_s + length_s));
        for (axis, column) in track.drive_v.iter().enumerate() {
            let Some(position) = &track.position_um[axis] else { continue };
            for &v in &column[track.settle..] {
                drive = (drive.0.min(v), drive.1.max(v));
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
    let [positions, monitors] = [Kind::Position, Kind::Monitor].map(|kind| lines(scene, raw, kind));
    let strongest = |lines: &[f64], kind| -> Vec<f64> {
        lines.iter().take(3).map(|&hz| coherent(scene, raw, kind, hz)).collect()
    };
    Ok(Ranges {
        drive_v: drive,
        travel_m: travel,
        current_a: current,
        lines_hz: strongest(&positions, Kind::Position),
        monitor_lines_hz: strongest(&monitors, Kind::Monitor),
        harmonics: [2.0, 3.0]
            .map(|order| has_harmonic(&positions, order) || has_harmonic(&monitors, order)),
        resonance_hz: resonance(scene, raw),
        stiffness_n_per_m: rig.axes[0].piezo.stiffness_n_per_m
            + rig.axes[0].mechanism.stiffness_n_per_m,
        mass_kg: rig.axes[0].piezo.mass_kg + rig.axes[0].mechanism.mass_kg,
        rate_hz,
        longest_s: longest,
        session_s: clock.1 - clock.0,
    })
}

/// Power spectrum of a row with a Hann window: frequency step in Hz and density of each bin.
pub fn spectrum(row: &[f32], rate_hz: f64) -> (f64, Vec<f64>) {
    let n = row.len();
    let mut planner = RealFftPlanner::<f64>::new();
    let fft = planner.plan_fft_forward(n);
    let mean = row.iter().map(|&x| f64::from(x)).sum::<f64>() / n as f64;
    let mut input: Vec<f64> = row
        .iter()
        .enumerate()
        .map(|(i, &x)| {
            let window = 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / n as f64).cos();
            (f64::from(x) - mean) * window
        })
        .collect();
    let mut output = fft.make_output_vec();
    if fft.process(&mut input, &mut output).is_err() {
        return (1.0, Vec::new());
    }
    // One-sided density; the Hann window keeps 3/8 of the power.
    let scale = 2.0 / (rate_hz * n as f64 * 0.375);
    (rate_hz / n as f64, output.iter().map(|c| c.norm_sqr() * scale).collect())
}

/// Slowest hum, Hz: mains and supplies are faster, and what stands out below is a harmonic of a slow drive, a nonlinearity.
const SLOWEST_HUM_HZ: f64 = 20.0;

/// Lines that are looked at for harmonics.
const MOST_LINES: usize = 8;

/// Whether one of the lines is this multiple of another one.
fn has_harmonic(lines: &[f64], order: f64) -> bool {
    lines.iter().any(|hz| lines.iter().any(|of| (hz - order * of).abs() < 0.6 * order))
}

/// Lines that stand out of their neighbourhood, the strongest first, summed over recordings on a grid of half a hertz.
fn lines(scene: &Scene, raw: &Stack, kind: Kind) -> Vec<f64> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    for (c, channel) in scene.channels.iter().enumerate() {
        let Some(row) = raw[c].as_ref().filter(|r| channel.kind == kind && r.len() >= 512) else {
            continue;
        };
        let rate = scene.tracks[channel.track].rate_hz;
        let (step, power) = spectrum(row, rate);
        let first = ((SLOWEST_HUM_HZ / step) as usize).max(4);
        for k in first..power.len().saturating_sub(40) {
            if power[k] < power[k - 1] || power[k] < power[k + 1] {
                continue;
            }
            let low = k.saturating_sub(30);
            let mut around: Vec<f64> = power[low..k + 31].to_vec();
            let middle = around.len() / 2;
            let (_, &mut median, _) = around.select_nth_unstable_by(middle, f64::total_cmp);
            // Of 10^5 bins of pure noise none stands out by a factor of forty over the median.
            if power[k] > 40.0 * median.max(1.0e-30) {
                // Parabola through the logarithms of three bins.
                let (a, b, c) =
                    (power[k - 1].max(1e-300).ln(), power[k].ln(), power[k + 1].max(1e-300).ln());
                let shift = if (a - 2.0 * b + c).abs() > 1.0e-9 {
                    0.5 * (a - c) / (a - 2.0 * b + c)
                } else {
                    0.0
                };
                let hz = (k as f64 + shift.clamp(-0.5, 0.5)) * step;
                // Every recording votes once a line: a line of the drive shows in one kind of recording only.
                match found.iter_mut().find(|(f, _)| (*f - hz).abs() < 0.6) {
                    Some(known) => known.1 += (power[k] / median).ln(),
                    None => found.push((hz, (power[k] / median).ln())),
                }
            }
        }
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.into_iter().take(MOST_LINES).map(|(hz, _)| hz).collect()
}

/// Frequency near `hz` whose phase runs on over the whole session: single recordings are too short to tell it.
fn coherent(scene: &Scene, raw: &Stack, kind: Kind, hz: f64) -> f64 {
    const BLOCK_S: f64 = 0.1;
    const REACH_HZ: f64 = 0.6;
    let tau = std::f64::consts::TAU;
    let axes = scene.position_noise.len();
    let mut blocks: Vec<Vec<(f64, f64, f64)>> = vec![Vec::new(); axes];
    let mut span = (f64::INFINITY, f64::NEG_INFINITY);
    for (c, channel) in scene.channels.iter().enumerate() {
        let Some(row) = raw[c].as_ref().filter(|_| channel.kind == kind) else { continue };
        let track = &scene.tracks[channel.track];
        let length = ((BLOCK_S * track.rate_hz) as usize).max(1);
        for (b, part) in row.chunks(length).enumerate() {
            let first = channel.range.start + b * length;
            let mean = part.iter().map(|&x| f64::from(x)).sum::<f64>() / part.len() as f64;
            let (mut re, mut im) = (0.0, 0.0);
            for (k, &x) in part.iter().enumerate() {
                let t = track.start_s + (first + k) as f64 / track.rate_hz;
                let (sin, cos) = (tau * hz * t).sin_cos();
                re += (f64::from(x) - mean) * cos;
                im -= (f64::from(x) - mean) * sin;
            }
            let t = track.start_s + (first as f64 + 0.5 * part.len() as f64) / track.rate_hz;
            span = (span.0.min(t), span.1.max(t));
            blocks[channel.axis].push((t, re, im));
        }
    }
    let step = 1.0 / (8.0 * (span.1 - span.0).max(1.0));
    let reach = (REACH_HZ / step) as i64;
    (-reach..=reach)
        .map(|k| {
            let shift = k as f64 * step;
            let power: f64 = blocks
                .iter()
                .map(|blocks| {
                    let (mut re, mut im) = (0.0, 0.0);
                    for &(t, x, y) in blocks {
                        let (sin, cos) = (tau * shift * t).sin_cos();
                        re += x * cos + y * sin;
                        im += y * cos - x * sin;
                    }
                    re * re + im * im
                })
                .sum();
            (hz + shift, power)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(hz, |(hz, _)| hz)
}

/// Where the rig answers most beyond its model: peak of the ratio of measured to simulated power, in twenty-fourths of an octave above
/// 60 Hz, where the simulation moves by more than the noise.
fn resonance(scene: &Scene, raw: &Stack) -> Option<f64> {
    let mut bins: std::collections::BTreeMap<i64, (f64, f64)> = std::collections::BTreeMap::new();
    for (c, channel) in scene.channels.iter().enumerate() {
        let Some(row) =
            raw[c].as_ref().filter(|r| channel.kind == Kind::Position && r.len() >= 512)
        else {
            continue;
        };
        let track = &scene.tracks[channel.track];
        let Some(position) = &track.position_um[channel.axis] else { continue };
        let measured: Vec<f32> =
            channel.range.clone().map(|i| position[i] / channel.sigma as f32).collect();
        let simulated: Vec<f32> = measured.iter().zip(row).map(|(m, r)| m - r).collect();
        let (step, power) = spectrum(&measured, track.rate_hz);
        let (_, model) = spectrum(&simulated, track.rate_hz);
        let noise = 2.0 / track.rate_hz;
        for (k, (&p, &m)) in power.iter().zip(&model).enumerate().skip(1) {
            let hz = k as f64 * step;
            if hz > 60.0 && m > 3.0 * noise {
                let cell = bins.entry((hz.log2() * 24.0).round() as i64).or_insert((0.0, 0.0));
                cell.0 += (p / m).min(1.0e4).ln();
                cell.1 += 1.0;
            }
        }
    }
    bins.into_iter()
        .filter(|(_, (_, n))| *n >= 3.0)
        .map(|(bin, (log_ratio, n))| (2.0_f64.powf(bin as f64 / 24.0), log_ratio / n))
        .filter(|(_, log_ratio)| *log_ratio > 0.3)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(hz, _)| hz)
}

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
            for share in [0.97, 0.9, 0.8, 0.65] {
                wanted.push(with(&[("max_v", low + share * (high - low))]));
            }
            for share in [0.03, 0.1, 0.25] {
                wanted.push(with(&[("min_v", low + share * (high - low))]));
            }
        }
        "amplifier-current-limit" => {
            for share in [0.8, 0.5, 0.25, 0.1] {
                wanted.push(with(&[("current_a", share * ranges.current_a)]));
            }
        }
        "preload-loss" => {
            for share in [0.08, 0.2, 0.35, 0.55, 0.8] {
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
            // A mass is where its resonance is: try resonances over the band and at the peak that was seen.
            let mut hz: Vec<f64> =
                (0..12).map(|k| 150.0 * 2.0_f64.powf(0.45 * f64::from(k))).collect();
            if let Some(peak) = ranges.resonance_hz {
                hz.extend([0.9, 0.95, 1.0, 1.05].map(|r| r * peak));
            }
            for f in hz.into_iter().filter(|f| *f < 0.6 * ranges.rate_hz) {
                let omega = std::f64::consts::TAU * f;
                let kg = ranges.stiffness_n_per_m / (omega * omega) - ranges.mass_kg;
                if kg > 0.0 {
                    let damping = 0.02 * (ranges.stiffness_n_per_m * kg).sqrt();
                    wanted.push(with(&[("added_kg", kg), ("added_damping_n_s_per_m", damping)]));
                }
            }
            wanted.push(with(&[("added_damping_n_s_per_m", typical("added_damping_n_s_per_m"))]));
        }
        "second-mass" => {
            let mass = typical("mass_kg");
            let mut hz = vec![80.0, 250.0, 600.0, 1200.0, 2400.0];
            if let Some(peak) = ranges.resonance_hz {
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
        "sensor-hum" | "amplifier-hum" => {
            let (cos, sin, lines) = if info.name == "sensor-hum" {
                ("cos_m", "sin_m", &ranges.lines_hz)
            } else {
                ("cos_v", "sin_v", &ranges.monitor_lines_hz)
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
        }
        "creep" => {
            for onset in [0.01, 0.1, 1.0] {
                wanted.push(with(&[("per_decade", typical("per_decade")), ("onset_s", onset)]));
            }
        }
        "viscoelasticity" => {
            for seconds in [0.003, 0.03, 0.3, 3.0] {
                wanted.push(with(&[
                    ("branch_n_per_m", typical("branch_n_per_m")),
                    ("time_constant_s", seconds),
                ]));
            }
            wanted.push(with(&[
                ("branch_n_per_m", typical("branch_n_per_m")),
                ("time_constant_s", 0.3),
                ("relaxed_share", 1.0),
            ]));
            wanted.push(with(&[("damping_n_s_per_m", typical("damping_n_s_per_m"))]));
        }
        "hysteresis-rate" => {
            let resistance = ("resistance_ohm", typical("resistance_ohm"));
            wanted.push(with(&[("per_decade", typical("per_decade"))]));
            wanted.push(with(&[resistance]));
            wanted.push(with(&[resistance, ("loss_exponent", 0.4)]));
        }
        "sensor-nonlinearity" => {
            for zero_m in [0.0, far] {
                for name in ["quadratic_per_m", "cubic_per_m2"] {
                    wanted.push(with(&[(name, typical(name)), ("zero_m", zero_m)]));
                }
            }
        }
        "friction" => {
            for metres in [0.003, 0.03, 0.2] {
                wanted.push(with(&[
                    ("coulomb_n", typical("coulomb_n")),
                    ("presliding_m", metres * span),
                ]));
            }
        }
        _ => {
            for p in parameters.iter().filter(|p| p.role == Role::Size) {
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
        // A tenth of a turn over the longest recording.
        ("sensor-hum" | "amplifier-hum", "frequency_hz") => Some(0.02 / ranges.longest_s.max(1.0)),
        _ => None,
    }
}
