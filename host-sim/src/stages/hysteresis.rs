//! Maxwell slip elements in charge, and the scalar solve for the charge at the end of a tick.
//!
//! `v_in = v_z + H(q)`, `q = q_a + c v_z`: with `dq` the charge drawn in the tick,
//! `(q_0 - q_a + dq)/c + H(dq) = v_in`, where `H(dq) = sum clamp(v_i + k_i dq, +-limit_i)` never falls. Newton from
//! the last tick's tangent ends after one evaluation while no further element starts to slip.
//! Source: Goldfarb and Celanovic, IEEE Control Systems Magazine 17(3), 1997 (generalized Maxwell slip model).

/// Residual at which the charge is found, V (about 1e-17 m).
const TOLERANCE_V: f64 = 1.0e-10;
const LANES: usize = 4;

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
}

/// State and parameters of the elements of one stack.
#[derive(Debug, Clone)]
pub struct MaxwellElements {
    slope: Vec<f64>,
    limit: Vec<f64>,
    voltage: Vec<f64>,
    trial: Vec<f64>,
    sum_v: f64,
    trial_sum_v: f64,
    charge_c: f64,
    trial_charge_c: f64,
    all_slopes: f64,
    tangent: f64,
    trial_tangent: f64,
    rising: bool,
    trial_rising: bool,
    count: usize,
}

impl MaxwellElements {
    /// Elements from slopes (V/C) and limits (V), virgin.
    pub fn new(slopes: &[f64], limits: &[f64]) -> Self {
        let count = slopes.len();
        let padded = count.next_multiple_of(LANES);
        let pad = |values: &[f64]| {
            let mut all = values.to_vec();
            all.resize(padded, 0.0);
            all
        };
        Self {
            slope: pad(slopes),
            limit: pad(limits),
            voltage: vec![0.0; padded],
            trial: vec![0.0; padded],
            sum_v: 0.0,
            trial_sum_v: 0.0,
            charge_c: 0.0,
            trial_charge_c: 0.0,
            all_slopes: slopes.iter().sum(),
            tangent: slopes.iter().sum(),
            trial_tangent: 0.0,
            rising: true,
            trial_rising: true,
            count,
        }
    }

    /// Voltages of the elements, V.
    pub fn voltages(&self) -> &[f64] {
        &self.voltage[..self.count]
    }

    /// Sum of the element voltages, V.
    pub fn sum_v(&self) -> f64 {
        self.sum_v
    }

    /// Charge on the stack, C.
    pub fn charge_c(&self) -> f64 {
        self.charge_c
    }

    /// Slope of the hysteresis voltage in the direction last moved, V/C.
    pub fn tangent_v_per_c(&self) -> f64 {
        self.tangent
    }

    /// Slope expected when the voltage goes on up or down, V/C.
    #[inline]
    pub fn tangent_towards(&self, rising: bool) -> f64 {
        if rising == self.rising { self.tangent } else { self.all_slopes }
    }

    /// Put the elements where `voltage_of(slope, limit, index)` says, held inside their limits.
    pub fn set_voltages(&mut self, voltage_of: impl Fn(f64, f64, usize) -> f64) {
        for i in 0..self.count {
            let (slope, limit) = (self.slope[i], self.limit[i]);
            self.voltage[i] = voltage_of(slope, limit, i).clamp(-limit, limit);
        }
        self.sum_v = self.voltage.iter().sum();
        self.tangent = self.all_slopes;
    }

    /// Say what charge the present state belongs to, C.
    pub fn set_charge(&mut self, charge_c: f64) {
        self.charge_c = charge_c;
    }

    /// Solve for this tick without leaving the start of it: transducer voltage, V. `commit` accepts.
    pub fn solve(&mut self, branch: &Branch) -> f64 {
        if branch.limit_scale == 1.0 {
            self.solve_scaled::<false>(branch)
        } else {
            self.solve_scaled::<true>(branch)
        }
    }

    fn solve_scaled<const SCALED: bool>(&mut self, branch: &Branch) -> f64 {
        let elastance = 1.0 / branch.capacitance_f;
        let start = self.charge_c - branch.charge_at_zero_c;
        let skew = branch.skew_per_c;
        let drag = branch.drag_v_per_c;
        let sum =
            if SCALED { self.evaluate::<SCALED>(0.0, branch.limit_scale).0 } else { self.sum_v };
        let gap = branch.input_v - start * elastance - sum * (1.0 + skew * self.charge_c);
        self.trial_rising = gap >= 0.0;
        let guess = self.tangent_towards(self.trial_rising);
        let mut drawn = gap / (elastance + guess + drag);
        for _ in 0..100 {
            let (voltage, tangent) = self.evaluate::<SCALED>(drawn, branch.limit_scale);
            let weight = 1.0 + skew * (self.charge_c + drawn);
            let error =
                (start + drawn) * elastance + voltage * weight + drag * drawn - branch.input_v;
            self.trial_sum_v = voltage;
            self.trial_tangent = tangent;
            if error.abs() <= TOLERANCE_V {
                break;
            }
            drawn -= error / (elastance + tangent * weight + skew * voltage + drag);
        }
        self.trial_charge_c = self.charge_c + drawn;
        (start + drawn) * elastance
    }

    /// Accept the tick that was last solved.
    pub fn commit(&mut self) {
        std::mem::swap(&mut self.voltage, &mut self.trial);
        self.sum_v = self.trial_sum_v;
        self.charge_c = self.trial_charge_c;
        self.tangent = self.trial_tangent;
        self.rising = self.trial_rising;
    }

    /// Sum of the element voltages after drawing `drawn` coulombs, and its slope; fills `trial`.
    #[inline]
    fn evaluate<const SCALED: bool>(&mut self, drawn: f64, scale: f64) -> (f64, f64) {
        let mut sum = [0.0; LANES];
        let mut slope_sum = [0.0; LANES];
        let (slopes, _) = self.slope.as_chunks::<LANES>();
        let (limits, _) = self.limit.as_chunks::<LANES>();
        let (voltages, _) = self.voltage.as_chunks::<LANES>();
        let (trials, _) = self.trial.as_chunks_mut::<LANES>();
        for (((slope, limit), voltage), trial) in
            slopes.iter().zip(limits).zip(voltages).zip(trials)
        {
            for lane in 0..LANES {
                let top = if SCALED { limit[lane] * scale } else { limit[lane] };
                let free = voltage[lane] + slope[lane] * drawn;
                let below = if free < top { free } else { top };
                let held = if below > -top { below } else { -top };
                trial[lane] = held;
                sum[lane] += held;
                slope_sum[lane] += if held == free { slope[lane] } else { 0.0 };
            }
        }
        (
            (sum[0] + sum[1]) + (sum[2] + sum[3]),
            (slope_sum[0] + slope_sum[1]) + (slope_sum[2] + slope_sum[3]),
        )
    }
}
