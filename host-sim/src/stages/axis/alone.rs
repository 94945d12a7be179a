//! Ticks of an axis that no spring ties to another one: the whole tick in one piece where no nonlinear force acts on it, which is what
//! nearly every simulation runs. `begin`, `solve`, `commit` give the same numbers to rounding and serve the rest.

use super::AxisSim;
use super::current::ByCurrent;
use crate::stages::amplifier::AmplifierSim;
use crate::stages::creep::CreepSim;
use crate::stages::hysteresis::{Branch, Elements, SlipElements};
use crate::stages::mechanism::LinearMechanism;

/// What a tick does at one level of stiffening, with everything that does not change multiplied out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tick {
    /// Displacement a volt of transducer voltage, m/V.
    per_volt: f64,
    /// Charge a volt of transducer voltage, F.
    capacitance_f: f64,
    /// Displacement a newton at the end of the tick, m/N.
    beta: f64,
    /// Displacement without transducer voltage from force, displacement and velocity before (two states).
    free: [f64; 3],
    /// Velocity from force, displacement and velocity before, and from force and displacement after (two states).
    velocity: [f64; 5],
}

/// Ticks for every level of a mechanism under a stack of so much transformer ratio (N/V) and capacitance (F); creep
/// multiplies what a volt does by `creeping`.
pub(super) fn ticks(
    mechanism: &LinearMechanism,
    transformer: f64,
    capacitance_f: f64,
    creeping: f64,
) -> Vec<Tick> {
    (0..mechanism.levels())
        .map(|level| {
            let m = mechanism.level(level);
            let beta = m.gamma1[0] * m.closing;
            let per_volt = beta * transformer * creeping;
            Tick {
                per_volt,
                capacitance_f: transformer * per_volt + capacitance_f,
                beta,
                free: [
                    m.gamma0[0] * m.closing,
                    (m.phi[0][0] + m.gamma0[0] * m.added_n_per_m) * m.closing,
                    m.phi[0][1] * m.closing,
                ],
                velocity: [
                    m.gamma0[1],
                    m.phi[1][0] + m.gamma0[1] * m.added_n_per_m,
                    m.phi[1][1],
                    m.gamma1[1],
                    m.gamma1[1] * m.added_n_per_m,
                ],
            }
        })
        .collect()
}

/// The capacitance that a stack shows its amplifier, worked out only if somebody asks.
#[derive(Debug, Clone, Copy)]
pub struct Load {
    /// Inverse capacitance of the stack when all elements slip, 1/F.
    pub free_elastance: f64,
    /// Slopes of the hysteresis voltage on the way down and up, V/C.
    pub tangents_v_per_c: [f64; 2],
}

impl Load {
    /// Large-signal capacitance on the way up or down, F. After a turn all elements hold: the stack takes less.
    #[inline]
    pub fn capacitance_f(self, rising: bool) -> f64 {
        1.0 / (self.free_elastance + self.tangents_v_per_c[usize::from(rising)])
    }
}

/// All of an axis but its elements.
struct Parts<'a> {
    amplifier: &'a mut AmplifierSim,
    mechanism: &'a mut LinearMechanism,
    creep: &'a mut CreepSim,
    by_current: &'a mut ByCurrent,
    ticks: &'a [Tick],
    levels_per_slope: f64,
    transformer: f64,
    skew_per_c: f64,
    imprint_v: f64,
    free_elastance: f64,
    output_v: &'a mut f64,
    transducer_v: &'a mut f64,
    force_n: &'a mut f64,
}

impl AxisSim {
    /// Whether a tick goes in one piece.
    #[inline]
    fn is_plain(&self) -> bool {
        self.forces.is_empty() && self.strain_loss.is_none()
    }

    /// Go through ticks without forces from outside. `output(amplifier, output_v, load)` is the amplifier's output
    /// at the end of a tick that begins at `output_v`; `reached(tick, position_m, output_v)` hears of that end.
    #[inline]
    pub fn follow(
        &mut self,
        ticks: usize,
        mut output: impl FnMut(&mut AmplifierSim, f64, Load) -> f64,
        mut reached: impl FnMut(usize, f64, f64),
    ) {
        if !self.is_plain() {
            for tick in 0..ticks {
                let (load, before_v) = (self.load(), self.output_v);
                let input_v = output(&mut self.amplifier, before_v, load);
                self.begin_at(input_v);
                self.solve(0.0);
                self.commit();
                reached(tick, self.position_m(), input_v);
            }
            return;
        }
        let two = self.mechanism.states() == 2;
        let parts = Parts {
            amplifier: &mut self.amplifier,
            mechanism: &mut self.mechanism,
            creep: &mut self.creep,
            by_current: &mut self.by_current,
            ticks: &self.ticks,
            levels_per_slope: self.levels_per_slope,
            transformer: self.transformer,
            skew_per_c: self.skew_per_c,
            imprint_v: self.imprint_v,
            free_elastance: self.free_elastance,
            output_v: &mut self.output_v,
            transducer_v: &mut self.transducer_v,
            force_n: &mut self.force_n,
        };
        match (&mut self.elements, two) {
            (Elements::Ladder(e), true) => parts.run::<_, true>(e, ticks, output, reached),
            (Elements::Ladder(e), false) => parts.run::<_, false>(e, ticks, output, reached),
            (Elements::Zones(e), true) => parts.run::<_, true>(e, ticks, output, reached),
            (Elements::Zones(e), false) => parts.run::<_, false>(e, ticks, output, reached),
            (Elements::Yielding(e), true) => parts.run::<_, true>(e, ticks, output, reached),
            (Elements::Yielding(e), false) => parts.run::<_, false>(e, ticks, output, reached),
        }
    }
}

impl Parts<'_> {
    #[inline(always)]
    fn run<E: SlipElements, const TWO_STATES: bool>(
        self,
        elements: &mut E,
        ticks: usize,
        mut output: impl FnMut(&mut AmplifierSim, f64, Load) -> f64,
        mut reached: impl FnMut(usize, f64, f64),
    ) {
        let creeping = !self.creep.is_empty();
        let (mut before_v, mut transducer_v) = (*self.output_v, *self.transducer_v);
        let mut force_n = *self.force_n;
        let [mut x, mut w] = self.mechanism.motion();
        let mut branch = Branch { skew_per_c: self.skew_per_c, ..Branch::default() };
        for tick in 0..ticks {
            let load = Load {
                free_elastance: self.free_elastance,
                tangents_v_per_c: [false, true].map(|rising| elements.tangent_towards(rising)),
            };
            let input_v = output(self.amplifier, before_v, load);
            let tangent = elements.tangent_towards(input_v >= before_v);
            // Through 32 bits: the processor has an instruction for that, and none for an unsigned number of 64.
            let level =
                ((tangent * self.levels_per_slope + 0.5) as i32 as usize).min(self.ticks.len() - 1);
            let constants = &self.ticks[level];
            let mut free = if TWO_STATES {
                let [force, position, velocity] = constants.free;
                force * force_n + position * x + velocity * w
            } else {
                self.mechanism.end_position(level, force_n).0
            };
            let (mut slow_v, mut slow_per_v) = (0.0, 0.0);
            if creeping {
                (slow_v, slow_per_v) = self.creep.begin(transducer_v);
                free += constants.beta * self.transformer * slow_v;
            }
            branch.charge_at_zero_c = self.transformer * free;
            branch.capacitance_f = constants.capacitance_f;
            branch.input_v = input_v - self.imprint_v;
            let change_v = input_v - before_v;
            self.by_current.begin(elements, &mut branch, transducer_v, change_v);
            transducer_v = self.by_current.solve(elements, &branch);
            elements.commit();
            self.by_current.commit();
            let position = free + constants.per_volt * transducer_v;
            let next_n = self.transformer * (transducer_v * (1.0 + slow_per_v) + slow_v);
            if TWO_STATES {
                let [f0, x0, w0, f1, x1] = constants.velocity;
                w = (f0 * force_n + x0 * x + w0 * w) + (f1 * next_n + x1 * position);
            } else {
                self.mechanism.advance(level, force_n, next_n, position);
            }
            x = position;
            if creeping {
                self.creep.commit(transducer_v);
            }
            force_n = next_n;
            before_v = input_v;
            reached(tick, x, input_v);
        }
        if TWO_STATES {
            self.mechanism.set_motion([x, w]);
        }
        (*self.output_v, *self.transducer_v, *self.force_n) = (before_v, transducer_v, force_n);
    }
}
