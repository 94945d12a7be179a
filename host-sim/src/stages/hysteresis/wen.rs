//! A loop of Bouc and Wen's law beside the elements of a stack.
//!
//! `dz = dq (1 - b |z/slip|^n)`, with `b = 1` on the way out and the recoil on the way back, gives the voltage `limit z/slip`. Slip elements
//! of any number close their minor loops and forget them; this one does neither: it creeps with a cycle that lies to one side
//! (Y. K. Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. Div. ASCE 102(2), 1976; for stacks: T. S. Low and
//! W. Guo, "Modeling of a three-layer piezoelectric bimorph beam with hysteresis", J. Microelectromech. Syst. 4(4), 1995).
//!
//! Over a tick the power of `|z/slip|` is that of its start; what is left is Dahl's law, solved as in [`super::Yielding`].

/// Such a loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WenLoop {
    /// Voltage that it comes to, V.
    pub limit_v: f64,
    /// Charge in which it would at its first slope, C.
    pub slip_c: f64,
    /// How late it bends: n.
    pub exponent: f64,
    /// Share of the bend on the way back, `(beta - gamma) / (beta + gamma)`, -1 to 1: above zero it comes back steeper than it began.
    pub recoil: f64,
}

/// Its state.
#[derive(Debug, Clone)]
pub(super) struct Wen {
    law: WenLoop,
    z_c: f64,
    next_z_c: f64,
}

impl Wen {
    pub(super) fn new(law: WenLoop) -> Self {
        Self { law, z_c: 0.0, next_z_c: 0.0 }
    }

    fn slope(&self) -> f64 {
        self.law.limit_v / self.law.slip_c
    }

    /// Voltage, V.
    pub(super) fn voltage_v(&self) -> f64 {
        self.slope() * self.z_c
    }

    /// Put it where `voltage_of(slope, limit)` says, within its limits.
    pub(super) fn set_voltage(&mut self, voltage_of: impl Fn(f64, f64) -> f64) {
        let (slope, limit) = (self.slope(), self.law.limit_v);
        self.z_c = voltage_of(slope, limit).clamp(-limit, limit) / slope;
    }

    /// How much it bends now, 1/C, if the charge goes in the direction of `sign`.
    #[inline]
    fn give(&self, sign: f64, scale: f64) -> f64 {
        let slip = self.law.slip_c * scale;
        let back = if sign * self.z_c < 0.0 { self.law.recoil } else { 1.0 };
        back * (self.z_c.abs() / slip).powf(self.law.exponent - 1.0) / slip
    }

    /// Voltage (V) and slope (V/C) after drawing `drawn` coulombs, which is `far` without its sign, with its slip charge scaled.
    #[inline]
    pub(super) fn draw(&mut self, (drawn, far, sign): (f64, f64, f64), scale: f64) -> (f64, f64) {
        let (slope, slip) = (self.slope(), self.law.slip_c * scale);
        let give = self.give(sign, scale);
        let half = 0.5 * give * far;
        let inverse = 1.0 / (1.0 + half);
        let free = (self.z_c * (1.0 - half) + drawn) * inverse;
        self.next_z_c = free.max(-slip).min(slip);
        let steep = (1.0 - sign * give * self.z_c) * inverse * inverse;
        (slope * self.next_z_c, if self.next_z_c == free { slope * steep } else { 0.0 })
    }

    /// Slopes if the charge falls and rises from where it stands, V/C.
    #[inline]
    pub(super) fn tangents(&self, scale: f64) -> [f64; 2] {
        let slip = self.law.slip_c * scale;
        [-1.0, 1.0].map(|sign| {
            let is_held = sign * self.z_c >= slip;
            let steep = 1.0 - sign * self.give(sign, scale) * self.z_c;
            if is_held { 0.0 } else { self.slope() * steep }
        })
    }

    /// Accept what was drawn last.
    #[inline]
    pub(super) fn commit(&mut self) {
        self.z_c = self.next_z_c;
    }
}
