//! How a simulation starts: what nobody recorded.

/// State of one axis before its first tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Initial {
    /// Output of the amplifier, V; `None`: settled at the first drive.
    pub amplifier_v: Option<f64>,
    /// Electrical memory of the stack.
    pub memory: Memory,
    /// Transducer voltage at which the slow strains are settled, V; 0 is a rested stack.
    pub held_v: f64,
}

/// Electrical memory: where the Maxwell elements stand.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Memory {
    /// Depoled: no element holds any voltage.
    #[default]
    Virgin,
    /// As left by this charge (C) drawn by a depoled stack: `clamp(charge * slope_i, +-limit_i)`.
    Swept(f64),
    /// Voltage of each element, V.
    Elements(Vec<f64>),
}
