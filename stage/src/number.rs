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

/// A value parser for sample rates, as recordings can have.
pub fn rate() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number(0.001..=1.0e8, " Hz")
}

/// A value parser for whole numbers of a range.
pub fn whole(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<u64, String> + Clone + Send + Sync + 'static {
    move |text| match text.trim().parse::<u64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("expected a whole number from {} to {}", range.start(), range.end())),
    }
}

/// The command, told that `-1` after an option is its value: what is wrong with it is for its value parser to say. Otherwise it is
/// taken for an option that there is not.
pub fn take_negative(command: clap::Command) -> clap::Command {
    let command = command.mut_args(|arg| {
        let takes_value = arg.get_long().is_some() && arg.get_action().takes_values();
        if takes_value { arg.allow_negative_numbers(true) } else { arg }
    });
    command.mut_subcommands(take_negative)
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
    match error.kind() {
        ErrorKind::ValueValidation => {
            let why = error.source().map(ToString::to_string).unwrap_or_default();
            Some(format!("{option} {value}: {why}"))
        }
        ErrorKind::InvalidValue => {
            let expected = match error.get(ContextKind::ValidValue) {
                Some(ContextValue::Strings(valid)) if !valid.is_empty() => valid.join(", "),
                _ => "a value".to_owned(),
            };
            let found = if value.is_empty() { "nothing" } else { value };
            Some(format!("{option}: expected {expected}, found {found}"))
        }
        _ => None,
    }
}
