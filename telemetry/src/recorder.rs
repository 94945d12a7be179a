//! Records the stream to the contract's Parquet while it runs.
//!
//! A thread of its own takes every batch to `recording`'s streaming writer, which puts one second after the other on disk with a
//! journal. Whatever ends the recording (stop, unplug, a board that restarts, a full disk, a crash of this program), at most the
//! last second is missing, and [`Progress::ended`] says what happened and where the file is.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use recording::{Channels, Meta, StreamWriter};
use serde::Serialize;

use crate::device::{Batch, Device, lock};
use crate::sample::{AXES, Sample};
use crate::{Error, Result};

/// How a recording ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "how")]
pub enum Ended {
    /// As asked.
    Stopped,
    /// The board went away or restarted; the file is complete up to there.
    BoardGone {
        /// Why.
        reason: String,
    },
    /// It could not be written any more; what was written is kept.
    CannotWrite {
        /// Why, and what to do.
        reason: String,
    },
}

/// Where a recording stands.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Progress {
    /// The file, or what it will be called.
    pub path: PathBuf,
    /// Samples taken.
    pub rows: u64,
    /// Ticks that never arrived.
    pub lost_ticks: u64,
    /// Length on the sample clock.
    pub seconds: f64,
    /// How it ended; `None` while it runs.
    pub ended: Option<Ended>,
}

/// A recording that runs.
pub struct Recorder {
    progress: Arc<Mutex<Progress>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Recorder {
    /// Start recording everything that the device streams. Refuses to overwrite a file.
    pub fn start(device: &Device, path: &Path, experiment: &str, rig: &str) -> Result<Self> {
        Self::start_for(device, path, experiment, rig, None)
    }

    /// As [`Recorder::start`]; ends by itself after so many seconds on the sample clock.
    pub fn start_for(
        device: &Device,
        path: &Path,
        experiment: &str,
        rig: &str,
        seconds: Option<f64>,
    ) -> Result<Self> {
        let rate = device.info().sample_rate_hz;
        let meta = Meta { rig: rig.to_owned(), ..Meta::new(experiment, rate) };
        Self::record(device.subscribe(), path, meta, seconds)
    }

    /// Record batches until their source ends, or for so many seconds on the sample clock.
    pub fn record(
        batches: Receiver<Batch>,
        path: &Path,
        meta: Meta,
        seconds: Option<f64>,
    ) -> Result<Self> {
        let rate = meta.sample_rate_hz;
        let channels = Channels { axes: AXES, monitor: true, reference: true, flags: true };
        let writer = StreamWriter::create(path, meta, channels)?;
        let progress = Arc::new(Mutex::new(Progress {
            path: path.to_owned(),
            rows: 0,
            lost_ticks: 0,
            seconds: 0.0,
            ended: None,
        }));
        let stop = Arc::new(AtomicBool::new(false));
        let job = Job {
            writer,
            batches,
            rate,
            ticks: seconds.map(|seconds| ((seconds * rate).round() as u64).max(1)),
            first: None,
            progress: progress.clone(),
            stop: stop.clone(),
        };
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || job.run())
            .map_err(|source| Error::File { path: "recorder thread".into(), source })?;
        Ok(Self { progress, stop, thread: Some(thread) })
    }

    /// Where it stands.
    pub fn progress(&self) -> Progress {
        lock(&self.progress).clone()
    }

    /// End the recording with what has arrived by now, and wait until the file is complete.
    pub fn stop(mut self) -> Progress {
        self.shut();
        self.progress()
    }

    fn shut(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.shut();
    }
}

struct Job {
    writer: StreamWriter,
    batches: Receiver<Batch>,
    rate: f64,
    /// Length, if it is to end by itself.
    ticks: Option<u64>,
    first: Option<u64>,
    progress: Arc<Mutex<Progress>>,
    stop: Arc<AtomicBool>,
}

impl Job {
    fn run(mut self) {
        let result = self.take_all();
        let path = lock(&self.progress).path.clone();
        // A recording without a single sample is not a recording: nothing to keep.
        let ended = match result.map(|ended| (self.writer.finish(), ended)) {
            Ok((Ok(_), ended)) => ended,
            Ok((Err(error), _)) | Err(error) => cannot_write(&path, &error.to_string(), self.rate),
        };
        lock(&self.progress).ended = Some(ended);
    }

    fn take_all(&mut self) -> recording::Result<Ended> {
        while !self.stop.load(Ordering::Acquire) {
            match self.batches.recv_timeout(Duration::from_millis(20)) {
                Ok(batch) => {
                    if let Some(ended) = self.take(&batch)? {
                        return Ok(ended);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let reason = "the connection to the board was lost".to_owned();
                    return Ok(Ended::BoardGone { reason });
                }
            }
        }
        // On a stop everything that had arrived before is still written. Out of the queue at once: with a fast source it might never be
        // empty while this writes.
        let arrived: Vec<Batch> = self.batches.try_iter().collect();
        for batch in arrived {
            if let Some(ended) = self.take(&batch)? {
                return Ok(ended);
            }
        }
        Ok(Ended::Stopped)
    }

    /// Writes a batch; how the recording ends with it, if it does.
    fn take(&mut self, batch: &Batch) -> recording::Result<Option<Ended>> {
        if batch.restarted && self.first.is_some() {
            let reason = "the board restarted: its ticks count anew".to_owned();
            return Ok(Some(Ended::BoardGone { reason }));
        }
        let Some(newest) = batch.samples.last() else { return Ok(None) };
        let first = *self.first.get_or_insert(batch.samples[0].tick);
        let end = self.ticks.map_or(u64::MAX, |ticks| first.saturating_add(ticks));
        let mut last = None;
        for sample in batch.samples.iter().take_while(|sample| sample.tick < end) {
            self.writer.push(&recording_sample(sample))?;
            last = Some(sample.tick);
        }
        if let Some(last) = last {
            let mut progress = lock(&self.progress);
            progress.rows = self.writer.rows();
            progress.lost_ticks = self.writer.lost_ticks();
            progress.seconds = (last - first + 1) as f64 / self.rate;
        }
        Ok((newest.tick.saturating_add(1) >= end).then_some(Ended::Stopped))
    }
}

/// What is on disk is vouched for by the journal. Makes it a file again at once, if the disk lets us.
fn cannot_write(path: &Path, error: &str, rate: f64) -> Ended {
    let shown = path.display();
    let kept = match recording::recover(path) {
        Ok(kept) => {
            let seconds = kept.span_ticks() as f64 / rate;
            format!("the first {seconds:.1} s are safe in {shown}")
        }
        // In its first second, of which nothing can be read: nor should it be in the way of the next recording.
        Err(_) if recording::recoverable_rows(path).is_ok_and(|rows| rows == 0) => {
            recording::discard(path);
            "nothing had been written yet: there is no recording".into()
        }
        Err(_) => format!(
            "what was written before is kept in {shown}.part and {shown}.journal: free some space and run `flexstage record --recover {shown}`"
        ),
    };
    Ended::CannotWrite { reason: format!("{error}; {kept}") }
}

fn recording_sample(sample: &Sample) -> recording::Sample<'_> {
    recording::Sample {
        tick: sample.tick,
        drive_v: &sample.drive_v,
        monitor_v: &sample.monitor_v,
        position_um: &sample.position_um,
        reference_um: &sample.reference_um,
        flags: sample.flags,
    }
}

/// A finished recording of samples that are in memory.
pub fn to_recording(samples: &[Sample], meta: Meta) -> recording::Recording {
    let mut out = recording::Recording::empty(meta, AXES);
    out.tick = samples.iter().map(|s| s.tick).collect();
    out.flags = Some(samples.iter().map(|s| s.flags).collect());
    for axis in 0..AXES {
        let column =
            |of: fn(&Sample) -> &[f32; AXES]| samples.iter().map(|s| of(s)[axis]).collect();
        out.drive_v[axis] = column(|s| &s.drive_v);
        out.monitor_v[axis] = Some(column(|s| &s.monitor_v));
        out.position_um[axis] = Some(column(|s| &s.position_um));
        out.reference_um[axis] = Some(column(|s| &s.reference_um));
    }
    out
}
