//! The last minutes of telemetry in memory: every sample of every channel, bounded, with pyramids for drawing.
//!
//! Indices are ticks counted from the first sample held, so a lost tick has its place in time and is NaN there.

use std::collections::VecDeque;

use crate::pyramid::{Column, Extent, Pyramid};
use crate::sample::{AXES, Channel, Sample};

/// A run of ticks that never arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LostTicks {
    /// First tick that is missing.
    pub tick: u64,
    /// How many are missing.
    pub count: u64,
}

/// Most stretches of lost ticks that are remembered for marking; the count goes on beyond.
const MARKS: usize = 4096;
/// Tick-time histogram: microseconds a bin.
const TICK_TIME_BIN_US: f32 = 0.5;
/// Bins of the tick-time histogram; the last one holds everything slower.
const TICK_TIME_BINS: usize = 201;

fn trace_index(channel: Channel, axis: usize) -> usize {
    channel as usize * AXES + axis
}

/// Bounded store of full-rate telemetry.
pub struct History {
    sample_rate_hz: f64,
    origin: Option<u64>,
    /// One a channel and axis, see [`trace_index`].
    traces: Vec<Pyramid>,
    flags: VecDeque<(u64, u32)>,
    lost: VecDeque<LostTicks>,
    lost_total: u64,
    tick_time_bins: Vec<u64>,
    tick_time_max_us: f32,
    last: Option<Sample>,
}

impl History {
    /// Room for `seconds` of samples at `sample_rate_hz`. Ten minutes at 10 kHz take about 410 MB once filled.
    pub fn new(sample_rate_hz: f64, seconds: f64) -> Self {
        let capacity = (sample_rate_hz * seconds).ceil().max(1.0) as usize;
        Self {
            sample_rate_hz,
            origin: None,
            traces: (0..Channel::ALL.len() * AXES).map(|_| Pyramid::new(capacity)).collect(),
            flags: VecDeque::new(),
            lost: VecDeque::new(),
            lost_total: 0,
            tick_time_bins: vec![0; TICK_TIME_BINS],
            tick_time_max_us: 0.0,
            last: None,
        }
    }

    /// Sample rate of the stored ticks.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Forget everything and go on at another rate.
    pub fn set_rate(&mut self, sample_rate_hz: f64) {
        self.forget();
        self.sample_rate_hz = sample_rate_hz;
    }

    /// Append a sample. Ticks before the newest one are ignored (the decoder has counted them).
    pub fn push(&mut self, sample: &Sample) {
        let origin = *self.origin.get_or_insert(sample.tick);
        let Some(index) = sample.tick.checked_sub(origin) else { return };
        let end = self.traces[0].end();
        if index < end {
            return;
        }
        let missing = index - end;
        if missing > self.traces[0].capacity() {
            // Longer away than what is held (the board ran on unplugged): nothing old would stay in sight.
            self.lost_total += missing;
            self.forget();
            self.origin = Some(sample.tick);
        } else if missing > 0 {
            self.lost_total += missing;
            self.lost.push_back(LostTicks { tick: origin + end, count: missing });
            if self.lost.len() > MARKS {
                self.lost.pop_front();
            }
            for _ in 0..missing {
                for trace in &mut self.traces {
                    trace.push(f32::NAN);
                }
            }
        }
        for channel in Channel::ALL {
            for axis in 0..AXES {
                self.traces[trace_index(channel, axis)].push(channel.of(sample, axis));
            }
        }
        if self.flags.back().is_none_or(|&(_, flags)| flags != sample.flags) {
            self.flags.push_back((sample.tick, sample.flags));
            if self.flags.len() > MARKS {
                self.flags.pop_front();
            }
        }
        let bin = (sample.tick_time_us / TICK_TIME_BIN_US) as usize;
        self.tick_time_bins[bin.min(TICK_TIME_BINS - 1)] += 1;
        self.tick_time_max_us = self.tick_time_max_us.max(sample.tick_time_us);
        self.last = Some(*sample);
    }

    /// Drop all samples and marks, keep the counts. The next sample starts the time axis anew.
    pub fn forget(&mut self) {
        for trace in &mut self.traces {
            trace.clear();
        }
        self.origin = None;
        self.flags.clear();
        self.lost.clear();
        self.last = None;
    }

    /// Newest sample.
    pub fn last(&self) -> Option<&Sample> {
        self.last.as_ref()
    }

    /// First and one past the last tick held.
    pub fn ticks(&self) -> (u64, u64) {
        let origin = self.origin.unwrap_or(0);
        (origin + self.traces[0].start(), origin + self.traces[0].end())
    }

    /// Seconds on the sample clock of a tick, counted from the first tick ever held.
    pub fn time_s(&self, tick: u64) -> f64 {
        (tick as f64 - self.origin.unwrap_or(0) as f64) / self.sample_rate_hz
    }

    /// Tick at a time of [`History::time_s`], clamped to what is held.
    pub fn tick_at(&self, time_s: f64) -> u64 {
        let (first, end) = self.ticks();
        let tick = self.origin.unwrap_or(0) as f64 + time_s * self.sample_rate_hz;
        (tick.max(first as f64) as u64).min(end.saturating_sub(1)).max(first)
    }

    fn trace(&self, channel: Channel, axis: usize) -> &Pyramid {
        &self.traces[trace_index(channel, axis)]
    }

    /// Value of a channel at a tick; NaN when lost or not held.
    pub fn value(&self, channel: Channel, axis: usize, tick: u64) -> f32 {
        tick.checked_sub(self.origin.unwrap_or(0))
            .and_then(|index| self.trace(channel, axis).get(index))
            .unwrap_or(f32::NAN)
    }

    /// Raw samples of a channel between two ticks, lost ones NaN.
    pub fn slice(&self, channel: Channel, axis: usize, from: u64, to: u64) -> Vec<f32> {
        let origin = self.origin.unwrap_or(0);
        self.trace(channel, axis).slice(from.saturating_sub(origin), to.saturating_sub(origin))
    }

    /// Every `stride`th sample between two ticks, for pictures that need no extremes. Lost ticks are NaN.
    pub fn every(
        &self,
        channel: Channel,
        axis: usize,
        (from, to): (u64, u64),
        stride: u64,
    ) -> Vec<f32> {
        let (first, end) = self.ticks();
        (from.max(first)..to.min(end))
            .step_by(stride.max(1) as usize)
            .map(|tick| self.value(channel, axis, tick))
            .collect()
    }

    /// Columns for drawing between two ticks; see [`Pyramid::columns`]. `start` is a tick.
    pub fn columns(
        &self,
        channel: Channel,
        axis: usize,
        from: u64,
        to: u64,
        n: usize,
    ) -> Vec<Column> {
        let origin = self.origin.unwrap_or(0);
        let (from, to) = (from.saturating_sub(origin), to.saturating_sub(origin));
        let mut columns = self.trace(channel, axis).columns(from, to, n);
        for column in &mut columns {
            column.start += origin;
        }
        columns
    }

    /// Stretches of lost ticks that are still in sight, oldest first.
    pub fn lost(&self) -> impl Iterator<Item = LostTicks> + '_ {
        let first = self.ticks().0;
        self.lost.iter().copied().filter(move |l| l.tick + l.count > first)
    }

    /// Ticks lost since the start.
    pub fn lost_total(&self) -> u64 {
        self.lost_total
    }

    /// Changes of the flags: tick and the bits from there on.
    pub fn flag_changes(&self) -> impl Iterator<Item = (u64, u32)> + '_ {
        self.flags.iter().copied()
    }

    /// Histogram of the time the control interrupt took: bin start in microseconds and count.
    pub fn tick_time_histogram(&self) -> impl Iterator<Item = (f32, u64)> + '_ {
        self.tick_time_bins.iter().enumerate().map(|(i, &n)| (i as f32 * TICK_TIME_BIN_US, n))
    }

    /// Longest control interrupt seen, microseconds.
    pub fn tick_time_max_us(&self) -> f32 {
        self.tick_time_max_us
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.traces.iter().map(Pyramid::bytes).sum()
    }

    /// Extent of a channel over a stretch of ticks.
    pub fn extent(&self, channel: Channel, axis: usize, from: u64, to: u64) -> Extent {
        let mut all = Extent::EMPTY;
        for c in self.columns(channel, axis, from, to, 64) {
            if !c.extent.is_empty() {
                all.min = all.min.min(c.extent.min);
                all.max = all.max.max(c.extent.max);
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(tick: u64, value: f32) -> Sample {
        Sample { tick, reference_um: [value; 3], position_um: [0.0; 3], ..Sample::default() }
    }

    #[test]
    fn lost_ticks_keep_their_place_in_time() {
        let mut history = History::new(1000.0, 10.0);
        for tick in (100..200).chain(250..300) {
            history.push(&sample(tick, tick as f32));
        }
        assert_eq!(history.lost_total(), 50);
        assert_eq!(history.lost().collect::<Vec<_>>(), [LostTicks { tick: 200, count: 50 }]);
        assert_eq!(history.value(Channel::Reference, 1, 250), 250.0);
        assert!(history.value(Channel::Reference, 1, 249).is_nan());
        assert_eq!(history.time_s(250), 0.15);
        assert_eq!(history.tick_at(0.15), 250);
        assert_eq!(history.value(Channel::Error, 0, 120), 120.0);
    }

    #[test]
    fn a_long_absence_starts_anew_but_is_counted() {
        let mut history = History::new(1000.0, 4.0);
        history.push(&sample(5, 1.0));
        history.push(&sample(1_000_000, 2.0));
        assert_eq!(history.lost_total(), 999_994);
        assert_eq!(history.ticks(), (1_000_000, 1_000_001));
    }

    #[test]
    fn a_tick_that_goes_back_is_ignored() {
        let mut history = History::new(1000.0, 4.0);
        history.push(&sample(50, 1.0));
        history.push(&sample(20, 2.0));
        assert_eq!(history.ticks(), (50, 51));
    }
}
