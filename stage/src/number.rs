//! Numbers of options: finite, within a range that is said with its unit. What cannot be is refused before any work.

use std::error::Error;
use std::ops::RangeInclusive;

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// A value parser for numbers of a range; `unit` as it is written after them.
pub fn number(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    // NaN is in no range.
    move |text| match text.trim().parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("expected a number from {} to {}{unit}", range.start(), range.end())),
    }
}

/// A value parser for axes, from 1.
pub fn axis(text: &str) -> Result<usize, String> {
    match text.trim().parse::<usize>() {
        Ok(axis) if (1..=telemetry::AXES).contains(&axis) => Ok(axis),
        _ => Err(format!("expected an axis from 1 to {}", telemetry::AXES)),
    }
}

/// A value that its option refuses, in the one line that every other error has; `None` for errors of another kind, which clap explains.
pub fn line(error: &clap::Error) -> Option<String> {
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.as_str()),
        _ => None,
    };
    let (argument, value) = (text(ContextKind::InvalidArg)?, text(ContextKind::InvalidValue)?);
    // Without the placeholder of its value: `--seconds <SECONDS>`.
    let option = argument.split(' ').next().unwrap_or(argument);
    (error.kind() == ErrorKind::ValueValidation).then(|| {
        format!("{option} {value}: {}", error.source().map(ToString::to_string).unwrap_or_default())
    })
}
