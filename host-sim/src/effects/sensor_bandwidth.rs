//! sensor-bandwidth: the conditioner is a low-pass.

use nalgebra::{Matrix3, Matrix4, Vector2, Vector4};

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorBandwidth;

pub(super) const EFFECT: SensorBandwidth = SensorBandwidth;

static INFO: Info = Info {
    name: "sensor-bandwidth",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("time_constant_s", "s", 0.0, (0.0, 10.0), 5.0e-5, "time constant of the conditioner"),
        Parameter::shape("curvature", "1", (0.0, 1.0), 0.2, "second order: 0 is a single pole, 0.25 two equal ones, 0.5 Butterworth"),
    ],
    threshold: false,
    physics: "curvature tau^2 y'' + tau y' + y = x, exact for a displacement that follows the amplifier over a tick. Linear, the same at all levels, \
              absent from the monitor; what moves does not know of it.",
    source: "conditioner pole at 5 to 15 kHz (notes/physics.md, section 4); 2120B -3 dB at 15 kHz",
    revealed_by: "steps, multisine up to 0.4 of the sample rate",
    confused_with: &["drive-delay", "amplifier-bandwidth"],
};

/// What the displacement does between two ticks: the drive is held, so that it follows the amplifier, towards its end with the
/// amplifier's time constant. After an 80 V edge a straight line would be tens of nm away from that.
#[derive(Clone, Copy)]
struct Approach {
    /// Time constants a tick; towards 0 it is a straight line.
    decay: f64,
    /// Slope at the start of a tick, per tick, for a displacement that gains 1 over the tick.
    slope: f64,
}

impl Approach {
    fn new(time_constant_s: f64, step_s: f64) -> Self {
        // Faster than a twentieth of a tick would be a jump at the tick.
        let decay = step_s / time_constant_s.max(0.05 * step_s);
        Self { decay, slope: decay / -(-decay).exp_m1() }
    }
}

/// One pole.
struct LowPass {
    decay: f64,
    from_start: f64,
    from_end: f64,
    state: Option<(f64, f64)>,
}

impl LowPass {
    fn new(time_constant_s: f64, approach: Approach, step_s: f64) -> Self {
        // In ticks: z = (y, x, x').
        let rate = step_s / time_constant_s;
        #[rustfmt::skip]
        let rates = Matrix3::new(
            -rate, rate, 0.0,
            0.0, 0.0, 1.0,
            0.0, 0.0, -approach.decay,
        );
        let advance = rates.exp();
        let from_end = advance.m13 * approach.slope;
        Self { decay: advance.m11, from_start: advance.m12 - from_end, from_end, state: None }
    }
}

impl SensorBlock for LowPass {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], _time_s: f64) -> f64 {
        let reading = match self.state {
            None => value_m,
            Some((reading, before)) => {
                self.decay * reading + self.from_start * before + self.from_end * value_m
            }
        };
        self.state = Some((reading, value_m));
        reading
    }
}

/// Two poles: reading and its slope (per tick).
struct SecondOrder {
    advance: Matrix4<f64>,
    slope: f64,
    state: Option<(Vector2<f64>, f64)>,
}

impl SecondOrder {
    fn new(time_constant_s: f64, curvature: f64, approach: Approach, step_s: f64) -> Self {
        // In ticks: z = (y, y', x, x').
        let stiffness = (step_s / time_constant_s).powi(2) / curvature;
        let damping = stiffness * time_constant_s / step_s;
        #[rustfmt::skip]
        let rates = Matrix4::new(
            0.0, 1.0, 0.0, 0.0,
            -stiffness, -damping, stiffness, 0.0,
            0.0, 0.0, 0.0, 1.0,
            0.0, 0.0, 0.0, -approach.decay,
        );
        Self { advance: rates.exp(), slope: approach.slope, state: None }
    }
}

impl SensorBlock for SecondOrder {
    fn read(&mut self, value_m: f64, _bare_m: &[f64], _time_s: f64) -> f64 {
        let motion = match self.state {
            None => Vector2::new(value_m, 0.0),
            Some((motion, before)) => {
                let slope = (value_m - before) * self.slope;
                (self.advance * Vector4::new(motion.x, motion.y, before, slope)).xy()
            }
        };
        self.state = Some((motion, value_m));
        motion.x
    }
}

impl Effect for SensorBandwidth {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, step_s: f64) {
        let axis = &mut model.axes[place.on()];
        let approach = Approach::new(axis.amplifier.time_constant_s, step_s);
        let blocks = &mut axis.sensor.blocks;
        // A second pole far inside a tick is one that nobody sees.
        if values[1] * values[0] > 0.02 * step_s {
            blocks.push(Box::new(SecondOrder::new(values[0], values[1], approach, step_s)));
        } else {
            blocks.push(Box::new(LowPass::new(values[0], approach, step_s)));
        }
    }
}
