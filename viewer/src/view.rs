//! Which stretch of time is on screen, and where the cursors are.

/// Time window of all traces.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeView {
    /// Length shown while live, s.
    pub window_s: f64,
    /// Whether the picture stands still; recording goes on.
    pub is_paused: bool,
    /// What is shown now: first and last time, s.
    pub range_s: (f64, f64),
    /// Cursors A and B, s.
    pub cursors: [Option<f64>; 2],
    /// Range that the plots have to take over in this frame, when they do not follow the newest sample.
    pub jump_s: Option<(f64, f64)>,
}

impl Default for TimeView {
    fn default() -> Self {
        Self {
            window_s: 5.0,
            is_paused: false,
            range_s: (0.0, 5.0),
            cursors: [None; 2],
            jump_s: None,
        }
    }
}

impl TimeView {
    /// The range to show, given the time of the newest sample.
    pub fn follow(&mut self, newest_s: f64) {
        if !self.is_paused {
            self.range_s = (newest_s - self.window_s, newest_s);
        }
    }

    /// Stand still on a range.
    pub fn show(&mut self, from_s: f64, to_s: f64) {
        self.is_paused = true;
        self.range_s = (from_s, to_s);
        self.jump_s = Some((from_s, to_s));
    }
}
