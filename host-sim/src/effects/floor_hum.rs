//! floor-hum: the stage is shaken. Not in the catalogue: what a diagnosis must not take for the hum of a gauge or an amplifier.

use super::hum::{self, Hum};
use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Force, Model};

pub(super) struct FloorHum;

pub(super) const EFFECT: FloorHum = FloorHum;

const NAMES: [&str; 6] =
    ["cos_n", "sin_n", "second_cos_n", "second_sin_n", "third_cos_n", "third_sin_n"];
static PARAMETERS: [Parameter; hum::COUNT] = hum::parameters(NAMES, "N", 1.0e4, 1.0);

static INFO: Info = Info {
    name: "floor-hum",
    stage: Stage::Environment,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &PARAMETERS,
    threshold: false,
    physics: "F = cos_n cos(w t) + sin_n sin(w t) and the same at 2 w and 3 w on the mechanism, t on the session's clock: a pump or a fan on the same \
              table. It moves the stage, and by its charge the stack, whose memory then depends on where in the period it turned.",
    source: "inertial force of the moving mass under a floor that accelerates, F = -m a",
    revealed_by: "rest after an excursion: the place where the stack comes to rest differs from time to time; absent from the monitor",
    confused_with: &["sensor-hum", "amplifier-hum"],
};

struct Shaking {
    hum: Hum,
    /// End of the tick being solved, s.
    end_s: f64,
    force_n: f64,
}

impl Force for Shaking {
    fn start(&mut self, time_s: f64) {
        self.end_s = time_s;
        self.force_n = self.hum.at(time_s);
    }

    fn begin(&mut self, step_s: f64) {
        self.end_s += step_s;
        self.force_n = self.hum.at(self.end_s);
    }

    fn force(&self, _x_m: f64) -> (f64, f64) {
        (self.force_n, 0.0)
    }

    fn goes_with_time(&self) -> bool {
        true
    }
}

impl Effect for FloorHum {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let hum = Hum::new(values);
        model.axes[place.on()].mechanism.forces.push(Box::new(Shaking {
            hum,
            end_s: 0.0,
            force_n: 0.0,
        }));
    }
}
