//! How a drift or the phase of a hum goes over a session, drawn: what a dozen coefficients do not show.

use host_sim::effects::walk::Walk;
use report::plot::{LinePlot, Series};

use crate::diagnosis::Cause;
use crate::fitting::knobs::{AHEAD, WANDERS};

/// Points of a line.
const POINTS: usize = 240;

/// A kind of walk.
struct Kind {
    parameters: &'static [&'static str],
    title: &'static str,
    unit: &'static str,
    scale: f64,
}

const KINDS: [Kind; 2] = [
    Kind { parameters: &WANDERS, title: "How the gauge drifts", unit: "drift (nm)", scale: 1.0e9 },
    Kind {
        parameters: &AHEAD,
        title: "How the grid runs ahead",
        unit: "phase (turns)",
        scale: 1.0,
    },
];

/// Whether a parameter of a cause is a coefficient of a walk, at any place.
pub(crate) fn is_of_walk(parameter: &str) -> bool {
    let mut names = KINDS.iter().flat_map(|kind| kind.parameters);
    names.any(|name| {
        parameter.strip_prefix(name).is_some_and(|rest| !rest.starts_with(char::is_alphanumeric))
    })
}

/// The walk of a cause on each of its axes over a session that ends at `ends_s`, if it goes one.
pub(crate) fn walk(cause: &Cause, ends_s: f64) -> Option<LinePlot> {
    let lines = |kind: &Kind| -> Vec<Series> {
        let of_axis = |&axis: &usize| {
            let size = |name: &&str| {
                let known = cause.parameters.get(&format!("{name}_{axis}"));
                known.or_else(|| cause.parameters.get(*name)).map(|p| p.value)
            };
            let sizes: Option<Vec<f64>> = kind.parameters.iter().map(size).collect();
            let mut walk = Walk::new(&sizes?, ends_s);
            let time_s = |k: usize| ends_s * k as f64 / (POINTS - 1) as f64;
            let at = |k: usize| (time_s(k), kind.scale * walk.at(time_s(k)));
            Some(Series::line(format!("axis {axis}"), (0..POINTS).map(at).collect()))
        };
        cause.axes.iter().filter_map(of_axis).collect()
    };
    KINDS.iter().map(|kind| (kind, lines(kind))).find(|(_, lines)| !lines.is_empty()).map(
        |(kind, lines)| {
            let plot = LinePlot::new(kind.title).x("time on the session's clock (s)").y(kind.unit);
            lines.into_iter().fold(plot, LinePlot::series)
        },
    )
}
