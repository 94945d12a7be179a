//! NumPy arrays to recordings.

use std::fs;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use ndarray::{ArrayD, Axis, IxDyn};
use ndarray_npy::ReadNpyExt;
use recording::{Meta, Recording};

use super::{Args, micrometres, volts};

/// Reads an array of any real number type, and orders its dimensions time, axis, record, period.
fn read_array(path: &Path, dims: &[String]) -> anyhow::Result<ArrayD<f64>> {
    let bytes = fs::read(path).with_context(|| format!("{}: cannot open", path.display()))?;
    let try_read = || -> Result<ArrayD<f64>, ndarray_npy::ReadNpyError> {
        let wrong = match ArrayD::<f64>::read_npy(bytes.as_slice()) {
            Ok(array) => return Ok(array),
            Err(error) => error,
        };
        macro_rules! try_types {
            ($($kind:ty),*) => {$(
                if let Ok(array) = ArrayD::<$kind>::read_npy(bytes.as_slice()) {
                    return Ok(array.mapv(|value| value as f64));
                }
            )*};
        }
        // Beyond 2^53 a 64-bit count is rounded: no voltage or position is told that finely.
        try_types!(f32, i16, i32, i64, u16, u32, u64, i8, u8);
        Err(wrong)
    };
    let array = try_read().map_err(|error| {
        anyhow::anyhow!("{}: expected a NumPy array of floats or integers: {error}", path.display())
    })?;
    ensure!(
        array.ndim() == dims.len(),
        "{}: expected the {} dimensions of --dims {}, found shape {:?}",
        path.display(),
        dims.len(),
        dims.join(","),
        array.shape()
    );
    let mut order = Vec::new();
    let mut missing = Vec::new();
    for (place, name) in ["time", "axis", "record", "period"].into_iter().enumerate() {
        match dims.iter().position(|dim| dim == name) {
            Some(at) => order.push(at),
            None => missing.push(place),
        }
    }
    ensure!(
        order.len() == dims.len() && dims.iter().any(|dim| dim == "time"),
        "--dims: expected time, and axis, record and period at most once each, found {}",
        dims.join(",")
    );
    let mut array = array.permuted_axes(IxDyn(&order));
    for place in missing {
        array = array.insert_axis(Axis(place));
    }
    Ok(array)
}

pub(super) fn read(args: &Args, drive: &Path, position: &Path) -> anyhow::Result<Vec<Recording>> {
    let Some(rate) = args.rate else {
        bail!("--rate: expected the sample rate (Hz) of the arrays")
    };
    let u = read_array(drive, &args.dims)?;
    let y = read_array(position, &args.dims)?;
    for dim in [0, 2, 3] {
        ensure!(
            u.shape()[dim] == y.shape()[dim],
            "{}: expected the times, records and periods of {}, {:?}, found {:?}",
            position.display(),
            drive.display(),
            u.shape(),
            y.shape()
        );
    }
    let (samples, records, periods) = (u.shape()[0], u.shape()[2], u.shape()[3]);
    let axes = u.shape()[1].max(y.shape()[1]);
    let (volt, micrometre) = (volts(&args.drive_unit)?, micrometres(&args.position_unit)?);
    let period_s = args.period.or((periods > 1).then(|| samples as f64 / rate));
    let settle_s = args.settle.or(period_s.filter(|_| periods > 1)).unwrap_or(0.0);
    let mut recordings = Vec::new();
    for record in 0..records {
        let column = |array: &ArrayD<f64>, axis: usize, scale: f64| -> Option<Vec<f32>> {
            (axis < array.shape()[1]).then(|| {
                let periods = (0..periods)
                    .flat_map(|period| (0..samples).map(move |sample| (sample, period)));
                periods
                    .map(|(sample, period)| (array[[sample, axis, record, period]] * scale) as f32)
                    .collect()
            })
        };
        let experiment = if records > 1 {
            format!("{}-{}", args.experiment, record + 1)
        } else {
            args.experiment.clone()
        };
        let meta = Meta {
            settle_s,
            period_s,
            start_s: record as f64 * (samples * periods) as f64 / rate,
            rig: args.rig.clone(),
            ..Meta::new(experiment, rate)
        };
        let mut recording = Recording::empty(meta, axes);
        recording.tick = (0..(samples * periods) as u64).collect();
        for axis in 0..axes {
            let rows = recording.tick.len();
            recording.drive_v[axis] = column(&u, axis, volt).unwrap_or_else(|| vec![0.0; rows]);
            recording.position_um[axis] = column(&y, axis, micrometre);
        }
        recordings.push(recording);
    }
    ensure!(
        !recordings.is_empty(),
        "{}: expected at least one record, found none",
        drive.display()
    );
    Ok(recordings)
}
