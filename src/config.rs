//! Configuration in the tick's terms, built from [`Settings`] off the hot path and exchanged whole.

mod lines;

use heapless::Vec;

pub(crate) use lines::{Converter, Dac};
use lines::{build_converter, build_dac, last_code};

use crate::creep::{self, Creep};
use crate::feedback::Feedback;
use crate::feedforward::Feedforward;
use crate::filter::Notch;
use crate::guard::Watch;
use crate::hysteresis::Maxwell;
use crate::math::exp_minus;
use crate::settings::{
    AxisSettings, Check, FeedbackSettings, GuardSettings, Settings, SettingsError,
};
use crate::units::{Gain, MicroCoulomb, Quantity, Um, Volt};
use crate::{AXES, MAX_MAXWELL, TICK_HZ, TICK_S};

/// A checked configuration. Only [`Config::build`] makes one.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Config {
    pub(crate) axes: [AxisConfig; AXES],
    pub(crate) gauge_map: Option<[[Gain<Um, Um>; AXES]; AXES]>,
    pub(crate) guard: GuardConfig,
    /// Some stiffness between axes is not zero.
    pub(crate) is_crossed: bool,
    pub(crate) digest: u32,
}

/// One axis.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct AxisConfig {
    pub(crate) feedforward: Feedforward,
    pub(crate) feedback: Feedback,
    pub(crate) watch: Watch,
    pub(crate) travel: [Um; 2],
    pub(crate) drive: [Volt; 2],
    pub(crate) slew: Volt,
    pub(crate) gauge: Converter,
    pub(crate) monitor: Converter,
    pub(crate) dac: Dac,
}

/// Supervision of the whole.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct GuardConfig {
    pub(crate) safe: Volt,
    pub(crate) return_step: Volt,
    pub(crate) arming_ticks: u32,
    /// Share of a bump that fades each tick, in 2^-32.
    pub(crate) arming_step: u32,
    pub(crate) transition_step: u32,
    pub(crate) timeout_ticks: u32,
}

/// FNV-1a over everything that was built, the same on a host and on the board.
struct Digest(u32);

impl core::hash::Hasher for Digest {
    fn finish(&self) -> u64 {
        u64::from(self.0)
    }
    // Once, and not for each of the hundred numbers: 4 KiB of flash.
    #[inline(never)]
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
        }
    }
    // Lengths and discriminants have the machine's width otherwise.
    fn write_usize(&mut self, i: usize) {
        self.write(&(i as u32).to_le_bytes());
    }
    fn write_isize(&mut self, i: isize) {
        self.write(&(i as i32).to_le_bytes());
    }
}

fn ticks(seconds: f32) -> u32 {
    (seconds * TICK_HZ as f32 + 0.5) as u32
}

/// For how many ticks something may last whose limit is set: one at least, or a short time would switch the watch off.
fn patience(seconds: f32) -> u32 {
    ticks(seconds).max(1)
}

/// Longest time that a return from either drive limit may take, s. The tasks' silence is noticed after 0.25 s and the watchdog bites 1 s
/// after it began (`board::tasks`), its clock being 5 % fast at worst: a drive that is still up then would be stepped to 0 V.
const LONGEST_RETURN_S: f32 = 0.6;

/// Share a tick of something that takes `seconds`, in 2^-32.
fn share(seconds: f32) -> u32 {
    match ticks(seconds) {
        0 | 1 => u32::MAX,
        n => u32::MAX / n + 1,
    }
}

/// A gain, or an error if its format cannot hold it.
fn gain<A: Quantity, B: Quantity>(
    check: &Check,
    field: &'static str,
    value: f32,
) -> Result<Gain<A, B>, SettingsError> {
    let most = Gain::<A, B>::MAX;
    check.range(field, value, -most, most, "in the controller's units").map(Gain::from_f32)
}

impl Config {
    /// Check all settings and build the configuration. The error names the first setting that cannot be used.
    pub fn build(settings: &Settings) -> Result<Self, SettingsError> {
        let [a, b, c] = &settings.axes;
        let cross = &settings.cross_stiffness_n_per_m;
        let mut config = Self {
            axes: [
                build_axis(0, a, [cross[0][1], cross[0][2]], &settings.guard)?,
                build_axis(1, b, [cross[1][2], cross[1][0]], &settings.guard)?,
                build_axis(2, c, [cross[2][0], cross[2][1]], &settings.guard)?,
            ],
            gauge_map: build_gauge_map(&settings.gauge_map)?,
            guard: build_guard(&settings.guard)?,
            is_crossed: false,
            digest: 0,
        };
        config.is_crossed = config.axes.iter().any(|axis| axis.feedforward.is_crossed);
        for (k, axis) in config.axes.iter().enumerate() {
            let [low, high] = axis.drive;
            let check = Check::axis("guard", k);
            check.range(
                "safe_v",
                settings.guard.safe_v,
                low.to_f32(),
                high.to_f32(),
                "V (the axis' drive limits)",
            )?;
            let safe = settings.guard.safe_v;
            let farthest = (high.to_f32() - safe).max(safe - low.to_f32());
            check.range(
                "return_v_per_ms",
                settings.guard.return_v_per_ms,
                farthest / (1.0e3 * LONGEST_RETURN_S),
                100.0,
                "V/ms (back within 0.6 s)",
            )?;
        }
        config.digest = digest_of(&config);
        Ok(config)
    }

    /// A number that differs for any two configurations that act differently (32 bits, FNV-1a), for acknowledgements and telemetry.
    pub const fn digest(&self) -> u32 {
        self.digest
    }
    /// The gauge code nearest to a position (um) on an axis (from 0): what a simulated converter puts into a sample, before
    /// its own range is applied. 0 for an axis that does not exist.
    pub fn gauge_code(&self, axis: usize, position_um: f64) -> i32 {
        self.axes
            .get(axis)
            .map_or(0, |axis| axis.gauge.code((position_um * (1u32 << 24) as f64) as i64))
    }
    /// The monitor code nearest to a voltage on an axis (from 0).
    pub fn monitor_code(&self, axis: usize, volts: f64) -> i32 {
        self.axes
            .get(axis)
            .map_or(0, |axis| axis.monitor.code((volts * (1u32 << 22) as f64) as i64))
    }
    /// The voltage that a DAC code stands for on an axis (from 0).
    pub fn dac_volts(&self, axis: usize, code: u16) -> f64 {
        self.axes.get(axis).map_or(0.0, |axis| {
            axis.dac.zero.to_f64()
                + f64::from(code) * (1u32 << 20) as f64 / f64::from(axis.dac.scale.max(1))
        })
    }
}

fn digest_of(value: &impl core::hash::Hash) -> u32 {
    let mut digest = Digest(0x811c_9dc5);
    value.hash(&mut digest);
    digest.0
}

fn build_axis(
    axis: usize,
    settings: &AxisSettings,
    cross: [f32; 2],
    guard: &GuardSettings,
) -> Result<AxisConfig, SettingsError> {
    let limits = &settings.limits;
    let check = Check::axis("limits", axis);
    let min_v = check.range("min_v", limits.min_v, -200.0, 400.0, "V")?;
    let max_v = check.range("max_v", limits.max_v, min_v, 400.0, "V")?;
    let min_um = check.range("min_um", limits.min_um, -100.0, 100.0, "um")?;
    let max_um = check.range("max_um", limits.max_um, min_um, 100.0, "um")?;
    let slew = check.range("slew_v_per_ms", limits.slew_v_per_ms, 1.0e-3, 5.0e3, "V/ms")?;
    let margin = check.range("travel_margin_um", limits.travel_margin_um, 0.0, 128.0, "um")?;
    let following =
        check.range("following_error_um", limits.following_error_um, 0.0, 128.0, "um")?;
    let following_s =
        check.range("following_error_s", limits.following_error_s, 0.0, 100.0, "s")?;

    let watched = Check::axis("guard", axis);
    let gauge_fault_s = watched.range("gauge_fault_s", guard.gauge_fault_s, 0.0, 10.0, "s")?;
    let max_step = watched.range("max_step_um", guard.max_step_um, 0.0, 128.0, "um")?;
    let stuck = watched.range("stuck_drive_v", guard.stuck_drive_v, 0.0, 400.0, "V")?;
    let monitor = watched.range("monitor_error_v", guard.monitor_error_v, 0.0, 400.0, "V")?;
    let monitor_s = watched.range("monitor_error_s", guard.monitor_error_s, 0.0, 100.0, "s")?;
    let or_off = |value: f32| if value == 0.0 { f32::MAX } else { value };
    let margin = or_off(margin);
    Ok(AxisConfig {
        feedforward: build_feedforward(axis, settings, cross)?,
        feedback: build_feedback(axis, &settings.feedback)?,
        watch: Watch {
            last_code: last_code(settings.gauge.full_code),
            gauge_ticks: if gauge_fault_s == 0.0 { 0 } else { patience(gauge_fault_s) },
            max_step: Um::from_f32(or_off(max_step)),
            stuck_drive: Volt::from_f32(or_off(stuck)),
            travel: [Um::from_f32(min_um - margin), Um::from_f32(max_um + margin)],
            following: Um::from_f32(or_off(following)),
            following_ticks: patience(following_s),
            monitor: Volt::from_f32(or_off(monitor)),
            monitor_ticks: patience(monitor_s),
        },
        travel: [Um::from_f32(min_um), Um::from_f32(max_um)],
        drive: [Volt::from_f32(min_v), Volt::from_f32(max_v)],
        slew: Volt::from_f32(slew * TICK_S * 1.0e3),
        gauge: build_converter(Check::axis("gauge", axis), &settings.gauge, 24)?,
        monitor: build_converter(Check::axis("monitor", axis), &settings.monitor, 22)?,
        dac: build_dac(Check::axis("dac", axis), &settings.dac)?,
    })
}

fn build_feedforward(
    axis: usize,
    settings: &AxisSettings,
    cross: [f32; 2],
) -> Result<Feedforward, SettingsError> {
    let (stack, mechanism, forward) = (&settings.stack, &settings.mechanism, &settings.feedforward);
    let check = Check::axis("stack", axis);
    let t = check.range("transformer_n_per_v", stack.transformer_n_per_v, 1.0e-3, 1.0e5, "N/V")?;
    let c = check.range("capacitance_f", stack.capacitance_f, 0.0, 1.0e-3, "F")?;
    let k_p = check.range("stiffness_n_per_m", stack.stiffness_n_per_m, 0.0, 1.0e12, "N/m")?;
    let b_p = check.range("damping_n_s_per_m", stack.damping_n_s_per_m, 0.0, 1.0e9, "N s/m")?;
    let m_p = check.range("mass_kg", stack.mass_kg, 0.0, 1.0e4, "kg")?;
    let load = Check::axis("mechanism", axis);
    let k = load.range("stiffness_n_per_m", mechanism.stiffness_n_per_m, 0.0, 1.0e12, "N/m")?;
    let b = load.range("damping_n_s_per_m", mechanism.damping_n_s_per_m, 0.0, 1.0e9, "N s/m")?;
    let m = load.range("mass_kg", mechanism.mass_kg, 0.0, 1.0e4, "kg")?;
    let ff = Check::axis("feedforward", axis);
    let scale = ff.range("gain", forward.gain, 0.0, 2.0, "(1 = as modelled)")?;
    let advance_ms = 1.0e3 * ff.range("advance_s", forward.advance_s, -2.0e-3, 2.0e-3, "s")?;
    let of_axis = Check::axis("settings", axis);
    let tau = of_axis.range(
        "amplifier_time_constant_s",
        settings.amplifier_time_constant_s,
        0.0,
        3.2e-3,
        "s",
    )?;
    let origin = of_axis.range("origin_um", settings.origin_um, -100.0, 100.0, "um")?;

    // N/m over N/V is V/m; per um 1e-6, per um/ms 1e-3, per um/ms^2 1.
    let (stiff, mut damp, mut inert) =
        ((k_p + k) / t * 1.0e-6, (b_p + b) / t * 1.0e-3, (m_p + m) / t);
    if !forward.dynamics {
        (damp, inert) = (0.0, 0.0);
    }
    // x(t + a) = x + a v + a^2/2 a: an advance of the motion is a matter of coefficients.
    inert += advance_ms * damp + 0.5 * advance_ms * advance_ms * stiff;
    damp += advance_ms * stiff;

    let mut maxwell = Vec::<Maxwell, MAX_MAXWELL>::new();
    if forward.hysteresis && scale > 0.0 {
        let (mut total, mut stiffest) = (0.0, 0.0);
        for element in &stack.hysteresis {
            let slip = Check::axis("stack.hysteresis", axis);
            let capacitance =
                slip.range("capacitance_f", element.capacitance_f, 1.0e-12, 1.0, "F")?;
            let limit = slip.range("limit_v", element.limit_v, 0.0, 400.0, "V")?;
            total += limit;
            slip.range("limit_v", total, 0.0, 400.0, "V in total")?;
            let slip_uc = slip.range(
                "capacitance_f",
                capacitance * limit * 1.0e6,
                0.0,
                500.0,
                "uC at slip (F times V)",
            )?;
            let elastance = scale / (capacitance * 1.0e6);
            stiffest += elastance;
            gain::<MicroCoulomb, Volt>(&slip, "capacitance_f", stiffest)?;
            let elastance = gain(&slip, "capacitance_f", elastance)?;
            let built = Maxwell::new(elastance, MicroCoulomb::from_f32(slip_uc));
            let place = maxwell.iter().take_while(|other| other.slip() <= built.slip()).count();
            let _ = maxwell.insert(place, built);
        }
    }
    let charge_per_um =
        if maxwell.is_empty() { Gain::ZERO } else { gain(&check, "transformer_n_per_v", t)? };
    let charge_per_volt = if maxwell.is_empty() {
        Gain::ZERO
    } else {
        gain(&check, "capacitance_f", c * 1.0e6 / scale)?
    };

    let mut creep = Vec::new();
    for element in &forward.creep {
        let kelvin = Check::axis("feedforward.creep", axis);
        let c = kelvin.range("gain", element.gain, -0.5, 0.5, "um/um")?;
        let tau = kelvin.range("time_constant_s", element.time_constant_s, 0.02, 1.0e5, "s")?;
        let rate = 1.0 - exp_minus(creep::DIVIDER as f32 * TICK_S / tau);
        // 1 - exp(-x) loses digits for small x; the series does not.
        let x = creep::DIVIDER as f32 * TICK_S / tau;
        let rate = if x < 0.01 { x - 0.5 * x * x } else { rate };
        let _ =
            creep.push(Creep { gain: Gain::from_f32(c), rate: (rate * 2_147_483_648.0) as i32 });
    }

    // Held for a tick T_s, the amplifier keeps the share p of its distance: p / (1 - p) is about tau / T_s - 1/2.
    let p = if tau > 0.0 && forward.amplifier_lead { exp_minus(TICK_S / tau) } else { 0.0 };
    let um_gain = |field, value: f32| gain::<Um, Volt>(&check, field, scale * value);
    let mut built = Feedforward {
        origin: Um::from_f32(origin),
        stiffness: um_gain("stiffness_n_per_m", stiff)?,
        // 1 um in 0.2 ms is 5 um/ms; 1 um/(0.4 ms)^2 is 6.25 um/ms^2.
        damping: gain(&check, "damping_n_s_per_m", scale * damp * 5.0)?,
        inertia: gain(&check, "mass_kg", scale * inert * 6.25)?,
        charge_per_um,
        charge_per_volt,
        cross: [
            um_gain("cross_stiffness_n_per_m", cross[0] / t * 1.0e-6)?,
            um_gain("cross_stiffness_n_per_m", cross[1] / t * 1.0e-6)?,
        ],
        is_crossed: cross != [0.0; 2],
        lead: gain(&of_axis, "amplifier_time_constant_s", p / (1.0 - p))?,
        maxwell,
        creep,
        model: 0,
    };
    built.model = digest_of(&built) | 1;
    Ok(built)
}

fn build_feedback(axis: usize, settings: &FeedbackSettings) -> Result<Feedback, SettingsError> {
    let check = Check::axis("feedback", axis);
    let proportional =
        check.range("proportional_v_per_um", settings.proportional_v_per_um, 0.0, 100.0, "V/um")?;
    let integral =
        check.range("integral_v_per_um_s", settings.integral_v_per_um_s, 0.0, 1.0e5, "V/(um s)")?;
    let derivative = check.range(
        "derivative_v_ms_per_um",
        settings.derivative_v_ms_per_um,
        0.0,
        100.0,
        "V ms/um",
    )?;
    let corner =
        check.range("derivative_filter_hz", settings.derivative_filter_hz, 1.0, 5.0e3, "Hz")?;
    let weight = check.range(
        "setpoint_weight",
        settings.setpoint_weight,
        0.0,
        1.0,
        "(share of the reference)",
    )?;
    let limit = check.range("integral_limit_v", settings.integral_limit_v, 0.0, 400.0, "V")?;
    let delay = check.range("sensor_delay_s", settings.sensor_delay_s, 0.0, 1.0e-3, "s")?;
    let pole = exp_minus(core::f32::consts::TAU * corner * TICK_S);
    let mut notches = Vec::new();
    for notch in &settings.notches {
        let check = Check::axis("feedback.notches", axis);
        let hz =
            check.range("frequency_hz", notch.frequency_hz, 5.0, 0.49 * TICK_HZ as f32, "Hz")?;
        let damping = check.range("damping_ratio", notch.damping_ratio, 1.0e-3, 5.0, "")?;
        let depth = check.range("depth", notch.depth, 0.0, 1.0, "(gain at the centre)")?;
        let _ = notches.push(Notch::design(hz / TICK_HZ as f32, damping, depth));
    }
    Ok(Feedback {
        proportional: Gain::from_f32(proportional),
        integral: Gain::from_f32(integral * TICK_S),
        derivative: gain(
            &check,
            "derivative_v_ms_per_um",
            derivative / (TICK_S * 1.0e3) * (1.0 - pole),
        )?,
        derivative_pole: Gain::from_f32(pole),
        setpoint_weight: Gain::from_f32(weight),
        integral_limit: Volt::from_f32(limit),
        sensor_delay: Gain::from_f32(delay / TICK_S),
        notches,
    })
}

type GaugeMap = [[Gain<Um, Um>; AXES]; AXES];

fn build_gauge_map(map: &[[f32; AXES]; AXES]) -> Result<Option<GaugeMap>, SettingsError> {
    let mut built = [[Gain::ZERO; AXES]; AXES];
    let mut identity = true;
    for (i, (row, out)) in map.iter().zip(&mut built).enumerate() {
        for (j, (value, out)) in row.iter().zip(out).enumerate() {
            *out = gain(&Check::axis("settings", i), "gauge_map", *value)?;
            identity &= *value == if i == j { 1.0 } else { 0.0 };
        }
    }
    Ok(if identity { None } else { Some(built) })
}

fn build_guard(settings: &GuardSettings) -> Result<GuardConfig, SettingsError> {
    let check = Check::new("guard");
    let safe = check.range("safe_v", settings.safe_v, -200.0, 400.0, "V")?;
    let back = check.range("return_v_per_ms", settings.return_v_per_ms, 1.0e-3, 100.0, "V/ms")?;
    let arming = check.range("arming_s", settings.arming_s, 1.0e-3, 100.0, "s")?;
    let transition = check.range("transition_s", settings.transition_s, 0.0, 100.0, "s")?;
    let timeout = check.range("command_timeout_s", settings.command_timeout_s, 0.0, 1.0e5, "s")?;
    Ok(GuardConfig {
        safe: Volt::from_f32(safe),
        return_step: Volt::from_f32(back * TICK_S * 1.0e3),
        arming_ticks: ticks(arming),
        arming_step: share(arming),
        transition_step: share(transition),
        timeout_ticks: ticks(timeout),
    })
}
