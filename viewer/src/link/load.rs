//! A recording, our own or another program's, as what the window shows.

use std::path::Path;

use telemetry::{AXES, History, Sample};

use super::LinkState;

/// A recording as history.
pub(super) fn load(
    path: &Path,
    sample_rate_hz: Option<f64>,
) -> anyhow::Result<(History, LinkState)> {
    let is_csv = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    let recording = match sample_rate_hz {
        Some(rate) if is_csv => recording::Recording::read_csv(path, rate)?,
        // An interrupted recording is finished first.
        _ if !path.exists() => recording::recover(path)?,
        _ => recording::Recording::read(path)?,
    };
    let rate = recording.meta.sample_rate_hz;
    let mut history = History::new(rate, recording.span_ticks() as f64 / rate + 1.0);
    let value =
        |column: &Option<Vec<f32>>, row: usize| column.as_ref().map_or(f32::NAN, |c| c[row]);
    for row in 0..recording.len() {
        let mut sample = Sample { tick: recording.tick[row], ..Sample::default() };
        sample.flags = recording.flags.as_ref().map_or(0, |flags| flags[row]);
        for axis in 0..recording.axes().min(AXES) {
            sample.drive_v[axis] = recording.drive_v[axis][row];
            sample.position_um[axis] = value(&recording.position_um[axis], row);
            sample.reference_um[axis] = value(&recording.reference_um[axis], row);
            sample.monitor_v[axis] = value(&recording.monitor_v[axis], row);
        }
        history.push(&sample);
    }
    let about = format!(
        "{}{} axes, {:.1} s at {rate} Hz, {} ticks lost",
        if recording.meta.experiment.is_empty() {
            String::new()
        } else {
            format!("{}, ", recording.meta.experiment)
        },
        recording.axes(),
        recording.span_ticks() as f64 / rate,
        recording.lost().iter().map(|l| l.ticks).sum::<u64>()
    );
    Ok((history, LinkState::Recording { path: path.to_owned(), about }))
}
