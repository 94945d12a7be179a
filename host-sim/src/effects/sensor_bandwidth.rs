//! sensor-bandwidth: the conditioner is a low-pass.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorBandwidth;

pub(super) const EFFECT: SensorBandwidth = SensorBandwidth;

static INFO: Info = Info {
    name: "sensor-bandwidth",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[Parameter::size(
        "time_constant_s",
        "s",
        0.0,
        (0.0, 10.0),
        5.0e-5,
        "time constant of the conditioner",
    )],
    threshold: false,
    physics: "tau y' + y = x, exact for a displacement that is straight over a tick. Linear, the same at all levels, \
              absent from the monitor; what moves does not know of it.",
    source: "conditioner pole at 5 to 15 kHz (notes/physics.md, section 4); 2120B -3 dB at 15 kHz",
    revealed_by: "steps, multisine up to 0.4 of the sample rate",
    confused_with: &["drive-delay", "amplifier-bandwidth"],
};

struct LowPass {
    decay: f64,
    from_start: f64,
    from_end: f64,
    state: Option<(f64, f64)>,
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

impl Effect for SensorBandwidth {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, step_s: f64) {
        let ratio = step_s / values[0];
        let rise = -(-ratio).exp_m1();
        let from_end = 1.0 - rise / ratio;
        model.axes[place.on()].sensor.blocks.push(Box::new(LowPass {
            decay: 1.0 - rise,
            from_start: rise - from_end,
            from_end,
            state: None,
        }));
    }
}
