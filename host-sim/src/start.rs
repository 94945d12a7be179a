//! How a simulation starts: what nobody recorded.

use std::sync::Arc;

/// State of one axis before its first tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Initial {
    /// Output of the amplifier, V; `None`: settled at the first drive.
    pub amplifier_v: Option<f64>,
    /// Electrical memory of the stack.
    pub memory: Memory,
    /// Transducer voltage at which the slow strains were settled before `past`, V; 0 is a rested stack.
    pub held_v: f64,
    /// What happened since, the oldest first, up to the first tick: slow strains run on between recordings.
    pub past: Option<Arc<[Stretch]>>,
}

/// A stretch of time before the first tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// How long it took, s.
    pub lasted_s: f64,
    /// Mean transducer voltage, V.
    pub transducer_v: f64,
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
