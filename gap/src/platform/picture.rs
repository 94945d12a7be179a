//! The report of a platform: the paper's figures 6 and 7 for these recordings, what is left over time, and the numbers.

use host_sim::platform::{PlatformRig, modes, time_to_fraction_s};
use report::{
    Report, Table,
    plot::{Bar, BarPlot, Figure, LinePlot, Series},
};

use super::{
    data::Return,
    diagnose::{Findings, predicted_m},
    identify::digits,
};

/// Draw the findings.
pub fn report(findings: &Findings) -> Report {
    let diagnosis = &findings.diagnosis;
    let mut report = Report::new(format!("Gap of platform {}", findings.nominal.name))
        .verdict(crate::sentence(diagnosis))
        .section("Measured and simulated return");
    for data in findings.returns {
        report = report.figures(vec![
            (Box::new(return_plot(findings, data)) as Box<dyn Figure>, format!(
                "{}: released from {} um. One mass is the rig as given; found is the rig with what the diagnosis added.",
                data.file,
                digits(data.initial_m * 1e6, 4)
            )),
            (Box::new(residual_plot(findings, data)), format!(
                "What is left of {}: simulation minus measurement on a logarithmic clock, with the band of two standard \
                 deviations of the measured noise.",
                data.file
            )),
        ]);
    }
    report = report.section("Where in time");
    let mut bars = BarPlot::new("Share of the gap's energy").y("share");
    let mut windows =
        Table::new(["after the release", "rig as given", "with what was found", "share"]);
    for window in &findings.windows {
        let span = format!("{:.2} to {:.2} s", window.span_s[0], window.span_s[1]);
        bars = bars.bar(Bar::new(span.clone(), window.share));
        windows = windows.row([
            span,
            format!("{} um", digits(window.before_m * 1e6, 3)),
            format!("{} um", digits(window.after_m * 1e6, 3)),
            format!("{:.1} %", 100.0 * window.share),
        ]);
    }
    report = report
        .figure(
            &bars,
            "Windows that double in length from the release; shares of the energy above the noise.",
        )
        .table(windows)
        .section("Held-out gap")
        .paragraph(format!("{}.", capital(&findings.split.how)))
        .table(tried(findings))
        .section("Times to return")
        .table(times(findings))
        .section("Parameters of the rig that was found")
        .table(parameters(findings));
    if let Some(next) = &diagnosis.next_experiment {
        report = report
            .section(format!("To tell {} apart", next.separates.join(" and ")))
            .paragraph(&next.excitation);
    }
    report = report.section("What was measured and what cannot be told");
    for note in &diagnosis.notes {
        report = report.paragraph(note);
    }
    report
        .section("Roots of det(\u{3bb}\u{b2}M + \u{3bb}C + K) = 0")
        .table(roots(findings))
        .details(
            "rig.toml",
            findings.found.model.rig.to_toml().lines().map(str::to_owned).collect::<Vec<_>>(),
        )
}

fn capital(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or(String::new(), |first| first.to_uppercase().chain(chars).collect())
}

/// Name of the rig as given: how many masses it has.
fn given_name(rig: &PlatformRig) -> String {
    match rig.masses.len() {
        1 => "one mass".to_owned(),
        2 => "two masses".to_owned(),
        n => format!("{n} masses"),
    }
}

fn um(data: &Return, position_m: &[f64]) -> Vec<(f64, f64)> {
    data.time_s.iter().zip(position_m).map(|(t, x)| (*t, x * 1e6)).collect()
}

fn return_plot(findings: &Findings, data: &Return) -> LinePlot {
    let mut plot = LinePlot::new("Return of the platform")
        .x("time after the release (s)")
        .y("position (um)")
        .series(Series::points("measured", um(data, &data.position_m)).color(0))
        .series(
            Series::dashed(
                format!("{}, as given", given_name(findings.nominal)),
                um(data, &predicted_m(findings.nominal, data)),
            )
            .color(1),
        );
    if !findings.selection.accepted.is_empty() {
        plot = plot.series(
            Series::line("found", um(data, &predicted_m(&findings.found.model.rig, data))).color(2),
        );
    }
    plot
}

fn residual_plot(findings: &Findings, data: &Return) -> LinePlot {
    let noise = findings
        .returns
        .iter()
        .position(|own| own.file == data.file)
        .map_or(0.0, |index| findings.noise[index].rms_m * 1e6);
    let left = |rig: &PlatformRig| -> Vec<(f64, f64)> {
        predicted_m(rig, data)
            .iter()
            .enumerate()
            .filter(|(row, _)| data.time_s[*row] > 0.0)
            .map(|(row, x)| (data.time_s[row], (x - data.position_m[row]) * 1e6))
            .collect()
    };
    let mut plot = LinePlot::new("Simulation minus measurement")
        .x("time after the release (s)")
        .y("difference (um)")
        .log_x()
        .band(-2.0 * noise, 2.0 * noise)
        .series(
            Series::line(
                format!("{}, as given", given_name(findings.nominal)),
                left(findings.nominal),
            )
            .color(1),
        );
    if let Some(refitted) = &findings.refitted {
        plot = plot.series(
            Series::line(
                format!("{}, refitted", given_name(findings.nominal)),
                left(&refitted.model.rig),
            )
            .color(3),
        );
    }
    if !findings.selection.accepted.is_empty() {
        plot = plot.series(Series::line("found", left(&findings.found.model.rig)).color(2));
    }
    plot
}

fn tried(findings: &Findings) -> Table {
    let diagnosis = &findings.diagnosis;
    let mut table =
        Table::new(["model", "free parameters", "gap on held-out samples", "over noise"]);
    let floor = diagnosis.gap.floor_nm;
    let mut row = |name: String, parameters: usize, nm: f64| {
        let old = std::mem::replace(&mut table, Table::new([""]));
        table = old.row([
            name,
            parameters.to_string(),
            format!("{} um", digits(nm / 1e3, 4)),
            digits(nm / floor, 4),
        ]);
    };
    row("rig as given".to_owned(), 0, diagnosis.gap.before_nm);
    let mut alternatives: Vec<_> = findings.selection.tried.iter().collect();
    alternatives.sort_by(|a, b| a.held_out_m.total_cmp(&b.held_out_m));
    for tried in alternatives {
        row(tried.effect.name().to_owned(), tried.fit.values.len(), tried.held_out_m * 1e9);
    }
    if findings.selection.accepted.len() > 1 {
        let names: Vec<&str> =
            findings.selection.accepted.iter().map(|a| a.effect.name()).collect();
        row(names.join(" + "), findings.selection.fit.values.len(), diagnosis.gap.after_nm);
    }
    row("noise".to_owned(), 0, floor);
    table
}

fn times(findings: &Findings) -> Table {
    let mut table = Table::new(["recording", "curve", "to 50 %", "to 10 %", "to 2 %"]);
    for data in findings.returns {
        let smooth = smoothed(&data.position_m);
        let curves = [
            ("measured (mean of 9 samples)".to_owned(), smooth),
            (
                format!("{}, as given", given_name(findings.nominal)),
                predicted_m(findings.nominal, data),
            ),
            ("found".to_owned(), predicted_m(&findings.found.model.rig, data)),
        ];
        for (name, curve) in curves {
            let at = |fraction: f64| {
                time_to_fraction_s(&data.time_s, &curve, data.initial_m, fraction)
                    .map_or("later".to_owned(), |t| format!("{} s", digits(t, 3)))
            };
            table = table.row([data.file.clone(), name, at(0.5), at(0.1), at(0.02)]);
        }
    }
    table
}

/// Mean of nine samples, so that noise does not set the time at which a level is crossed for good.
pub fn smoothed(position: &[f64]) -> Vec<f64> {
    (0..position.len())
        .map(|i| {
            let reach = i.min(position.len() - 1 - i).min(4);
            let part = &position[i - reach..=i + reach];
            part.iter().sum::<f64>() / part.len() as f64
        })
        .collect()
}

fn parameters(findings: &Findings) -> Table {
    let mut table = Table::new(["parameter", "value", "95 % interval", "unit"]);
    let extra = findings.diagnosis.causes.iter().flat_map(|cause| {
        cause.parameters.iter().map(|(name, p)| (name.clone(), p.value, p.ci95, p.unit.clone()))
    });
    let chain = findings
        .parameters
        .iter()
        .map(|p| (p.name.clone(), p.estimate.value, p.estimate.ci95, p.unit.to_owned()));
    let mut seen: Vec<String> = Vec::new();
    for (name, value, [low, high], unit) in chain.chain(extra) {
        if !seen.contains(&name) {
            table = table.row([
                name.clone(),
                digits(value, 5),
                format!("{} to {}", digits(low, 5), digits(high, 5)),
                unit,
            ]);
            seen.push(name);
        }
    }
    table
}

fn roots(findings: &Findings) -> Table {
    let mut table = Table::new(["rig", "root (1/s)", "time constant"]);
    for (name, rig) in [("as given", findings.nominal), ("found", &findings.found.model.rig)] {
        for root in modes::roots(rig).unwrap_or_default() {
            let value = if root.im == 0.0 {
                digits(root.re, 5)
            } else {
                format!("{} {:+.4}i", digits(root.re, 5), root.im)
            };
            table = table.row([name.to_owned(), value, format!("{} s", digits(-1.0 / root.re, 4))]);
        }
    }
    table
}
