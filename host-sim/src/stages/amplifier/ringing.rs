//! Amplifier whose two poles are a pair that rings: `further tau^2 v'' + 2 tau v' + v = target` with `further > 1`, exact towards a held
//! target. A slew limit holds its slope at points within a tick.

/// Points at which a slew limit holds the slope of a part of a tick. Between them it may be exceeded by what the pair gains in an eighth
/// of the part.
const LIMITED_PARTS: u32 = 8;

/// What a time makes of a gap and of a slope.
#[derive(Clone, Copy)]
struct Propagator {
    length_s: f64,
    gap_of_gap: f64,
    gap_of_slope_s: f64,
    slope_of_gap_per_s: f64,
    slope_of_slope: f64,
}

impl Propagator {
    /// `decay_per_s` is zeta omega_0, `turn_per_s` the damped angular frequency.
    fn new(length_s: f64, decay_per_s: f64, turn_per_s: f64) -> Self {
        let (sine, cosine) = (turn_per_s * length_s).sin_cos();
        let left = (-decay_per_s * length_s).exp();
        let (along, across) = (left * cosine, left * sine / turn_per_s);
        Self {
            length_s,
            gap_of_gap: along + decay_per_s * across,
            gap_of_slope_s: across,
            slope_of_gap_per_s: -(decay_per_s * decay_per_s + turn_per_s * turn_per_s) * across,
            slope_of_slope: along - decay_per_s * across,
        }
    }

    fn apply(&self, gap_v: f64, slope_v_per_s: f64) -> (f64, f64) {
        (
            self.gap_of_gap * gap_v + self.gap_of_slope_s * slope_v_per_s,
            self.slope_of_gap_per_s * gap_v + self.slope_of_slope * slope_v_per_s,
        )
    }
}

/// The slope of the pair, and how it goes on. The output itself is kept by the amplifier.
pub(super) struct Ringing {
    slope_v_per_s: f64,
    /// Over the two parts of a tick, as a whole and in small.
    whole: [Propagator; 2],
    limited: [Propagator; 2],
}

impl Ringing {
    /// `further` is above 1; `lengths_s` are the two parts of a tick.
    pub(super) fn new(time_constant_s: f64, further: f64, lengths_s: [f64; 2]) -> Self {
        let decay_per_s = 1.0 / (further * time_constant_s);
        let turn_per_s = decay_per_s * (further - 1.0).sqrt();
        let over = |parts: u32| {
            lengths_s.map(|s| Propagator::new(s / f64::from(parts), decay_per_s, turn_per_s))
        };
        Self { slope_v_per_s: 0.0, whole: over(1), limited: over(LIMITED_PARTS) }
    }

    /// The output stands still.
    pub(super) fn rest(&mut self) {
        self.slope_v_per_s = 0.0;
    }

    /// The output after a part of the tick towards a held target. `limits` are the steepest fall and rise, V/s, both positive.
    pub(super) fn advance(
        &mut self,
        from_v: f64,
        target_v: f64,
        part: usize,
        limits: Option<(f64, f64)>,
    ) -> f64 {
        let mut gap_v = from_v - target_v;
        let Some((fall, rise)) = limits else {
            (gap_v, self.slope_v_per_s) = self.whole[part].apply(gap_v, self.slope_v_per_s);
            return target_v + gap_v;
        };
        let step = self.limited[part];
        for _ in 0..LIMITED_PARTS {
            let (free_v, slope) = step.apply(gap_v, self.slope_v_per_s);
            gap_v += (free_v - gap_v).max(-fall * step.length_s).min(rise * step.length_s);
            self.slope_v_per_s = slope.max(-fall).min(rise);
        }
        target_v + gap_v
    }
}
