//! Maxwell slip elements in charge, and the scalar solve for the charge at the end of a tick.
//!
//! `v_in = v_z + H(q)`, `q = q_a + c v_z`: with `q` the charge at the end of the tick, `(q - q_a)/c + H(q) = v_in`, where
//! `H(q) = sum clamp(v_i + k_i dq, +-limit_i)` never falls.
//! Source: Goldfarb and Celanovic, IEEE Control Systems Magazine 17(3), 1997 (generalized Maxwell slip model).
//!
//! Two ways to the same numbers: [`Ladder`] looks only at the element that slips next and is what nearly every
//! simulation runs; [`Zones`] looks at those near their limits and takes what the ladder cannot: limits that change from
//! tick to tick, and memories that no history of charge leaves behind. [`Yielding`] elements give way before they slip.

mod ladder;
mod wen;
mod yielding;
mod zones;

pub use ladder::Ladder;
pub use wen::WenLoop;
pub use yielding::Yielding;
pub use zones::Zones;

/// How the charge follows the transducer voltage in this tick, and what the branch adds beside the elements.
#[derive(Debug, Clone, Copy)]
pub struct Branch {
    /// Charge at a transducer voltage of zero, C.
    pub charge_at_zero_c: f64,
    /// Charge a volt of transducer voltage, F.
    pub capacitance_f: f64,
    /// Amplifier voltage at the end of the tick, V.
    pub input_v: f64,
    /// Voltage a coulomb drawn in this tick, beyond the elements: series resistance over the step, V/C.
    pub drag_v_per_c: f64,
    /// Relative growth of the hysteresis voltage with charge, 1/C: loops wider at one end.
    pub skew_per_c: f64,
    /// Factor on every limit in this tick.
    pub limit_scale: f64,
    /// Factor on the whole hysteresis voltage in this tick; [`Ladder`]s take none.
    pub sum_scale: f64,
}

impl Default for Branch {
    fn default() -> Self {
        Self {
            charge_at_zero_c: 0.0,
            capacitance_f: 0.0,
            input_v: 0.0,
            drag_v_per_c: 0.0,
            skew_per_c: 0.0,
            limit_scale: 1.0,
            sum_scale: 1.0,
        }
    }
}

/// What a tick asks of any form.
pub trait SlipElements {
    /// Slope of the hysteresis voltage in the direction last moved, V/C.
    fn tangent_v_per_c(&self) -> f64;
    /// Slope expected when the voltage goes on up or down, V/C.
    fn tangent_towards(&self, rising: bool) -> f64;
    /// Charge at the start of the tick, C.
    fn charge_c(&self) -> f64;
    /// Charge drawn in the tick that was last solved, C, until that is accepted.
    fn drawn_c(&self) -> f64;
    /// Solve for this tick without leaving the start of it: transducer voltage, V. `commit` accepts.
    fn solve(&mut self, branch: &Branch) -> f64;
    /// Accept the tick that was last solved.
    fn commit(&mut self);
}

/// The elements of one stack, in the cheapest form that holds their state.
#[derive(Debug, Clone)]
pub enum Elements {
    /// Fixed limits, a memory left by a history of charge.
    Ladder(Ladder),
    /// Any limits and memory.
    Zones(Zones),
    /// The same, and elements that give way before they slip.
    Yielding(Yielding),
}

macro_rules! either {
    ($self:expr, $elements:ident => $body:expr) => {
        match $self {
            Elements::Ladder($elements) => $body,
            Elements::Zones($elements) => $body,
            Elements::Yielding($elements) => $body,
        }
    };
}

impl Elements {
    /// Elements from slopes (V/C) and limits (V), virgin; `scaled`: their limits will change from tick to tick; `give`: by how much
    /// they give way before they slip, and which share of that on the way back, both 0 to 1; `beside`: a loop of another law.
    pub fn new(
        slopes: &[f64],
        limits: &[f64],
        scaled: bool,
        give: (f64, f64),
        beside: Option<WenLoop>,
    ) -> Self {
        if give.0 > 0.0 || beside.is_some() {
            Self::Yielding(Yielding::new(slopes, limits, give, beside))
        } else if scaled {
            Self::Zones(Zones::new(slopes, limits))
        } else {
            Self::Ladder(Ladder::new(slopes, limits))
        }
    }

    /// Voltages of the elements in the order in which they were given, V.
    pub fn voltages(&self) -> Vec<f64> {
        either!(self, elements => elements.voltages())
    }

    /// Sum of the element voltages, V.
    pub fn sum_v(&self) -> f64 {
        either!(self, elements => elements.sum_v())
    }

    /// Put the elements where `voltage_of(slope, limit, index)` says, held inside their limits.
    pub fn set_voltages(&mut self, voltage_of: impl Fn(f64, f64, usize) -> f64) {
        if let Self::Ladder(ladder) = self
            && !ladder.set_voltages(&voltage_of)
        {
            let (slopes, limits) = ladder.parameters();
            *self = Self::Zones(Zones::new(&slopes, &limits));
        }
        match self {
            Self::Ladder(_) => {}
            Self::Zones(elements) => elements.set_voltages(voltage_of),
            Self::Yielding(elements) => elements.set_voltages(voltage_of),
        }
    }

    /// Say what charge the present state belongs to, C.
    pub fn set_charge(&mut self, charge_c: f64) {
        either!(self, elements => elements.set_charge(charge_c));
    }
}

impl SlipElements for Elements {
    fn tangent_v_per_c(&self) -> f64 {
        either!(self, elements => elements.tangent_v_per_c())
    }

    #[inline]
    fn tangent_towards(&self, rising: bool) -> f64 {
        either!(self, elements => elements.tangent_towards(rising))
    }

    #[inline]
    fn charge_c(&self) -> f64 {
        either!(self, elements => elements.charge_c())
    }

    #[inline]
    fn drawn_c(&self) -> f64 {
        either!(self, elements => elements.drawn_c())
    }

    #[inline]
    fn solve(&mut self, branch: &Branch) -> f64 {
        either!(self, elements => elements.solve(branch))
    }

    #[inline]
    fn commit(&mut self) {
        either!(self, elements => elements.commit());
    }
}
