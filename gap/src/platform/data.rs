//! Free returns from a session's recordings, and which samples are held out.

use std::path::Path;

use recording::{Entry, Recording, Session};

/// A recording that cannot be used as a free return: one line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {message}")]
pub struct PlatformDataError {
    /// Recording or rig at fault.
    pub file: String,
    /// What was expected, what was found, what to do.
    pub message: String,
}

/// One free return.
#[derive(Debug, Clone)]
pub struct Return {
    /// File name inside the session.
    pub file: String,
    /// Time of every sample after the release, s.
    pub time_s: Vec<f64>,
    /// Measured position, m.
    pub position_m: Vec<f64>,
    /// Deflection that the platform was held at, m.
    pub initial_m: f64,
    /// Release on the session's clock, s.
    pub start_s: f64,
    /// First sample that is scored.
    pub scored_from: usize,
}

/// Some samples of some returns: what a fit sees, or what it is scored on.
#[derive(Debug, Clone, Default)]
pub struct Part {
    /// Index into the returns, and rows in ascending order.
    pub rows: Vec<(usize, Vec<usize>)>,
}

/// What is fitted and what is held out.
#[derive(Debug, Clone)]
pub struct Split {
    /// Samples that parameters are fitted to.
    pub fit: Part,
    /// Samples that are only scored.
    pub held_out: Part,
    /// In words, for the report.
    pub how: String,
}

/// Farthest position and deflection that a recording can hold, um: a metre. The platform is a few centimetres large.
const FARTHEST_UM: f64 = 1.0e6;
/// Share of the initial position by which the first positions contradict it.
const CONTRADICTS: f64 = 0.5;
/// Fewest scored samples that a return must have.
const MIN_SAMPLES: usize = 20;
/// Held-out blocks of a single recording.
const BLOCKS: usize = 160;

/// The position channel and the deflection of a free return.
pub fn free_return_of(
    recording: &Recording,
    file: &Path,
) -> Result<(f64, Vec<f64>), PlatformDataError> {
    let fail =
        |message: String| Err(PlatformDataError { file: file.display().to_string(), message });
    let Some(initial_um) = recording.meta.initial_position_um else {
        return fail(
            "key initial_position_um is missing from the metadata: a free return of a platform needs the deflection \
             that it was held at, in um"
                .to_owned(),
        );
    };
    if !initial_um.is_finite() || initial_um == 0.0 {
        return fail(format!(
            "key initial_position_um must be a number other than zero, found {initial_um}"
        ));
    }
    if initial_um.abs() > FARTHEST_UM {
        return fail(format!(
            "key initial_position_um: expected micrometres from -{FARTHEST_UM} to {FARTHEST_UM}, found {initial_um:e}"
        ));
    }
    let first = recording.tick.first().copied().unwrap_or(0);
    let rate = recording.meta.sample_rate_hz;
    let time_s = recording.tick.iter().map(|tick| (tick - first) as f64 / rate).collect();
    Ok((initial_um * 1e-6, time_s))
}

impl Return {
    /// A recording as a free return.
    pub fn of(entry: &Entry) -> Result<Self, PlatformDataError> {
        let Entry { path, file, recording } = entry;
        let (initial_m, time_s) = free_return_of(recording, path)?;
        let fail =
            |message: String| Err(PlatformDataError { file: path.display().to_string(), message });
        if recording.axes() != 1 {
            return fail(format!(
                "a platform has one axis, found columns of {} axes",
                recording.axes()
            ));
        }
        let Some(position) = recording.position_um.first().and_then(Option::as_ref) else {
            return fail("column position_um_1 is missing".to_owned());
        };
        // Also what is not scored: a wrong number there is a wrong file.
        if let Some(row) = position.iter().position(|um| f64::from(um.abs()) > FARTHEST_UM) {
            return fail(format!(
                "column position_um_1, row {row}: expected micrometres from -{FARTHEST_UM} to {FARTHEST_UM}, found {:e}",
                position[row]
            ));
        }
        let scored_from = recording.settle_rows();
        let scored = position.len().saturating_sub(scored_from);
        if scored < MIN_SAMPLES {
            return fail(format!(
                "{scored} of {} samples come after settle_s = {} s: expected at least {MIN_SAMPLES}",
                position.len(),
                recording.meta.settle_s
            ));
        }
        let found = Self {
            file: file.clone(),
            time_s,
            position_m: position.iter().map(|um| f64::from(*um) * 1e-6).collect(),
            initial_m,
            start_s: recording.meta.start_s,
            scored_from,
        };
        if found.first_over_initial() < -CONTRADICTS {
            return fail(format!(
                "key initial_position_um is {:.1} and the first positions are about {:.0} um: expected the same sign; turn that of \
                 initial_position_um, or of column position_um_1",
                initial_m * 1e6,
                found.first_m() * 1e6
            ));
        }
        Ok(found)
    }

    /// Where the platform is at the release, as measured, m: one wrong sample does not count.
    fn first_m(&self) -> f64 {
        let mut first: Vec<f64> = self.position_m.iter().take(3).copied().collect();
        first.sort_by(f64::total_cmp);
        first.get(first.len() / 2).copied().unwrap_or(0.0)
    }

    fn first_over_initial(&self) -> f64 {
        self.first_m() / self.initial_m
    }

    /// One line where the first positions are not those of a platform that was held at its initial one.
    pub fn doubt(&self) -> Option<String> {
        ((self.first_over_initial() - 1.0).abs() > CONTRADICTS).then(|| {
            format!(
                "{}: initial_position_um is {:.0}, but the first positions are about {:.0} um: check it, and that the recording begins \
                 at the release.",
                self.file,
                self.initial_m * 1e6,
                self.first_m() * 1e6
            )
        })
    }

    /// Rows that are scored.
    pub fn scored(&self) -> std::ops::Range<usize> {
        self.scored_from..self.position_m.len()
    }
}

/// All free returns of a session, in its order.
pub fn returns(session: &Session) -> Result<Vec<Return>, PlatformDataError> {
    session.recordings.iter().map(Return::of).collect()
}

impl Part {
    /// Every scored sample of every return.
    pub fn all(returns: &[Return]) -> Self {
        Self { rows: returns.iter().map(|r| r.scored().collect()).enumerate().collect() }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.rows.iter().map(|(_, rows)| rows.len()).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Hold out the other deflections where there are several recordings (the largest deflection is fitted, then every other
/// one by size), interleaved blocks where there is one.
pub fn split(returns: &[Return]) -> Split {
    let mut split = Split { fit: Part::default(), held_out: Part::default(), how: String::new() };
    if let [only] = returns {
        let rows: Vec<usize> = only.scored().collect();
        let block = (rows.len() / BLOCKS).max(5);
        let (mut fit, mut held_out) = (Vec::new(), Vec::new());
        for (index, chunk) in rows.chunks(block).enumerate() {
            if index % 2 == 0 { &mut fit } else { &mut held_out }.extend_from_slice(chunk);
        }
        split.how =
            format!("one recording: blocks of {block} samples are fitted and held out in turn");
        split.fit.rows.push((0, fit));
        split.held_out.rows.push((0, held_out));
        return split;
    }
    let mut order: Vec<usize> = (0..returns.len()).collect();
    order.sort_by(|a, b| returns[*b].initial_m.abs().total_cmp(&returns[*a].initial_m.abs()));
    for (place, index) in order.into_iter().enumerate() {
        let part = if place % 2 == 0 { &mut split.fit } else { &mut split.held_out };
        part.rows.push((index, returns[index].scored().collect()));
    }
    for part in [&mut split.fit, &mut split.held_out] {
        part.rows.sort_by_key(|(index, _)| *index);
    }
    let names = |part: &Part| {
        let list: Vec<&str> = part.rows.iter().map(|(i, _)| returns[*i].file.as_str()).collect();
        list.join(", ")
    };
    split.how = format!("fitted: {}; held out: {}", names(&split.fit), names(&split.held_out));
    split
}
