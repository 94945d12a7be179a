//! amplifier-current-limit: the output current ends, so the output voltage of a capacitive load becomes a ramp.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Model, SlewLimit};

pub(super) struct AmplifierCurrentLimit;

pub(super) const EFFECT: AmplifierCurrentLimit = AmplifierCurrentLimit;

static INFO: Info = Info {
    name: "amplifier-current-limit",
    stage: Stage::Amplifier,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("current_a", "A", 100.0, (1.0e-4, 100.0), 0.1, "largest current; 100 A is none").by_ratio(),
        Parameter::shape(
            "stack_share",
            "1",
            (0.0, 1.0),
            0.0,
            "0: load of the stack's small-signal capacitance; 1: of the capacitance it shows on the way that it goes: less after a turn, more once its elements slip",
        ),
        Parameter::shape("sink_ratio", "1", (0.1, 10.0), 1.0, "current sunk over current sourced").by_ratio(),
        Parameter::shape("knee", "1", (0.0, 1.0), 0.0, "how early the current falls behind: 0 a corner, 1 from the start"),
    ],
    threshold: true,
    physics: "dv/dt is held to I/C on the way to the target: full current until the first-order approach needs less. \
              Large fast moves become ramps, small ones stay exponential. An output stage that runs out of current by and by has a knee: \
              dv/dt = I/C u (1 + u^(1/knee))^-knee with u the slope that the first order asks for, in units of I/C.",
    source: "ENV 400: 60 W / 150 V = 0.4 A; 286 V/ms into 1.4 uF, 190 V/ms into 2.1 uF (notes/physics.md, section 4)",
    revealed_by: "steps and fast triangles at two amplitudes; the monitor",
    confused_with: &["amplifier-bandwidth", "amplifier-clipping"],
};

struct CurrentLimit {
    current_a: f64,
    sink_ratio: f64,
    load_f: f64,
    stack_share: f64,
    knee: f64,
}

impl SlewLimit for CurrentLimit {
    fn limits_v_per_s(&self, stack_f: f64) -> (f64, f64) {
        let load_f = self.load_f + self.stack_share * (stack_f - self.load_f);
        let up = self.current_a / load_f;
        (up * self.sink_ratio, up)
    }

    fn knee(&self) -> f64 {
        self.knee
    }
}

impl Effect for AmplifierCurrentLimit {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let axis = &mut model.axes[place.on()];
        let piezo = &axis.piezo;
        let stiffness = piezo.stiffness_n_per_m + axis.mechanism.stiffness_n_per_m;
        let unhysteretic_f =
            piezo.capacitance_f + piezo.transformer_n_per_v * piezo.transformer_n_per_v / stiffness;
        let load_f = 1.0 / (1.0 / unhysteretic_f + piezo.slopes_v_per_c.iter().sum::<f64>());
        axis.amplifier.slew = Some(Box::new(CurrentLimit {
            current_a: values[0],
            stack_share: values[1],
            sink_ratio: values[2],
            knee: values[3],
            load_f,
        }));
    }
}
