//! sensor-crosstalk: a gauge also reads another axis.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct SensorCrosstalk;

pub(super) const EFFECT: SensorCrosstalk = SensorCrosstalk;

static INFO: Info = Info {
    name: "sensor-crosstalk",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Pair,
    parameters: &[Parameter::size(
        "share",
        "1",
        0.0,
        (-20.0, 20.0),
        0.01,
        "reading here a metre of the other sensor's displacement",
    )],
    threshold: false,
    physics: "y_i = x_i + share x_j: shared bridge supply, a gauge that lies askew, sensors that look at a point which all \
              axes move. Instantaneous and proportional to displacement, so it repeats the neighbour's loops unchanged.",
    source: "gauges do not see cross motion when glued well (notes/physics.md, section 1); fsm: full 3x3 map (notes/gap.md, 5)",
    revealed_by: "one axis driven alone; its loops in the others' readings",
    confused_with: &["stiffness-coupling", "drive-crosstalk"],
};

struct Leak {
    from: usize,
    share: f64,
}

impl SensorBlock for Leak {
    fn read(&mut self, value_m: f64, bare_m: &[f64], _time_s: f64) -> f64 {
        value_m + self.share * bare_m[self.from]
    }

    fn needs(&self) -> Option<usize> {
        Some(self.from)
    }
}

impl Effect for SensorCrosstalk {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let leak = Leak { from: place.from(), share: values[0] };
        model.axes[place.on()].sensor.blocks.push(Box::new(leak));
    }
}
