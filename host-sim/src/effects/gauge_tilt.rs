//! gauge-tilt: a gauge reads what goes with the square of another axis or with the product of both. Not in the catalogue: crosstalk goes with
//! the other axis itself.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SensorBlock};

pub(super) struct GaugeTilt;

pub(super) const EFFECT: GaugeTilt = GaugeTilt;

static INFO: Info = Info {
    name: "gauge-tilt",
    stage: Stage::Sensor,
    kind: Kind::Structural,
    scope: Scope::Pair,
    parameters: &[
        Parameter::size(
            "square_per_m",
            "1/m",
            0.0,
            (-1.0e6, 1.0e6),
            1.0e3,
            "reading here a square metre of the other axis' displacement squared",
        ),
        Parameter::size(
            "product_per_m",
            "1/m",
            0.0,
            (-1.0e6, 1.0e6),
            1.0e3,
            "reading here a square metre of the product of both displacements",
        ),
    ],
    threshold: false,
    physics: "y_i = x_i + square x_j^2 + product x_i x_j: the moving stage tilts as another axis moves, so that a gauge looks at \
              another point or at an angle. Instantaneous; a crosstalk whose share changes with where the stage is.",
    source: "sine and cosine errors of a displacement gauge that is off the axis of motion (Abbe), to second order",
    revealed_by: "one axis moved up and down with the others at two positions; twice its frequency in the others' readings",
    confused_with: &["sensor-crosstalk", "stiffness-coupling", "drive-crosstalk"],
};

struct Tilt {
    on: usize,
    from: usize,
    square_per_m: f64,
    product_per_m: f64,
}

impl SensorBlock for Tilt {
    fn read(&mut self, value_m: f64, bare_m: &[f64], _time_s: f64) -> f64 {
        let (own_m, other_m) = (bare_m[self.on], bare_m[self.from]);
        value_m + other_m * (self.square_per_m * other_m + self.product_per_m * own_m)
    }

    fn needs(&self) -> Option<usize> {
        Some(self.from)
    }
}

impl Effect for GaugeTilt {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let tilt = Tilt {
            on: place.on(),
            from: place.from(),
            square_per_m: values[0],
            product_per_m: values[1],
        };
        model.axes[place.on()].sensor.blocks.push(Box::new(tilt));
    }
}
