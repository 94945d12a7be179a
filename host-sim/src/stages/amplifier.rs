//! Amplifier of one axis: drive errors, dead time, what sits at its input, first order towards a held target, slew limit, a further pole
//! if it has one (or two that ring, in `ringing`), rails, and what sits at its output. Exact between ticks; no sub-steps.

use std::collections::VecDeque;

mod ringing;

use ringing::Ringing;

use super::axis::Load;
use super::knee::Knee;
use super::model::{AmplifierModel, DriveModel, SlewLimit, VoltageBlock};

/// State and parameters of one amplifier.
pub struct AmplifierSim {
    gain: f64,
    offset_v: f64,
    crosstalk: Vec<(usize, f64)>,
    /// Commanded voltages still on their way, oldest first; empty without dead time.
    pipeline: VecDeque<f64>,
    whole_ticks: usize,
    /// Before the command of this tick arrives, and after.
    segments: [Segment; 2],
    knees: [Option<Knee>; 2],
    time_constant_s: f64,
    min_v: f64,
    max_v: f64,
    slew: Option<Box<dyn SlewLimit>>,
    input: Vec<Box<dyn VoltageBlock>>,
    output: Vec<Box<dyn VoltageBlock>>,
    state_v: f64,
    further: Option<Further>,
    ringing: Option<Ringing>,
    plain: bool,
}

/// The pole behind the first one and its slew limit.
struct Further {
    time_constant_s: f64,
    /// tau_1 / (tau_1 - tau_2): what an exponential of the first pole makes of itself behind the second.
    mix: f64,
    state_v: f64,
}

impl Further {
    /// None where it is too fast to matter in a tick.
    fn new(first_s: f64, time_constant_s: f64, step_s: f64) -> Option<Self> {
        (time_constant_s > 1.0e-4 * step_s).then(|| {
            // Two equal poles are the limit of two that nearly are.
            let least_s = 1.0e-6 * first_s;
            let is_equal = (first_s - time_constant_s).abs() < least_s;
            let time_constant_s = if is_equal { first_s - least_s } else { time_constant_s };
            Self { time_constant_s, mix: first_s / (first_s - time_constant_s), state_v: 0.0 }
        })
    }

    fn decay(&self, length_s: f64) -> f64 {
        (-length_s / self.time_constant_s).exp()
    }

    /// The first pole goes from `from_v` towards a target for a segment.
    fn approach(&mut self, from_v: f64, target_v: f64, segment: Segment) {
        let decay = segment.further_decay;
        let forced = self.mix * (from_v - target_v) * (segment.decay - decay);
        self.state_v = target_v + forced + (self.state_v - target_v) * decay;
    }

    /// The first pole goes straight from `from_v` to `to_v`.
    fn ramp(&mut self, from_v: f64, to_v: f64, length_s: f64) {
        let lag_v = (to_v - from_v) / length_s * self.time_constant_s;
        self.state_v = to_v - lag_v + (self.state_v - from_v + lag_v) * self.decay(length_s);
    }
}

/// A part of the tick with a constant target.
#[derive(Clone, Copy)]
struct Segment {
    length_s: f64,
    /// What is left of a gap behind the first pole, and behind the further one on its own.
    decay: f64,
    further_decay: f64,
}

impl Segment {
    fn new(length_s: f64, time_constant_s: f64, further: Option<&Further>) -> Self {
        let decay = if time_constant_s > 0.0 { (-length_s / time_constant_s).exp() } else { 0.0 };
        Self {
            length_s,
            decay: if length_s > 0.0 { decay } else { 1.0 },
            further_decay: further.map_or(0.0, |further| further.decay(length_s)),
        }
    }
}

/// `v` behind all of `blocks`.
fn passed(blocks: &mut [Box<dyn VoltageBlock>], v: f64, time_s: f64) -> f64 {
    blocks.iter_mut().fold(v, |v, block| block.output(v, time_s))
}

impl AmplifierSim {
    /// Build for a tick of `step_s`.
    pub fn new(drive: DriveModel, amplifier: AmplifierModel, step_s: f64) -> Self {
        let delay_ticks = (drive.delay_s / step_s).max(0.0);
        let whole_ticks = delay_ticks.floor() as usize;
        let fraction = delay_ticks - delay_ticks.floor();
        let tau = amplifier.time_constant_s;
        let lengths_s = [fraction * step_s, (1.0 - fraction) * step_s];
        let softness = amplifier.slew.as_ref().map_or(0.0, |slew| slew.knee());
        let does_ring = amplifier.further_pole > 1.0 && tau > 0.0;
        let further_s = if does_ring { 0.0 } else { amplifier.further_pole * tau };
        let further = Further::new(tau, further_s, step_s);
        Self {
            plain: amplifier.slew.is_none()
                && amplifier.input.is_empty()
                && amplifier.output.is_empty()
                && amplifier.further_pole == 0.0
                && delay_ticks == 0.0,
            gain: drive.gain,
            offset_v: drive.offset_v,
            crosstalk: drive.crosstalk,
            pipeline: VecDeque::new(),
            whole_ticks,
            segments: lengths_s.map(|length_s| Segment::new(length_s, tau, further.as_ref())),
            knees: lengths_s.map(|length_s| Knee::new(softness, length_s / tau)),
            time_constant_s: tau,
            min_v: amplifier.min_v,
            max_v: amplifier.max_v,
            slew: amplifier.slew,
            input: amplifier.input,
            output: amplifier.output,
            state_v: 0.0,
            further,
            ringing: does_ring.then(|| Ringing::new(tau, amplifier.further_pole, lengths_s)),
        }
    }

    /// Voltage asked of the amplifier of axis `axis`, from the voltages commanded to all axes.
    #[inline]
    pub fn target_v(&self, axis: usize, commanded: impl Fn(usize) -> f64) -> f64 {
        let mut asked = commanded(axis);
        for &(from, share) in &self.crosstalk {
            asked += share * commanded(from);
        }
        self.gain * asked + self.offset_v
    }

    /// Start from an output voltage (before what sits at the output) with `target_v` having been asked for long.
    pub fn start(&mut self, state_v: f64, target_v: f64) {
        self.state_v = state_v.clamp(self.min_v, self.max_v);
        if let Some(further) = &mut self.further {
            further.state_v = self.state_v;
        }
        if let Some(ringing) = &mut self.ringing {
            ringing.rest();
        }
        self.pipeline.clear();
        if !self.plain {
            self.pipeline.extend(std::iter::repeat_n(target_v, self.whole_ticks + 1));
        }
    }

    /// Output before what sits there, V.
    pub fn state_v(&self) -> f64 {
        self.state_v
    }

    /// Output voltage now, V.
    pub fn output_v(&mut self, time_s: f64) -> f64 {
        let v = self.further.as_ref().map_or(self.state_v, |further| further.state_v);
        passed(&mut self.output, v, time_s)
    }

    /// Hold a target to the next tick (at `time_s`): the output there. `load` is what the stack shows it.
    #[inline]
    pub fn advance(&mut self, target_v: f64, load: Load, time_s: f64) -> f64 {
        if self.plain {
            let v = target_v + (self.state_v - target_v) * self.segments[1].decay;
            self.state_v = clamp(v, self.min_v, self.max_v);
            return self.state_v;
        }
        self.advance_in_parts(target_v, load, time_s)
    }

    /// `advance` by several steps at once, at whose end it is `time_s(0)`, and `time_s(k)` k steps earlier.
    #[inline]
    pub fn advance_by(
        &mut self,
        steps: usize,
        target_v: f64,
        load: Load,
        time_s: impl Fn(usize) -> f64,
    ) -> f64 {
        if steps == 1 {
            return self.advance(target_v, load, time_s(0));
        }
        if self.plain {
            // It goes one way: within the rails in the end is within them throughout.
            let v =
                target_v + (self.state_v - target_v) * self.segments[1].decay.powi(steps as i32);
            self.state_v = clamp(v, self.min_v, self.max_v);
            return self.state_v;
        }
        (0..steps).rev().fold(0.0, |_, later| self.advance(target_v, load, time_s(later)))
    }

    /// Ticks that a command takes on its way through the dead time at most, of `substeps` steps each.
    pub fn ticks_of_delay(&self, substeps: usize) -> usize {
        if self.plain { 0 } else { self.whole_ticks.div_ceil(substeps) + 1 }
    }

    /// With dead time, slew limit or something at the input or the output.
    #[inline(never)]
    fn advance_in_parts(&mut self, target_v: f64, load: Load, time_s: f64) -> f64 {
        self.pipeline.push_back(target_v);
        let early_target = self.pipeline.pop_front().unwrap_or(target_v);
        let late_target = self.pipeline.front().copied().unwrap_or(target_v);
        let [early_target, late_target] =
            [early_target, late_target].map(|v| passed(&mut self.input, v, time_s));
        // Steepest fall and rise, V/s.
        let limits = self.slew.as_ref().map(|slew| {
            let [down, up] =
                [false, true].map(|rising| slew.limits_v_per_s(load.capacitance_f(rising)));
            (down.0, up.1)
        });
        if self.segments[0].length_s > 0.0 {
            self.segment(early_target, 0, limits);
        }
        self.segment(late_target, 1, limits);
        self.output_v(time_s)
    }

    /// First order towards the target with the slope held between limits: a ramp, then an exponential, or what a knee makes of them.
    fn segment(&mut self, target_v: f64, part: usize, limits: Option<(f64, f64)>) {
        if let Some(ringing) = &mut self.ringing {
            let v = ringing.advance(self.state_v, target_v, part, limits);
            self.keep_within(v);
            return;
        }
        let (segment, knee) = (self.segments[part], &self.knees[part]);
        let gap = target_v - self.state_v;
        if let Some((down, up)) = limits {
            let slope = if gap > 0.0 { up } else { down };
            if let Some(knee) = knee {
                match knee.left(gap.abs() / (slope * self.time_constant_s)) {
                    Some(left) => self.ramp(target_v - gap * left, segment.length_s),
                    None => self.approach(target_v, segment),
                }
                return;
            }
            // Where the exponential becomes slower than the limit.
            let knee = slope * self.time_constant_s;
            if gap.abs() > knee {
                let ramp_s = ((gap.abs() - knee) / slope).min(segment.length_s);
                self.ramp(self.state_v + gap.signum() * slope * ramp_s, ramp_s);
                let rest_s = segment.length_s - ramp_s;
                if rest_s > 0.0 {
                    let further = self.further.as_ref();
                    self.approach(target_v, Segment::new(rest_s, self.time_constant_s, further));
                }
                return;
            }
        }
        self.approach(target_v, segment);
    }

    fn approach(&mut self, target_v: f64, segment: Segment) {
        let from_v = self.state_v;
        let v = target_v + (from_v - target_v) * segment.decay;
        if let Some(further) = &mut self.further {
            further.approach(from_v, target_v, segment);
        }
        self.keep_within(v);
    }

    fn ramp(&mut self, to_v: f64, length_s: f64) {
        if let Some(further) = &mut self.further {
            further.ramp(self.state_v, to_v, length_s);
        }
        self.keep_within(to_v);
    }

    fn keep_within(&mut self, v: f64) {
        self.state_v = clamp(v, self.min_v, self.max_v);
        if let Some(further) = &mut self.further {
            further.state_v = clamp(further.state_v, self.min_v, self.max_v);
        }
        // At a rail the output stage holds still.
        if let Some(ringing) = self.ringing.as_mut().filter(|_| self.state_v != v) {
            ringing.rest();
        }
    }
}

/// Below this an output is zero, V. An output that dies away would otherwise end among the subnormal numbers and stay there, which a
/// processor multiplies a hundred times slower.
const REST_V: f64 = 1.0e-30;

#[inline]
fn clamp(v: f64, min: f64, max: f64) -> f64 {
    let v = if v.abs() < REST_V { 0.0 } else { v };
    let v = if v < max { v } else { max };
    if v > min { v } else { min }
}

#[cfg(test)]
mod tests {
    use super::super::model::Model;
    use super::*;
    use crate::Place;
    use crate::rig::Rig;

    #[test]
    fn an_output_that_dies_away_comes_to_zero() {
        const STEP_S: f64 = 1.0e-4;
        let load = Load { free_elastance: 1.0e5, tangents_v_per_c: [0.0; 2] };
        // In one piece, in parts with a further pole, and with two that ring.
        for further_pole in [0.0, 0.5, 2.0] {
            let mut rig = Rig::named("handley").unwrap();
            let axis = Place::Axis(0);
            rig.set("amplifier-bandwidth", axis, "further_pole", further_pole).unwrap();
            let model = Model::new(&rig, STEP_S).axes.remove(0);
            let mut amplifier = AmplifierSim::new(model.drive, model.amplifier, STEP_S);
            amplifier.start(50.0, 50.0);
            for tick in 1..=5_000 {
                amplifier.advance(0.0, load, f64::from(tick) * STEP_S);
            }
            assert_eq!(amplifier.output_v(0.5), 0.0, "further pole {further_pole}");
        }
    }
}
