//! One axis from amplifier output to displacement, a tick at a time.
//!
//! A tick is `begin` (the amplifier goes to its output at the end), `solve` (charge and displacement at the end, any
//! number of times while neighbours are being solved), `commit`.

mod alone;
mod current;
mod steps;
mod strain_loss;

use super::amplifier::AmplifierSim;
use super::creep::CreepSim;
use super::hysteresis::{Branch, Elements, SlipElements};
use super::mechanism::LinearMechanism;
use super::model::{AxisModel, Force};
use crate::start::{Initial, Memory};

pub use alone::Load;
use current::ByCurrent;
use steps::{Steps, stiffening};
use strain_loss::StrainLossSim;

/// What the forces may differ by from those that were solved for, as the displacement that it makes, m.
const FORCE_TOLERANCE_M: f64 = 1.0e-15;
/// Farthest that an axis is expected to go in a tick, m.
const FARTHEST_M: f64 = 1.0e-5;
/// Change of displacement at which a place of rest is found, m.
const REST_M: f64 = 1.0e-15;

/// One axis with its state.
pub struct AxisSim {
    /// From command to amplifier output.
    pub amplifier: AmplifierSim,
    elements: Elements,
    mechanism: LinearMechanism,
    forces: Vec<Box<dyn Force>>,
    creep: CreepSim,
    by_current: ByCurrent,
    transformer: f64,
    capacitance: f64,
    strain_loss: Option<StrainLossSim>,
    skew_per_c: f64,
    imprint_v: f64,
    step_s: f64,
    levels_per_slope: f64,
    free_elastance: f64,
    ticks: Vec<alone::Tick>,
    /// What a leap of several ticks does; while leaping, what a step does.
    other: Option<Box<Steps>>,
    leap: Option<usize>,
    is_leaping: bool,
    // State at the start of the tick.
    output_v: f64,
    transducer_v: f64,
    force_n: f64,
    /// Displacements of the last tick and of the one before it, m.
    travels_m: [f64; 2],
    // Of the tick being solved.
    input_v: f64,
    level: usize,
    free_m: f64,
    beta: f64,
    slow_v: f64,
    slow_per_v: f64,
    branch: Branch,
    next_transducer_v: f64,
    next_position_m: f64,
    next_force_n: f64,
}

impl AxisSim {
    /// Build from a model, which gives up its blocks, for ticks of `tick_s` in so many sub-steps, and for leaps of so many ticks.
    pub fn new(model: AxisModel, tick_s: f64, substeps: usize, leap: Option<usize>) -> Self {
        let step_s = tick_s / substeps as f64;
        let added = stiffening(&model);
        let shape_s = model.amplifier.time_constant_s;
        let Steps { mechanism, creep, ticks, .. } = Steps::new(&model, step_s, shape_s, &added);
        let leap = leap.filter(|_| !model.follows_every_tick());
        // Over several calm ticks an amplifier goes straight.
        let other = leap.map(|ticks| {
            let shape_s = if ticks > 1 { f64::INFINITY } else { shape_s };
            Box::new(Steps::new(&model, ticks as f64 * tick_s, shape_s, &added))
        });
        let mut piezo = model.piezo;
        let all_slopes = piezo.steepest_v_per_c();
        let top = (added.len() - 1) as f64;
        let square = piezo.transformer_n_per_v * piezo.transformer_n_per_v;
        let free_elastance = 1.0 / (piezo.capacitance_f + square * mechanism.compliance_m_per_n());
        let by_current = ByCurrent::new(&mut piezo, free_elastance, step_s, shape_s);
        Self {
            ticks,
            other,
            leap,
            is_leaping: false,
            free_elastance,
            level: 0,
            levels_per_slope: if all_slopes > 0.0 { top / all_slopes } else { 0.0 },
            elements: Elements::new(
                &piezo.slopes_v_per_c,
                &piezo.limits_v,
                by_current.has_law(),
                (piezo.element_yield, piezo.element_recoil),
                piezo.loop_beside,
            ),
            mechanism,
            forces: model.mechanism.forces,
            creep,
            by_current,
            transformer: piezo.transformer_n_per_v,
            capacitance: piezo.capacitance_f,
            strain_loss: piezo
                .strain_loss
                .map(|loss| StrainLossSim::new(loss, piezo.transformer_n_per_v, step_s, shape_s)),
            skew_per_c: piezo.skew_per_c,
            imprint_v: piezo.imprint_v,
            step_s,
            amplifier: AmplifierSim::new(model.drive, model.amplifier, step_s),
            output_v: 0.0,
            transducer_v: 0.0,
            force_n: 0.0,
            travels_m: [0.0; 2],
            input_v: 0.0,
            free_m: 0.0,
            beta: 0.0,
            slow_v: 0.0,
            slow_per_v: 0.0,
            branch: Branch::default(),
            next_transducer_v: 0.0,
            next_position_m: 0.0,
            next_force_n: 0.0,
        }
    }

    /// Ticks that it can leap, if it can.
    #[inline]
    pub fn leap(&self) -> Option<usize> {
        self.leap
    }

    /// Go on in leaps, or in steps again.
    #[inline]
    pub fn set_leaping(&mut self, is_leaping: bool) {
        if self.is_leaping == is_leaping {
            return;
        }
        let Some(other) = self.other.as_deref_mut() else { return };
        self.is_leaping = is_leaping;
        let longer = other.step_s / self.step_s;
        self.travels_m.iter_mut().for_each(|travel| *travel *= longer);
        other.mechanism.take_over(&self.mechanism);
        other.creep.take_over(&self.creep);
        std::mem::swap(&mut self.mechanism, &mut other.mechanism);
        std::mem::swap(&mut self.creep, &mut other.creep);
        std::mem::swap(&mut self.ticks, &mut other.ticks);
        std::mem::swap(&mut self.step_s, &mut other.step_s);
    }

    /// Come to rest at an initial state, with `target_v` asked of the amplifier; `output_v` overrides its output.
    pub fn start(&mut self, initial: &Initial, target_v: f64, time_s: f64, output_v: Option<f64>) {
        self.travels_m = [0.0; 2];
        self.by_current.start(output_v.is_some());
        self.amplifier.start(initial.amplifier_v.unwrap_or(target_v), target_v);
        self.output_v = output_v.unwrap_or_else(|| self.amplifier.output_v(time_s));
        match &initial.memory {
            Memory::Virgin => self.elements.set_voltages(|_, _, _| 0.0),
            Memory::Swept(charge) => self.elements.set_voltages(|slope, _, _| slope * charge),
            Memory::Elements(volts) => {
                self.elements.set_voltages(|_, _, i| volts.get(i).copied().unwrap_or(0.0));
            }
        }
        self.creep.settle(initial.held_v, initial.past.as_deref().unwrap_or_default());
        self.forces.iter_mut().for_each(|force| force.start(time_s));
        self.rest(0.0);
        for force in &mut self.forces {
            force.commit(self.mechanism.position_m(), 0.0);
        }
        self.rest(0.0);
    }

    /// Find the resting place at the present output voltage and memory under a force from outside, N.
    pub fn rest(&mut self, outside_n: f64) {
        let slow = self.creep.sum_v();
        let mut charge = 0.0;
        for _ in 0..100 {
            let before = (charge, self.mechanism.position_m());
            let weight = 1.0 + self.skew_per_c * charge;
            self.transducer_v = self.output_v - self.imprint_v - self.elements.sum_v() * weight;
            let (pushed, slope) = self.forces_at(before.1);
            let stiffness = 1.0 / self.mechanism.compliance_m_per_n();
            let driven = self.transformer * (self.transducer_v + slow) + outside_n;
            let x = (driven + pushed - slope * before.1) / (stiffness - slope);
            self.force_n = x * stiffness;
            self.mechanism.rest_under(self.force_n);
            charge = self.transformer * x + self.capacitance * self.transducer_v;
            if (x - before.1).abs() <= REST_M && (charge - before.0).abs() <= 1.0e-18 {
                break;
            }
        }
        self.elements.set_charge(charge);
        if let Some(loss) = &mut self.strain_loss {
            loss.rest(charge);
        }
    }

    /// Output of the amplifier at this tick, V.
    #[inline]
    pub fn output_v(&self) -> f64 {
        self.output_v
    }

    /// Displacement at this tick, m.
    #[inline]
    pub fn position_m(&self) -> f64 {
        self.mechanism.position_m()
    }

    /// Displacement at the end of the tick as last solved, m.
    #[inline]
    pub fn next_position_m(&self) -> f64 {
        self.next_position_m
    }

    /// The state at this tick, to start from later.
    pub fn state(&self) -> Initial {
        Initial {
            amplifier_v: Some(self.amplifier.state_v()),
            memory: Memory::Elements(self.elements.voltages()),
            held_v: self.creep.held_v().unwrap_or(self.transducer_v),
            past: None,
        }
    }

    /// Send a target to the amplifier for the tick that ends at `time_s`.
    #[inline]
    pub fn begin(&mut self, target_v: f64, time_s: f64) {
        let load = self.load();
        let output_v = self.amplifier.advance(target_v, load, time_s);
        self.begin_at(output_v);
    }

    /// Begin a tick at whose end the amplifier's output is known.
    #[inline]
    pub fn begin_at(&mut self, output_v: f64) {
        self.input_v = output_v;
        let tangent = self.elements.tangent_towards(output_v >= self.output_v);
        let level = (tangent * self.levels_per_slope + 0.5) as usize;
        self.level = level.min(self.mechanism.levels() - 1);
        (self.free_m, self.beta) = self.mechanism.end_position(self.level, self.force_n);
        self.next_position_m = self.mechanism.position_m() + self.expected_m();
        let step_s = self.step_s;
        self.forces.iter_mut().for_each(|force| force.begin(step_s));
        if !self.creep.is_empty() {
            (self.slow_v, self.slow_per_v) = self.creep.begin(self.transducer_v);
        }
        let per_volt = self.beta * self.transformer * (1.0 + self.slow_per_v);
        self.branch.capacitance_f = self.transformer * per_volt + self.capacitance;
        self.branch.input_v = output_v - self.imprint_v;
        self.branch.skew_per_c = self.skew_per_c;
        let change_v = output_v - self.output_v;
        let (elements, branch) = (&mut self.elements, &mut self.branch);
        self.by_current.begin(elements, branch, self.transducer_v, change_v);
    }

    /// Displacement of a tick that goes on as the two before it, m.
    #[inline]
    fn expected_m(&self) -> f64 {
        let [last_m, before_m] = self.travels_m;
        let expected_m = 2.0 * last_m - before_m;
        // Where a spring that gives way lets the axis run away, the answer near by is looked for.
        if expected_m.abs() < FARTHEST_M { expected_m } else { 0.0 }
    }

    /// Solve for the end of the tick under a force from outside, N; returns the displacement there.
    #[inline]
    pub fn solve(&mut self, outside_n: f64) -> f64 {
        let beta = self.beta;
        let free = self.free_m + beta * (self.transformer * self.slow_v + outside_n);
        let per_volt = beta * self.transformer * (1.0 + self.slow_per_v);
        let forces_n = if self.forces.is_empty() {
            self.solve_linear(free, per_volt, beta);
            0.0
        } else {
            self.solve_with_forces(free, per_volt, beta)
        };
        let driven = self.next_transducer_v * (1.0 + self.slow_per_v) + self.slow_v;
        let lost_n = self.strain_loss.as_ref().map_or(0.0, |loss| loss.next_force_n());
        self.next_force_n = self.transformer * driven + forces_n + lost_n + outside_n;
        self.next_position_m
    }

    /// Newton on the displacement, with the forces taken by their tangent, inside a bracket.
    ///
    /// It begins where the axis would be if it went on as in the tick before, and ends where the forces are those of the tangents:
    /// of most ticks that takes two values of each force. A force that gives way over nanometres (friction at a reversal) is steep where
    /// the tick begins and flat where it ends: tangents from the steep side gain one such length a round. So after a few rounds the
    /// flat side is asked.
    fn solve_with_forces(&mut self, free_m: f64, per_volt: f64, beta: f64) -> f64 {
        const PATIENCE: usize = 3;
        let mut x = self.next_position_m;
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        let (mut value, mut slope) = self.forces_at(x);
        let mut force = 0.0;
        for round in 0..50 {
            force = self.solve_tangent(x, (value, slope), free_m, per_volt, beta);
            let mut next = self.next_position_m;
            let there = self.forces_at(next);
            // What moves the axis by less than this was solved for.
            if ((there.0 - force) * beta).abs() <= FORCE_TOLERANCE_M || next == x {
                break;
            }
            // All of this rises with the displacement, so a tangent points to the side of the answer.
            if next > x {
                low = low.max(x)
            } else {
                high = high.min(x)
            }
            let mut is_known = true;
            if round == PATIENCE {
                self.solve_tangent(x, (value, 0.0), free_m, per_volt, beta);
                let far = self.next_position_m;
                let of_far = self.forces_at(far);
                self.solve_tangent(far, of_far, free_m, per_volt, beta);
                let back = self.next_position_m;
                if back > low && back < high && (back - x).abs() > (next - x).abs() {
                    (next, is_known) = (back, false);
                }
            }
            if !(next > low && next < high) {
                (next, is_known) = (0.5 * (low + high), false);
            }
            (value, slope) = if is_known { there } else { self.forces_at(next) };
            x = next;
        }
        force
    }

    /// Solve with the forces by a line through their value and slope at `x_m`; the force at the answer.
    fn solve_tangent(
        &mut self,
        x_m: f64,
        (value, slope): (f64, f64),
        free_m: f64,
        per_volt: f64,
        beta: f64,
    ) -> f64 {
        let stiffer = 1.0 - beta * slope;
        let base = value - slope * x_m;
        self.solve_linear((free_m + beta * base) / stiffer, per_volt / stiffer, beta / stiffer);
        base + slope * self.next_position_m
    }

    /// Solve where a volt of transducer voltage moves `per_volt` and a newton `beta`.
    #[inline]
    fn solve_linear(&mut self, free_m: f64, per_volt: f64, beta: f64) {
        let branch = Branch {
            charge_at_zero_c: self.transformer * free_m,
            capacitance_f: self.transformer * per_volt + self.capacitance,
            ..self.branch
        };
        let lost_n = match self.strain_loss {
            Some(loss) => self.solve_with_loss(loss, &branch, beta),
            None => {
                self.next_transducer_v = self.by_current.solve(&mut self.elements, &branch);
                0.0
            }
        };
        self.next_position_m = free_m + per_volt * self.next_transducer_v + beta * lost_n;
    }

    /// First with the loss held, which says how the charge goes without it; then with what comes of that, until the charge is where the loss
    /// has it. The force of the loss.
    fn solve_with_loss(&mut self, mut loss: StrainLossSim, branch: &Branch, beta: f64) -> f64 {
        let per_newton_c = self.transformer * beta;
        let charge_under = |sim: &mut Self, force_n: f64| {
            let charge_at_zero_c = branch.charge_at_zero_c + per_newton_c * force_n;
            let branch = Branch { charge_at_zero_c, ..*branch };
            sim.next_transducer_v = sim.by_current.solve(&mut sim.elements, &branch);
            branch.charge_at_zero_c + branch.capacitance_f * sim.next_transducer_v
        };
        let held_n = loss.held_n();
        let held_c = charge_under(self, held_n);
        let tangent = self.elements.tangent_towards(held_c >= self.elements.charge_c());
        let mut drawn_c = per_newton_c / (1.0 + branch.capacitance_f * tangent);
        let mut lost_n = held_n;
        for _ in 0..StrainLossSim::ROUNDS {
            lost_n = loss.solve(held_c, drawn_c);
            let (change_n, expected_c) = (lost_n - held_n, held_c + drawn_c * (lost_n - held_n));
            let charge_c = charge_under(self, lost_n);
            loss.reached(charge_c);
            if (charge_c - expected_c).abs() <= StrainLossSim::TOLERANCE_C {
                break;
            }
            // More than the whole stack can give no newton draws, and less than none neither.
            let next_c = (charge_c - held_c) / change_n;
            if !next_c.is_finite() {
                break;
            }
            drawn_c = next_c.max(0.0).min(per_newton_c);
        }
        self.strain_loss = Some(loss);
        lost_n
    }

    /// Accept the tick that was last solved.
    #[inline]
    pub fn commit(&mut self) {
        self.elements.commit();
        self.by_current.commit();
        let travel_m = self.next_position_m - self.mechanism.position_m();
        self.travels_m = [travel_m, self.travels_m[0]];
        self.mechanism.advance(self.level, self.force_n, self.next_force_n, self.next_position_m);
        if !self.creep.is_empty() {
            self.creep.commit(self.next_transducer_v);
        }
        for force in &mut self.forces {
            force.commit(self.next_position_m, self.step_s);
        }
        if let Some(loss) = &mut self.strain_loss {
            loss.commit();
        }
        self.force_n = self.next_force_n;
        self.transducer_v = self.next_transducer_v;
        self.output_v = self.input_v;
    }

    /// How far a newton at the end of the tick that has begun moves the axis there as its mechanism alone holds it, m/N.
    #[inline]
    pub fn metres_per_newton(&self) -> f64 {
        self.beta
    }

    /// How far a volt moves the axis at rest on the branch that it is on, m/V; 0 where forces have a say in it.
    #[inline]
    pub fn metres_per_volt(&self) -> f64 {
        if !self.forces.is_empty() {
            return 0.0;
        }
        let per_charge_branch = 1.0 + self.elements.tangent_v_per_c() / self.free_elastance;
        self.mechanism.compliance_m_per_n() * self.transformer / per_charge_branch
    }

    /// What the stack shows the amplifier.
    pub fn load(&self) -> Load {
        Load {
            free_elastance: self.free_elastance,
            tangents_v_per_c: [false, true].map(|rising| self.elements.tangent_towards(rising)),
        }
    }

    fn forces_at(&self, x: f64) -> (f64, f64) {
        self.forces
            .iter()
            .map(|force| force.force(x))
            .fold((0.0, 0.0), |(f, s), (g, t)| (f + g, s + t))
    }
}
