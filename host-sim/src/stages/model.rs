//! What a rig becomes before it is simulated: nominal values of every stage, which parametric effects change in
//! place, and the blocks that structural effects add at their physical place.

use nalgebra::DMatrix;

use super::hysteresis::WenLoop;
use crate::rig::{Axis, Rig};

/// Model of a whole rig.
pub struct Model {
    /// One entry an axis.
    pub axes: Vec<AxisModel>,
    /// Springs between axes.
    pub springs: Vec<CouplingSpring>,
    /// What the sensors see of the axes, m per m: a row a sensor.
    pub output_map: Option<Vec<Vec<f64>>>,
}

/// A reciprocal spring between two axes: force on each is `-stiffness` times the displacement of the other.
#[derive(Debug, Clone, Copy)]
pub struct CouplingSpring {
    /// The two axes.
    pub axes: (usize, usize),
    /// Off-diagonal entry of the stiffness matrix, N/m.
    pub stiffness_n_per_m: f64,
}

/// Model of one axis.
pub struct AxisModel {
    /// From the command to the amplifier's target.
    pub drive: DriveModel,
    /// Amplifier.
    pub amplifier: AmplifierModel,
    /// Stack.
    pub piezo: PiezoModel,
    /// Mechanism.
    pub mechanism: MechanismModel,
    /// Sensor.
    pub sensor: SensorModel,
}

/// Drive: `gain * (command + sum share_j command_j) + offset`, `delay_s` late.
pub struct DriveModel {
    /// Gain, 1.
    pub gain: f64,
    /// Offset, V.
    pub offset_v: f64,
    /// Dead time, s.
    pub delay_s: f64,
    /// Shares of other axes' commands, by axis.
    pub crosstalk: Vec<(usize, f64)>,
}

/// Amplifier: blocks at the input, first order, slew limit, rails, blocks at the output, in the order of the lists.
pub struct AmplifierModel {
    /// Time constant, s.
    pub time_constant_s: f64,
    /// Time constant of a further pole, behind the slew limit, over the first one's, 1; 0 without one. Above 1 the two are a pair that
    /// rings: `further_pole tau^2 v'' + 2 tau v' + v = target`.
    pub further_pole: f64,
    /// Lower rail, V.
    pub min_v: f64,
    /// Upper rail, V.
    pub max_v: f64,
    /// Limit on the slope.
    pub slew: Option<Box<dyn SlewLimit>>,
    /// What the voltage asked for passes before the first order.
    pub input: Vec<Box<dyn VoltageBlock>>,
    /// What sits at the output; the monitor is behind it.
    pub output: Vec<Box<dyn VoltageBlock>>,
}

/// Current at which a loss that goes with a power of the current is stated, A: that of a slow triangle.
pub const LOSS_AT_A: f64 = 1.0e-3;

/// Stack: Goldfarb-Celanovic with optional loss, skew and slow strain.
pub struct PiezoModel {
    /// Transformer ratio, N/V.
    pub transformer_n_per_v: f64,
    /// Clamped capacitance, F.
    pub capacitance_f: f64,
    /// Stiffness, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Effective mass, kg.
    pub mass_kg: f64,
    /// Slopes of the Maxwell elements, V/C.
    pub slopes_v_per_c: Vec<f64>,
    /// Limits of the Maxwell elements, V.
    pub limits_v: Vec<f64>,
    /// Voltage about whose value the loops lie: an internal bias of the ceramic, V.
    pub imprint_v: f64,
    /// By how much the elements give way before they slip, 0 to 1.
    pub element_yield: f64,
    /// Share of that on their way back, 0 to 1.
    pub element_recoil: f64,
    /// A loop of another law beside the elements.
    pub loop_beside: Option<WenLoop>,
    /// Growth of the hysteresis voltage with charge, 1/C.
    pub skew_per_c: f64,
    /// Loss in series with the elements, V per A at a current of [`LOSS_AT_A`].
    pub resistance_ohm: f64,
    /// Power of the current that the voltage of this loss goes with, 1.
    pub loss_exponent: f64,
    /// What the drag of domain walls takes from the force: see [`StrainLoss`].
    pub strain_loss: Option<StrainLoss>,
    /// How the limits grow with current.
    pub rate: Option<Box<dyn RateLaw>>,
    /// Slow strain.
    pub creep: Vec<Kelvin>,
    /// Growth of the slow strain with the transducer voltage, 1/V.
    pub creep_level_per_v: f64,
}

impl PiezoModel {
    /// Slope of the hysteresis voltage where nothing slips, V/C.
    pub fn steepest_v_per_c(&self) -> f64 {
        let beside = self.loop_beside.map_or(0.0, |beside| beside.limit_v / beside.slip_c);
        self.slopes_v_per_c.iter().sum::<f64>() + beside
    }
}

/// Loss between charge and strain: the stack pushes as if the transducer voltage were `voltage_v ln(1 + u^onset) / onset`,
/// `u = |dq/dt| / current_a`, nearer to where it came from; the charge falls only by what the stage lacks in displacement.
#[derive(Debug, Clone, Copy)]
pub struct StrainLoss {
    /// Growth of the loss where the current grows by a factor of e, V.
    pub voltage_v: f64,
    /// Current from which it grows with the logarithm, A.
    pub current_a: f64,
    /// Power of the current that it goes with far below that, 1.
    pub onset: f64,
}

/// One slow strain: `share` of the transducer voltage arrives with `time_constant_s`.
#[derive(Debug, Clone, Copy)]
pub struct Kelvin {
    /// Final share of the transducer voltage, 1.
    pub share: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
}

/// Mechanism: spring, mass, damper, linear blocks, and forces that are not linear.
pub struct MechanismModel {
    /// Stiffness, N/m.
    pub stiffness_n_per_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Blocks propagated exactly with the mechanism.
    pub linear: Vec<Box<dyn LinearBlock>>,
    /// Forces solved for at the end of each tick.
    pub forces: Vec<Box<dyn Force>>,
}

/// Sensor: blocks in the order of the list, then the offset.
pub struct SensorModel {
    /// Reading at zero displacement, m.
    pub offset_m: f64,
    /// What lies between displacement and reading.
    pub blocks: Vec<Box<dyn SensorBlock>>,
}

/// A limit on the slope of the amplifier output.
pub trait SlewLimit: Send {
    /// Steepest fall and rise, V/s, both positive, into a load of `stack_f` farad (the stack's own, large-signal).
    fn limits_v_per_s(&self, stack_f: f64) -> (f64, f64);

    /// How early the slope begins to fall behind, 0 to 1: 0 is a limit with a corner.
    fn knee(&self) -> f64;
}

/// Something at the input or the output of the amplifier.
pub trait VoltageBlock: Send {
    /// Output for an input of `v` volts at session time `time_s`.
    fn output(&mut self, v: f64, time_s: f64) -> f64;
}

/// Growth of the slip limits with current.
pub trait RateLaw: Send {
    /// Factors on the limits and on the whole hysteresis voltage at a current of `current_a` (absolute).
    fn scales(&self, current_a: f64) -> (f64, f64);
}

/// Kind of a linear state, for the scaling of the matrices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StateKind {
    /// A displacement, m.
    Position,
    /// A velocity, m/s.
    Velocity,
}

/// A linear block on the mechanism.
pub trait LinearBlock: Send {
    /// Its states.
    fn states(&self) -> &'static [StateKind];
    /// Add it to `s' = A s`: displacement and velocity of the axis are rows 0 and 1, its own states start at row `at`;
    /// `mass_kg` is the mass in row 1.
    fn assemble(&self, a: &mut DMatrix<f64>, at: usize, mass_kg: f64);
}

/// A force on the mechanism that is not linear.
pub trait Force: Send {
    /// Come to rest at session time `time_s`.
    fn start(&mut self, _time_s: f64) {}
    /// Begin a tick of `step_s`.
    fn begin(&mut self, _step_s: f64) {}
    /// Force (N) and its slope (N/m) if the tick ended at displacement `x_m`.
    fn force(&self, x_m: f64) -> (f64, f64);
    /// Accept the end of a tick of `step_s`, or the resting place when `step_s` is 0.
    fn commit(&mut self, _x_m: f64, _step_s: f64) {}
    /// Whether it holds at every reversal, wherever that is.
    fn rubs(&self) -> bool {
        false
    }
    /// Whether it goes with time, or with the speed: such an axis is followed in every tick.
    fn goes_with_time(&self) -> bool {
        false
    }
}

/// Something between displacement and reading.
pub trait SensorBlock: Send {
    /// Reading for a reading of `value_m` so far; `bare_m` is what every sensor sees before any block.
    fn read(&mut self, value_m: f64, bare_m: &[f64], time_s: f64) -> f64;
    /// Other sensors whose bare reading it needs.
    fn needs(&self) -> Option<usize> {
        None
    }
}

impl Model {
    /// The nominal model of a rig with its effects applied, for a tick of `step_s`.
    pub fn new(rig: &Rig, step_s: f64) -> Self {
        let mut model = Self {
            axes: rig.axes.iter().map(AxisModel::nominal).collect(),
            springs: Vec::new(),
            output_map: rig.output_map.clone(),
        };
        for setting in rig.effects.iter().filter(|setting| setting.is_active()) {
            setting.effect.apply(&setting.values, setting.place, &mut model, step_s);
        }
        model
    }
}

impl AxisModel {
    /// Whether it has to be followed tick by tick, however calm: what depends on the current changes in every tick, a loss of strain goes by
    /// the ways of two steps of one length, and some forces go with time or speed.
    pub fn follows_every_tick(&self) -> bool {
        let PiezoModel { strain_loss, rate, resistance_ohm, .. } = &self.piezo;
        strain_loss.is_some()
            || rate.is_some()
            || *resistance_ohm != 0.0
            || self.mechanism.forces.iter().any(|force| force.goes_with_time())
    }

    fn nominal(axis: &Axis) -> Self {
        let piezo = &axis.piezo;
        Self {
            drive: DriveModel { gain: 1.0, offset_v: 0.0, delay_s: 0.0, crosstalk: Vec::new() },
            amplifier: AmplifierModel {
                further_pole: 0.0,
                time_constant_s: axis.amplifier.time_constant_s,
                min_v: axis.amplifier.min_v,
                max_v: axis.amplifier.max_v,
                slew: None,
                input: Vec::new(),
                output: Vec::new(),
            },
            piezo: PiezoModel {
                transformer_n_per_v: piezo.transformer_n_per_v,
                capacitance_f: piezo.capacitance_f,
                stiffness_n_per_m: piezo.stiffness_n_per_m,
                damping_n_s_per_m: piezo.damping_n_s_per_m,
                mass_kg: piezo.mass_kg,
                slopes_v_per_c: piezo.hysteresis.slopes().collect(),
                limits_v: piezo.hysteresis.limit_v.clone(),
                imprint_v: 0.0,
                element_yield: 0.0,
                element_recoil: 1.0,
                loop_beside: None,
                skew_per_c: 0.0,
                resistance_ohm: 0.0,
                loss_exponent: 1.0,
                strain_loss: None,
                rate: None,
                creep: Vec::new(),
                creep_level_per_v: 0.0,
            },
            mechanism: MechanismModel {
                stiffness_n_per_m: axis.mechanism.stiffness_n_per_m,
                mass_kg: axis.mechanism.mass_kg,
                damping_n_s_per_m: axis.mechanism.damping_n_s_per_m,
                linear: Vec::new(),
                forces: Vec::new(),
            },
            sensor: SensorModel { offset_m: axis.sensor.offset_m, blocks: Vec::new() },
        }
    }
}
