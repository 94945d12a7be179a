//! A loop of Bouc and Wen's law beside the elements of a stack.
//!
//! `dz = dq (1 - b |z/slip|^n)`, with `b = 1` on the way out and the recoil on the way back, gives the voltage `limit z/slip`. Slip elements
//! of any number close their minor loops and forget them; this one does neither: it creeps with a cycle that lies to one side
//! (Y. K. Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. Div. ASCE 102(2), 1976; for stacks: T. S. Low and
//! W. Guo, "Modeling of a three-layer piezoelectric bimorph beam with hysteresis", J. Microelectromech. Syst. 4(4), 1995).
//!
//! A tick is drawn in parts of a tenth of the slip charge: an edge of 100 V draws half of it in one. Over a part the power of `|z/slip|` is
//! that of its middle; what is left is Dahl's law, solved as in [`super::Yielding`].

/// Most of the slip charge that a part draws.
const PART: f64 = 0.1;
/// Most parts of a tick: what draws more than all the slip charge comes to the limit anyway.
const MOST_PARTS: f64 = 40.0;

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

    /// How much it bends at `z_c`, 1/C, if the charge goes in the direction of `sign`.
    #[inline]
    fn give(&self, z_c: f64, sign: f64, slip_c: f64) -> f64 {
        let back = if sign * z_c < 0.0 { self.law.recoil } else { 1.0 };
        back * (z_c.abs() / slip_c).powf(self.law.exponent - 1.0) / slip_c
    }

    /// Slope at `z_c`, V/C: what draws a little more goes on from there.
    #[inline]
    fn slope_at(&self, z_c: f64, sign: f64, slip_c: f64) -> f64 {
        let is_held = sign * z_c >= slip_c;
        let steep = 1.0 - sign * self.give(z_c, sign, slip_c) * z_c;
        if is_held { 0.0 } else { self.slope() * steep.max(0.0) }
    }

    /// Voltage (V) and slope (V/C) after drawing `drawn` coulombs, which is `far` without its sign, with its slip charge scaled.
    #[inline]
    pub(super) fn draw(&mut self, (drawn, far, sign): (f64, f64, f64), scale: f64) -> (f64, f64) {
        let slip = self.law.slip_c * scale;
        let parts = (far / (PART * slip)).ceil().clamp(1.0, MOST_PARTS);
        let (part, half) = (drawn / parts, 0.5 * far / parts);
        let mut z = self.z_c;
        for _ in 0..parts as usize {
            let middle = z + 0.5 * part * (1.0 - sign * self.give(z, sign, slip) * z);
            let give = half * self.give(middle, sign, slip);
            z = ((z * (1.0 - give) + part) / (1.0 + give)).max(-slip).min(slip);
        }
        self.next_z_c = z;
        (self.slope() * z, self.slope_at(z, sign, slip))
    }

    /// Slopes if the charge falls and rises from where it stands, V/C.
    #[inline]
    pub(super) fn tangents(&self, scale: f64) -> [f64; 2] {
        [-1.0, 1.0].map(|sign| self.slope_at(self.z_c, sign, self.law.slip_c * scale))
    }

    /// Accept what was drawn last.
    #[inline]
    pub(super) fn commit(&mut self) {
        self.z_c = self.next_z_c;
    }
}
