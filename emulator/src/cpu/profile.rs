//! What the handlers cost: instructions and time, per exception; where the tick spends them; how deep the stack goes.

use std::collections::HashMap;

use crate::time::{NEVER, Time};

/// Cost of one exception's handler, without what preempted it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Runs.
    pub count: u64,
    /// Fewest instructions of a run.
    pub min: u64,
    /// Most.
    pub max: u64,
    /// All runs together.
    pub sum: u64,
    /// Longest time from entry to return, preemption included.
    pub longest: Time,
    /// Latest entry after the trigger edge that started it (the tick only).
    pub latest_entry: Time,
}

impl Default for Cost {
    fn default() -> Self {
        Cost { count: 0, min: NEVER, max: 0, sum: 0, longest: 0, latest_entry: 0 }
    }
}

impl Cost {
    /// Mean instructions.
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.count.max(1) as f64
    }
}

struct Running {
    exception: u32,
    instructions: u64,
    nested: u64,
    at: Time,
}

/// Collects as the core runs.
#[derive(Default)]
pub struct Profile {
    /// By exception number.
    pub costs: HashMap<u32, Cost>,
    running: Vec<Running>,
    /// Lowest stack pointer at an exception entry.
    pub lowest_frame: u32,
    /// Deepest nesting of handlers.
    pub deepest: usize,
    /// When set, blocks run inside this exception are counted by `(address, size)`.
    pub watched: Option<u32>,
    /// Executions of the watched exception's blocks.
    pub blocks: HashMap<(u32, u32), u64>,
    /// When set, the instructions of every run of this exception are noted.
    pub traced: Option<u32>,
    /// Every run of the traced exception, in order.
    pub runs: Vec<u64>,
}

impl Profile {
    /// Forgets the costs, keeps what is running.
    pub fn clear(&mut self) {
        self.costs.clear();
        self.blocks.clear();
        self.runs.clear();
        self.deepest = 0;
    }

    /// After a reset nothing runs.
    pub fn reset(&mut self) {
        self.running.clear();
    }

    pub(super) fn enter(&mut self, exception: u32, instructions: u64, at: Time, frame: u32) {
        self.running.push(Running { exception, instructions, nested: 0, at });
        self.deepest = self.deepest.max(self.running.len());
        if self.lowest_frame == 0 || frame < self.lowest_frame {
            self.lowest_frame = frame;
        }
    }

    pub(super) fn leave(&mut self, exception: u32, instructions: u64, now: Time) {
        let Some(run) = self.running.pop().filter(|r| r.exception == exception) else { return };
        let total = instructions - run.instructions;
        let own = total - run.nested.min(total);
        if let Some(outer) = self.running.last_mut() {
            outer.nested += total;
        }
        if self.traced == Some(exception) {
            self.runs.push(own);
        }
        let cost = self.costs.entry(exception).or_default();
        cost.count += 1;
        cost.sum += own;
        cost.min = cost.min.min(own);
        cost.max = cost.max.max(own);
        cost.longest = cost.longest.max(now - run.at);
    }

    pub(super) fn watching(&self) -> bool {
        self.watched.is_some() && self.running.last().map(|r| r.exception) == self.watched
    }
}
