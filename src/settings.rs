//! Settings in physical units: what a person writes, a file holds and the link carries.
//!
//! Plain single-precision numbers with the unit in the name, and defaults for the first paper's rig. They mean nothing to
//! the tick: [`crate::Config::build`] checks every one and turns them into integers. Any serde
//! format reads and writes them: TOML on the host, postcard on the board.

use heapless::Vec;

use crate::{AXES, MAX_CREEP, MAX_MAXWELL, MAX_NOTCH};

/// A setting that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettingsError {
    /// Part of the settings, like `feedback` or `generator`.
    pub group: &'static str,
    /// Name of the setting.
    pub field: &'static str,
    /// Axis, from 1.
    pub axis: Option<u8>,
    /// Unit or meaning of the range.
    pub unit: &'static str,
    /// Smallest value allowed.
    pub min: f32,
    /// Largest value allowed.
    pub max: f32,
    /// What was found.
    pub found: f32,
}

impl core::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if let Some(axis) = self.axis {
            write!(f, "axis {axis}: ")?;
        }
        write!(
            f,
            "{}.{} must be {} to {} {}, found {}",
            self.group, self.field, self.min, self.max, self.unit, self.found
        )
    }
}

impl core::error::Error for SettingsError {}

/// Range checks that remember where they are.
#[derive(Clone, Copy)]
pub(crate) struct Check {
    group: &'static str,
    axis: Option<u8>,
}

impl Check {
    pub(crate) const fn new(group: &'static str) -> Self {
        Self { group, axis: None }
    }
    pub(crate) const fn axis(group: &'static str, axis: usize) -> Self {
        Self { group, axis: Some(axis as u8 + 1) }
    }
    /// `found` if it lies in `min..=max`; not-a-number does not.
    pub(crate) fn range(
        &self,
        field: &'static str,
        found: f32,
        min: f32,
        max: f32,
        unit: &'static str,
    ) -> Result<f32, SettingsError> {
        if found >= min && found <= max {
            Ok(found)
        } else {
            Err(SettingsError { group: self.group, field, axis: self.axis, unit, min, max, found })
        }
    }
}

macro_rules! settings {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty = $default:expr,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq)]
        #[derive(serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind,)*
        }
        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }
    };
}

settings! {
    /// One Maxwell slip element in electrical terms.
    MaxwellSettings {
        /// Charge per volt below slip, F.
        capacitance_f: f32 = 33.6e-6,
        /// Voltage at which it slips, V.
        limit_v: f32 = 0.372,
    }
}

settings! {
    /// Goldfarb-Celanovic model of one stack. Defaults: Tokin AE0505D16 (`notes/physics.md`, section 1).
    StackSettings {
        /// Force per volt, equally charge per metre.
        transformer_n_per_v: f32 = 7.10,
        /// Clamped capacitance, F.
        capacitance_f: f32 = 1.063e-6,
        /// Short-circuit stiffness, N/m.
        stiffness_n_per_m: f32 = 48.6e6,
        /// Internal damping, N s/m.
        damping_n_s_per_m: f32 = 50.0,
        /// Effective moving mass, kg.
        mass_kg: f32 = 1.3e-3,
        /// Slip elements; none for a stack without hysteresis.
        hysteresis: Vec<MaxwellSettings, MAX_MAXWELL> = (1..=8u8)
            .map(|i| MaxwellSettings { capacitance_f: 33.6e-6, limit_v: 0.372 * f32::from(i) })
            .collect(),
    }
}

settings! {
    /// What one stack pushes: three independent springs are the first paper's result.
    MechanismSettings {
        /// Stiffness, N/m.
        stiffness_n_per_m: f32 = 4.8e6,
        /// Moving mass as seen by the stack, kg.
        mass_kg: f32 = 0.0,
        /// Damping, N s/m.
        damping_n_s_per_m: f32 = 0.0,
    }
}

settings! {
    /// One Kelvin-Voigt element: displacement that follows the elastic one as gain / (1 + time constant s).
    CreepSettings {
        /// Final creep displacement per elastic displacement.
        gain: f32 = 0.0,
        /// Time constant, s.
        time_constant_s: f32 = 1.0,
    }
}

settings! {
    /// The inverse model that turns the reference into a voltage.
    FeedforwardSettings {
        /// Whole feedforward: 1 as modelled, 0 off.
        gain: f32 = 1.0,
        /// Compensate the stack's hysteresis.
        hysteresis: bool = true,
        /// Damping and inertia terms, stack and mechanism together.
        dynamics: bool = true,
        /// Invert the amplifier's first-order lag.
        amplifier_lead: bool = true,
        /// Creep model; none to leave creep alone.
        creep: Vec<CreepSettings, MAX_CREEP> = Vec::new(),
        /// Extra time by which the drive leads, s: delays of the rig that no other setting describes.
        advance_s: f32 = 0.0,
    }
}

settings! {
    /// Notch filter in the feedback path.
    NotchSettings {
        /// Centre, Hz.
        frequency_hz: f32 = 1_600.0,
        /// Damping ratio of its poles: half the relative width.
        damping_ratio: f32 = 0.3,
        /// Gain left at the centre, 0 to 1.
        depth: f32 = 0.05,
    }
}

settings! {
    /// Feedback of one axis.
    FeedbackSettings {
        /// Proportional gain, V/um.
        proportional_v_per_um: f32 = 0.0,
        /// Integral gain, V/(um s).
        integral_v_per_um_s: f32 = 0.0,
        /// Derivative gain, V ms/um.
        derivative_v_ms_per_um: f32 = 0.0,
        /// Corner of the derivative's low-pass filter, Hz.
        derivative_filter_hz: f32 = 1_000.0,
        /// Share of the reference in the derivative: 0 acts on the measurement alone, 1 on the error.
        setpoint_weight: f32 = 1.0,
        /// Largest magnitude of the integral term, V.
        integral_limit_v: f32 = 30.0,
        /// Delay of the measurement, s: the reference is delayed as much before the comparison.
        sensor_delay_s: f32 = 0.0,
        /// Notches, in series with the whole feedback.
        notches: Vec<NotchSettings, MAX_NOTCH> = Vec::new(),
    }
}

settings! {
    /// What an axis may do.
    LimitSettings {
        /// Lowest drive, V.
        min_v: f32 = -10.0,
        /// Highest drive, V.
        max_v: f32 = 150.0,
        /// Fastest change of the drive, V/ms. 167 V/ms is 0.4 A into 2.4 uF.
        slew_v_per_ms: f32 = 150.0,
        /// Lowest reference, um.
        min_um: f32 = -2.0,
        /// Highest reference, um.
        max_um: f32 = 18.0,
        /// Measured positions this far beyond the travel for `guard.gauge_fault_s` are a fault, um; 0 = not watched. The default gauge is at
        /// its end 0.65 um beyond the travel.
        travel_margin_um: f32 = 0.4,
        /// Largest lasting distance between reference and position, um; 0 = not watched.
        following_error_um: f32 = 2.0,
        /// How long it may last, s; one tick at least.
        following_error_s: f32 = 0.05,
    }
}

settings! {
    /// Straight line from converter codes to a measured quantity (um for gauges, V for monitors).
    ConverterSettings {
        /// Value at code 0.
        at_zero: f32 = -3.0,
        /// Value at `full_code`.
        at_full: f32 = 18.994_63,
        /// Highest code that the converter gives. A gauge is at its end within a 64th of either end of the codes.
        full_code: u32 = 65_520,
    }
}

settings! {
    /// Straight line from drive to DAC codes.
    DacSettings {
        /// Drive at code 0, V.
        at_zero_v: f32 = -10.0,
        /// Drive at `full_code`, V.
        at_full_v: f32 = 149.960_94,
        /// Highest code.
        full_code: u32 = 4_095,
        /// Carry each code's rounding error into the next: noise moves to high frequencies, where the stage does not follow.
        noise_shaping: bool = true,
    }
}

settings! {
    /// One axis.
    AxisSettings {
        /// The stack.
        stack: StackSettings = StackSettings::default(),
        /// Its load.
        mechanism: MechanismSettings = MechanismSettings::default(),
        /// Time constant of the amplifier, s; 0 for none.
        amplifier_time_constant_s: f32 = 4.0e-4,
        /// Gauge reading of the relaxed stack at 0 V, um.
        origin_um: f32 = 0.0,
        /// Inverse model.
        feedforward: FeedforwardSettings = FeedforwardSettings::default(),
        /// Feedback.
        feedback: FeedbackSettings = FeedbackSettings::default(),
        /// Limits.
        limits: LimitSettings = LimitSettings::default(),
        /// Gauge, um.
        gauge: ConverterSettings = ConverterSettings { at_zero: -3.0, at_full: 18.994_63, full_code: 65_520 },
        /// Amplifier monitor, V.
        monitor: ConverterSettings = ConverterSettings { at_zero: -18.0, at_full: 157.957, full_code: 65_520 },
        /// Output.
        dac: DacSettings = DacSettings::default(),
    }
}

settings! {
    /// What the guard watches and how it brings the stage to rest.
    GuardSettings {
        /// Voltage of the parked drives, V.
        safe_v: f32 = 0.0,
        /// How fast a drive returns there, V/ms: from either drive limit within 0.6 s.
        return_v_per_ms: f32 = 0.5,
        /// Duration of arming, s.
        arming_s: f32 = 0.5,
        /// Time over which the drive moves from an old configuration's value to a new one's, s.
        transition_s: f32 = 0.1,
        /// Longest time without a command while armed, s; 0 = for ever.
        command_timeout_s: f32 = 0.0,
        /// Time for which a gauge may read the end of its range or jump, s; 0 = not watched. Positions beyond the travel may last as long, one
        /// tick at least.
        gauge_fault_s: f32 = 0.005,
        /// Largest change of a gauge in one tick, um; 0 = not watched.
        max_step_um: f32 = 3.0,
        /// A gauge whose code stays the same while the drive moves this far is stuck, V; 0 = not watched.
        stuck_drive_v: f32 = 20.0,
        /// Largest lasting difference between monitor and drive, V; 0 = not watched.
        monitor_error_v: f32 = 0.0,
        /// How long it may last, s; one tick at least.
        monitor_error_s: f32 = 0.05,
    }
}

impl AxisSettings {
    /// No control: the drive is `volts_per_um` times the reference. Generators then make voltages, for probing a stage whose
    /// model is unknown; voltage, slew and travel limits and the watch over the gauges still act.
    pub fn open_loop(volts_per_um: f32) -> Self {
        let stack = StackSettings {
            transformer_n_per_v: 1.0,
            stiffness_n_per_m: volts_per_um * 1.0e6,
            hysteresis: Vec::new(),
            ..StackSettings::default()
        };
        Self {
            stack,
            mechanism: MechanismSettings { stiffness_n_per_m: 0.0, ..MechanismSettings::default() },
            feedforward: FeedforwardSettings {
                hysteresis: false,
                dynamics: false,
                amplifier_lead: false,
                ..FeedforwardSettings::default()
            },
            limits: LimitSettings { following_error_um: 0.0, ..LimitSettings::default() },
            ..Self::default()
        }
    }
}

const IDENTITY: [[f32; AXES]; AXES] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

settings! {
    /// Everything that can be set.
    Settings {
        /// The axes.
        axes: [AxisSettings; AXES] = [AxisSettings::default(), AxisSettings::default(), AxisSettings::default()],
        /// Stiffness between axes, N/m: force at the row's stack per displacement of the column's. The diagonal is ignored
        /// (it is `mechanism.stiffness_n_per_m`).
        cross_stiffness_n_per_m: [[f32; AXES]; AXES] = [[0.0; AXES]; AXES],
        /// Axis positions from gauge readings: the inverse of what each gauge sees of each axis. Identity for gauges on the stacks.
        gauge_map: [[f32; AXES]; AXES] = IDENTITY,
        /// Supervision.
        guard: GuardSettings = GuardSettings::default(),
    }
}

impl Settings {
    /// The same for all axes.
    pub fn uniform(axis: AxisSettings) -> Self {
        Self { axes: [axis.clone(), axis.clone(), axis], ..Self::default() }
    }
}
