//! What of the hysteresis depends on the current: limits that grow with it, and a loss in series with the elements.

use crate::stages::hysteresis::{Branch, SlipElements};
use crate::stages::model::{LOSS_AT_A, PiezoModel, RateLaw};

/// Time in which growth follows the current, s: a sample at 10 kHz. The current of an amplifier that is told another voltage jumps; no
/// recording shows how much faster the walls of domains are.
const FOLLOWS_S: f64 = 1.0e-4;
/// Growth does not follow the current through zero any closer than it comes on the average of this time, s: after an edge it is through in
/// microseconds.
const BRIEF_S: f64 = 4.0e-6;
/// Ticks longer than so many time constants of the amplifier do not say when in them it moved: it is taken to go straight.
const LONG: f64 = 8.0;

/// Growing limits and loss of one stack, as far as it has them.
pub(super) struct ByCurrent {
    law: Option<Box<dyn RateLaw>>,
    drag: Drag,
    /// The loss over what the elements have yet to go of this tick, if they have been taken through a part of it.
    rest: Option<Drag>,
    /// What a stack takes whose elements all slip, F.
    capacitance_f: f64,
    through: Through,
    /// The same where the output is known from tick to tick.
    straight: Through,
    is_straight: bool,
    /// Change of the output that the growth follows, V/s.
    speed_v_per_s: f64,
}

/// How the output goes through a tick, exponentially, and what follows its speed.
#[derive(Debug, Clone, Copy)]
struct Through {
    step_s: f64,
    /// Time constant of the output, s.
    shape_s: f64,
    /// Share of the way to where the output would end that it goes in a tick.
    all: f64,
    /// Share of the speed before the tick that is left after it, and speed a volt of change there, 1/s.
    end: (f64, f64),
}

impl Through {
    /// In a tick of `step_s` with a time constant of `shape_s`.
    fn new(step_s: f64, shape_s: f64) -> Self {
        if step_s > LONG * shape_s {
            return Self::straight(step_s);
        }
        // A hundredth apart: of equal ones the formula is 0 by 0.
        let near = (shape_s / FOLLOWS_S - 1.0).abs() < 0.01;
        let shape_s = if near { 1.01 * FOLLOWS_S } else { shape_s };
        let all = -(-step_s / shape_s).exp_m1();
        let [tail, left] = [shape_s, FOLLOWS_S].map(|time_s| (-step_s / time_s).exp());
        let per_v = (tail - left) / (all * (shape_s - FOLLOWS_S));
        Self { step_s, shape_s, all, end: (left, per_v) }
    }

    /// As good as straight.
    fn straight(step_s: f64) -> Self {
        Self::new(step_s, 1.0e3 * step_s.max(FOLLOWS_S))
    }

    /// When a speed is zero that begins at `before`, s, and how fast it goes through, V/s^2.
    fn turn(&self, before: f64, change_v: f64) -> (f64, f64) {
        let towards = change_v / (self.all * (self.shape_s - FOLLOWS_S));
        let sooner = 1.0 / FOLLOWS_S - 1.0 / self.shape_s;
        let turn_s = (1.0 - before / towards).max(f64::MIN_POSITIVE).ln() / sooner;
        (turn_s, towards * sooner * (-turn_s / self.shape_s).exp())
    }

    /// Share of the change that is done after a share of the time.
    fn done(&self, share: f64) -> f64 {
        -(-share * self.step_s / self.shape_s).exp_m1() / self.all
    }
}

impl ByCurrent {
    /// Of a stack of so much free elastance (1/F) that goes in steps of `step_s` behind an amplifier of `shape_s`; takes its law.
    pub(super) fn new(
        piezo: &mut PiezoModel,
        free_elastance: f64,
        step_s: f64,
        shape_s: f64,
    ) -> Self {
        let linear_v_per_c = piezo.resistance_ohm / step_s;
        let exponent = piezo.loss_exponent;
        let at_c = LOSS_AT_A * step_s;
        Self {
            law: piezo.rate.take(),
            drag: Drag { linear_v_per_c, exponent, at_c, last_c: 0.0, next_c: 0.0 },
            capacitance_f: 1.0 / free_elastance,
            rest: None,
            through: Through::new(step_s, shape_s),
            straight: Through::straight(step_s),
            is_straight: false,
            speed_v_per_s: 0.0,
        }
    }

    /// Whether limits change from tick to tick.
    #[inline]
    pub(super) fn has_law(&self) -> bool {
        self.law.is_some()
    }

    /// Forget the ticks before; in those to come the output is known, or the amplifier's.
    pub(super) fn start(&mut self, is_known: bool) {
        (self.speed_v_per_s, self.drag.last_c) = (0.0, 0.0);
        (self.rest, self.is_straight) = (None, is_known);
    }

    /// Begin a tick in which the output goes from where it is by `change_v`, in a branch that has its input and its capacitance; sets the
    /// factors in it.
    #[inline(always)]
    pub(super) fn begin<E: SlipElements>(
        &mut self,
        elements: &mut E,
        branch: &mut Branch,
        transducer_v: f64,
        change_v: f64,
    ) {
        branch.drag_v_per_c = self.drag.linear_v_per_c;
        if self.law.is_some() {
            self.begin_by_law(elements, branch, transducer_v, change_v);
        }
    }

    /// Where the current turns it is zero in between, and with it the growth: that is where the charge goes farthest, and the
    /// loop from there on hangs on it. A tick would miss it, so the elements go there first, on the line through where they are: in a part of a
    /// tick neither a swing nor creep moves the stage by what counts.
    #[inline(never)]
    fn begin_by_law<E: SlipElements>(
        &mut self,
        elements: &mut E,
        branch: &mut Branch,
        transducer_v: f64,
        change_v: f64,
    ) {
        let Some(law) = &self.law else { return };
        let before = self.speed_v_per_s;
        let through = if self.is_straight { &self.straight } else { &self.through };
        let (left, per_v) = through.end;
        let after = left * before + per_v * change_v;
        if before * after < 0.0 {
            let (turn_s, steep) = through.turn(before, change_v);
            let share = (turn_s / through.step_s).clamp(0.01, 0.99);
            let mut part = self.drag.of_part(share);
            let least = before.abs().min(0.5 * BRIEF_S * steep.abs());
            let (limit_scale, sum_scale) = law.scales(least * self.capacitance_f);
            let turn = Branch {
                charge_at_zero_c: elements.charge_c() - branch.capacitance_f * transducer_v,
                input_v: branch.input_v - (1.0 - through.done(share)) * change_v,
                drag_v_per_c: part.linear_v_per_c,
                limit_scale,
                sum_scale,
                ..*branch
            };
            part.solve(elements, &turn);
            elements.commit();
            let rest = self.drag.of_part(1.0 - share);
            branch.drag_v_per_c = rest.linear_v_per_c;
            self.rest = Some(Drag { last_c: part.next_c * (1.0 - share) / share, ..rest });
        }
        self.speed_v_per_s = after;
        (branch.limit_scale, branch.sum_scale) = law.scales((after * self.capacitance_f).abs());
    }

    /// Solve a tick that was begun: transducer voltage, V.
    #[inline(always)]
    pub(super) fn solve<E: SlipElements>(&mut self, elements: &mut E, branch: &Branch) -> f64 {
        match &mut self.rest {
            None => self.drag.solve(elements, branch),
            Some(rest) => rest.solve(elements, branch),
        }
    }

    /// Accept the tick that was last solved.
    #[inline]
    pub(super) fn commit(&mut self) {
        self.drag.last_c = match self.rest.take() {
            None => self.drag.next_c,
            Some(rest) => rest.next_c * self.drag.at_c / rest.at_c,
        };
    }
}

/// Loss in series with the elements.
#[derive(Debug, Clone, Copy)]
struct Drag {
    /// Voltage that a coulomb drawn in one tick meets with an exponent of 1, and at [`LOSS_AT_A`] with any other, V/C.
    linear_v_per_c: f64,
    /// Power of the current that the voltage goes with.
    exponent: f64,
    /// Drawn in a tick at [`LOSS_AT_A`], C.
    at_c: f64,
    /// Drawn in the last tick, and in the one that was solved, C.
    last_c: f64,
    next_c: f64,
}

impl Drag {
    /// Share of [`LOSS_AT_A`] below which a power law goes straight through zero: a root has an infinite slope there.
    const LEAST_SHARE: f64 = 1.0e-3;
    /// Error of the voltage up to which a tick is solved, V.
    const TOLERANCE_V: f64 = 1.0e-6;
    /// Most rounds; a bracket of a whole tick is halved to nothing in as many.
    const ROUNDS: usize = 40;

    /// The same over a part of a tick.
    fn of_part(&self, part: f64) -> Self {
        Self {
            linear_v_per_c: self.linear_v_per_c / part,
            at_c: self.at_c * part,
            last_c: self.last_c * part,
            ..*self
        }
    }

    /// Voltage where so much is drawn in a tick, V, and its slope, V/C.
    fn voltage(&self, drawn_c: f64) -> (f64, f64) {
        let u = drawn_c / self.at_c;
        let square = u * u + Self::LEAST_SHARE * Self::LEAST_SHARE;
        let per_c = self.linear_v_per_c * square.powf(0.5 * (self.exponent - 1.0));
        (per_c * drawn_c, per_c * (1.0 + (self.exponent - 1.0) * u * u / square))
    }

    #[inline(always)]
    fn solve<E: SlipElements>(&mut self, elements: &mut E, branch: &Branch) -> f64 {
        if self.exponent == 1.0 || self.linear_v_per_c == 0.0 {
            elements.solve(branch)
        } else {
            self.solve_power(elements, branch)
        }
    }

    /// Newton on what is drawn, with a power law taken by its tangent, inside a bracket: voltage and elements both rise with it, so a
    /// tangent points to the side of the answer.
    #[inline(never)]
    fn solve_power<E: SlipElements>(&mut self, elements: &mut E, branch: &Branch) -> f64 {
        let mut at = self.last_c;
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut transducer_v = 0.0;
        for _ in 0..Self::ROUNDS {
            let (voltage, slope) = self.voltage(at);
            let line = Branch {
                drag_v_per_c: slope,
                input_v: branch.input_v - (voltage - slope * at),
                ..*branch
            };
            transducer_v = elements.solve(&line);
            let next = elements.drawn_c();
            self.next_c = next;
            let of_line = voltage + slope * (next - at);
            if (self.voltage(next).0 - of_line).abs() <= Self::TOLERANCE_V || next == at {
                break;
            }
            if next > at {
                low = low.max(at);
            } else {
                high = high.min(at);
            }
            at = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        transducer_v
    }
}
