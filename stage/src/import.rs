//! `flexstage import`: turns public data files into recordings.
//!
//! In: NumPy arrays (`--drive u.npy --position y.npy`) of any shape whose dimensions are named, or one table (`--table`) of
//! columns separated by white space, commas, semicolons or tabs. Out: one recording for each realisation, in the contract's
//! units. Nothing is filtered or resampled; repeated periods are joined.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use ndarray::{ArrayD, Axis, IxDyn};
use ndarray_npy::ReadNpyExt;
use recording::{Meta, Recording, Together};

use crate::say::say;

/// Options of `flexstage import`.
#[derive(clap::Args)]
pub struct Args {
    /// NumPy array of drive voltages.
    #[arg(long, value_name = "NPY", requires = "position", conflicts_with = "table")]
    drive: Option<PathBuf>,
    /// NumPy array of positions, of the same shape but for the number of axes.
    #[arg(long, value_name = "NPY", requires = "drive")]
    position: Option<PathBuf>,
    /// What the arrays' dimensions are, in order: time, axis, record, period, each at most once.
    #[arg(long, value_delimiter = ',', default_value = "time,axis")]
    dims: Vec<String>,
    /// Text table: columns by white space, commas, semicolons or tabs.
    #[arg(long, value_name = "FILE", required_unless_present = "drive")]
    table: Option<PathBuf>,
    /// Columns of the table, by number from 1 or by name: drive_v_1=1,position_um_1=5.
    #[arg(long, value_delimiter = ',', requires = "table")]
    columns: Vec<String>,
    /// Column of the table that holds the time (s): gives the sample rate and shows lost samples.
    #[arg(long, requires = "table", conflicts_with = "rate")]
    time: Option<String>,
    /// First and last line of numbers to take from the table, from 1: 100..8126 (either may be left out).
    #[arg(long, requires = "table")]
    rows: Option<String>,
    /// Samples per second.
    #[arg(long)]
    rate: Option<f64>,
    /// Unit of the voltages: V, mV or kV.
    #[arg(long, default_value = "V")]
    drive_unit: String,
    /// Unit of the positions: m, mm, um or nm.
    #[arg(long, default_value = "um")]
    position_unit: String,
    /// Seconds at the start that only settle the stack's memory; default: the first of several periods.
    #[arg(long)]
    settle: Option<f64>,
    /// Period of the excitation (s); default: that of the array, if it has periods.
    #[arg(long)]
    period: Option<f64>,
    /// What was done.
    #[arg(long, default_value = "import")]
    experiment: String,
    /// Name of the rig.
    #[arg(long, default_value = "")]
    rig: String,
    /// Recording (.parquet or .csv), or a folder for several.
    #[arg(long)]
    out: PathBuf,
}

/// Run the command.
pub fn run(args: Args) -> anyhow::Result<()> {
    let recordings = match (&args.drive, &args.position, &args.table) {
        (Some(drive), Some(position), _) => from_arrays(&args, drive, position)?,
        (_, _, Some(table)) => vec![from_table(&args, table)?],
        _ => bail!("expected --drive and --position, or --table"),
    };
    let one = recording::check_name(&args.out).is_ok();
    let mut together = Together::default();
    let paths: Vec<PathBuf> = if one {
        ensure!(
            recordings.len() == 1,
            "--out {}: expected a folder for {} recordings, found the name of one",
            args.out.display(),
            recordings.len()
        );
        vec![args.out.clone()]
    } else {
        // A name with another ending is a slip, unless there is such a folder.
        ensure!(
            args.out.is_dir() || args.out.extension().is_none(),
            "--out {}: expected a name that ends in .parquet or .csv and is no folder, or a folder (one with a dot in its name has to be \
             made before)",
            args.out.display()
        );
        ensure!(
            Path::new(&args.experiment).file_name().is_some_and(|n| n == args.experiment.as_str())
                && !args.experiment.starts_with('.'),
            "--experiment: the recordings are named after it: expected text without / that does not begin with a dot, found \"{}\"",
            args.experiment
        );
        together.folder(&args.out)?;
        let name = |r: &Recording| args.out.join(format!("{}.parquet", r.meta.experiment));
        recordings.iter().map(name).collect()
    };
    // All are written before the first gets its name.
    let inputs = [&args.drive, &args.position, &args.table];
    for (recording, path) in recordings.iter().zip(&paths) {
        crate::diagnose::no_input(path, inputs.into_iter().flatten().map(PathBuf::as_path))?;
        recording.check(args.drive.as_deref().or(args.table.as_deref()).unwrap_or(&args.out))?;
        recording.write_into(&mut together, path)?;
    }
    together.publish()?;
    for (recording, path) in recordings.iter().zip(&paths) {
        say!("{}: {} samples, {} axes", path.display(), recording.len(), recording.axes())?;
    }
    Ok(())
}

/// Factor to volts.
fn volts(unit: &str) -> anyhow::Result<f64> {
    match unit {
        "V" => Ok(1.0),
        "mV" => Ok(1e-3),
        "kV" => Ok(1e3),
        _ => bail!("--drive-unit: expected V, mV or kV, found \"{unit}\""),
    }
}

/// Factor to micrometres.
fn micrometres(unit: &str) -> anyhow::Result<f64> {
    match unit {
        "m" => Ok(1e6),
        "mm" => Ok(1e3),
        "um" => Ok(1.0),
        "nm" => Ok(1e-3),
        _ => bail!("--position-unit: expected m, mm, um or nm, found \"{unit}\""),
    }
}

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

fn from_arrays(args: &Args, drive: &Path, position: &Path) -> anyhow::Result<Vec<Recording>> {
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

/// Splits a line of a table at its separators.
fn fields(line: &str) -> Vec<&str> {
    for separator in ['\t', ';', ','] {
        if line.contains(separator) {
            return line.split(separator).map(str::trim).collect();
        }
    }
    line.split_whitespace().collect()
}

/// `FROM..TO`, from 1, both ends taken.
fn row_range(text: &str) -> anyhow::Result<(usize, usize)> {
    let wrong = || format!("--rows: expected FROM..TO, counted from 1, found \"{text}\"");
    let (from, to) = text.split_once("..").with_context(wrong)?;
    let number = |part: &str, default: usize| match part {
        "" => Ok(default),
        part => part.parse().with_context(wrong),
    };
    let (from, to) = (number(from, 1)?, number(to, usize::MAX)?);
    ensure!(1 <= from && from <= to, wrong());
    Ok((from, to))
}

fn from_table(args: &Args, path: &Path) -> anyhow::Result<Recording> {
    let text = fs::read(path).with_context(|| format!("{}: cannot open", path.display()))?;
    let text = String::from_utf8_lossy(&text);
    let (first, last) = args.rows.as_deref().map_or(Ok((1, usize::MAX)), row_range)?;
    let mut header: Vec<&str> = Vec::new();
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut numeric = 0;
    let mut not_numeric = None;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim().trim_start_matches('\u{feff}');
        if line.is_empty() || line.starts_with(['#', '%']) {
            continue;
        }
        let fields = fields(line);
        match fields.iter().map(|field| field.parse::<f64>()).collect::<Result<Vec<_>, _>>() {
            Ok(row) => {
                numeric += 1;
                if (first..=last).contains(&numeric) {
                    rows.push(row);
                }
            }
            // Lines of text before the first numbers are headers; the last one names the columns.
            Err(_) if numeric == 0 => {
                if !header.is_empty() {
                    not_numeric.get_or_insert((number + 1, line));
                }
                header = fields;
            }
            Err(_) => {
                bail!("{}: line {}: expected numbers, found \"{line}\"", path.display(), number + 1)
            }
        }
    }
    if let (0, Some((number, line))) = (numeric, not_numeric) {
        bail!(
            "{}: expected rows of numbers (with points, and no separator at the end), found none; line {number} is \"{}\"",
            path.display(),
            line.chars().take(60).collect::<String>()
        );
    }
    ensure!(!rows.is_empty(), "{}: expected rows of numbers, found none", path.display());
    let width = rows[0].len();
    if let Some(row) = rows.iter().position(|row| row.len() != width) {
        let (row, found) = (row + first, rows[row].len());
        bail!("{}: row {row}: expected {width} columns, found {found}", path.display());
    }
    let column = |which: &str| -> anyhow::Result<Vec<f64>> {
        let index = match which.parse::<usize>() {
            Ok(number) => number.checked_sub(1),
            Err(_) => header.iter().position(|name| *name == which),
        };
        let Some(index) = index.filter(|index| *index < width) else {
            bail!(
                "{}: expected a column {which}, found {width} columns {header:?}",
                path.display()
            );
        };
        Ok(rows.iter().map(|row| row[index]).collect())
    };
    let (rate, tick) = match (&args.time, args.rate) {
        (Some(which), _) => clock(&column(which)?, path)?,
        (None, Some(rate)) => (rate, (0..rows.len() as u64).collect()),
        (None, None) => bail!("expected --rate (Hz) or --time (the column that holds it)"),
    };
    let meta = Meta {
        settle_s: args.settle.unwrap_or(0.0),
        period_s: args.period,
        rig: args.rig.clone(),
        ..Meta::new(args.experiment.clone(), rate)
    };
    ensure!(
        !args.columns.is_empty(),
        "--columns: expected for example drive_v_1=1,position_um_1=2"
    );
    let (volt, micrometre) = (volts(&args.drive_unit)?, micrometres(&args.position_unit)?);
    let mut recording = Recording::empty(meta, 0);
    recording.tick = tick;
    let mut driven = Vec::new();
    for assignment in &args.columns {
        let wrong = || format!("--columns: expected NAME_AXIS=COLUMN, found \"{assignment}\"");
        let (name, which) = assignment.split_once('=').with_context(wrong)?;
        let (kind, axis) = name.rsplit_once('_').with_context(wrong)?;
        let axis: usize = axis.parse().with_context(wrong)?;
        ensure!((1..=recording::MAX_AXES).contains(&axis), wrong());
        if recording.axes() < axis {
            let rows = recording.len();
            recording.drive_v.resize(axis, vec![0.0; rows]);
            recording.monitor_v.resize(axis, None);
            recording.position_um.resize(axis, None);
            recording.reference_um.resize(axis, None);
        }
        let scale = |scale: f64| -> anyhow::Result<Vec<f32>> {
            Ok(column(which)?.into_iter().map(|value| (value * scale) as f32).collect())
        };
        match kind {
            "drive_v" => {
                recording.drive_v[axis - 1] = scale(volt)?;
                driven.push(axis);
            }
            "monitor_v" => recording.monitor_v[axis - 1] = Some(scale(volt)?),
            "position_um" => recording.position_um[axis - 1] = Some(scale(micrometre)?),
            "reference_um" => recording.reference_um[axis - 1] = Some(scale(micrometre)?),
            _ => bail!(
                "--columns: expected drive_v, monitor_v, position_um or reference_um, found \"{kind}\""
            ),
        }
    }
    ensure!(!driven.is_empty(), "--columns: expected a drive_v_K, found none");
    ensure!(
        recording.position_um.iter().any(Option::is_some),
        "--columns: expected a position_um_K, found none"
    );
    Ok(recording)
}

/// Sample rate and sample numbers from times: the median step is a tick; longer ones are lost samples.
fn clock(times: &[f64], path: &Path) -> anyhow::Result<(f64, Vec<u64>)> {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let step = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    ensure!(
        step > 0.0 && step.is_finite(),
        "{}: --time: expected increasing seconds, found a median step of {step} s",
        path.display()
    );
    // Over the whole length, so that a time printed with few digits still gives the rate.
    let span = times[times.len() - 1] - times[0];
    let ticks = (span / step).round().max(1.0);
    let rate = ticks / span;
    let tick =
        times.iter().map(|time| ((time - times[0]) * rate).round().max(0.0) as u64).collect();
    Ok((rate, tick))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use ndarray::{Array2, Array4};
    use ndarray_npy::WriteNpyExt;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    fn import(folder: &Path, options: &str) -> anyhow::Result<()> {
        let words = options.replace('@', folder.to_str().expect("a path in plain text"));
        let words = std::iter::once("import".to_string()).chain(words.split(' ').map(String::from));
        run(Command::try_parse_from(words)?.args)
    }

    fn save<D: ndarray::Dimension>(array: &ndarray::Array<f64, D>, path: &Path) {
        array.write_npy(fs::File::create(path).unwrap()).unwrap();
    }

    #[test]
    fn arrays_of_realisations_and_periods_become_recordings() {
        let folder = tempfile::tempdir().unwrap();
        let value = |(t, axis, record, period): (usize, usize, usize, usize)| {
            t as f64 + 10.0 * axis as f64 + 100.0 * record as f64 + 1000.0 * period as f64
        };
        let u = Array4::from_shape_fn((8, 3, 2, 2), value);
        save(&u, &folder.path().join("u.npy"));
        save(&(&u * 1e-6), &folder.path().join("y.npy"));
        import(folder.path(), "--drive @/u.npy --position @/y.npy --dims time,axis,record,period --rate 64 --position-unit m --experiment ms --out @/out").unwrap();
        let second = Recording::read(folder.path().join("out/ms-2.parquet")).unwrap();
        assert_eq!((second.len(), second.axes()), (16, 3));
        assert_eq!((second.meta.period_s, second.meta.settle_s), (Some(0.125), 0.125));
        assert_eq!(second.meta.start_s, 0.25);
        assert_eq!(second.drive_v[2][9], value((1, 2, 1, 1)) as f32);
        assert!(
            (second.position_um[2].as_ref().unwrap()[9] - value((1, 2, 1, 1)) as f32).abs() < 1e-3
        );
        // Other orders of dimensions, and none for axes.
        let time_last = Array2::from_shape_fn((3, 8), |(axis, t)| value((t, axis, 0, 0)));
        save(&time_last, &folder.path().join("t.npy"));
        import(
            folder.path(),
            "--drive @/t.npy --position @/t.npy --dims axis,time --rate 64 --out @/one.csv",
        )
        .unwrap();
        assert_eq!(Recording::read(folder.path().join("one.csv")).unwrap().drive_v[1][3], 13.0);
    }

    #[test]
    fn tables_by_number_by_name_and_by_time() {
        let folder = tempfile::tempdir().unwrap();
        let mut text = String::from("% measured\n");
        for row in 0..100 {
            text += &format!("  {:.3}  x{row}  {}\n", 0.5 * f64::from(row), row).replace('x', "");
        }
        fs::write(folder.path().join("a.dat"), text).unwrap();
        import(folder.path(), "--table @/a.dat --columns drive_v_1=1,position_um_2=3 --rows 11..20 --rate 200 --drive-unit mV --position-unit nm --out @/a.parquet").unwrap_err();
        import(folder.path(), "--table @/a.dat --columns drive_v_1=1,position_um_1=3 --rows 11..20 --rate 200 --drive-unit mV --position-unit nm --out @/a.parquet").unwrap();
        let recording = Recording::read(folder.path().join("a.parquet")).unwrap();
        assert_eq!((recording.len(), recording.drive_v[0][0]), (10, 0.005));
        assert_eq!(recording.position_um[0].as_ref().unwrap()[9], 0.019);

        // Named columns; two samples are missing between 0.2 and 0.5 s.
        fs::write(
            folder.path().join("b.csv"),
            "t,um,V\n0.0,1,2\n0.1,2,3\n0.2,3,4\n0.5,4,5\n0.6,5,6\n",
        )
        .unwrap();
        import(
            folder.path(),
            "--table @/b.csv --columns drive_v_1=V,position_um_1=um --time t --out @/b.parquet",
        )
        .unwrap();
        let recording = Recording::read(folder.path().join("b.parquet")).unwrap();
        assert_eq!(recording.tick, [0, 1, 2, 5, 6]);
        assert!((recording.meta.sample_rate_hz - 10.0).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_imported_is_said_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a.dat"), "1 2\n3 4\nx y\n").unwrap();
        fs::write(folder.path().join("b.dat"), "1 2\n3\n").unwrap();
        fs::write(folder.path().join("c.npy"), "no array").unwrap();
        save(&Array2::zeros((4, 3)), &folder.path().join("u.npy"));
        save(&Array2::zeros((5, 3)), &folder.path().join("y.npy"));
        for (options, expected) in [
            ("--table @/a.dat --columns drive_v_1=1,position_um_1=2 --rate 1", "line 3"),
            (
                "--table @/b.dat --columns drive_v_1=1,position_um_1=2 --rate 1",
                "row 2: expected 2 columns, found 1",
            ),
            ("--table @/none.dat --columns drive_v_1=1,position_um_1=2 --rate 1", "cannot open"),
            ("--drive @/c.npy --position @/c.npy --rate 1", "NumPy"),
            ("--drive @/u.npy --position @/y.npy --rate 1", "expected the times"),
            ("--drive @/u.npy --position @/u.npy", "--rate"),
            ("--drive @/u.npy --position @/u.npy --rate 1 --dims time", "shape [4, 3]"),
            ("--drive @/u.npy --position @/u.npy --rate 1 --dims axis,record", "--dims"),
            ("--drive @/u.npy --position @/u.npy --rate 1 --position-unit inch", "inch"),
        ] {
            let message = format!(
                "{:#}",
                import(folder.path(), &format!("{options} --out @/out.parquet")).unwrap_err()
            );
            assert!(message.contains(expected), "{options}: {message}");
        }
        assert!(!folder.path().join("out.parquet").exists());
    }
}
