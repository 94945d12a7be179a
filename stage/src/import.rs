//! `flexstage import`: turns public data files into recordings.
//!
//! In: NumPy arrays (`--drive u.npy --position y.npy`) of any shape whose dimensions are named, or one table (`--table`) of
//! columns separated by white space, commas, semicolons or tabs. Out: one recording for each realisation, in the contract's
//! units. Nothing is filtered or resampled; repeated periods are joined.

use std::path::{Path, PathBuf};

use anyhow::{bail, ensure};
use recording::{Recording, Together};

use crate::number::{number, rate};
use crate::say::say;

mod arrays;
mod clock;
mod table;

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
    #[arg(long, value_parser = rate())]
    rate: Option<f64>,
    /// Unit of the voltages: V, mV or kV.
    #[arg(long, default_value = "V")]
    drive_unit: String,
    /// Unit of the positions: m, mm, um or nm.
    #[arg(long, default_value = "um")]
    position_unit: String,
    /// Seconds at the start that only settle the stack's memory; default: the first of several periods.
    #[arg(long, value_parser = number(0.0..=1.0e9, " s"))]
    settle: Option<f64>,
    /// Period of the excitation (s); default: that of the array, if it has periods.
    #[arg(long, value_parser = number(1.0e-8..=1.0e9, " s"))]
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
        (Some(drive), Some(position), _) => arrays::read(&args, drive, position)?,
        (_, _, Some(table)) => vec![table::read(&args, table)?],
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
        // What was made of the times: whoever knows the rate sees at once whether it is that.
        let clock = args.time.as_ref().map_or_else(String::new, |_| {
            let lost: u64 = recording.lost().iter().map(|hole| hole.ticks).sum();
            format!(", {} Hz, {lost} lost", recording.meta.sample_rate_hz)
        });
        say!("{}: {} samples, {} axes{clock}", path.display(), recording.len(), recording.axes())?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use ndarray::{Array2, Array4};
    use ndarray_npy::WriteNpyExt;
    use std::fs;

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

        // 3000 Hz with four decimals: the median step is 0.3 ms.
        let row = |row: u32| format!("{:.4},{row},{row}\n", f64::from(row) / 3000.0);
        let text: String = (0..5000).map(row).collect();
        fs::write(folder.path().join("c.csv"), "time,u,y\n".to_owned() + &text).unwrap();
        import(
            folder.path(),
            "--table @/c.csv --columns drive_v_1=u,position_um_1=y --time time --out @/c.parquet",
        )
        .unwrap();
        let recording = Recording::read(folder.path().join("c.parquet")).unwrap();
        assert_eq!((recording.meta.sample_rate_hz, recording.lost().len()), (3000.0, 0));
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
