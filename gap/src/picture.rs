//! `report.html`: the findings as a person reads them, verdict first.

mod walk;

use host_sim::effects::find;
use report::plot::{Figure, HeatMap, LinePlot, Series, Waterfall};
use report::{Report, Table};

use crate::diagnose::Findings;
use crate::diagnosis::{CauseKind, Parameter, Role, Verdict};
use crate::locate::Cuts;
use crate::session::floor::Kind;
use crate::session::scene::{Channel, Stack};
use crate::session::spectra::spectrum;

/// Stages in the order of the chain.
const STAGES: [&str; 6] = ["drive", "amplifier", "piezo", "mechanism", "sensor", "environment"];

/// Draw the findings.
pub fn report(f: &Findings) -> Report {
    let mut page = Report::new(format!("Why {} and its simulation disagree", f.nominal.name))
        .verdict(crate::sentence(f.diagnosis));
    page = budget(page, f);
    page = location(page, f);
    if f.diagnosis.verdict != Verdict::NoGap {
        page = traces(page, f);
    }
    page = causes(page, f);
    page = leftover(page, f);
    recordings(page, f)
}

fn budget(page: Report, f: &Findings) -> Report {
    let gap = &f.diagnosis.gap;
    let mut fall = Waterfall::new("From the nominal gap to the noise", "rms gap (nm)")
        .start("rig as given", gap.before_nm);
    for (name, after) in f.staircase {
        fall = fall.step(name.clone(), *after);
    }
    fall = fall.end("noise", gap.floor_nm);
    let mut page = page.section("How large the gap is").paragraph(format!(
        "Root mean square over all axes and samples of {}: {:.2} nm before, {:.2} nm after, \
         with a noise floor of {:.2} nm. Closed: {:.1} % of the energy beyond noise (95 % interval {:.1} to {:.1} %).",
        crate::unfitted(f.diagnosis),
        gap.before_nm,
        gap.after_nm,
        gap.floor_nm,
        100.0 * gap.closed,
        100.0 * gap.closed_ci95[0],
        100.0 * gap.closed_ci95[1]
    ));
    page = page.figure(&fall, "Gap on what was held out as the causes are added one after the other; the last bar is the measured noise.");
    let mut table = Table::new(["axis", "before (nm)", "after (nm)", "noise (nm)", "closed (%)"]);
    for axis in &gap.per_axis {
        table = table.row([
            axis.axis.to_string(),
            format!("{:.2}", axis.before_nm),
            format!("{:.2}", axis.after_nm),
            format!("{:.2}", axis.floor_nm),
            if axis.before_nm > 1.05 * axis.floor_nm {
                format!("{:.1}", 100.0 * axis.closed)
            } else {
                "no gap".into()
            },
        ]);
    }
    page.table(table)
}

fn axis_names(f: &Findings) -> Vec<String> {
    (0..f.scene.position_noise.len()).map(|a| format!("axis {}", a + 1)).collect()
}

fn bands(cuts: &Cuts) -> (Vec<String>, Vec<Vec<f64>>) {
    let total: f64 = cuts.axis.iter().sum::<f64>().max(1.0e-30);
    let axes = cuts.axis.len();
    let columns = cuts
        .band
        .iter()
        .map(|(hz, _)| {
            if *hz == 0.0 {
                "mean".into()
            } else if *hz < 1.0 {
                format!("{hz:.2}")
            } else {
                format!("{hz:.0}")
            }
        })
        .collect();
    let rows =
        (0..axes).map(|a| cuts.band.iter().map(|(_, e)| 100.0 * e[a] / total).collect()).collect();
    (columns, rows)
}

fn location(page: Report, f: &Findings) -> Report {
    let mut page = page.section("Where it lies");
    if f.diagnosis.verdict == Verdict::NoGap {
        return page
            .paragraph("Nowhere: no axis, band or recording holds more than the noise does.");
    }
    let axes = f.scene.position_noise.len();
    let mut stage = vec![vec![0.0; STAGES.len()]; axes];
    for l in &f.diagnosis.location {
        if let Some(k) = STAGES.iter().position(|s| *s == l.stage) {
            stage[l.axis - 1][k] += 100.0 * l.share;
        }
    }
    let map = HeatMap::new("Share of the gap by axis and stage")
        .columns(STAGES)
        .rows(axis_names(f))
        .values(stage)
        .unit("%");
    let (columns, rows) = bands(f.cuts);
    // Recordings of several rates have bands of their own: a dozen columns and more, with no room for units.
    let band = HeatMap::new("Share of the gap (%) by axis and band (Hz)")
        .columns(columns)
        .rows(axis_names(f))
        .values(rows);
    let figures: Vec<(Box<dyn Figure>, &str)> = vec![
        (Box::new(map), "Stage of each axis that the gap comes from (before any effect is added)."),
        (
            Box::new(band),
            "Centre frequencies of factor-of-four bands; `mean` is a constant difference.",
        ),
    ];
    page = page.figures(figures);
    let mut level = LinePlot::new("By drive level").x("drive (V)").y("rms gap (nm)");
    for a in 0..axes {
        let points: Vec<_> =
            f.cuts.level.iter().filter_map(|(v, rms)| Some((*v, rms[a]?))).collect();
        // An axis at one level all the time is a point, of which no line would be seen.
        let series = if points.len() == 1 { Series::points } else { Series::line };
        level = level.series(series(format!("axis {}", a + 1), points).color(a));
    }
    let mut since = LinePlot::new("By time since the last step")
        .x("time since the step (s)")
        .y("rms gap (nm)")
        .log_x();
    since = since.series(Series::line("before", f.cuts.since_step.clone()));
    since = since.series(Series::line("after", f.cuts_after.since_step.clone()));
    let mut figures: Vec<(Box<dyn Figure>, String)> =
        vec![(Box::new(level), by_direction(f.cuts.direction))];
    if f.cuts.since_step.len() > 2 {
        figures.push((
            Box::new(since),
            "All axes together, after drive jumps of more than a twentieth of the range.".into(),
        ));
    }
    page.figures(figures)
}

/// The gap while the drive goes each way, in words; a way that it never goes is not said.
fn by_direction(gap_nm: [Option<f64>; 3]) -> String {
    let ways = ["rises", "falls", "stands still"].into_iter().zip(gap_nm);
    let said: Vec<String> =
        ways.filter_map(|(way, nm)| Some(format!("{way} {:.1} nm", nm?))).collect();
    format!("Gap while the drive {}.", said.join(", "))
}

/// Most instructive position channel: the largest gap, held out if that loses little. One in which a stack's memory is unknown shows less
/// than it holds, and has to do only where it is in all of them.
fn showcase<'a>(f: &'a Findings) -> Option<(usize, &'a Channel)> {
    let gap = |c: usize| {
        let energy = |r: &Vec<f32>| r.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
        f.before[c].as_ref().map_or(0.0, energy) / f.scene.channels[c].samples()
    };
    let is_known = |ch: &Channel| ch.kind == Kind::Position && !ch.has_memory();
    let any_known = f.scene.channels.iter().any(is_known);
    f.scene
        .channels
        .iter()
        .enumerate()
        .filter(|(_, ch)| ch.kind == Kind::Position && (is_known(ch) || !any_known))
        .max_by(|a, b| {
            let score = |(c, ch): &(usize, &Channel)| {
                gap(*c) * if ch.held_out { 4.0 } else { 1.0 } * ch.sigma.powi(2)
            };
            score(a).total_cmp(&score(b))
        })
}

fn traces(page: Report, f: &Findings) -> Report {
    let Some((c, channel)) = showcase(f) else { return page };
    let track = &f.scene.tracks[channel.track];
    let (Some(before), Some(after)) = (&f.before[c], &f.after[c]) else { return page };
    let Some(position) = &track.position_um[channel.axis] else { return page };
    let drive = &track.drive_v[channel.axis];
    let sigma = channel.sigma;
    let start = channel.range.start;
    let time = |k: usize| track.time_s(start + k);
    let with = |value: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
        (0..before.len()).map(|k| (time(k), value(k))).collect()
    };
    let measured = |k: usize| f64::from(position[start + k]);
    let traces = LinePlot::new(format!("{}, axis {}", track.experiment, channel.axis + 1))
        .x("time (s)")
        .y("position (um)")
        .series(Series::line("measured", with(&measured)))
        .series(Series::line(
            "simulated before",
            with(&|k| measured(k) - f64::from(before[k]) * sigma),
        ))
        .series(Series::dashed(
            "simulated after",
            with(&|k| measured(k) - f64::from(after[k]) * sigma),
        ));
    let errors = LinePlot::new("Measured minus simulated")
        .x("time (s)")
        .y("difference (nm)")
        .series(Series::line("before", with(&|k| f64::from(before[k]) * sigma * 1.0e3)).color(1))
        .series(Series::line("after", with(&|k| f64::from(after[k]) * sigma * 1.0e3)).color(2));
    let against_drive = |row: &[f32]| -> Vec<(f64, f64)> {
        (0..row.len()).map(|k| (drive[start + k], f64::from(row[k]) * sigma * 1.0e3)).collect()
    };
    let thin = |points: Vec<(f64, f64)>| -> Vec<(f64, f64)> {
        let step = points.len().div_ceil(4000).max(1);
        points.into_iter().step_by(step).collect()
    };
    let loops = LinePlot::new("Difference against drive")
        .x("drive (V)")
        .y("difference (nm)")
        .series(Series::points("before", thin(against_drive(before))).color(1))
        .series(Series::points("after", thin(against_drive(after))).color(2));
    let mut spectra = LinePlot::new("Spectrum of the difference")
        .x("frequency (Hz)")
        .y("nm / sqrt(Hz)")
        .log_x()
        .log_y();
    let mut floor = 0.0;
    for (name, row, colour) in [("before", before, 1), ("after", after, 2)] {
        let (step, power) = spectrum(row, track.rate_hz);
        spectra =
            spectra.series(Series::line(name, octaves(step, &power, sigma * 1.0e3)).color(colour));
        floor = sigma * 1.0e3 * (2.0 / track.rate_hz).sqrt();
    }
    spectra = spectra.hline(floor, "noise");
    let of = if channel.held_out { crate::unfitted(f.diagnosis) } else { "all recordings" };
    let figures: Vec<(Box<dyn Figure>, String)> = vec![
        (Box::new(traces), format!("{}: the largest gap of {of}.", track.file)),
        (Box::new(errors), "The same, difference only.".into()),
        (Box::new(loops), "A loop is memory or lag, a curve a static error, a fan a gain.".into()),
        (Box::new(spectra), "Twelfth-octave means; the line is the measured white noise.".into()),
    ];
    page.section("Before and after").figures(figures)
}

/// Means over twelfths of an octave of an amplitude density, for a log axis.
fn octaves(step_hz: f64, power: &[f64], scale: f64) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = Vec::new();
    let mut low = 1;
    while low < power.len() {
        let high =
            ((low as f64 * 2.0_f64.powf(1.0 / 12.0)).ceil() as usize).max(low + 1).min(power.len());
        let mean = power[low..high].iter().sum::<f64>() / (high - low) as f64;
        out.push((0.5 * (low + high - 1) as f64 * step_hz, scale * mean.sqrt()));
        low = high;
    }
    out.retain(|(_, y)| *y > 0.0);
    out
}

fn figures_of(p: &Parameter) -> String {
    let half = 0.5 * (p.ci95[1] - p.ci95[0]);
    let unit = if p.unit == "1" { "" } else { &p.unit };
    format!("{} ± {} {unit}", engineering(p.value), engineering(half))
}

/// Four significant digits, exponents where they help.
fn engineering(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 {
        "0".into()
    } else if (1.0e-3..1.0e5).contains(&size) {
        let digits = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.3e}")
    }
}

fn causes(page: Report, f: &Findings) -> Report {
    if f.diagnosis.causes.is_empty() {
        return page;
    }
    let mut page = page.section("What causes it");
    for cause in &f.diagnosis.causes {
        let axes: Vec<String> = cause.axes.iter().map(usize::to_string).collect();
        let kind = match cause.kind {
            CauseKind::Parametric => "a wrong value",
            CauseKind::Structural => "missing physics",
        };
        let closes = match &f.diagnosis.band {
            Some(band) => format!(
                "with what else is named closes {:.1} % of the gap below {:.0} Hz",
                100.0 * band.closed(),
                band.below_hz
            ),
            None => format!("closes {:.1} % of the gap", 100.0 * cause.closes),
        };
        page = page.paragraph(format!(
            "{} ({} stage, {kind}) on axis {}: {closes}, confidence {:.0} %.",
            cause.effect,
            cause.stage,
            axes.join(", "),
            100.0 * cause.confidence
        ));
        let is_told = |(name, _): &(&String, &Parameter)| !walk::is_of_walk(name);
        let told: Vec<_> = cause.parameters.iter().filter(is_told).collect();
        if !told.is_empty() {
            let table = Table::new(["parameter", "value (95 % interval)"]);
            let row = |table: Table, (name, parameter): (&String, &Parameter)| {
                table.row([name.clone(), figures_of(parameter)])
            };
            page = page.table(told.into_iter().fold(table, row));
        }
        if let Some(plot) = walk::walk(cause, f.scene.clock_s().1) {
            page = page.figure(&plot, "Over the session, pauses between recordings included. The coefficients are in diagnosis.json and rig.toml.");
        }
        if let Some(effect) = find(&cause.effect) {
            let info = effect.info();
            page = page
                .paragraph(format!("Physics: {} Revealed by {}.", info.physics, info.revealed_by));
        }
        page = page.paragraph(if cause.indistinguishable_from.is_empty() {
            "Nothing else in the catalogue explains these recordings as well.".to_string()
        } else {
            format!(
                "These recordings cannot tell it from {}: either may be the cause.",
                cause.indistinguishable_from.join(" or ")
            )
        });
    }
    if let Some(next) = &f.diagnosis.next_experiment {
        page = page.section("What to record next").paragraph(format!(
            "To tell {} apart: {}.",
            next.separates.join(" and "),
            next.excitation
        ));
    }
    if !f.tried.is_empty() {
        let mut table = Table::new(["effects", "explains (%)"]);
        for (name, share) in f.tried {
            table = table.row([name.clone(), format!("{:.2}", 100.0 * share)]);
        }
        page = page
            .section("What else was tried")
            .paragraph("Share of the gap of the fitted recordings that each model explains, every band and recording weighed alike.")
            .table(table);
    }
    page
}

fn energy_of(stack: &Stack) -> f64 {
    stack.iter().flatten().map(|r| r.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>()).sum()
}

fn leftover(page: Report, f: &Findings) -> Report {
    if f.diagnosis.verdict == Verdict::NoGap {
        return notes(page, f);
    }
    let mut page = page.section("What was not explained");
    let (columns, rows) = bands(f.cuts_after);
    let total: f64 = f.cuts_after.axis.iter().sum();
    let before: f64 = f.cuts.axis.iter().sum::<f64>().max(1.0e-30);
    let share = 100.0 * total / before;
    page = page.paragraph(format!(
        "{share:.2} % of the energy beyond noise is left over all recordings (energy of all residuals {:.3} of what it was).",
        energy_of(f.after) / energy_of(f.before).max(1.0e-30)
    ));
    if share > 0.5 {
        let band = HeatMap::new("Share of what is left (%) by axis and band (Hz)")
            .columns(columns)
            .rows(axis_names(f))
            .values(rows);
        page = page.figure(&band, "Where the remainder lies.");
    }
    if let Some(rest) = &f.diagnosis.rest {
        page = crate::rest::draw(page, rest);
    }
    notes(page, f)
}

fn notes(mut page: Report, f: &Findings) -> Report {
    for note in &f.diagnosis.notes {
        page = page.paragraph(note);
    }
    page
}

fn recordings(page: Report, f: &Findings) -> Report {
    let mut table = Table::new(["recording", "used to", "before (nm)", "after (nm)"]);
    let is_in_parts = f.diagnosis.recordings.iter().all(|r| r.role == Role::Fit);
    for r in &f.diagnosis.recordings {
        let role = match r.role {
            Role::Fit if is_in_parts => "fit and check, in parts",
            Role::Fit => "fit",
            Role::HeldOut => "check",
        };
        table = table.row([
            r.file.clone(),
            role.into(),
            format!("{:.2}", r.before_nm),
            format!("{:.2}", r.after_nm),
        ]);
    }
    page.section("Recordings").table(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_that_never_stands_has_no_gap_there() {
        assert_eq!(
            by_direction([Some(2.04), Some(3.0), None]),
            "Gap while the drive rises 2.0 nm, falls 3.0 nm."
        );
    }
}
