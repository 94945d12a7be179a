//! friction: the mechanism rubs.

use std::cell::Cell;

use super::{Effect, Info, Kind, Parameter, Place, Scope, Stage};
use crate::stages::model::{Force, Model};
use crate::stages::speed::EndSpeed;

/// Speed at which dry metal slides with next to nothing of what it took to break loose, m/s, before anybody knows. Canudas de Wit et al. (1995) simulate 1 mm/s;
/// a fit begun there does not get to 0.2 mm/s, and one begun here does.
const STRIBECK_M_PER_S: f64 = 3.0e-4;

/// Creeping speed at which friction is the same at all speeds, m/s.
const EVERY_SPEED_M_PER_S: f64 = 1.0e-8;

pub(super) struct Friction;

pub(super) const EFFECT: Friction = Friction;

static INFO: Info = Info {
    name: "friction",
    stage: Stage::Mechanism,
    kind: Kind::Structural,
    scope: Scope::Axis,
    parameters: &[
        Parameter::size("coulomb_n", "N", 0.0, (0.0, 1.0e5), 3.0, "friction once sliding"),
        Parameter::shape("presliding_m", "m", (1.0e-9, 1.0e-4), 1.0e-7, "displacement in which it builds up").by_ratio(),
        Parameter::shape("creeping_m_per_s", "m/s", (EVERY_SPEED_M_PER_S, 1.0e-1), EVERY_SPEED_M_PER_S, "speed below which it falls").by_ratio(),
        Parameter::shape("corner", "1", (0.0, 1.0), 0.0, "share of it that holds like a spring until it slips: 0 is Dahl's law, 1 a spring and a slider"),
        Parameter::shape("stribeck", "1", (0.0, 1.0), 0.0, "share by which it is larger at rest: what breaks loose over what slides, less one"),
        Parameter::shape("stribeck_m_per_s", "m/s", (1.0e-6, 1.0), STRIBECK_M_PER_S, "speed at which that is mostly gone").by_ratio(),
        Parameter::shape("spread_decades", "1", (0.0, 4.0), 0.0, "decades of displacement over which the corner's share slips, part after part; 0: all of it at once"),
    ],
    threshold: false,
    physics: "Dahl: dF/dx = -(coulomb/presliding) (1 + F sgn(dx)/coulomb), so after a reversal the force goes to the other \
              side within a few presliding lengths, whatever the stroke; presliding -> 0 is Coulomb. In closed form over a \
              tick, so it does not depend on the step. The level is coulomb tanh(v/creeping): a lubricated guide \
              rubs less the slower it goes; at the smallest creeping speed it is the same at all speeds. The corner's share is that of a \
              spring of coulomb/presliding in series with a slider (Jenkins), which gives way at once. \
              What rubs dry takes more to break loose than to slide (Stribeck): the level grows by stribeck exp(-(v/stribeck_m_per_s)^2), by the speed of the tick \
              before, which the force follows in its presliding length. \
              Many contacts slip one after the other (Iwan; Maxwell slip): the corner's share is then eight sliders of equal force, each behind a spring that \
              gives until it slips, in lengths an eighth of spread_decades apart, presliding in the middle.",
    source: "Dahl, 1968; G. M. Jenkins, Br. J. Appl. Phys. 13, 30, 1962; Coulomb's level made smooth with a hyperbolic tangent; Canudas de Wit et al., IEEE Trans. Autom. Control 40, 419, 1995 (level of LuGre's law); W. D. Iwan, J. Appl. Mech. 33, 893, 1966; a touching cable, a guide or a stop; loop height constant in force (notes/gap.md, section 3)",
    revealed_by: "slow triangles at small and large strokes: the same step at each reversal",
    confused_with: &["hysteresis-shape", "preload-loss", "hysteresis-rate"],
};

/// Multiple of the creeping speed at which the hyperbolic tangent is 1 to the last bit.
const SATURATED: f64 = 20.0;
/// Presliding lengths after which nothing is left of the force before, to the last bit of the one after.
const FORGOTTEN: f64 = 40.0;
/// Sliders of a friction whose presliding lengths are spread.
const SLIDERS: usize = 8;

/// Forces of a friction, N.
#[derive(Clone, Copy, Default)]
struct Forces {
    /// What yields ever more before it slips.
    yields_n: f64,
    /// What holds until it slips, slider by slider.
    hold_n: [f64; SLIDERS],
}

struct Dahl {
    coulomb_n: f64,
    presliding_m: f64,
    /// Displacement in which each slider comes to slip, m; one of them, or all.
    slip_m: [f64; SLIDERS],
    sliders: usize,
    creeping_m_per_s: f64,
    /// Share that holds until it slips.
    corner: f64,
    /// By how much of itself it is larger at rest, and the speed at which that is gone, m/s.
    stribeck: (f64, f64),
    /// Level over that of fast sliding, in this tick.
    grown: f64,
    /// Speed in the tick before, m/s.
    was_m_per_s: f64,
    step_s: f64,
    speed: EndSpeed,
    forces: Forces,
    at_m: f64,
    /// Displacement that was looked at last in this tick, and the forces there.
    last: Cell<(f64, Forces)>,
}

impl Force for Dahl {
    fn start(&mut self, _time_s: f64) {
        (self.step_s, self.forces, self.speed) = (0.0, Forces::default(), EndSpeed::default());
        (self.was_m_per_s, self.grown) = (0.0, 1.0 + self.stribeck.0);
    }

    fn begin(&mut self, step_s: f64) {
        self.step_s = step_s;
        self.last.set((f64::NAN, Forces::default()));
        // By the speed of this tick there would be more than one answer where it falls faster than the stage is stiff.
        if self.stribeck.0 > 0.0 {
            let share = self.was_m_per_s / self.stribeck.1;
            self.grown = 1.0 + self.stribeck.0 * (-share * share).exp();
        }
    }

    fn force(&self, x_m: f64) -> (f64, f64) {
        let travel = x_m - self.at_m;
        let (level, rise) = if self.step_s > 0.0 {
            let creeping_m = self.creeping_m_per_s * self.step_s;
            if self.speed.is_beyond(travel, SATURATED * creeping_m) {
                (1.0_f64.copysign(travel), 0.0)
            } else {
                let (speed, faster) = self.speed.at(travel);
                let level = (speed / creeping_m).tanh();
                let steep = self.coulomb_n * self.grown * (1.0 - level * level);
                (level, steep / creeping_m * faster)
            }
        } else {
            // On the way to rest there is no speed to fall with.
            (1.0_f64.copysign(travel), 0.0)
        };
        let coulomb_n = self.coulomb_n * self.grown;
        let (yields_n, holds_n) = ((1.0 - self.corner) * coulomb_n, self.corner * coulomb_n);
        let gone = travel.abs() / self.presliding_m;
        let kept = if gone > FORGOTTEN { 0.0 } else { (-gone).exp() };
        let left = (self.forces.yields_n + yields_n * level) * kept;
        // Where the level falls faster than the force follows, the slope is taken for none, so that a tangent points to the side of the
        // answer.
        let holding = (left * travel.signum()).max(0.0) / self.presliding_m;
        let mut forces = Forces { yields_n: left - yields_n * level, ..Forces::default() };
        let mut sum_n = forces.yields_n;
        let mut slope = -rise * (1.0 - self.corner) * (1.0 - kept) - holding;
        if holds_n > 0.0 {
            let share = 1.0 / self.sliders as f64;
            // What holds at every speed holds at rest.
            let (most, rise) = if self.goes_with_time() {
                (holds_n * share * level.abs(), rise * self.corner * share)
            } else {
                (holds_n * share, 0.0)
            };
            for (slider, slip_m) in self.slip_m[..self.sliders].iter().enumerate() {
                let stiffness = self.corner * self.coulomb_n * share / slip_m;
                let held = self.forces.hold_n[slider] - stiffness * travel;
                let holds_n = held.max(-most).min(most);
                forces.hold_n[slider] = holds_n;
                sum_n += holds_n;
                slope -= if holds_n == held { stiffness } else { rise };
            }
        }
        self.last.set((x_m, forces));
        (sum_n, slope)
    }

    fn commit(&mut self, x_m: f64, step_s: f64) {
        if step_s > 0.0 {
            // Where a tick was solved is mostly where it was looked at last.
            if self.last.get().0 != x_m {
                self.force(x_m);
            }
            self.forces = self.last.get().1;
            self.speed.commit(x_m - self.at_m);
            self.was_m_per_s = (x_m - self.at_m) / step_s;
        }
        self.at_m = x_m;
    }

    fn rubs(&self) -> bool {
        true
    }

    fn goes_with_time(&self) -> bool {
        self.creeping_m_per_s > EVERY_SPEED_M_PER_S
    }
}

impl Effect for Friction {
    fn info(&self) -> &'static Info {
        &INFO
    }

    fn apply(&self, values: &[f64], place: Place, model: &mut Model, _step_s: f64) {
        let spread = values[6];
        let sliders = if spread > 0.0 { SLIDERS } else { 1 };
        // Each in the middle of its part of the decades.
        let decades = |slider: usize| spread * ((slider as f64 + 0.5) / sliders as f64 - 0.5);
        model.axes[place.on()].mechanism.forces.push(Box::new(Dahl {
            coulomb_n: values[0],
            presliding_m: values[1],
            slip_m: std::array::from_fn(|slider| values[1] * 10f64.powf(decades(slider))),
            sliders,
            creeping_m_per_s: values[2],
            corner: values[3],
            stribeck: (values[4], values[5]),
            grown: 1.0 + values[4],
            was_m_per_s: 0.0,
            step_s: 0.0,
            speed: EndSpeed::default(),
            forces: Forces::default(),
            at_m: 0.0,
            last: Cell::new((f64::NAN, Forces::default())),
        }));
    }
}
