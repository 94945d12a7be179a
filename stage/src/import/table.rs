//! Tables of text to a recording.

use std::fs;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use recording::{Meta, Recording};

use super::{Args, clock, micrometres, volts};

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

pub(super) fn read(args: &Args, path: &Path) -> anyhow::Result<Recording> {
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
        (Some(which), _) => {
            let source = clock::Source { file: path, column: which, first_row: first };
            clock::clock(&column(which)?, &source)?
        }
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
