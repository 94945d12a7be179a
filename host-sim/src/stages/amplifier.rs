//! Amplifier of one axis: drive errors, dead time, what sits at its input, first order towards a held target, slew limit,
//! rails, and what sits at its output. Exact between ticks; no sub-steps.

use std::collections::VecDeque;

use super::axis::Load;
use super::model::{AmplifierModel, DriveModel, SlewLimit, VoltageBlock};

/// State and parameters of one amplifier.
pub struct AmplifierSim {
    gain: f64,
    offset_v: f64,
    crosstalk: Vec<(usize, f64)>,
    /// Commanded voltages still on their way, oldest first; empty without dead time.
    pipeline: VecDeque<f64>,
    whole_ticks: usize,
    early: Segment,
    late: Segment,
    time_constant_s: f64,
    min_v: f64,
    max_v: f64,
    slew: Option<Box<dyn SlewLimit>>,
    input: Vec<Box<dyn VoltageBlock>>,
    output: Vec<Box<dyn VoltageBlock>>,
    state_v: f64,
    plain: bool,
}

/// A part of the tick with a constant target.
#[derive(Clone, Copy)]
struct Segment {
    length_s: f64,
    decay: f64,
}

impl Segment {
    fn new(length_s: f64, time_constant_s: f64) -> Self {
        let decay = if time_constant_s > 0.0 { (-length_s / time_constant_s).exp() } else { 0.0 };
        Self { length_s, decay: if length_s > 0.0 { decay } else { 1.0 } }
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
        Self {
            plain: amplifier.slew.is_none()
                && amplifier.input.is_empty()
                && amplifier.output.is_empty()
                && delay_ticks == 0.0,
            gain: drive.gain,
            offset_v: drive.offset_v,
            crosstalk: drive.crosstalk,
            pipeline: VecDeque::new(),
            whole_ticks,
            early: Segment::new(fraction * step_s, tau),
            late: Segment::new((1.0 - fraction) * step_s, tau),
            time_constant_s: tau,
            min_v: amplifier.min_v,
            max_v: amplifier.max_v,
            slew: amplifier.slew,
            input: amplifier.input,
            output: amplifier.output,
            state_v: 0.0,
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
        passed(&mut self.output, self.state_v, time_s)
    }

    /// Hold a target to the next tick (at `time_s`): the output there. `load` is what the stack shows it.
    #[inline]
    pub fn advance(&mut self, target_v: f64, load: Load, time_s: f64) -> f64 {
        if self.plain {
            let v = target_v + (self.state_v - target_v) * self.late.decay;
            self.state_v = clamp(v, self.min_v, self.max_v);
            return self.state_v;
        }
        self.advance_in_parts(target_v, load, time_s)
    }

    /// With dead time, slew limit or something at the input or the output.
    #[inline(never)]
    fn advance_in_parts(&mut self, target_v: f64, load: Load, time_s: f64) -> f64 {
        self.pipeline.push_back(target_v);
        let early_target = self.pipeline.pop_front().unwrap_or(target_v);
        let late_target = self.pipeline.front().copied().unwrap_or(target_v);
        let [early_target, late_target] =
            [early_target, late_target].map(|v| passed(&mut self.input, v, time_s));
        let limits = self.slew.as_ref().map(|slew| slew.limits_v_per_s(load.capacitance_f()));
        if self.early.length_s > 0.0 {
            self.segment(early_target, self.early, limits);
        }
        self.segment(late_target, self.late, limits);
        self.output_v(time_s)
    }

    /// First order towards the target with the slope held between limits (down, up): a ramp, then an exponential.
    fn segment(&mut self, target_v: f64, segment: Segment, limits: Option<(f64, f64)>) {
        let gap = target_v - self.state_v;
        let mut v = target_v - gap * segment.decay;
        if let Some((down, up)) = limits {
            let slope = if gap > 0.0 { up } else { down };
            // Where the exponential becomes slower than the limit.
            let knee = slope * self.time_constant_s;
            if gap.abs() > knee {
                let ramp_s = (gap.abs() - knee) / slope;
                v = if ramp_s >= segment.length_s {
                    self.state_v + gap.signum() * slope * segment.length_s
                } else {
                    let rest_s = segment.length_s - ramp_s;
                    let decay = if self.time_constant_s > 0.0 {
                        (-rest_s / self.time_constant_s).exp()
                    } else {
                        0.0
                    };
                    target_v - gap.signum() * knee * decay
                };
            }
        }
        self.state_v = clamp(v, self.min_v, self.max_v);
    }
}

#[inline]
fn clamp(v: f64, min: f64, max: f64) -> f64 {
    let v = if v < max { v } else { max };
    if v > min { v } else { min }
}
