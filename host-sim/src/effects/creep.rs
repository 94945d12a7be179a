//! creep: the stack goes on growing with the logarithm of time.

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Kelvin, Model};

pub(super) struct Creep;

pub(super) const EFFECT: Creep = Creep;

static INFO: Info = Info {
    name: "creep",
    stage: Stage::Piezo,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("per_decade", "1", 0.0, (0.0, 0.3), 0.015, "growth of the stroke a decade of time"),
        Parameter::shape("onset_s", "s", (1.0e-4, 10.0), 0.02, "time after a step from which it goes with the logarithm").by_ratio(),
        Parameter::size("level", "1", 0.0, (-0.3, 2.0), 0.2, "share by which a step from 0 V to 100 V creeps more than in proportion to a small one"),
        Parameter::size("tilt", "1", 0.0, (-0.5, 0.5), 0.05, "power of the time that a decade's growth goes with; 0 is the logarithm"),
        Parameter::shape(
            "sharp",
            "1",
            (0.0, 1.0),
            0.0,
            "1: slow strains of one size from the onset on and none faster; 0: ever smaller ones below it, as the logarithm has them; between: a share of both",
        ),
    ],
    threshold: false,
    physics: "A step of the transducer voltage goes on as x(t) = x0 (1 + per_decade lg(1 + t/onset)): domains that switch \
              late. Built as a chain of slow strains in front of the stack's stiffness, two a decade up to \
              1e5 onset, each exact over a tick. A stack may creep by such a chain itself, of strains alike that begin sharply. Restarts at every step, in proportion to it, or, with level, to v (1 + level |v|/100 V); with tilt a \
              decade's growth goes with its time/1 s to this power. Draws charge.",
    source: "1 to 2 % a decade from 0.1 s (notes/physics.md, sections 2 and 4, S13)",
    revealed_by: "steps held for ten seconds and more, at two heights",
    confused_with: &["viscoelasticity", "sensor-drift", "hysteresis-rate"],
};

/// Slow strains a decade of time constants.
const PER_DECADE: f64 = 2.0;
/// Slow strains, from a third of the onset to 1e5 times the onset.
const STRAINS: i32 = 12;
/// Those faster than the onset.
const FASTER: i32 = 1;

impl Effect for Creep {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let [per_decade, onset_s, level, tilt, sharp] = values[..5] else { return };
        // ln(1 + t/onset) is the integral of (1 - e^(-t/tau)) e^(-onset/tau) over ln tau.
        let strains = (-FASTER..STRAINS - FASTER).map(|j| {
            let ratio = 10f64.powf(f64::from(j) / PER_DECADE);
            let time_constant_s = onset_s * ratio;
            let growth = per_decade * time_constant_s.powf(tilt) / PER_DECADE;
            let of_the_logarithm = (-1.0 / ratio).exp();
            let from_the_onset = if j < 0 { 0.0 } else { 1.0 };
            let share = growth * (of_the_logarithm + sharp * (from_the_onset - of_the_logarithm));
            Kelvin { share, time_constant_s }
        });
        let strains = strains.filter(|strain| strain.share != 0.0);
        let piezo = &mut model.axes[place.on()].piezo;
        piezo.creep.extend(strains);
        piezo.creep_level_per_v = level / 100.0;
    }
}
